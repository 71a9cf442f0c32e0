//! Starts the program.

use std::process::{Command, Output};

/// Runs the program with these arguments and without progress.
pub(crate) fn sms(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sms"));
    command.args(arguments).arg("--quiet").output().expect("the program starts")
}

/// Runs the program, which must succeed, and returns its output.
pub(crate) fn done(arguments: &[&str]) -> String {
    let output = sms(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", said(&output));
    said(&output)
}

/// Returns the standard output and error of a run.
pub(crate) fn said(output: &Output) -> String {
    [&output.stdout, &output.stderr].map(|s| String::from_utf8_lossy(s).into_owned()).concat()
}
