//! Prompts and schemas of questions about objects.

use crate::answer::Fault;
use crate::dialect::ReplyForm;
use crate::property::EstimatedProperty;
use crate::quantity::shortened;
use base64::Engine;
use serde_json::{Map, Value, json};
use std::fmt::Write;

/// The system message: the use of the answers, the same for every object.
pub(crate) const SYSTEM: &str = "You look at photographs for a robot that is going to simulate the scene in them before it \
acts. You judge what single objects are made of and how they behave when they touch, slide and collide. You answer with \
one JSON object and nothing else. You give honest ranges: where a picture cannot tell, the range is wide.";

/// Returns the first sentences of a question: the place of the object in the picture.
pub(crate) fn place(is_surface: bool) -> String {
    let mut text = String::from("The photograph shows a workspace. ");
    text.push_str(if is_surface {
        "The red box marks a surface or a fixed part of the room. Things that stand on it or before it are in the box too \
         and are not meant. "
    } else {
        "The red box marks one object; where others are in the box too, the one meant fills most of it. "
    });
    text
}

/// Returns a text of the user for use between quotation marks.
pub(crate) fn unquoted(text: &str) -> String {
    text.trim().replace(['"', '\n', '\r'], " ")
}

/// Returns the question about the material of one object. `annotation` is its current label; empty if it has none.
pub(crate) fn question(annotation: &str, is_surface: bool) -> String {
    let mut text = place(is_surface);
    if annotation.trim().is_empty() {
        text.push_str("Nobody has named it yet: set label_is_right to false and name it.\n\n");
    } else {
        let _ = write!(
            text,
            "So far it is called \"{}\", which may be wrong: say in label_is_right whether that is what it is, and give in \
             label what it should be called.\n\n",
            unquoted(annotation)
        );
    }
    text.push_str(include_str!("../assets/question.txt"));
    text.push_str(&example());
    text
}

/// Returns the form of the answer, with placeholders for numbers.
fn example() -> String {
    const RANGE: &str = "{\"best\": …, \"low\": …, \"high\": …}";
    let mut out = String::from(
        "{\"label_is_right\": true or false, \"label\": \"…\", \"description\": \"…\", \"material\": \"…\",\n \"properties\": {",
    );
    for (i, p) in EstimatedProperty::ALL.into_iter().enumerate() {
        let _ = write!(out, "{}\"{}\": {}", if i == 0 { "" } else { ",\n  " }, p.key(), RANGE);
    }
    out.push_str("}}");
    out
}

/// Rules for the numbers of an answer.
pub(crate) const NUMBER_RULES: &str =
    "Numbers are plain JSON numbers in SI units (kg/m³, Pa), and low ≤ best ≤ high.";

/// Returns the message that requests a repair of an unusable reply. `rules` for its values are repeated.
pub(crate) fn repair(faults: &[Fault], rules: &str) -> String {
    let mut text = String::from("Your answer cannot be used as it is:\n");
    for fault in faults.iter().take(12) {
        let _ = writeln!(text, "- {fault}");
    }
    text.push_str(
        "Give the whole answer again with this put right, as one JSON object of the same form and nothing else. ",
    );
    text.push_str(rules);
    text
}

/// Greatest number of characters of a reply quoted back to the model for repair.
const QUOTED_CHARS: usize = 6000;

/// Returns the assistant's message that quotes a reply back to the model.
pub(crate) fn quoted(reply: &str) -> Value {
    let text = shortened(reply, QUOTED_CHARS);
    json!({"role": "assistant", "content": if text.is_empty() { "(nothing)" } else { &text }})
}

/// Returns the part of a message that contains a picture.
pub(crate) fn picture_part(jpeg: &[u8]) -> Value {
    let picture = base64::engine::general_purpose::STANDARD.encode(jpeg);
    json!({"type": "image_url", "image_url": {"url": format!("data:image/jpeg;base64,{picture}")}})
}

/// Returns the form of the answer.
pub(crate) fn form() -> ReplyForm {
    ReplyForm { name: "object_properties", nested: nested_schema(), flat: flat_schema() }
}

/// Returns the schema with the properties as nested objects.
fn nested_schema() -> Value {
    let range = object([
        ("best", json!({"type": "number"})),
        ("low", json!({"type": "number"})),
        ("high", json!({"type": "number"})),
    ]);
    let properties = object(EstimatedProperty::ALL.map(|p| (p.key(), range.clone())));
    let mut fields = words();
    fields.push(("properties", properties));
    object(fields)
}

/// Returns the schema without nesting, for servers that cannot enforce it: the ends have keys of their own.
fn flat_schema() -> Value {
    let number = || json!({"type": "number"});
    let names: Vec<String> = EstimatedProperty::ALL
        .iter()
        .flat_map(|p| ["", "_low", "_high"].map(|end| format!("{}{end}", p.key())))
        .collect();
    let mut fields = words();
    fields.extend(names.iter().map(|n| (n.as_str(), number())));
    object(fields)
}

fn words() -> Vec<(&'static str, Value)> {
    vec![
        ("label_is_right", json!({"type": "boolean"})),
        ("label", json!({"type": "string"})),
        ("description", json!({"type": "string"})),
        ("material", json!({"type": "string"})),
    ]
}

/// Returns an object schema for strict modes: all keys required, no others.
pub(crate) fn object<'a>(fields: impl IntoIterator<Item = (&'a str, Value)>) -> Value {
    let properties: Map<String, Value> = fields.into_iter().map(|(k, v)| (k.to_owned(), v)).collect();
    let required: Vec<String> = properties.keys().cloned().collect();
    json!({"type": "object", "properties": properties, "required": required, "additionalProperties": false})
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_question_names_every_key_of_the_schema() {
        let text = question("blue mug", false);
        for schema in [nested_schema(), flat_schema()] {
            assert!(schema["required"].as_array().is_some_and(|r| r.len() >= 5));
            for key in schema["properties"].as_object().unwrap().keys() {
                let key = key.trim_end_matches("_low").trim_end_matches("_high");
                assert!(text.contains(&format!("\"{key}\"")), "{key}");
            }
        }
        for p in EstimatedProperty::ALL {
            assert!(
                text.contains(&format!("- {}:", p.key())) && text.contains(&format!("\"{}\": {{", p.key()))
            );
        }
        for (annotation, is_surface) in [("", false), ("blue mug", true), ("red mug", false)] {
            assert_ne!(question(annotation, is_surface), text);
        }
        assert_eq!(question("a \"b\"\nc", false), question("a  b  c", false));
    }

    #[test]
    fn a_repair_lists_the_faults() {
        let faults = [Fault { field: "density".into(), what: "it is missing".into() }];
        assert!(repair(&faults, NUMBER_RULES).contains(&format!("- {}", faults[0])));
    }
}
