//! Names by a vision-language model, from a server within the test. The run has masks and no later result.

use crate::common::{CopiedRun, said};
use crate::server::{Act, Server, refusal, reply};
use serde_json::{Value, json};
use std::fs;
use std::process::Output;

/// A run with frames and masks, and a model that acts on the number of the request.
struct Asked {
    run: CopiedRun,
    server: Server,
}

impl Asked {
    fn new(act: impl Fn(usize) -> Act + Send + Sync + 'static) -> Self {
        let run = CopiedRun::new();
        for stage in ["gaussians", "entities", "scene"] {
            fs::remove_dir_all(run.path(stage)).unwrap();
        }
        assert!(run.objects().len() >= 3);
        Self { run, server: Server::new(move |n, _| act(n)) }
    }

    /// Options that name the server. Objects are asked about in their order.
    fn options(&self) -> [String; 6] {
        let url = format!("vlm.url={}", self.server.url);
        ["--set", &url, "--set", "vlm.model=seer-1", "--set", "vlm.parallel=1"].map(str::to_owned)
    }

    fn name(&self, more: &[&str]) -> Output {
        let options = self.options();
        let options: Vec<&str> = options.iter().map(String::as_str).collect();
        self.run.run("name", &[&["--ask"], more, &options].concat())
    }

    /// Runs the command, which must succeed, and returns the names that it prints, by label.
    fn names(&self, more: &[&str]) -> Value {
        let output = self.name(&[&["--json"], more].concat());
        assert!(output.status.success(), "{}", said(&output));
        serde_json::from_slice(&output.stdout).unwrap()
    }

    fn requests(&self) -> usize {
        self.server.requests().len()
    }
}

impl CopiedRun {
    fn labels(&self) -> Vec<u8> {
        fs::read(self.path("masks/labels.json")).unwrap()
    }

    fn objects(&self) -> Vec<Value> {
        let labels: Value = serde_json::from_slice(&self.labels()).unwrap();
        labels["objects"].as_array().unwrap().clone()
    }
}

fn mug(_: usize) -> Act {
    reply(r#"{"name": "Mug", "description": "blue ceramic mug"}"#)
}

#[test]
fn objects_with_a_number_get_unique_names_and_descriptions() {
    let asked = Asked::new(mug);
    let before = asked.run.labels();
    asked.run.edit_labels("\"name\": \"object_02\"", "\"name\": \"mug\"");
    let names = asked.names(&["object_01=base"]);
    let objects = asked.run.objects();
    assert_eq!(asked.requests(), objects.len() - 2, "one question for each object without a name");
    assert_eq!(asked.server.requests()[0].body["model"], "seer-1");
    for (i, object) in objects.iter().enumerate() {
        let (name, description) = match i {
            0 => ("base".to_owned(), ""),
            1 => ("mug".to_owned(), ""),
            _ => (format!("mug_{i}"), "blue ceramic mug"),
        };
        assert_eq!((&object["name"], &object["description"]), (&json!(name), &json!(description)));
        assert_eq!(names[format!("names.{}", object["id"])], name);
    }
    // Nothing is left to ask about.
    let requests = asked.requests();
    assert_eq!(asked.names(&[]), names);
    assert_eq!(asked.requests(), requests);
    // The same questions have stored replies.
    fs::write(asked.run.path("masks/labels.json"), before).unwrap();
    assert_eq!(asked.names(&["object_01=base", "object_02=mug", "--set", "vlm.cache_only=true"]), names);
    assert_eq!((asked.requests(), asked.run.objects()), (requests, objects));
}

#[test]
fn merged_objects_are_not_asked_about_and_an_unknown_one_keeps_its_name() {
    let unknown = |_| reply(r#"{"name": "unknown", "description": "something grey"}"#);
    let asked = Asked::new(move |n| if n == 0 { unknown(n) } else { mug(n) });
    asked.run.edit_labels("\"merge_into\": null", "\"merge_into\": \"object_02\"");
    asked.run.edit_labels("\"description\": \"\"", "\"description\": \"a piece\"");
    let output = asked.name(&[]);
    assert!(output.status.success(), "{}", said(&output));
    let told = said(&output).matches("object_02=").count();
    assert_eq!(told, 1, "the command that names it by hand: {}", said(&output));
    let objects = asked.run.objects();
    assert_eq!(asked.requests(), objects.len() - 1);
    let names: Vec<&str> = objects.iter().map(|o| o["name"].as_str().unwrap()).collect();
    assert_eq!(names[..3], ["object_01", "object_02", "mug"]);
    assert_eq!((&objects[0]["description"], &objects[1]["description"]), (&json!("a piece"), &json!("")));
}

#[test]
fn a_server_that_cannot_be_used_changes_no_name() {
    let asked = Asked::new(|_| refusal(401, "no such key"));
    let before = asked.run.labels();
    let refused = asked.name(&["object_01=base"]);
    assert_eq!((refused.status.code(), asked.requests()), (Some(2), 1), "{}", said(&refused));
    // Wrong names are refused before any question.
    let wrong = asked.name(&["object_01=floor"]);
    assert_eq!((wrong.status.code(), asked.requests()), (Some(2), 1), "{}", said(&wrong));
    let without = asked.run.run("name", &["--ask", "object_01=base", "--set", "vlm.url="]);
    assert_eq!(without.status.code(), Some(2), "{}", said(&without));
    let setting = "SMS_VLM_URL";
    assert!(said(&without).contains(setting), "{}", said(&without));
    assert_eq!(asked.run.labels(), before);
}

#[cfg(unix)]
#[test]
fn an_interruption_changes_no_name() {
    use std::process::{Command, Stdio};
    use std::time::{Duration, Instant};

    let asked = Asked::new(|n| if n == 0 { mug(n) } else { Act::Hang });
    let before = asked.run.labels();
    let mut command = Command::new(env!("CARGO_BIN_EXE_sms"));
    command.args(["name", &asked.run.folder(), "--ask", "object_01=base", "--quiet"]).args(asked.options());
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let began = Instant::now();
    while asked.requests() < 2 {
        assert!(began.elapsed() < Duration::from_secs(60), "the second question was not asked");
        std::thread::sleep(Duration::from_millis(20));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert_eq!(asked.run.labels(), before);
}
