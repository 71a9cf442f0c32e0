//! `sms view`: opens the report.

use super::report;
use crate::cli::ReportArguments;
use sms_cli::front::Console;
use std::process::{Command, Stdio};

pub(crate) fn run(console: &Console, a: &ReportArguments) -> anyhow::Result<()> {
    let page = report::run(console, a)?;
    let opener = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    let opened = Command::new(opener).arg(&page).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
    if opened.is_err() {
        console.say(format!("no browser could be started; open {} yourself", page.display()));
    }
    Ok(())
}
