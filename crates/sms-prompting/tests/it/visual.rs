//! Visual prompting over real connections: valid answers, invalid ones, an unreachable server.

use glamx::{DPose3, DVec3};
use sms_core::{Camera, Cancel, ColorImage, Intrinsics, Mesh, Seed, StageContext, Warnings};
use sms_prompting::{
    ApproachSettings, Chooser, ObjectSurface, Observation, PromptedChoice, PromptingInputs, SiteSettings,
    Sites, landing_sites, visual_prompting,
};
use sms_robots::Quadrotor;
use sms_vlm::{Cache, ChooseError, Client, VlmConfig};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpListener;
use std::path::Path;
use std::sync::{Arc, Mutex};

/// A chat-completions server that answers request `n` with `replies[n]`, then always with the last one, and records
/// the bodies.
fn server(replies: Vec<&'static str>) -> (String, Arc<Mutex<Vec<serde_json::Value>>>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}/v1", listener.local_addr().unwrap());
    let asked = Arc::new(Mutex::new(Vec::new()));
    let all = Arc::clone(&asked);
    // The thread lives as long as the test's process.
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let Ok(mut stream) = stream else { continue };
            let mut reader = BufReader::new(stream.try_clone().unwrap());
            let mut length = 0;
            loop {
                let mut line = String::new();
                if reader.read_line(&mut line).unwrap_or(0) == 0 || line.trim().is_empty() {
                    break;
                }
                if let Some((name, value)) = line.split_once(':')
                    && name.eq_ignore_ascii_case("content-length")
                {
                    length = value.trim().parse().unwrap();
                }
            }
            let mut body = vec![0; length];
            if reader.read_exact(&mut body).is_err() {
                continue;
            }
            let number = {
                let mut all = all.lock().unwrap();
                all.push(serde_json::from_slice(&body).unwrap());
                all.len() - 1
            };
            let reply = replies[number.min(replies.len() - 1)];
            let body =
                serde_json::json!({"choices": [{"message": {"content": reply}, "finish_reason": "stop"}]})
                    .to_string();
            let _ = write!(
                stream,
                "HTTP/1.1 200 OK\r\nConnection: close\r\nContent-Length: {}\r\n\r\n{body}",
                body.len()
            );
        }
    });
    (url, asked)
}

const TARGET: &str = "cardboard box";

fn scene() -> (Sites, Observation) {
    let half = DVec3::new(0.35, 0.25, 0.05);
    let mesh_w = Mesh::cuboid(half).transformed(&DPose3::from_translation(DVec3::Z * 0.65));
    let surface = ObjectSurface { name: "box".into(), mesh_w };
    let sites = landing_sites(&[surface], &Quadrotor::default(), &SiteSettings::default()).unwrap();
    let camera = Camera::look_at(
        Intrinsics::from_fov(320, 200, 1.1),
        DVec3::new(0.9, -0.9, 1.4),
        DVec3::Z * 0.6,
        DVec3::Z,
    );
    let image = ColorImage::filled(320, 200, [120, 130, 140]);
    (sites, Observation { image, camera, target: TARGET.into() })
}

fn prompted(url: &str, dir: &Path, change: impl Fn(&mut VlmConfig)) -> Result<PromptedChoice, ChooseError> {
    let mut config = VlmConfig {
        url: url.into(),
        model: "seer-1".into(),
        timeout_s: 5.0,
        max_retries: 1,
        backoff_s: 0.0,
        ..VlmConfig::default()
    };
    change(&mut config);
    let client = Client::new(&config, None, Seed(1)).unwrap();
    let (sites, observation) = scene();
    let start = DVec3::new(2.0, 0.0, 1.05);
    let settings = ApproachSettings::default();
    let inputs =
        PromptingInputs { observation: &observation, sites: &sites, start_w: start, approaches: &settings };
    let (cancel, warnings) = (Cancel::new(), Warnings::new());
    visual_prompting(&inputs, &client, &Cache::new(dir), StageContext::quiet(&cancel, &warnings))
}

#[test]
fn the_models_numbers_become_a_site_and_an_approach_and_are_kept() {
    let (url, asked) = server(vec![
        r#"{"reasoning": "over the base", "decision": 4}"#,
        "Reasoning: around the overhang\nDecision: 8",
    ]);
    let dir = tempfile::tempdir().unwrap();
    let done = prompted(&url, dir.path(), |_| {}).unwrap();
    let (sites, _) = scene();
    assert_eq!(done.choice.chooser, Chooser::VisualPrompting);
    assert_eq!(done.choice.site, sites.sites[3]);
    assert_eq!(done.choice.approach.id, 8);
    assert_eq!(done.choice.reasons, ["over the base".to_owned(), "around the overhang".to_owned()]);
    let [_, _, to] = done.choice.approach.path.control_w();
    assert!(to.truncate().distance(sites.sites[3].p_w.truncate()) < 1e-12);
    {
        let asked = asked.lock().unwrap();
        assert_eq!(asked.len(), 2);
        for body in asked.iter() {
            let parts = body["messages"][1]["content"].as_array().unwrap();
            assert!(
                parts[0]["image_url"]["url"].as_str().unwrap().starts_with("data:image/jpeg;base64,/9j/")
            );
            assert!(parts[1]["text"].as_str().unwrap().contains(TARGET));
            let schema = &body["response_format"]["json_schema"]["schema"]["properties"]["decision"];
            assert!(schema["enum"].as_array().unwrap().len() >= 9, "{schema}");
        }
    }
    // Again, without a request.
    let again = prompted("", dir.path(), |c| c.cache_only = true).unwrap();
    assert_eq!(again.choice, done.choice);
}

#[test]
fn unknown_marks_are_refused_after_two_repairs() {
    let (url, asked) = server(vec![r#"{"reasoning": "", "decision": 99}"#]);
    let dir = tempfile::tempdir().unwrap();
    let error = prompted(&url, dir.path(), |_| {}).unwrap_err();
    assert!(matches!(&error, ChooseError::Undecided { name, .. } if name == "landing site"), "{error}");
    assert_eq!(error.input("http://server/v1").unwrap().path, "http://server/v1");
    let asked = asked.lock().unwrap();
    assert_eq!(asked.len(), 3, "one question, two repairs");
    let messages = asked[2]["messages"].as_array().unwrap();
    assert_eq!(messages.len(), 6, "with both invalid answers and their repairs");
    assert!(
        !dir.path().exists() || std::fs::read_dir(dir.path()).unwrap().next().is_none(),
        "nothing to keep"
    );

    let (url, _) = server(vec![r#"{"decision": 0}"#, r#"{"decision": 2}"#, "no idea", r#"{"decision": 1}"#]);
    let other = tempfile::tempdir().unwrap();
    let done = prompted(&url, other.path(), |_| {}).unwrap();
    assert_eq!((done.choice.site.id, done.choice.approach.id), (2, 1), "repaired on request");
}

#[test]
fn an_unreachable_server_is_an_error() {
    // A port without listener.
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let dir = tempfile::tempdir().unwrap();
    let error = prompted(&format!("http://{free}/v1"), dir.path(), |_| {}).unwrap_err();
    assert!(
        matches!(&error, ChooseError::NoAnswer { what, .. } if what.contains(&free.to_string())),
        "{error}"
    );
}
