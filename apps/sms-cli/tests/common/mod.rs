//! Starting the program, for the tests of its commands.
#![allow(
    dead_code,
    unreachable_pub,
    reason = "each file of tests is a program of its own and takes its own part"
)]

use std::process::{Command, Output};

/// Runs the program with these arguments and without progress.
pub fn sms(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sms"));
    command.args(arguments).arg("--quiet").output().expect("the program starts")
}

/// Runs the program, which has to succeed; what it wrote.
pub fn done(arguments: &[&str]) -> String {
    let output = sms(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", said(&output));
    said(&output)
}

/// What a run wrote to both of its outputs.
pub fn said(output: &Output) -> String {
    [&output.stdout, &output.stderr].map(|s| String::from_utf8_lossy(s).into_owned()).concat()
}
