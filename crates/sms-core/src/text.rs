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

/// Formats a duration: `41 s`, `2 min 10 s`, `1 h 5 min`.
pub fn duration_text(seconds: f64) -> String {
    let whole = seconds.max(0.0).round() as u64;
    match whole {
        0..60 => format!("{whole} s"),
        60..3600 => format!("{} min {} s", whole / 60, whole % 60),
        _ => format!("{} h {} min", whole / 3600, whole % 3600 / 60),
    }
}

/// Escapes text for the content and the attribute values of XML and HTML elements.
pub fn escape_xml(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

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
