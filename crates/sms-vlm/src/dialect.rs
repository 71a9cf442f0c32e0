//! Differences between servers: enforced features, refused ones, and the place of the reply.

use crate::quantity::shortened;
use serde_json::{Map, Value, json};

/// How the form of the reply is requested, from the strictest down.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Enforcement {
    /// `json_schema` with nested objects.
    NestedSchema,
    /// `json_schema` with a flat object.
    FlatSchema,
    /// `json_object`: any JSON object.
    JsonObject,
    /// Only by the prompt.
    Prompt,
}

/// The form of a reply, for servers that can enforce one.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ReplyForm {
    /// Its name, which servers require.
    pub name: &'static str,
    /// Schema with nested objects.
    pub nested: Value,
    /// Schema with a flat object.
    pub flat: Value,
}

/// The features that a server supports, as far as known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Dialect {
    pub enforcement: Enforcement,
    /// The key for the length of the reply; newer models refuse the older key.
    pub tokens_key: Option<&'static str>,
    pub sends_temperature: bool,
}

impl Default for Dialect {
    fn default() -> Self {
        Self {
            enforcement: Enforcement::NestedSchema,
            tokens_key: Some("max_tokens"),
            sends_temperature: true,
        }
    }
}

impl Dialect {
    /// Returns the body of a request.
    pub(crate) fn body(
        &self,
        model: &str,
        max_tokens: usize,
        temperature: f64,
        form: &ReplyForm,
        messages: &[Value],
    ) -> Value {
        let mut body = Map::new();
        body.insert("model".to_owned(), json!(model));
        body.insert("messages".to_owned(), json!(messages));
        if let Some(key) = self.tokens_key {
            body.insert(key.to_owned(), json!(max_tokens));
        }
        if self.sends_temperature {
            body.insert("temperature".to_owned(), json!(temperature));
        }
        let schema = |schema: &Value| json!({"type": "json_schema", "json_schema": {"name": form.name, "strict": true, "schema": schema}});
        let format = match self.enforcement {
            Enforcement::NestedSchema => Some(schema(&form.nested)),
            Enforcement::FlatSchema => Some(schema(&form.flat)),
            Enforcement::JsonObject => Some(json!({"type": "json_object"})),
            Enforcement::Prompt => None,
        };
        body.extend(format.map(|f| ("response_format".to_owned(), f)));
        Value::Object(body)
    }

    /// Returns the dialect to try after a request was refused as malformed, by the words of the refusal; `None` if
    /// the refusal has another reason or no simpler dialect is left.
    pub(crate) fn after_refusal(&self, words: &str) -> Option<Self> {
        let words = words.to_lowercase();
        let says = |list: &[&str]| list.iter().any(|w| words.contains(w));
        if says(&["max_tokens", "max_completion_tokens"]) && self.tokens_key.is_some() {
            let tokens_key = match self.tokens_key {
                Some("max_tokens") if words.contains("max_completion_tokens") => {
                    Some("max_completion_tokens")
                }
                _ => None,
            };
            return Some(Self { tokens_key, ..*self });
        }
        if words.contains("temperature") && self.sends_temperature {
            return Some(Self { sends_temperature: false, ..*self });
        }
        let about_image = says(&["image", "multimodal", "vision"]);
        let about_form =
            says(&["response_format", "json_schema", "schema", "json_object", "grammar", "structured"]);
        // A bare "bad request" has no reason; the form of the reply is the feature most likely unknown to a server.
        let says_nothing = words.split_whitespace().count() < 4;
        if !about_form && (about_image || !says_nothing) {
            return None;
        }
        let enforcement = match self.enforcement {
            Enforcement::NestedSchema => Enforcement::FlatSchema,
            Enforcement::FlatSchema => Enforcement::JsonObject,
            Enforcement::JsonObject => Enforcement::Prompt,
            Enforcement::Prompt => return None,
        };
        Some(Self { enforcement, ..*self })
    }
}

/// A reply.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Completion {
    pub text: String,
    pub prompt_tokens: u64,
    pub completion_tokens: u64,
    /// Whether the reply was cut at the allowed length.
    pub is_cut: bool,
}

/// Reason why a body with a good status contains no reply.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum NoReply {
    /// It is not JSON, or JSON without a reply: the server, or a proxy, is out of order.
    Malformed(String),
    /// An error instead of the reply, with its status if given.
    Error { status: Option<u16>, words: String },
    /// The model declined.
    Refused { words: String, prompt_tokens: u64, completion_tokens: u64 },
}

/// Finds the reply in a body: as text, as a list of parts, as the arguments of a tool call, as a parsed object, or
/// in the form of the responses interface.
pub(crate) fn completion(body: &[u8]) -> Result<Completion, NoReply> {
    let text = String::from_utf8_lossy(body);
    let value: Value = serde_json::from_str(text.trim())
        .map_err(|e| NoReply::Malformed(format!("the body is no JSON ({e}): {}", excerpt(&text))))?;
    if let Some(error) = value.get("error").filter(|e| !e.is_null() && value.get("choices").is_none()) {
        let status = error.get("code").or(error.get("status")).and_then(Value::as_u64);
        return Err(NoReply::Error {
            status: status.and_then(|s| u16::try_from(s).ok()),
            words: words_of_error(body),
        });
    }
    let usage = &value["usage"];
    let tokens = |keys: [&str; 2]| keys.iter().find_map(|k| usage[*k].as_u64()).unwrap_or(0);
    let prompt_tokens = tokens(["prompt_tokens", "input_tokens"]);
    let completion_tokens = tokens(["completion_tokens", "output_tokens"]);
    let choice = &value["choices"][0];
    let message = &choice["message"];
    let found = [
        text_of(&message["content"]),
        message["parsed"].is_object().then(|| message["parsed"].to_string()),
        arguments(&message["tool_calls"][0]["function"]),
        arguments(&message["function_call"]),
        text_of(&choice["text"]),
        text_of(&value["output_text"]),
        value["output"].as_array().map(|items| items.iter().filter_map(|i| text_of(&i["content"])).collect()),
    ];
    let text = found.into_iter().flatten().find(|t: &String| !t.trim().is_empty());
    let is_cut = matches!(choice["finish_reason"].as_str(), Some("length" | "max_tokens"));
    if let Some(text) = text {
        return Ok(Completion { text, prompt_tokens, completion_tokens, is_cut });
    }
    if let Some(words) = message["refusal"].as_str() {
        return Err(NoReply::Refused { words: excerpt(words), prompt_tokens, completion_tokens });
    }
    if choice["finish_reason"].as_str() == Some("content_filter") {
        let words = "the server's content filter held it back".to_owned();
        return Err(NoReply::Refused { words, prompt_tokens, completion_tokens });
    }
    if choice.is_object() {
        // An empty reply is the model's fault, not the server's; a repair can be requested.
        return Ok(Completion { text: String::new(), prompt_tokens, completion_tokens, is_cut });
    }
    Err(NoReply::Malformed(format!("the body has no choices: {}", excerpt(&value.to_string()))))
}

fn text_of(content: &Value) -> Option<String> {
    match content {
        Value::String(text) => Some(text.clone()),
        Value::Object(_) if content["text"].is_string() => content["text"].as_str().map(str::to_owned),
        // An object instead of its text.
        Value::Object(_) => Some(content.to_string()),
        Value::Array(parts) => {
            let texts: Vec<&str> = parts
                .iter()
                .filter_map(|part| {
                    part.as_str().or_else(|| part["text"].as_str()).or_else(|| part["content"].as_str())
                })
                .collect();
            let objects = parts.iter().find_map(|part| {
                ["json", "input", "parsed"].iter().map(|k| &part[*k]).find(|v| v.is_object())
            });
            match (texts.is_empty(), objects) {
                (false, _) => Some(texts.concat()),
                (true, Some(object)) => Some(object.to_string()),
                _ => None,
            }
        }
        _ => None,
    }
}

fn arguments(function: &Value) -> Option<String> {
    match &function["arguments"] {
        Value::String(text) => Some(text.clone()),
        object @ Value::Object(_) => Some(object.to_string()),
        _ => None,
    }
}

/// Returns the text of an error's body: its message if it has one, else its beginning.
pub(crate) fn words_of_error(body: &[u8]) -> String {
    let text = String::from_utf8_lossy(body);
    let Ok(value) = serde_json::from_str::<Value>(text.trim()) else { return excerpt(&text) };
    let error = &value["error"];
    let message = [&error["message"], error, &value["message"], &value["detail"]]
        .into_iter()
        .find_map(Value::as_str)
        .map(str::to_owned);
    let code = error["code"].as_str().or(error["type"].as_str()).unwrap_or_default();
    let param = error["param"].as_str().unwrap_or_default();
    let words = message.unwrap_or_else(|| value.to_string());
    let more: Vec<&str> = [code, param].into_iter().filter(|w| !w.is_empty() && !words.contains(w)).collect();
    excerpt(&if more.is_empty() { words } else { format!("{words} [{}]", more.join(", ")) })
}

/// Returns the beginning of a text on one line, for messages.
pub(crate) fn excerpt(text: &str) -> String {
    let line: String = text.chars().take(2000).map(|c| if c.is_control() { ' ' } else { c }).collect();
    shortened(&line.split_whitespace().collect::<Vec<_>>().join(" "), 240)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(body: &str) -> String {
        completion(body.as_bytes()).unwrap().text
    }

    #[test]
    fn the_reply_is_found_wherever_it_is() {
        for body in [
            r#"{"choices":[{"message":{"content":"{\"a\":1}"}}]}"#,
            r#"{"choices":[{"message":{"content":[{"type":"text","text":"{\"a\":"},{"type":"text","text":"1}"}]}}]}"#,
            r#"{"choices":[{"message":{"content":["{\"a\":1}"]}}]}"#,
            r#"{"choices":[{"message":{"content":{"a":1}}}]}"#,
            r#"{"choices":[{"message":{"content":null,"tool_calls":[{"function":{"arguments":"{\"a\":1}"}}]}}]}"#,
            r#"{"choices":[{"message":{"content":"","tool_calls":[{"function":{"arguments":{"a":1}}}]}}]}"#,
            r#"{"choices":[{"message":{"content":null,"function_call":{"arguments":"{\"a\":1}"}}}]}"#,
            r#"{"choices":[{"message":{"parsed":{"a":1}}}]}"#,
            r#"{"choices":[{"text":"{\"a\":1}"}]}"#,
            r#"{"output":[{"type":"reasoning"},{"content":[{"type":"output_text","text":"{\"a\":1}"}]}]}"#,
            r#"{"choices":[{"message":{"content":[{"type":"tool_use","input":{"a":1}}]}}]}"#,
        ] {
            assert_eq!(text(body).replace(' ', ""), "{\"a\":1}", "{body}");
        }
        let cut = completion(br#"{"choices":[{"message":{"content":"{"},"finish_reason":"length"}],"usage":{"prompt_tokens":7,"completion_tokens":9}}"#).unwrap();
        assert_eq!((cut.is_cut, cut.prompt_tokens, cut.completion_tokens), (true, 7, 9));
    }

    #[test]
    fn bodies_without_a_reply_say_why() {
        for body in ["", "<html>502</html>", "[]", "{}", "null", "{\"choices\":[]}", "\u{0}"] {
            assert!(matches!(completion(body.as_bytes()), Err(NoReply::Malformed(_))), "{body}");
        }
        assert!(matches!(completion(b"\xff\xfe{"), Err(NoReply::Malformed(_))));
        let error = completion(br#"{"error":{"message":"slow down","code":429}}"#);
        assert_eq!(error, Err(NoReply::Error { status: Some(429), words: "slow down".into() }));
        let refused = completion(br#"{"choices":[{"message":{"content":null,"refusal":"I cannot"}}]}"#);
        assert!(matches!(refused, Err(NoReply::Refused { words, .. }) if words == "I cannot"));
        assert_eq!(text(r#"{"choices":[{"message":{"content":null}}]}"#), "");
    }

    #[test]
    fn refusals_step_down_only_for_their_own_feature() {
        let first = Dialect::default();
        let after = |d: Dialect, words: &str| d.after_refusal(words);
        let mut d = first;
        for enforcement in [Enforcement::FlatSchema, Enforcement::JsonObject, Enforcement::Prompt] {
            d = after(d, "Invalid parameter: 'response_format' of type 'json_schema' is not supported")
                .unwrap();
            assert_eq!(d.enforcement, enforcement);
        }
        assert_eq!(
            after(d, "response_format is not supported with this model at all"),
            None,
            "nothing is left"
        );
        assert_eq!(after(first, "").unwrap().enforcement, Enforcement::FlatSchema);
        assert_eq!(after(first, "Bad Request").unwrap().enforcement, Enforcement::FlatSchema);
        assert_eq!(after(first, "This model does not support image input, use another model: error"), None);
        assert_eq!(
            after(first, "error: the messages are longer than the context length of this model"),
            None
        );
        let other =
            after(first, "Unsupported parameter: 'max_tokens', use 'max_completion_tokens' instead").unwrap();
        assert_eq!(
            (other.enforcement, other.tokens_key),
            (Enforcement::NestedSchema, Some("max_completion_tokens"))
        );
        let none = after(other, "max_completion_tokens is unknown").unwrap();
        assert_eq!(none.tokens_key, None);
        assert!(
            !after(first, "'temperature' does not support 0.0 with this model").unwrap().sends_temperature
        );
        let body = none.body("m", 10, 0.0, &crate::prompt::form(), &[]);
        assert!(body.get("max_tokens").is_none() && body.get("temperature").is_some());
        assert_eq!(body["response_format"]["json_schema"]["strict"], true);
    }
}
