//! Parser of JSON as language models write it: in prose, in fences, with trailing commas, comments, bare words and
//! single quotes.

/// Greatest depth of nesting.
const MAX_DEPTH: usize = 32;
/// Greatest number of objects searched in one reply.
const MAX_OBJECTS: usize = 64;
/// Greatest number of bytes read during the search, counting repeated reading.
const MAX_READ: usize = 1 << 22;

/// A value of a reply. Keys stay in order and may repeat, because a repeated key is a fault to report.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum ReplyNode {
    Null,
    Bool(bool),
    /// A number as written.
    Number(String),
    Text(String),
    List(Vec<ReplyNode>),
    Map(Vec<(String, ReplyNode)>),
}

impl ReplyNode {
    /// Returns its kind in one or two words, for messages.
    pub(crate) fn kind(&self) -> &'static str {
        match self {
            Self::Null => "null",
            Self::Bool(_) => "true or false",
            Self::Number(_) => "a number",
            Self::Text(_) => "text",
            Self::List(_) => "a list",
            Self::Map(_) => "an object",
        }
    }
}

/// Reason why a text contains no complete object.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum NoObject {
    /// It contains none.
    Missing,
    /// An object begins but does not end.
    CutOff,
}

/// The objects of a text.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FoundObjects {
    /// Every complete object that is not part of another complete one, in order.
    pub maps: Vec<Vec<(String, ReplyNode)>>,
    /// Whether an object begins but does not end; complete objects within it are in `maps`.
    pub is_cut_off: bool,
}

/// Finds JSON objects in a text.
pub(crate) fn objects(text: &str) -> Result<FoundObjects, NoObject> {
    let text = without_thoughts(text);
    let mut found = Vec::new();
    let mut cut_off = false;
    let (mut at, mut spent) = (0, 0);
    while let Some(offset) = text[at..].find('{') {
        let start = at + offset;
        let mut parser = Parser { text, at: start };
        match parser.value(0) {
            Ok(ReplyNode::Map(map)) => {
                found.push(map);
                at = parser.at;
            }
            Ok(_) => at = start + 1,
            Err(ParseFault::End) => {
                cut_off = true;
                at = start + 1;
            }
            Err(ParseFault::Malformed) => at = start + 1,
        }
        // Unclosed objects are read to the end from each of their braces; the limit prevents quadratic cost.
        spent += parser.at - start;
        if found.len() >= MAX_OBJECTS || spent > MAX_READ {
            break;
        }
    }
    match (found.is_empty(), cut_off) {
        (false, is_cut_off) => Ok(FoundObjects { maps: found, is_cut_off }),
        // An object as a JSON string: the whole text in quotes with escaped inner quotes.
        (true, _) if text.trim_start().starts_with('"') => {
            match serde_json::from_str::<String>(text.trim()) {
                Ok(inner) if inner.len() < text.len() => objects(&inner),
                _ => Err(NoObject::Missing),
            }
        }
        (true, true) => Err(NoObject::CutOff),
        (true, false) => Err(NoObject::Missing),
    }
}

/// Returns the text after the model's thoughts, if it shows them.
fn without_thoughts(text: &str) -> &str {
    ["</think>", "</thinking>", "</reasoning>"]
        .iter()
        .filter_map(|tag| text.rfind(tag).map(|i| i + tag.len()))
        .max()
        .map_or(text, |end| &text[end..])
}

enum ParseFault {
    /// The text ends within a value.
    End,
    /// The text is not a value.
    Malformed,
}

struct Parser<'a> {
    text: &'a str,
    at: usize,
}

impl Parser<'_> {
    fn peek(&self) -> Option<char> {
        self.text[self.at..].chars().next()
    }

    fn bump(&mut self) -> Option<char> {
        let c = self.peek()?;
        self.at += c.len_utf8();
        Some(c)
    }

    fn skip_space(&mut self) -> Result<(), ParseFault> {
        loop {
            let rest = &self.text[self.at..];
            let trimmed = rest.trim_start_matches(|c: char| c.is_whitespace() || c == '\u{feff}');
            self.at += rest.len() - trimmed.len();
            if trimmed.starts_with("//") {
                self.at += trimmed.find('\n').unwrap_or(trimmed.len());
            } else if trimmed.starts_with("/*") {
                self.at += trimmed.find("*/").ok_or(ParseFault::End)? + 2;
            } else {
                return Ok(());
            }
        }
    }

    fn value(&mut self, depth: usize) -> Result<ReplyNode, ParseFault> {
        if depth > MAX_DEPTH {
            return Err(ParseFault::Malformed);
        }
        self.skip_space()?;
        match self.peek().ok_or(ParseFault::End)? {
            '{' => self.map(depth),
            '[' => self.list(depth),
            quote @ ('"' | '\'' | '“' | '‘') => self.quoted(closing(quote)).map(ReplyNode::Text),
            _ => self.bare(),
        }
    }

    fn map(&mut self, depth: usize) -> Result<ReplyNode, ParseFault> {
        self.bump();
        let mut entries = Vec::new();
        loop {
            self.skip_space()?;
            match self.peek().ok_or(ParseFault::End)? {
                '}' => {
                    self.bump();
                    return Ok(ReplyNode::Map(entries));
                }
                ',' | ';' => drop(self.bump()),
                quote @ ('"' | '\'' | '“' | '‘') => {
                    let key = self.quoted(closing(quote))?;
                    self.colon()?;
                    entries.push((key, self.value(depth + 1)?));
                }
                c if c.is_alphabetic() || c == '_' => {
                    let rest = &self.text[self.at..];
                    let end = rest.find([':', '=', '{', '}', '\n', '"']).ok_or(ParseFault::End)?;
                    let key = rest[..end].trim().to_owned();
                    self.at += end;
                    self.colon()?;
                    entries.push((key, self.value(depth + 1)?));
                }
                _ => return Err(ParseFault::Malformed),
            }
        }
    }

    fn colon(&mut self) -> Result<(), ParseFault> {
        self.skip_space()?;
        match self.bump() {
            Some(':' | '=' | '：') => Ok(()),
            Some(_) => Err(ParseFault::Malformed),
            None => Err(ParseFault::End),
        }
    }

    fn list(&mut self, depth: usize) -> Result<ReplyNode, ParseFault> {
        self.bump();
        let mut items = Vec::new();
        loop {
            self.skip_space()?;
            match self.peek().ok_or(ParseFault::End)? {
                ']' => {
                    self.bump();
                    return Ok(ReplyNode::List(items));
                }
                ',' => drop(self.bump()),
                '}' => return Err(ParseFault::Malformed),
                _ => items.push(self.value(depth + 1)?),
            }
        }
    }

    /// Text up to the closing quote. Line breaks within it are kept, as models leave them unescaped.
    fn quoted(&mut self, close: char) -> Result<String, ParseFault> {
        self.bump();
        let mut out = String::new();
        loop {
            match self.bump().ok_or(ParseFault::End)? {
                c if c == close => return Ok(out),
                '\\' => match self.bump().ok_or(ParseFault::End)? {
                    'n' => out.push('\n'),
                    't' => out.push('\t'),
                    'r' | 'b' | 'f' => out.push(' '),
                    'u' => out.push(self.escaped()?),
                    c => out.push(c),
                },
                c => out.push(c),
            }
        }
    }

    /// Parses the character of `\uXXXX`, or of two of them for one beyond the basic plane.
    fn escaped(&mut self) -> Result<char, ParseFault> {
        let high = self.hex4()?;
        if (0xD800..0xDC00).contains(&high) && self.text[self.at..].starts_with("\\u") {
            self.at += 2;
            let low = self.hex4()?;
            if (0xDC00..0xE000).contains(&low) {
                let code = 0x10000 + ((high - 0xD800) << 10) + (low - 0xDC00);
                return Ok(char::from_u32(code).unwrap_or(char::REPLACEMENT_CHARACTER));
            }
            return Ok(char::REPLACEMENT_CHARACTER);
        }
        Ok(char::from_u32(high).unwrap_or(char::REPLACEMENT_CHARACTER))
    }

    fn hex4(&mut self) -> Result<u32, ParseFault> {
        let mut code = 0;
        for _ in 0..4 {
            let digit = self.bump().ok_or(ParseFault::End)?.to_digit(16).ok_or(ParseFault::Malformed)?;
            code = 16 * code + digit;
        }
        Ok(code)
    }

    /// Parses an unquoted word or number up to the next comma, bracket or line: `true`, `1.5e9`, `2400 kg/m3`,
    /// `NaN`.
    fn bare(&mut self) -> Result<ReplyNode, ParseFault> {
        let rest = &self.text[self.at..];
        let end = rest.find([',', '}', ']', '{', '[', '\n', '"', ':']).ok_or(ParseFault::End)?;
        let word = rest[..end].split("//").next().unwrap_or_default();
        let word = word.split("/*").next().unwrap_or_default().trim();
        if word.is_empty() {
            return Err(ParseFault::Malformed);
        }
        self.at += end;
        Ok(match word {
            "true" | "True" | "TRUE" => ReplyNode::Bool(true),
            "false" | "False" | "FALSE" => ReplyNode::Bool(false),
            "null" | "None" | "NULL" | "undefined" => ReplyNode::Null,
            _ if word.starts_with(|c: char| c.is_ascii_digit() || matches!(c, '-' | '+' | '.'))
                && word.parse::<f64>().is_ok() =>
            {
                ReplyNode::Number(word.to_owned())
            }
            _ => ReplyNode::Text(word.to_owned()),
        })
    }
}

fn closing(quote: char) -> char {
    match quote {
        '“' => '”',
        '‘' => '’',
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one(text: &str) -> Vec<(String, ReplyNode)> {
        let mut all = objects(text).unwrap().maps;
        assert_eq!(all.len(), 1, "{text}");
        all.remove(0)
    }

    fn number(text: &str) -> ReplyNode {
        ReplyNode::Number(text.into())
    }

    #[test]
    fn plain_json_is_read_as_it_is() {
        let read = one(r#"{"a": 1.5e3, "b": [true, null, "x\n\u00e9\ud83d\ude00\"y"], "c": {"d": -2}}"#);
        assert_eq!(read[0], ("a".into(), number("1.5e3")));
        let list = vec![ReplyNode::Bool(true), ReplyNode::Null, ReplyNode::Text("x\né😀\"y".into())];
        assert_eq!(read[1], ("b".into(), ReplyNode::List(list)));
        assert_eq!(read[2].1, ReplyNode::Map(vec![("d".into(), number("-2"))]));
    }

    #[test]
    fn damaged_json_is_repaired() {
        for text in [
            "Sure! Here it is:\n```json\n{\"a\": 1, \"b\": \"x\",}\n```\nHope {it} helps",
            "{a: 1, 'b': 'x'}",
            "<think>maybe {\"a\": 2}?</think>{\"a\": 1 /* one */, // first\n \"b\": \"x\"}",
            "“quoted” {“a”: 1, “b”: “x”}",
            "\u{feff}{\"a\":1,,\"b\":\"x\"}",
            r#""{\"a\": 1, \"b\": \"x\"}""#,
            "[{\"a\": 1, \"b\": \"x\"}]",
        ] {
            let all = objects(text).unwrap().maps;
            assert_eq!(
                all[0],
                vec![("a".into(), number("1")), ("b".into(), ReplyNode::Text("x".into()))],
                "{text}"
            );
        }
    }

    #[test]
    fn bare_quantities_are_kept_as_text() {
        let read = one("{\"density\": 2400 kg/m3, \"e\": NaN, \"f\": 1e400, \"g\": Infinity}");
        assert_eq!(read[0].1, ReplyNode::Text("2400 kg/m3".into()));
        assert_eq!(read[1].1, ReplyNode::Text("NaN".into()));
        assert_eq!(read[2].1, number("1e400"));
        assert_eq!(read[3].1, ReplyNode::Text("Infinity".into()));
    }

    #[test]
    fn replies_without_an_object_are_explained() {
        for text in ["", "I cannot tell.", "[1, 2]", "\"just text\"", "{ ( }"] {
            assert_eq!(objects(text), Err(NoObject::Missing), "{text}");
        }
        for text in ["{", "}{", "{\"a\": 1", "{\"a\": \"x", "text {\"a\": {\"b\": 1", "{\"a\""] {
            assert_eq!(objects(text), Err(NoObject::CutOff), "{text}");
        }
        let deep = format!("{}1{}", "{\"a\":".repeat(500), "}".repeat(500));
        assert!(objects(&deep).is_ok(), "the innermost levels are objects too");
        assert!(objects(&"{".repeat(300_000)).is_err());
        assert!(objects(&"[".repeat(300_000)).is_err());
    }

    #[test]
    fn repeated_keys_and_several_objects_are_kept() {
        assert_eq!(one("{\"a\": 1, \"a\": 2}").len(), 2);
        assert_eq!(objects("{\"a\": 1} or {\"a\": 2}").unwrap().maps.len(), 2);
    }
}
