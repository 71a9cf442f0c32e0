//! Visual prompting over real connections: a right answer, a nonsense one, a server that is not there.

use glamx::{DPose3, DVec3};
use sms_core::{Camera, Cancel, ColorImage, Intrinsics, Mesh, Seed, Warnings};
use sms_prompting::{
    ApproachSettings, Chooser, Observation, Prompted, SiteSettings, Sites, Surface, landing_sites,
    visual_prompting,
};
use sms_robots::Quadrotor;
use sms_vlm::{Cache, ChooseError, Client, VlmConfig};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpListener;
use std::path::Path;
use std::sync::{Arc, Mutex};

/// A chat-completions server that answers request `n` with `replies[n]`, the last one ever after, and keeps the bodies.
fn server(replies: Vec<&'static str>) -> (String, Arc<Mutex<Vec<serde_json::Value>>>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}/v1", listener.local_addr().unwrap());
    let asked = Arc::new(Mutex::new(Vec::new()));
    let all = Arc::clone(&asked);
    // It lives as long as the test's process.
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

fn scene() -> (Sites, Observation) {
    let half = DVec3::new(0.35, 0.25, 0.05);
    let mesh_w = Mesh::cuboid(half).transformed(&DPose3::from_translation(DVec3::Z * 0.65));
    let surface = Surface { name: "box".into(), mesh_w };
    let sites = landing_sites(&[surface], &Quadrotor::default(), &SiteSettings::default()).unwrap();
    let camera = Camera::look_at(
        Intrinsics::from_fov(320, 200, 1.1),
        DVec3::new(0.9, -0.9, 1.4),
        DVec3::Z * 0.6,
        DVec3::Z,
    );
    let image = ColorImage::filled(320, 200, [120, 130, 140]);
    (sites, Observation { image, camera, target: "cardboard box".into() })
}

fn prompted(url: &str, dir: &Path, change: impl Fn(&mut VlmConfig)) -> Result<Prompted, ChooseError> {
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
    let (sites, seen) = scene();
    let start = DVec3::new(2.0, 0.0, 1.05);
    let settings = ApproachSettings::default();
    visual_prompting(
        &seen,
        &sites,
        start,
        &settings,
        &client,
        &Cache::new(dir),
        &Cancel::new(),
        &Warnings::new(),
    )
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
        for (body, words) in asked.iter().zip(["red circles", "propellers"]) {
            let parts = body["messages"][1]["content"].as_array().unwrap();
            assert!(
                parts[0]["image_url"]["url"].as_str().unwrap().starts_with("data:image/jpeg;base64,/9j/")
            );
            let text = parts[1]["text"].as_str().unwrap();
            assert!(
                text.contains(words) && text.contains("cardboard box") && text.contains("decision"),
                "{text}"
            );
            let schema = &body["response_format"]["json_schema"]["schema"]["properties"]["decision"];
            assert!(schema["enum"].as_array().unwrap().len() >= 9, "{schema}");
        }
    }
    // Again, without a request.
    let again = prompted("", dir.path(), |c| c.cache_only = true).unwrap();
    assert_eq!(again.choice, done.choice);
}

#[test]
fn a_number_that_is_not_there_is_told_to_the_model_and_then_refused() {
    let (url, asked) = server(vec![r#"{"reasoning": "", "decision": 99}"#]);
    let dir = tempfile::tempdir().unwrap();
    let error = prompted(&url, dir.path(), |_| {}).unwrap_err();
    let told = error.to_string();
    let ChooseError::Undecided { name, what } = &error else { panic!("{error}") };
    assert!(name == "landing site" && what.contains("no mark 99") && told.contains("cure"), "{told}");
    let input = error.input("http://server/v1").unwrap().to_string();
    assert!(input.contains("no mark 99") && input.contains("http://server/v1"), "{input}");
    let asked = asked.lock().unwrap();
    assert_eq!(asked.len(), 3, "one question, two repairs");
    let last =
        asked[2]["messages"].as_array().unwrap().last().unwrap()["content"].as_str().unwrap().to_owned();
    assert!(last.contains("no mark 99") && last.contains("one of 1, 2"), "{last}");
    assert!(
        !dir.path().exists() || std::fs::read_dir(dir.path()).unwrap().next().is_none(),
        "nothing to keep"
    );

    let (url, _) = server(vec![r#"{"decision": 0}"#, r#"{"decision": 2}"#, "no idea", r#"{"decision": 1}"#]);
    let other = tempfile::tempdir().unwrap();
    let done = prompted(&url, other.path(), |_| {}).unwrap();
    assert_eq!((done.choice.site.id, done.choice.approach.id), (2, 1), "put right when told");
}

#[test]
fn a_server_that_is_not_there_is_named_with_a_cure() {
    // A port that was just free.
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let dir = tempfile::tempdir().unwrap();
    let error = prompted(&format!("http://{free}/v1"), dir.path(), |_| {}).unwrap_err().to_string();
    assert!(
        error.contains("cannot be reached")
            && error.contains(&free.to_string())
            && error.contains("SMS_VLM_URL"),
        "{error}"
    );
}
