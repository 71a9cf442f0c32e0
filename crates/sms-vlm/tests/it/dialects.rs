//! Servers with different features and failures, over real connections: each question ends with validated values or
//! a reported fallback.

use crate::server::{Act, RecordedRequest as Request, Server, envelope, refusal, reply};
use serde_json::json;
use sms_core::{Cancel, CoreError, Seed, StageContext, Warnings};
use sms_vlm::{
    Answers, ApiKey, Cache, Client, Enforcement, HttpTransport, Outcome, Pause, Question, VlmConfig, ask,
};
use std::sync::{Arc, Mutex};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

const WHOLE: &str = r#"{"label_is_right": true, "label": "mug", "description": "a mug", "material": "ceramic", "properties": {
    "density_kg_m3": {"best": 2400, "low": 2200, "high": 2600}, "fill_factor": {"best": 0.35, "low": 0.25, "high": 0.5},
    "friction": {"best": 0.4, "low": 0.3, "high": 0.5}, "restitution": {"best": 0.5, "low": 0.3, "high": 0.6},
    "youngs_modulus_pa": {"best": 7e10, "low": 5e10, "high": 1e11}, "poissons_ratio": {"best": 0.22, "low": 0.2, "high": 0.25}}}"#;

/// Name of the first object.
const OBJECT: &str = "object_01";
const KEY: &str = "sk-test";

/// Records the requested pauses.
#[derive(Default)]
struct RecordedPauses(Mutex<Vec<f64>>);

impl Pause for RecordedPauses {
    fn pause(&self, seconds: f64, cancel: &Cancel) -> Result<(), CoreError> {
        self.0.lock().unwrap().push(seconds);
        cancel.check()
    }
}

struct Setup {
    server: Server,
    config: VlmConfig,
    dir: tempfile::TempDir,
    cancel: Cancel,
}

struct Done {
    answers: Result<Answers, CoreError>,
    warnings: Vec<sms_core::Warning>,
    pauses: Vec<f64>,
    requests: Vec<Request>,
    enforcement: Enforcement,
}

impl Done {
    fn outcomes(&self) -> &[Outcome] {
        &self.answers.as_ref().unwrap().outcomes
    }

    /// Asserts that the only question was answered completely.
    fn whole(&self) {
        assert!(
            matches!(self.outcomes(), [Outcome::Answered { faults, .. }] if faults.is_empty()),
            "{:?}",
            self.outcomes()
        );
        let estimate = self.outcomes()[0].answer().unwrap();
        assert_eq!((estimate.density.unwrap().best, estimate.material.as_str()), (2400.0, "ceramic"));
        assert_eq!(self.warnings, []);
    }

    /// Asserts that the only question has no answer, with a warning of this code about the object.
    fn fallback(&self, code: &str) {
        assert!(matches!(self.outcomes(), [Outcome::Fallback(_)]), "{:?}", self.outcomes());
        assert_eq!(self.warnings.len(), 1, "{:?}", self.warnings);
        let w = &self.warnings[0];
        assert!(w.message.contains(OBJECT) && !w.cure.is_empty(), "{w:?}");
        assert_eq!(w.code, code, "{w:?}");
    }
}

impl Setup {
    fn new(script: impl Fn(usize, &Request) -> Act + Send + Sync + 'static) -> Self {
        let server = Server::new(script);
        let config = VlmConfig {
            url: server.url.clone(),
            model: "seer-1".into(),
            timeout_s: 5.0,
            max_retries: 3,
            max_reply_bytes: 100_000,
            ..VlmConfig::default()
        };
        Self { server, config, dir: tempfile::tempdir().unwrap(), cancel: Cancel::new() }
    }

    fn ask(&self, objects: usize) -> Done {
        let questions: Vec<Question> = (1..=objects)
            .map(|i| Question {
                name: format!("object_{i:02}"),
                annotation: "mug".into(),
                is_surface: false,
                jpeg: vec![0xFF, 0xD8, i as u8],
            })
            .collect();
        let pause = Arc::new(RecordedPauses::default());
        let transport = Arc::new(HttpTransport::new(&self.config));
        let key = ApiKey::new(KEY).unwrap();
        let client = Client::with(&self.config, key, Seed(1), transport, pause.clone()).unwrap();
        let warnings = Warnings::new();
        let cache = Cache::new(&self.dir.path().join("vlm"));
        let answers = ask(&questions, &client, &cache, StageContext::quiet(&self.cancel, &warnings));
        let pauses = pause.0.lock().unwrap().clone();
        Done {
            answers,
            warnings: warnings.snapshot(),
            pauses,
            requests: self.server.requests(),
            enforcement: client.enforcement(),
        }
    }
}

fn one(script: impl Fn(usize, &Request) -> Act + Send + Sync + 'static) -> Done {
    Setup::new(script).ask(1)
}

#[test]
fn a_server_that_enforces_schemas_is_asked_once() {
    let done = one(|_, _| reply(WHOLE));
    done.whole();
    assert_eq!((done.requests.len(), done.enforcement), (1, Enforcement::NestedSchema));
    let request = &done.requests[0];
    assert_eq!((request.form(), request.path.as_str()), ("nested", "/v1/chat/completions"));
    assert_eq!(request.authorization.as_deref(), Some(format!("Bearer {KEY}").as_str()));
    assert_eq!(request.body["model"], "seer-1");
    let parts = request.body["messages"][1]["content"].as_array().unwrap();
    assert_eq!(parts[1]["image_url"]["url"], "data:image/jpeg;base64,/9gB");
    let usage = done.answers.unwrap().usage;
    assert_eq!((usage.requests, usage.prompt_tokens, usage.completion_tokens), (1, 1000, 100));
}

#[test]
fn servers_are_asked_as_strictly_as_they_can() {
    for (least, enforcement, requests) in [
        ("flat", Enforcement::FlatSchema, 2),
        ("object", Enforcement::JsonObject, 3),
        ("none", Enforcement::Prompt, 4),
    ] {
        let done = one(move |_, r| {
            if r.form() == least {
                reply(WHOLE)
            } else {
                refusal(400, "Invalid value for 'response_format': not supported by this model")
            }
        });
        done.whole();
        assert_eq!((done.enforcement, done.requests.len()), (enforcement, requests), "{least}");
        assert!(done.pauses.is_empty(), "a refusal is no reason to wait");
    }
    let bare = one(|_, r| if r.form() == "none" { reply(WHOLE) } else { Act::Http(422, vec![], vec![]) });
    bare.whole();
    assert_eq!(bare.enforcement, Enforcement::Prompt);
}

#[test]
fn server_capabilities_are_remembered_for_later_objects() {
    let done = Setup::new(|_, r| {
        if r.form() == "none" {
            reply(WHOLE)
        } else {
            refusal(400, "json_schema and json_object are unknown")
        }
    })
    .ask(6);
    assert_eq!(done.answers.as_ref().unwrap().answered(), 6);
    assert_eq!(done.requests.len(), 3 + 6);
}

#[test]
fn newer_models_have_other_parameters() {
    let done = one(|_, r| {
        if r.body.get("max_tokens").is_some() {
            refusal(400, "Unsupported parameter: 'max_tokens'. Use 'max_completion_tokens' instead.")
        } else if r.body.get("temperature").is_some() {
            refusal(400, "Unsupported value: 'temperature' does not support 0 with this model.")
        } else {
            reply(WHOLE)
        }
    });
    done.whole();
    assert_eq!((done.enforcement, done.requests.len()), (Enforcement::NestedSchema, 3));
    assert!(done.requests[2].body["max_completion_tokens"].is_u64());
}

#[test]
fn replies_in_parts_and_tool_calls_are_read() {
    one(|_, _| Act::Http(200, vec![], envelope(json!([{"type": "text", "text": WHOLE}])))).whole();
    let call = json!({"choices": [{"message": {"content": null,
        "tool_calls": [{"type": "function", "function": {"name": "answer", "arguments": WHOLE}}]}}]});
    one(move |_, _| Act::Http(200, vec![], call.to_string().into_bytes())).whole();
    one(|_, _| Act::Chunked(7, envelope(json!(WHOLE)))).whole();
}

#[test]
fn prose_around_the_object_is_left_aside() {
    one(|_, _| reply(&format!("Let me think {{…}}.\n```json\n{WHOLE}\n```\nI hope that {{helps}}!"))).whole();
}

#[test]
fn at_most_two_repairs_are_requested() {
    let units = WHOLE.replace(
        "\"best\": 2400, \"low\": 2200, \"high\": 2600",
        "\"best\": 2.4, \"low\": 2.2, \"high\": 2.6",
    );
    let first = units.clone();
    let done = one(move |n, _| reply(if n == 0 { &first } else { WHOLE }));
    done.whole();
    assert_eq!(done.requests.len(), 2);
    let faulty = "density";
    assert!(done.requests[1].last_text().contains(faulty));
    assert_eq!(done.requests[1].body["messages"].as_array().unwrap().len(), 4, "with what it said before");

    let done = one(move |_, _| reply(&units));
    assert_eq!(done.requests.len(), 3, "and no more");
    let Outcome::Answered { answer: estimate, faults, .. } = &done.outcomes()[0] else {
        panic!("{:?}", done.outcomes())
    };
    assert_eq!((estimate.density, estimate.friction.unwrap().best), (None, 0.4), "the rest is kept");
    assert_eq!(faults.len(), 1);
    assert_eq!((done.warnings.len(), done.warnings[0].code.as_str()), (1, "vlm_partial"));
    assert!(done.warnings[0].message.contains(OBJECT));

    let done = one(|_, _| reply("I am not able to see the picture."));
    done.fallback("vlm_fallback");
    assert_eq!(done.requests.len(), 3);
}

#[test]
fn wrong_units_and_missing_fields_are_converted_or_asked_for() {
    let text = WHOLE
        .replace(
            "2400, \"low\": 2200, \"high\": 2600",
            "\"2.4 g/cm3\", \"low\": \"2.2 g/cm³\", \"high\": \"2600 kg/m^3\"",
        )
        .replace(
            "7e10, \"low\": 5e10, \"high\": 1e11",
            "\"70 GPa\", \"low\": \"50 GPa\", \"high\": \"100000 MPa\"",
        )
        .replace("0.5, \"low\": 0.3, \"high\": 0.6", "\"50 %\", \"low\": \"30 %\", \"high\": \"60 %\"");
    let done = one(move |_, _| reply(&text));
    done.whole();
    let estimate = done.outcomes()[0].answer().unwrap();
    assert_eq!(estimate.youngs_modulus_pa.unwrap().best, 7e10);
    assert_eq!(estimate.restitution.unwrap().high, 0.6);
    let missing = WHOLE.replace("\"friction\"", "\"weight\"");
    let done = one(move |n, _| reply(if n < 2 { &missing } else { WHOLE }));
    done.whole();
    assert_eq!(done.requests.len(), 3);
}

#[test]
fn a_repair_that_fails_leaves_the_first_answer() {
    let partial = WHOLE.replace("\"friction\"", "\"weight\"");
    let done = one(move |n, _| if n == 0 { reply(&partial) } else { refusal(500, "out of memory") });
    let Outcome::Answered { answer: estimate, faults, .. } = &done.outcomes()[0] else {
        panic!("{:?}", done.outcomes())
    };
    assert_eq!((estimate.friction, faults.len()), (None, 1));
    assert_eq!(done.warnings[0].code, "vlm_partial");
}

#[test]
fn a_wrong_key_stops_everything_at_once_with_one_cure() {
    for status in [401, 403] {
        let done = Setup::new(move |_, _| refusal(status, "Incorrect API key provided")).ask(5);
        assert_eq!(done.requests.len(), 1, "the others are not asked");
        let answers = done.answers.as_ref().unwrap();
        assert!(answers.outcomes.iter().all(|o| matches!(o, Outcome::Fallback(_))));
        assert!(answers.given_up.is_some());
        assert_eq!(done.warnings.len(), 1, "{:?}", done.warnings);
        for i in 1..=5 {
            assert!(done.warnings[0].message.contains(&format!("object_0{i}")));
        }
        assert!(!format!("{:?}", done.warnings).contains(KEY));
    }
    one(|_, _| refusal(404, "model `seer-1` does not exist")).fallback("vlm_given_up");
    one(|_, _| Act::Http(308, vec![("Location", "http://elsewhere/".into())], vec![]))
        .fallback("vlm_given_up");
    let quota =
        json!({"error": {"message": "You exceeded your quota", "code": "insufficient_quota"}}).to_string();
    let done = one(move |_, _| Act::Http(429, vec![], quota.clone().into_bytes()));
    done.fallback("vlm_given_up");
    assert_eq!(done.requests.len(), 1);
}

#[test]
fn a_busy_server_is_asked_again_after_its_pause() {
    let done = one(|n, _| match n {
        0 => Act::Http(429, vec![("Retry-After", "7".into())], vec![]),
        1 => Act::Http(503, vec![("Retry-After", date_in(20))], b"busy".to_vec()),
        2 => Act::Http(500, vec![], b"oops".to_vec()),
        _ => reply(WHOLE),
    });
    done.whole();
    assert_eq!(done.requests.len(), 4);
    assert!((7.0..=7.1).contains(&done.pauses[0]), "{:?}", done.pauses);
    assert!((15.0..=20.1).contains(&done.pauses[1]), "a date counts from now: {:?}", done.pauses);
    assert!((2.0..=4.0).contains(&done.pauses[2]), "doubled twice, less the jitter: {:?}", done.pauses);
    let late = one(|_, _| Act::Http(429, vec![("Retry-After", "86400".into())], vec![]));
    late.fallback("vlm_fallback");
    assert!(
        late.pauses.is_empty() && late.requests.len() == 1,
        "longer than `max_backoff_s`: not asked again"
    );
    one(|n, _| if n == 0 { Act::Http(408, vec![], vec![]) } else { reply(WHOLE) }).whole();
}

/// Returns the date in a number of seconds in HTTP's format.
fn date_in(seconds: u64) -> String {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs() + seconds;
    let (days, rest) = (now / 86_400, now % 86_400);
    let (mut year, mut day) = (1970, days);
    let is_leap = |y: u64| y.is_multiple_of(4) && (!y.is_multiple_of(100) || y.is_multiple_of(400));
    while day >= 365 + u64::from(is_leap(year)) {
        day -= 365 + u64::from(is_leap(year));
        year += 1;
    }
    let lengths = [31, 28 + u64::from(is_leap(year)), 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    let mut month = 0;
    while day >= lengths[month] {
        day -= lengths[month];
        month += 1;
    }
    let names = ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"];
    let (h, m, s) = (rest / 3600, rest / 60 % 60, rest % 60);
    format!("Xxx, {:02} {} {year} {h:02}:{m:02}:{s:02} GMT", day + 1, names[month])
}

#[test]
fn connections_that_fail_are_tried_again_and_then_given_up() {
    one(|n, _| if n == 0 { Act::Drop } else { reply(WHOLE) }).whole();
    one(|n, _| if n == 0 { Act::CutBody(envelope(json!(WHOLE))) } else { reply(WHOLE) }).whole();
    one(|n, _| if n == 0 { Act::Garbage(b"\x16\x03\x01 no http\r\n\r\n".to_vec()) } else { reply(WHOLE) })
        .whole();
    let done = one(|_, _| Act::CutBody(envelope(json!(WHOLE))));
    done.fallback("vlm_fallback");
    assert_eq!(done.requests.len(), 4, "once and `max_retries` times more");
    let done = one(|_, _| Act::Drop);
    done.fallback("vlm_fallback");
}

#[test]
fn bodies_that_are_no_reply_are_never_taken_for_one() {
    for body in [
        b"<html><body>502 Bad Gateway</body></html>".to_vec(),
        b"".to_vec(),
        b"{\"choices\": []}".to_vec(),
        b"\xff\xfe\x00{".to_vec(),
        b"{\"error\": {\"message\": \"upstream is down\"}}".to_vec(),
        b"{\"choices\": [{\"message\": {\"content\": \"x".to_vec(),
    ] {
        let done = one(move |_, _| Act::Http(200, vec![], body.clone()));
        done.fallback("vlm_fallback");
        assert_eq!(done.requests.len(), 4);
    }
    // Text with invalid UTF-8 within a complete reply: the rest of it counts.
    let mut odd = envelope(json!(WHOLE.replace("a mug", "a m@g")));
    let at = odd.iter().position(|b| *b == b'@').unwrap();
    odd[at] = 0xFF;
    one(move |_, _| Act::Http(200, vec![], odd.clone())).whole();
    let huge = one(|_, _| Act::Http(200, vec![], envelope(json!("x".repeat(200_000)))));
    huge.fallback("vlm_fallback");
    assert_eq!(huge.requests.len(), 1, "it would be as large the next time");
    one(|_, _| Act::Chunked(10_000, vec![b' '; 300_000])).fallback("vlm_fallback");
    let declined = json!({"choices": [{"message": {"content": null, "refusal": "I cannot help with that"}}]});
    let done = one(move |_, _| Act::Http(200, vec![], declined.to_string().into_bytes()));
    done.fallback("vlm_fallback");
    assert_eq!(done.requests.len(), 1);
}

#[test]
fn a_silent_server_is_given_up() {
    let mut setup = Setup::new(|_, _| Act::Hang);
    setup.config.timeout_s = 0.2;
    setup.config.parallel = 1;
    let done = setup.ask(6);
    let answers = done.answers.as_ref().unwrap();
    assert!(answers.outcomes.iter().all(|o| matches!(o, Outcome::Fallback(_))));
    assert_eq!(done.requests.len(), 6, "two attempts each, and after three objects no more");
    assert!(answers.given_up.is_some());
    for i in 1..=6 {
        let name = format!("object_0{i}");
        assert!(done.warnings.iter().any(|w| w.message.contains(&name)), "{name}: {:?}", done.warnings);
    }
    let mut setup = Setup::new(|n, _| if n == 0 { Act::Hang } else { reply(WHOLE) });
    setup.config.timeout_s = 0.5;
    setup.ask(1).whole();
}

#[test]
fn an_unreachable_server_is_reported_once() {
    let mut setup = Setup::new(|_, _| Act::Drop);
    // A port without listener.
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    setup.config.url = format!("http://127.0.0.1:{port}/v1");
    let done = setup.ask(3);
    assert_eq!((done.warnings.len(), done.pauses.len()), (1, 3), "{:?}", done.warnings);
    assert_eq!(done.warnings[0].code, "vlm_given_up");
}

#[test]
fn cancellation_interrupts_a_pending_request() {
    let mut setup = Setup::new(|_, _| Act::Hang);
    setup.config.timeout_s = 600.0;
    let cancel = setup.cancel.clone();
    let stopper = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(100));
        cancel.cancel();
    });
    let done = setup.ask(2);
    stopper.join().unwrap();
    assert!(matches!(done.answers, Err(CoreError::Interrupted)));
}

#[test]
fn replies_are_stored_and_a_damaged_one_is_asked_for_again() {
    let mut setup = Setup::new(|_, _| reply(WHOLE));
    assert_eq!(setup.ask(3).requests.len(), 3);
    let again = setup.ask(3);
    let answers = again.answers.as_ref().unwrap();
    assert_eq!((again.requests.len(), answers.cached(), answers.usage.requests), (3, 3, 0), "no requests");
    let stored = std::fs::read_dir(setup.dir.path().join("vlm")).unwrap().next().unwrap().unwrap().path();
    let text = std::fs::read_to_string(&stored).unwrap();
    std::fs::write(&stored, text.replace("2400", "9999")).unwrap();

    setup.config.cache_only = true;
    let only = setup.ask(3);
    let answers = only.answers.as_ref().unwrap();
    assert_eq!((only.requests.len(), answers.cached(), answers.answered()), (3, 2, 2));
    let codes: Vec<&str> = only.warnings.iter().map(|w| w.code.as_str()).collect();
    assert_eq!(codes, ["vlm_cache_damaged", "vlm_not_stored"]);

    setup.config.cache_only = false;
    let repaired = setup.ask(3);
    assert_eq!((repaired.requests.len(), repaired.answers.as_ref().unwrap().answered()), (4, 3));
    assert_eq!(repaired.warnings.len(), 1, "damage is reported");
    setup.config.model = "seer-2".into();
    assert_eq!(setup.ask(3).requests.len(), 7, "another model is another question");
}
