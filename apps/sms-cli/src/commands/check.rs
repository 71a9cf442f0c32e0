//! `sms check`: is this recording what it says?

use crate::cli::Check;
use crate::context::Context;
use sms_frames::{ReadOptions, Recording, check};
use std::process::ExitCode;

pub(crate) fn run(context: &Context, a: &Check) -> anyhow::Result<ExitCode> {
    let options = context.settings.section("read", ReadOptions::default())?;
    let recording = Recording::open(&a.recording, &options)?;
    let report = check(&recording, context.progress.as_ref(), &context.cancel)?;
    if context.json {
        let mut metrics = report.metrics();
        metrics.set("check.approved", report.approved());
        metrics.set("check.findings", serde_json::to_value(&report.findings)?);
        context.print_json(&metrics)?;
    } else {
        context.say(report.to_text());
    }
    // 2 is a recording that cannot be read; one that was read and is wrong is neither that nor done.
    Ok(if report.approved() { ExitCode::SUCCESS } else { ExitCode::from(1) })
}
