//! `sms check`: checks the consistency of a recording.

use crate::cli::CheckArguments;
use sms_cli::front::Console;
use sms_frames::{ReadOptions, Recording, check};
use std::process::ExitCode;

pub(crate) fn run(console: &Console, a: &CheckArguments) -> anyhow::Result<ExitCode> {
    let options = console.context.settings.section("read", ReadOptions::default())?;
    let recording = Recording::open(&a.recording, &options)?;
    let report = check(&recording, console.context.progress.as_ref(), &console.context.cancel)?;
    if console.json {
        let mut metrics = report.metrics();
        metrics.set("check.approved", report.approved());
        metrics.set("check.findings", serde_json::to_value(&report.findings)?);
        console.print_json(&metrics)?;
    } else {
        console.say(report.to_string());
    }
    // Exit code 2 means that the recording cannot be read; a fault in its content gives 1.
    Ok(if report.approved() { ExitCode::SUCCESS } else { ExitCode::from(1) })
}
