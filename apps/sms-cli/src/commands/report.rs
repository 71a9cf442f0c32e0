//! `sms report`: writes the report page of a run.

use crate::cli::ReportArguments;
use sms_cli::front::Console;
use sms_pipeline::Run;
use std::path::PathBuf;

/// Writes the report; returns the page's path.
pub(crate) fn run(console: &Console, a: &ReportArguments) -> anyhow::Result<PathBuf> {
    let run = Run::new(&a.run, &console.context);
    let page = run.report()?;
    console.say(format!("report: {}", page.display()));
    console.conclude(&run)?;
    Ok(page)
}
