//! Text of commands that are printed for a shell.

use std::path::Path;

/// Returns a path as one argument of a command. A leading `-` gets `./` in front: quotes would not keep the command from
/// reading the path as an option.
pub fn shell_argument(path: &Path) -> String {
    let text = path.display().to_string();
    if text.starts_with('-') { shell_word(&format!("./{text}")) } else { shell_word(&text) }
}

/// Returns a text as one word of a command, in quotes if a shell would change or divide it.
pub fn shell_word(text: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "/._-+=:,@~".contains(c);
    // A shell replaces a leading `~` by the user's folder.
    if !text.is_empty() && !text.starts_with('~') && text.chars().all(is_plain) {
        return text.to_owned();
    }
    format!("'{}'", text.replace('\'', "'\\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_is_one_argument_and_no_option() {
        for (path, argument) in [
            ("runs/desk-1", "runs/desk-1"),
            ("my run", "'my run'"),
            ("it's", "'it'\\''s'"),
            ("", "''"),
            ("~/run", "'~/run'"),
            ("desk~2", "desk~2"),
            ("-v", "./-v"),
            ("- v", "'./- v'"),
        ] {
            assert_eq!(shell_argument(Path::new(path)), argument);
        }
        assert_eq!((shell_word("--up"), shell_word("a b")), ("--up".to_owned(), "'a b'".to_owned()));
    }
}
