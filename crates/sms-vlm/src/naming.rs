//! Questions about the names of objects.

use crate::answer::{Fault, Fields, Word};
use crate::ask::{Answers, Outcome, Question, STAGE, Topic, ask_all};
use crate::cache::Cache;
use crate::client::Client;
use crate::dialect::ReplyForm;
use crate::prompt::{object, place, unquoted};
use crate::quantity::{plain, shortened};
use serde_json::json;
use sms_core::{CoreError, StageContext, Warnings};
use sms_masks::{file_name, is_automatic, is_usable};

/// Greatest number of words of a name.
const MAX_WORDS: usize = 3;
/// Greatest number of characters of a description.
const DESCRIPTION_CHARS: usize = 200;
/// Names that name nothing, without blanks and signs.
const UNKNOWN: [&str; 14] = [
    "unknown",
    "unknownobject",
    "unidentified",
    "unidentifiedobject",
    "unrecognizable",
    "unclear",
    "uncertain",
    "unsure",
    "notsure",
    "none",
    "na",
    "object",
    "thing",
    "item",
];

/// A model's name of an object.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ObjectName {
    /// The name, usable in a scene; `None` if the model cannot tell what the object is.
    pub name: Option<String>,
    /// A short phrase; may be empty.
    pub description: String,
}

/// Asks for the name of every object, or takes the reply from the cache. Every question ends with an answer or with a
/// fallback. Objects without a name are reported in the warnings. Two objects may get the same name.
///
/// # Errors
/// [`CoreError::Interrupted`]; [`CoreError::Write`] if the cache cannot be written.
pub fn ask_names(
    questions: &[Question],
    client: &Client,
    cache: &Cache,
    context: StageContext<'_>,
) -> Result<Answers<ObjectName>, CoreError> {
    ask_all::<NameTopic>(questions, client, cache, context)
}

struct NameTopic;

impl Topic for NameTopic {
    type Answer = ObjectName;
    const SYSTEM: &'static str = "You look at photographs for a robot that keeps a list of the objects in them. You name \
                                  single objects. You answer with one JSON object and nothing else.";
    const RULES: &'static str =
        "name is a noun of one to three English words with the letters a to z, or \"unknown\".";
    const SUBSTITUTE: &'static str = "the present name is kept";

    fn text(q: &Question) -> String {
        let mut text = place(q.is_surface);
        if !q.annotation.trim().is_empty() {
            let annotation = unquoted(&q.annotation);
            text.push_str(&format!("So far it is described as \"{annotation}\", which may be wrong. "));
        }
        text.push_str(
            "Name the object:\n\
             - name: the common noun for it in one to three English words, such as \"mug\" or \"cereal box\", without its colour; \
             \"unknown\" if the picture does not show what it is;\n\
             - description: a short phrase with its colour and its material, such as \"blue ceramic mug\".\n\n\
             Answer with one JSON object of this form:\n\
             {\"name\": \"…\", \"description\": \"…\"}",
        );
        text
    }

    fn form() -> ReplyForm {
        let schema =
            object([("name", json!({"type": "string"})), ("description", json!({"type": "string"}))]);
        ReplyForm { name: "object_name", nested: schema.clone(), flat: schema }
    }

    fn read(reply: &str) -> Result<(Option<ObjectName>, Vec<Fault>), String> {
        let fields = Fields::of(reply)?;
        let fault = |field: &str, what| vec![Fault { field: field.to_owned(), what }];
        match (fields.text(Word::Label).and_then(|text| name_of(&text)), fields.text(Word::Description)) {
            (Err(what), _) => Ok((None, fault("name", what))),
            (Ok(None), _) => Ok((Some(ObjectName { name: None, description: String::new() }), Vec::new())),
            (Ok(name), Ok(text)) => {
                let description = shortened(&text, DESCRIPTION_CHARS);
                Ok((Some(ObjectName { name, description }), Vec::new()))
            }
            (Ok(name), Err(what)) => {
                let description = String::new();
                Ok((Some(ObjectName { name, description }), fault("description", what)))
            }
        }
    }

    fn warn(q: &Question, outcome: &Outcome<ObjectName>, warnings: &Warnings) {
        let why = match outcome {
            Outcome::Fallback(what) => what,
            Outcome::Answered { answer, .. } if answer.name.is_none() => "it cannot tell what it is",
            Outcome::Answered { faults, .. } => {
                let list: Vec<String> = faults.iter().map(ToString::to_string).collect();
                if !list.is_empty() {
                    warnings.add(
                        STAGE,
                        "vlm_partial",
                        format!(
                            "the model gave {} a name without a description ({})",
                            q.name,
                            list.join("; ")
                        ),
                        "write a `description` in masks/labels.json",
                    );
                }
                return;
            }
        };
        warn_not_named(warnings, &q.name, &format!("the model gave {} no name: {why}", q.name));
    }
}

/// Warns that an object keeps its name, with the reason.
pub fn warn_not_named(warnings: &Warnings, name: &str, why: &str) {
    warnings.add(
        STAGE,
        "not_named",
        format!("{why}; {}", NameTopic::SUBSTITUTE),
        format!("name it with `sms name RUN {name}=NAME`"),
    );
}

/// Returns the name in a scene of an object that a model calls `text`; `None` if that is no name.
///
/// # Errors
/// The complaint to send to the model if no name can be made of it.
fn name_of(text: &str) -> Result<Option<String>, String> {
    let words: Vec<&str> =
        text.split(|c: char| c.is_whitespace() || c == '_').filter(|w| !w.is_empty()).collect();
    let is_article = |word: &str| ["a", "an", "the"].iter().any(|a| word.eq_ignore_ascii_case(a));
    let words = match words.split_first() {
        Some((first, rest)) if is_article(first) && !rest.is_empty() => rest,
        _ => &words[..],
    };
    let text = words.join(" ");
    let name = file_name(&text);
    if UNKNOWN.contains(&plain(&text).as_str()) || is_automatic(&name) {
        return Ok(None);
    }
    if words.len() > MAX_WORDS {
        return Err(format!("`{}` has more than {MAX_WORDS} words", shortened(&text, 80)));
    }
    if text.chars().any(|c| c.is_alphabetic() && !c.is_ascii()) {
        return Err(format!("`{}` has letters other than a to z", shortened(&text, 80)));
    }
    if !is_usable(&name) {
        return Err(format!("`{name}` is the name of another part of the scene"));
    }
    Ok(Some(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(reply: &str) -> (Option<ObjectName>, Vec<String>) {
        let (answer, faults) = NameTopic::read(reply).unwrap();
        (answer, faults.into_iter().map(|f| f.field).collect())
    }

    fn named(name: &str, description: &str) -> Option<ObjectName> {
        Some(ObjectName { name: Some(name.into()), description: description.into() })
    }

    #[test]
    fn names_become_legal() {
        for (text, name) in [
            ("duck", "duck"),
            ("Rubber Duck", "rubber_duck"),
            ("the rubber duck.", "rubber_duck"),
            ("T-shirt", "t_shirt"),
            ("rubber_duck", "rubber_duck"),
            ("9 V battery", "9_v_battery"),
            ("A", "a"),
            ("floor lamp", "floor_lamp"),
        ] {
            assert_eq!(name_of(text), Ok(Some(name.to_owned())), "{text}");
            assert!(is_usable(name));
        }
        let long = name_of(&"x".repeat(500)).unwrap().unwrap();
        assert!(is_usable(&long) && is_usable(&format!("{long}_100")));
        for text in ["unknown", "Unknown object", "N/A", "an object", "object_03", "Object 3", "unknown_2"] {
            assert_eq!(name_of(text), Ok(None), "{text}");
        }
        for text in
            ["Floor", "the world", "environment", "Entenküken für Bäder", "鸭子", "what looks like a duck"]
        {
            assert!(name_of(text).is_err(), "{text}");
        }
    }

    #[test]
    fn replies_in_several_forms_are_read() {
        let duck = named("duck", "yellow rubber duck");
        for reply in [
            r#"{"name": "duck", "description": "yellow rubber duck"}"#,
            r#"Sure! ```json
            {"name": "Duck", "description": "yellow\nrubber duck",}
            ```"#,
            r#"{"object": {"name": "duck", "description": "yellow rubber duck"}}"#,
            r#"{"label": "duck", "general description": "yellow rubber duck"}"#,
        ] {
            assert_eq!(read(reply), (duck.clone(), vec![]), "{reply}");
        }
        for reply in [r#"{"name": "duck"}"#, r#"{"name": "duck", "description": 7}"#] {
            assert_eq!(read(reply), (named("duck", ""), vec!["description".to_owned()]), "{reply}");
        }
        for reply in [r#"{"name": "", "description": "a"}"#, r#"{"name": 3}"#, r#"{"description": "a duck"}"#]
        {
            assert_eq!(read(reply), (None, vec!["name".to_owned()]), "{reply}");
        }
        let unknown = ObjectName { name: None, description: String::new() };
        assert_eq!(read(r#"{"name": "unknown", "description": ""}"#), (Some(unknown), vec![]));
        let long = format!("{{\"name\": \"duck\", \"description\": \"{}\"}}", "yellow ".repeat(500));
        assert!(read(&long).0.unwrap().description.chars().count() <= DESCRIPTION_CHARS + 1);
        for reply in ["a duck", "{}", r#"{"name": "du"#] {
            assert!(NameTopic::read(reply).is_err(), "{reply}");
        }
    }

    #[test]
    fn the_question_names_every_key_of_the_form() {
        let question = |annotation: &str| Question { annotation: annotation.into(), ..Question::default() };
        let text = NameTopic::text(&question(""));
        for key in NameTopic::form().flat["properties"].as_object().unwrap().keys() {
            assert!(text.contains(&format!("\"{key}\"")) && text.contains(&format!("- {key}:")));
        }
        assert!(NameTopic::text(&question("a \"red\" thing")).contains("a  red  thing"));
    }
}
