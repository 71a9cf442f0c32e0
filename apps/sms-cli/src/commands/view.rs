//! `sms view`: opens the report.

use super::report;
use crate::cli::ReportArguments;
use sms_cli::front::{Console, note};
use sms_pipeline::Run;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Time to wait for the end of the opener. One that finds no browser ends at once; one that still runs has started a
/// browser in the foreground.
const PATIENCE: Duration = Duration::from_secs(3);

pub(crate) fn run(console: &Console, a: &ReportArguments) -> anyhow::Result<()> {
    let run = Run::new(&a.run, &console.context);
    let page = std::path::absolute(&report::write(console, &run)?)?;
    let opener = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    if let Err(reason) = open(opener, &page) {
        let url = file_url(&page);
        note(format_args!("warning: no browser was opened ({reason}); open this page yourself:\n  {url}"));
    }
    console.conclude_without(&run, "view")
}

/// Opens a page with a program that starts the user's browser; returns why it could not.
fn open(opener: &str, page: &Path) -> Result<(), String> {
    let fault = |reason: &dyn std::fmt::Display| format!("{opener}: {reason}");
    let mut command = Command::new(opener);
    command.arg(page).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    let mut child = command.spawn().map_err(|e| fault(&e))?;
    let began = Instant::now();
    loop {
        match child.try_wait() {
            Ok(Some(status)) if status.success() => return Ok(()),
            Ok(Some(status)) => return Err(fault(&status)),
            Ok(None) if began.elapsed() >= PATIENCE => return Ok(()),
            Ok(None) => std::thread::sleep(Duration::from_millis(20)),
            Err(e) => return Err(fault(&e)),
        }
    }
}

/// Returns the address of a file for a browser (RFC 8089): bytes outside of the unreserved characters are escaped.
fn file_url(path: &Path) -> String {
    let escaped = path.to_string_lossy().bytes().fold(String::new(), |mut url, byte| {
        if byte.is_ascii_alphanumeric() || b"/-_.~".contains(&byte) {
            url.push(char::from(byte));
        } else {
            url.push_str(&format!("%{byte:02X}"));
        }
        url
    });
    format!("file://{escaped}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_of_files_have_no_spaces() {
        assert_eq!(file_url(Path::new("/tmp/my run/ü/index.html")), "file:///tmp/my%20run/%C3%BC/index.html");
    }

    #[cfg(unix)]
    #[test]
    fn the_exit_code_of_the_opener_counts() {
        let page = Path::new("/");
        assert_eq!(open("true", page), Ok(()));
        assert!(open("false", page).unwrap_err().contains("1"));
        assert!(open("no-such-opener", page).is_err());
    }
}
