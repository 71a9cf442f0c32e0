//! Formatting of quantities in messages, and of text for XML.

/// Formats a length: millimetres below a centimetre, centimetres below a metre, metres above.
pub fn length_text(metres: f64) -> String {
    let [text] = lengths_text([metres]);
    text
}

/// Formats lengths that are compared, all in the unit of the largest one ([`length_text`]).
pub fn lengths_text<const N: usize>(metres: [f64; N]) -> [String; N] {
    let largest = metres.iter().map(|m| m.abs()).filter(|m| !m.is_nan()).max_by(f64::total_cmp);
    let (per_metre, unit) = match largest {
        Some(m) if m < 0.01 => (1e3, "mm"),
        Some(m) if m < 1.0 => (1e2, "cm"),
        _ => (1.0, "m"),
    };
    metres.map(|m| format!("{:.2} {unit}", m * per_metre))
}

/// Formats a count with its noun: `1 pair`, `3 pairs`.
pub fn counted(count: usize, one: &str, more: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { more })
}

/// Formats a duration: `41 s`, `2 min 10 s`, `1 h 5 min`.
pub fn duration_text(seconds: f64) -> String {
    let whole = seconds.max(0.0).round() as u64;
    match whole {
        0..60 => format!("{whole} s"),
        60..3600 => format!("{} min {} s", whole / 60, whole % 60),
        _ => format!("{} h {} min", whole / 3600, whole % 3600 / 60),
    }
}

/// Breaks text between words into lines of at most `width` characters; lines after the first begin with `indent`. Text
/// between backticks stays on one line, so that commands can be copied.
pub fn wrapped(text: &str, width: usize, indent: &str) -> String {
    let mut words: Vec<String> = Vec::new();
    let mut is_quoted = false;
    for word in text.split(' ') {
        match words.last_mut().filter(|_| is_quoted) {
            Some(quoted) => *quoted = format!("{quoted} {word}"),
            None => words.push(word.to_owned()),
        }
        is_quoted ^= word.matches('`').count() % 2 == 1;
    }
    let (mut out, mut used) = (String::new(), 0);
    for word in words {
        let length = word.chars().count();
        if used > 0 && used + 1 + length > width {
            out.push('\n');
            out.push_str(indent);
            used = indent.chars().count();
        } else if used > 0 {
            out.push(' ');
            used += 1;
        }
        out.push_str(&word);
        used += length;
    }
    out
}

/// Escapes text for the content and the attribute values of XML and HTML elements.
pub fn escape_xml(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_text_is_broken_between_words_and_not_in_commands() {
        let text = "one two `sms scan REC --out RUN` three";
        assert_eq!(wrapped(text, 100, "  "), text);
        assert_eq!(wrapped(text, 10, "  "), "one two\n  `sms scan REC --out RUN`\n  three");
        let words = "word ".repeat(40);
        let lines = wrapped(words.trim(), 21, "> ");
        assert!(lines.lines().all(|line| line.len() <= 21) && lines.lines().count() == 10, "{lines}");
        assert_eq!(lines.replace("\n> ", " "), words.trim());
        assert_eq!(wrapped("an `open quote", 4, ""), "an\n`open quote");
    }

    #[test]
    fn lengths_and_durations() {
        assert_eq!(length_text(0.00123), "1.23 mm");
        assert_eq!(length_text(-0.0512), "-5.12 cm");
        assert_eq!(length_text(2.5), "2.50 m");
        assert_eq!(length_text(f64::NAN), "NaN m");
        assert_eq!(lengths_text([0.00473, 0.0105]), ["0.47 cm", "1.05 cm"]);
        assert_eq!(lengths_text([-2.5, 0.004, f64::NAN]), ["-2.50 m", "0.00 m", "NaN m"]);
        assert_eq!(duration_text(40.6), "41 s");
        assert_eq!(duration_text(59.7), "1 min 0 s");
        assert_eq!(duration_text(3900.0), "1 h 5 min");
        assert_eq!(duration_text(-1.0), "0 s");
    }
}
