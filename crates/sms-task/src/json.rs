//! Readable JSON with long tables: one line per key and per element of a key's list; deeper levels stay on one line.

use serde::Serialize;
use serde_json::ser::{Formatter, PrettyFormatter, Serializer};
use sms_core::{CoreError, atomic};
use std::io::{self, Write};
use std::path::Path;

/// Levels with one element per line.
const PRETTY_LEVELS: usize = 2;

/// Writes a value atomically, with a final newline.
///
/// # Errors
/// [`CoreError::Write`].
pub fn write<T: Serialize>(path: &Path, value: &T) -> Result<(), CoreError> {
    atomic::write_with(path, |w| {
        let layout = LineFormatter { pretty: PrettyFormatter::new(), level: 0 };
        value.serialize(&mut Serializer::with_formatter(&mut *w, layout)).map_err(io::Error::other)?;
        w.write_all(b"\n")
    })
}

struct LineFormatter {
    pretty: PrettyFormatter<'static>,
    level: usize,
}

impl LineFormatter {
    fn is_pretty(&self) -> bool {
        self.level <= PRETTY_LEVELS
    }
}

impl Formatter for LineFormatter {
    fn begin_array<W: ?Sized + Write>(&mut self, w: &mut W) -> io::Result<()> {
        self.level += 1;
        if self.is_pretty() { self.pretty.begin_array(w) } else { w.write_all(b"[") }
    }

    fn end_array<W: ?Sized + Write>(&mut self, w: &mut W) -> io::Result<()> {
        let pretty = self.is_pretty();
        self.level -= 1;
        if pretty { self.pretty.end_array(w) } else { w.write_all(b"]") }
    }

    fn begin_array_value<W: ?Sized + Write>(&mut self, w: &mut W, first: bool) -> io::Result<()> {
        if self.is_pretty() {
            self.pretty.begin_array_value(w, first)
        } else if first {
            Ok(())
        } else {
            w.write_all(b", ")
        }
    }

    fn end_array_value<W: ?Sized + Write>(&mut self, w: &mut W) -> io::Result<()> {
        if self.is_pretty() { self.pretty.end_array_value(w) } else { Ok(()) }
    }

    fn begin_object<W: ?Sized + Write>(&mut self, w: &mut W) -> io::Result<()> {
        self.level += 1;
        if self.is_pretty() { self.pretty.begin_object(w) } else { w.write_all(b"{") }
    }

    fn end_object<W: ?Sized + Write>(&mut self, w: &mut W) -> io::Result<()> {
        let pretty = self.is_pretty();
        self.level -= 1;
        if pretty { self.pretty.end_object(w) } else { w.write_all(b"}") }
    }

    /// Keys are laid out as elements of an array.
    fn begin_object_key<W: ?Sized + Write>(&mut self, w: &mut W, first: bool) -> io::Result<()> {
        self.begin_array_value(w, first)
    }

    fn begin_object_value<W: ?Sized + Write>(&mut self, w: &mut W) -> io::Result<()> {
        w.write_all(b": ")
    }

    fn end_object_value<W: ?Sized + Write>(&mut self, w: &mut W) -> io::Result<()> {
        self.end_array_value(w)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deep_levels_stay_on_their_line_and_the_value_is_the_same() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.json");
        let value = serde_json::json!({
            "a": [1, [2, 3], {"b": [], "c": {"d": null, "e": "x"}}], "empty": {}, "list": [],
        });
        write(&path, &value).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let expected = "{\n  \"a\": [\n    1,\n    [2, 3],\n    {\"b\": [], \"c\": {\"d\": null, \"e\": \"x\"}}\n  ],\n  \
                        \"empty\": {},\n  \"list\": []\n}\n";
        assert_eq!(text, expected);
        assert_eq!(serde_json::from_str::<serde_json::Value>(&text).unwrap(), value);
    }
}
