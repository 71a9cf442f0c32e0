//! Questions about names, with a server in memory: each ends with a name, or with a warning that the object keeps its own.

use sms_core::{Cancel, CoreError, Seed, StageContext, Warning, Warnings};
use sms_vlm::{
    Answers, Cache, Client, ObjectName, Pause, Question, Reply, Request, Transport, TransportError,
    VlmConfig, ask_names,
};
use std::path::Path;
use std::sync::{Arc, Mutex};

/// Answers by the object of the question (its annotation) and the number of messages, and records the requests.
struct Script {
    reply: fn(object: &str, messages: usize) -> (u16, &'static str),
    requests: Mutex<Vec<serde_json::Value>>,
}

impl Transport for Script {
    fn post(&self, request: &Request) -> Result<Reply, TransportError> {
        let body: serde_json::Value = serde_json::from_slice(&request.body).unwrap();
        let messages = body["messages"].as_array().unwrap();
        let text = messages[1]["content"][0]["text"].as_str().unwrap();
        let object = text.split('"').nth(1).unwrap();
        let (status, said) = (self.reply)(object, messages.len());
        let reply = serde_json::json!({"choices": [{"message": {"content": said}, "finish_reason": "stop"}]});
        self.requests.lock().unwrap().push(body);
        Ok(Reply { status, retry_after: None, body: reply.to_string().into_bytes() })
    }
}

struct Never;

impl Pause for Never {
    fn pause(&self, _: f64, cancel: &Cancel) -> Result<(), CoreError> {
        cancel.check()
    }
}

struct Done {
    answers: Answers<ObjectName>,
    warnings: Vec<Warning>,
    requests: Vec<serde_json::Value>,
}

impl Done {
    fn names(&self) -> Vec<Option<&str>> {
        self.answers.outcomes.iter().map(|o| o.answer().and_then(|a| a.name.as_deref())).collect()
    }

    /// Codes of the warnings, each with the object that its text names.
    fn warned(&self) -> Vec<(&str, &str)> {
        let object = |w: &Warning| OBJECTS.into_iter().find(|o| w.message.contains(o)).unwrap();
        self.warnings.iter().map(|w| (w.code.as_str(), object(w))).collect()
    }
}

const OBJECTS: [&str; 3] = ["object_01", "object_02", "object_03"];

/// Asks about [`OBJECTS`], which are annotated `first`, `second` and `third`.
fn asked(dir: &Path, reply: fn(&str, usize) -> (u16, &'static str)) -> Done {
    let questions: Vec<Question> = OBJECTS
        .iter()
        .zip(["first", "second", "third"])
        .map(|(name, annotation)| Question {
            name: (*name).into(),
            annotation: annotation.into(),
            jpeg: annotation.as_bytes().to_vec(),
            ..Question::default()
        })
        .collect();
    let config = VlmConfig { url: "http://server/v1".into(), model: "m".into(), ..VlmConfig::default() };
    let script = Arc::new(Script { reply, requests: Mutex::new(Vec::new()) });
    let client = Client::with(&config, None, Seed(0), script.clone(), Arc::new(Never)).unwrap();
    let (cancel, warnings) = (Cancel::new(), Warnings::new());
    let context = StageContext::quiet(&cancel, &warnings);
    let answers = ask_names(&questions, &client, &Cache::new(dir), context).unwrap();
    let requests = script.requests.lock().unwrap().clone();
    Done { answers, warnings: warnings.snapshot(), requests }
}

#[test]
fn names_and_descriptions_are_read_and_kept() {
    let dir = tempfile::tempdir().unwrap();
    let reply = |object: &str, _| match object {
        "first" => (200, r#"{"name": "Rubber Duck", "description": "yellow rubber duck"}"#),
        "second" => (200, r#"It is: {"name": "mug", "description": "blue ceramic mug"}"#),
        _ => (200, r#"{"name": "mug", "description": "red steel mug"}"#),
    };
    let done = asked(dir.path(), reply);
    assert_eq!(
        done.names(),
        [Some("rubber_duck"), Some("mug"), Some("mug")],
        "equal names are not resolved here"
    );
    assert_eq!(done.answers.outcomes[0].answer().unwrap().description, "yellow rubber duck");
    assert_eq!((done.requests.len(), done.warnings.len()), (3, 0));
    let schema = &done.requests[0]["response_format"]["json_schema"]["schema"];
    assert_eq!(schema["required"], serde_json::json!(["name", "description"]));

    let again = asked(dir.path(), |_, _| (500, ""));
    assert_eq!((again.names(), again.requests.len(), again.answers.cached()), (done.names(), 0, 3));
}

#[test]
fn an_unusable_name_is_repaired_or_the_object_keeps_its_own() {
    let dir = tempfile::tempdir().unwrap();
    let reply = |object: &str, messages| match (object, messages) {
        ("first", 2) => (200, r#"{"name": "something like a duck", "description": "yellow rubber duck"}"#),
        ("first", 4) => (200, r#"{"name": "floor", "description": "yellow rubber duck"}"#),
        ("first", _) => (200, r#"{"name": "duck", "description": "yellow rubber duck"}"#),
        ("second", _) => (200, r#"{"name": "unknown", "description": "something grey"}"#),
        _ => (200, "I see nothing."),
    };
    let done = asked(dir.path(), reply);
    assert_eq!(done.names(), [Some("duck"), None, None]);
    assert_eq!(done.warned(), [("not_named", "object_02"), ("not_named", "object_03")]);
    assert_eq!(done.requests.len(), 3 + 1 + 3, "`unknown` is an answer; others are repaired at most twice");
    assert_eq!(done.answers.answered(), 2);
    // An unusable reply is not stored.
    let again = asked(dir.path(), |_, _| (200, r#"{"name": "cup", "description": "white cup"}"#));
    assert_eq!((again.names(), again.requests.len()), (vec![Some("duck"), None, Some("cup")], 1));
}

#[test]
fn a_name_without_description_is_used_with_a_warning() {
    let dir = tempfile::tempdir().unwrap();
    let done = asked(dir.path(), |_, _| (200, r#"{"name": "duck"}"#));
    assert_eq!(done.names(), [Some("duck"); 3]);
    assert_eq!(done.warned(), OBJECTS.map(|object| ("vlm_partial", object)));
}

#[test]
fn a_refused_key_ends_all_questions() {
    let dir = tempfile::tempdir().unwrap();
    let done = asked(dir.path(), |_, _| (401, ""));
    assert_eq!((done.names(), done.requests.len()), (vec![None; 3], 1));
    assert!(done.answers.given_up.is_some());
    assert_eq!(done.warnings.iter().map(|w| w.code.as_str()).collect::<Vec<_>>(), ["vlm_given_up"]);
}
