//! Choice of one of several marks in a picture by the model (visual prompting: Nasiriany et al. 2024, PIVOT).

use crate::cache::{Cache, CachedReply};
use crate::client::{CallError, Client};
use crate::dialect::ReplyForm;
use crate::node::{NoObject, ReplyNode, objects};
use crate::prompt::{object, picture_part, quoted};
use crate::quantity::{plain, shortened};
use serde_json::{Value, json};
use sms_core::{CoreError, InputError, StageContext};

/// A picture with numbered marks to choose from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChoiceQuestion {
    /// Name of the choice ("landing site"), for messages.
    pub name: String,
    /// The system message.
    pub system: String,
    /// The question, without the form of the answer.
    pub text: String,
    /// The picture with its marks, JPEG.
    pub jpeg: Vec<u8>,
    /// The numbers in the picture.
    pub ids: Vec<u32>,
}

const UNDECIDED_CURE: &str = "use a model that reads numbers in pictures, or another chooser";

/// The model's choice.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChosenMark {
    /// One of [`ChoiceQuestion::ids`].
    pub id: u32,
    /// The model's reasons; may be empty.
    pub reasoning: String,
    /// Whether it came from the cache.
    pub is_cached: bool,
}

/// A failed choice.
#[derive(Debug, thiserror::Error)]
pub enum ChooseError {
    /// The server cannot be used, or there is nothing to ask.
    #[error("no {name} was chosen: {what}\n  cure: {cure}")]
    NoAnswer {
        /// Name of the choice.
        name: String,
        /// The reason.
        what: String,
        /// Its remedy.
        cure: String,
    },
    /// The model answers, but repeatedly names none of the marks: another run will hardly help.
    #[error("no {name} was chosen: {what}\n  cure: {UNDECIDED_CURE}")]
    Undecided {
        /// Name of the choice.
        name: String,
        /// The problem with the last answer.
        what: String,
    },
    /// The user asked to stop, or the cache cannot be written.
    #[error(transparent)]
    Core(#[from] CoreError),
}

impl ChooseError {
    /// Converts failures that the user can fix; `at` identifies the server.
    ///
    /// # Errors
    /// All others.
    pub fn input(self, at: &str) -> Result<InputError, CoreError> {
        let error = |name: &str, what: &str, cure: &str| {
            InputError::new(format!("no {name} was chosen: {what}"), at, cure)
        };
        match self {
            Self::NoAnswer { name, what, cure } => Ok(error(&name, &what, &cure)),
            Self::Undecided { name, what } => Ok(error(&name, &what, UNDECIDED_CURE)),
            Self::Core(e) => Err(e),
        }
    }
}

/// Asks which mark to choose, or takes the reply from the cache. If a reply names none of the marks, a repair is
/// requested, at most `max_repairs` times.
pub fn choose(
    question: &ChoiceQuestion,
    client: &Client,
    cache: &Cache,
    context: StageContext<'_>,
) -> Result<ChosenMark, ChooseError> {
    let text = format!("{}\n\n{}", question.text, form_of_answer(&question.ids));
    let config = client.config();
    let key = Cache::key(&question.jpeg, &format!("{}\n\n{text}", question.system), &config.model);
    if let Some(entry) = cache.get(&key, &question.name, context.warnings)
        && let Ok((id, reasoning)) = read_choice(&entry.reply, &question.ids)
    {
        return Ok(ChosenMark { id, reasoning, is_cached: true });
    }
    let no_answer = |what: String, cure: &str| ChooseError::NoAnswer {
        name: question.name.clone(),
        what,
        cure: cure.to_owned(),
    };
    if config.cache_only {
        let what = "its reply is not in the cache, and no requests are allowed".to_owned();
        return Err(no_answer(what, "allow requests, or use another chooser"));
    }
    let mut messages = vec![
        json!({"role": "system", "content": question.system}),
        json!({"role": "user", "content": [
            picture_part(&question.jpeg),
            {"type": "text", "text": text},
        ]}),
    ];
    let schema = schema(&question.ids);
    let form = ReplyForm { name: "choice", nested: schema.clone(), flat: schema };
    let (mut tokens, mut complaint) = ((0, 0), String::new());
    for _ in 0..=config.max_repairs {
        let completion = match client.complete(&question.name, &form, &messages, context.cancel) {
            Ok(completion) => completion,
            Err(CallError::Core(e)) => return Err(e.into()),
            Err(CallError::Fatal { what, cure }) => return Err(no_answer(what, &cure)),
            Err(e) => return Err(no_answer(e.to_string(), "check the server, and ask again")),
        };
        tokens.0 += completion.prompt_tokens;
        tokens.1 += completion.completion_tokens;
        match read_choice(&completion.text, &question.ids) {
            Ok((id, reasoning)) => {
                let entry = CachedReply::new(&config.model, &question.name, &completion.text, tokens);
                cache.put(&key, &entry)?;
                return Ok(ChosenMark { id, reasoning, is_cached: false });
            }
            Err(what) => complaint = what,
        }
        messages.push(quoted(&completion.text));
        let again = format!("Your answer cannot be used: {complaint}. {}", form_of_answer(&question.ids));
        messages.push(json!({"role": "user", "content": again}));
    }
    Err(ChooseError::Undecided { name: question.name.clone(), what: complaint })
}

fn listed(ids: &[u32]) -> String {
    ids.iter().map(u32::to_string).collect::<Vec<_>>().join(", ")
}

fn form_of_answer(ids: &[u32]) -> String {
    format!(
        "Answer with one JSON object and nothing else: {{\"reasoning\": \"what speaks for and against, in a few sentences\", \
         \"decision\": ID}}, where ID is the number alone, one of {}.",
        listed(ids)
    )
}

fn schema(ids: &[u32]) -> Value {
    object([("reasoning", json!({"type": "string"})), ("decision", json!({"type": "integer", "enum": ids}))])
}

/// Parses the chosen mark and the reasons: from the last JSON object with a decision, else from the last line that
/// begins with "Decision:".
///
/// # Errors
/// The complaint to send to the model if there is no decision, or it is not one of `ids`.
fn read_choice(text: &str, ids: &[u32]) -> Result<(u32, String), String> {
    let (decision, reasoning) = match objects(text) {
        Ok(found) => found.maps.iter().rev().find_map(|map| {
            let field = |names: &[&str]| map.iter().find(|(k, _)| names.contains(&plain(k).as_str()));
            let words = |node: &ReplyNode| match node {
                ReplyNode::Number(t) | ReplyNode::Text(t) => Some(t.trim().to_owned()),
                _ => None,
            };
            let (_, decision) = field(&["decision", "id", "choice", "answer"])?;
            let reasoning = field(&["reasoning", "reason", "thoughts"]).and_then(|(_, node)| words(node));
            Some((words(decision)?, reasoning.unwrap_or_default()))
        }),
        Err(NoObject::CutOff) => return Err("the JSON object in the reply is not closed".to_owned()),
        Err(NoObject::Missing) => None,
    }
    .or_else(|| decision_line(text))
    .ok_or("there is no decision in the reply")?;
    let numbers: Vec<&str> = decision
        .split(|c: char| !c.is_ascii_digit() && c != '.' && c != '-')
        .filter(|t| !t.is_empty())
        .collect();
    let [number] = numbers[..] else {
        return Err(format!("the decision `{}` is not one number", shortened(&decision, 60)));
    };
    let id = number.trim_end_matches(".0").trim_end_matches('.').parse::<u32>().ok();
    match id.filter(|id| ids.contains(id)) {
        Some(id) => Ok((id, reasoning)),
        None => Err(format!("there is no mark {}: the marks are {}", shortened(number, 20), listed(ids))),
    }
}

/// Parses the paper's format: "Reasoning: …" and "Decision: 3", each on a line.
fn decision_line(text: &str) -> Option<(String, String)> {
    let stripped = |line: &str| line.trim().trim_start_matches(['*', '#', '-', ' ']).to_owned();
    let lines: Vec<String> = text.lines().map(stripped).collect();
    let at = lines.iter().rposition(|l| l.get(..8).is_some_and(|w| w.eq_ignore_ascii_case("decision")))?;
    let line = &lines[at];
    let reasoning = lines[..at].join(" ");
    let reasoning = reasoning.trim().strip_prefix("Reasoning:").unwrap_or(reasoning.trim());
    let reasoning = reasoning.trim_matches(['*', ' ']).to_owned();
    Some((line["decision".len()..].trim_matches([':', '*', ' ']).to_owned(), reasoning))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_decision_is_read_in_the_forms_that_models_give_it() {
        for text in [
            r#"{"reasoning": "over the legs", "decision": 7}"#,
            r#"Sure: ```json
            {"reasoning": "over the legs", "decision": "ID 7",}
            ```"#,
            r#"{"Reasoning": "over the legs", "ID": 7.0}"#,
            "Reasoning: over the legs\nDecision: 7",
            "**Reasoning:** over the legs\n**Decision:** 7.",
            "<think>{\"decision\": 2}</think>{\"reasoning\": \"over the legs\", \"decision\": 7}",
        ] {
            let (id, reasoning) = read_choice(text, &[2, 7]).unwrap_or_else(|e| panic!("{text}: {e}"));
            assert_eq!(id, 7, "{text}");
            assert!(reasoning.ends_with("over the legs"), "{reasoning}");
        }
    }

    #[test]
    fn replies_without_a_mark_are_explained() {
        for (text, why) in [
            (r#"{"decision": 12}"#, "no mark 12: the marks are 1, 2"),
            (r#"{"decision": "1 or 2"}"#, "not one number"),
            (r#"{"decision": 1.5}"#, "no mark 1.5"),
            (r#"{"decision": -1}"#, "no mark -1"),
            (r#"{"decision": 1"#, "not closed"),
            ("I would rather not.", "no decision"),
            ("", "no decision"),
            (r#"{"reasoning": "both are bad"}"#, "no decision"),
            ("Decision: none", "not one number"),
        ] {
            let error = read_choice(text, &[1, 2]).unwrap_err();
            assert!(error.contains(why), "{text}: {error}");
        }
    }
}
