//! Warnings as text.

use sms_core::{Warning, wrapped};

/// Longest line of a warning, characters.
const WIDTH: usize = 100;

/// Returns a warning as lines: the message, then the cure.
pub(super) fn warning_lines(warning: &Warning) -> String {
    let message = wrapped(&format!("warning: {}", message(warning)), WIDTH, "  ");
    if warning.cure.is_empty() {
        return message;
    }
    let cure = wrapped(&format!("cure: {}", warning.cure), WIDTH - 2, "        ");
    format!("{message}\n  {cure}")
}

/// Returns a warning as one line, for output that programs read line by line.
pub(super) fn warning_line(warning: &Warning) -> String {
    let cure = if warning.cure.is_empty() { String::new() } else { format!("; {}", warning.cure) };
    format!("warning: {}{cure}", message(warning))
}

fn message(warning: &Warning) -> String {
    let times = if warning.count > 1 { format!(" ({} times)", warning.count) } else { String::new() };
    format!("{}{times}", warning.message)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_warnings_are_broken_into_lines() {
        let names: Vec<String> = (1..=12).map(|i| format!("object_{i:02}")).collect();
        let warning = Warning {
            stage: "scene".into(),
            code: "material_prior".into(),
            message: format!("the material of {} is unknown", names.join(", ")),
            cure: "give names, or values with `sms materials RUN --set OBJECT.KEY=VALUE`, ".repeat(3),
            count: 2,
        };
        let text = warning_lines(&warning);
        assert!(text.lines().count() > 4 && text.lines().all(|line| line.chars().count() <= WIDTH), "{text}");
        let is_whole = |line: &str| line.matches('`').count().is_multiple_of(2);
        assert!(text.lines().all(is_whole), "commands are on one line: {text}");
        assert!(names.iter().all(|name| text.contains(name)) && text.contains("(2 times)"));
        assert_eq!(warning_line(&warning).lines().count(), 1);
    }
}
