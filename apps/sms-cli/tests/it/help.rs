//! The help fits on a screen: of the program, and of every command.

use crate::common::done;

/// Lines and columns of a screen.
const SCREEN: (usize, usize) = (40, 100);

/// Returns the number of lines on the screen, where long lines are wrapped.
fn height(text: &str) -> usize {
    text.trim_end().lines().map(|line| line.chars().count().div_ceil(SCREEN.1).max(1)).sum()
}

/// Returns the commands that the help lists.
fn commands(help: &str) -> Vec<&str> {
    let lists = help.split("Global options").next().unwrap().lines().filter(|line| line.starts_with("  "));
    lists.map(|line| line.split_whitespace().next().unwrap()).collect()
}

#[test]
fn the_help_of_every_command_fits_on_a_screen() {
    let all = done(&["--help"]);
    assert!(height(&all) <= SCREEN.0, "{} lines:\n{all}", height(&all));
    let commands = commands(&all);
    assert!(commands.len() > 20, "{commands:?}");
    for command in commands {
        let text = done(&[command, "--help"]);
        assert!(height(&text) <= SCREEN.0, "{} lines:\n{text}", height(&text));
        assert_eq!(text.matches("Global options:").count(), 1, "{text}");
        assert_eq!(text, done(&[command, "-h"]));
        let full =
            std::process::Command::new(env!("CARGO_BIN_EXE_sms")).args(["help", command]).output().unwrap();
        assert!(full.stdout.len() > text.len(), "the full text is longer: {command}");
    }
}
