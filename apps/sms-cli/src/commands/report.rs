//! `sms report`: writes the report page of a run.

use crate::cli::ReportArguments;
use sms_cli::front::Console;
use sms_pipeline::Run;
use std::path::PathBuf;

/// Writes the report; returns the page's path.
pub(crate) fn run(console: &Console, a: &ReportArguments) -> anyhow::Result<PathBuf> {
    let run = Run::new(&a.run, &console.context);
    let page = write(console, &run)?;
    console.conclude(&run)?;
    Ok(page)
}

/// Writes the report without a conclusion; returns the page's path.
pub(super) fn write(console: &Console, run: &Run<'_>) -> anyhow::Result<PathBuf> {
    let page = run.report()?;
    console.say(format!("report: {}", page.display()));
    Ok(page)
}
