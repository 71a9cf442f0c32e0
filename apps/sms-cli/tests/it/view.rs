//! `sms view`: names the page if no browser opens.

use crate::common::copy_materialized_run;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};

/// Views a run with an opener that ends with this exit code.
fn view(run: &Path, tools: &Path, code: u8) -> Output {
    let opener = tools.join(if cfg!(target_os = "macos") { "open" } else { "xdg-open" });
    std::fs::write(&opener, format!("#!/bin/sh\nexit {code}\n")).unwrap();
    std::fs::set_permissions(&opener, std::fs::Permissions::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", tools.display(), std::env::var("PATH").unwrap());
    let mut command = Command::new(env!("CARGO_BIN_EXE_sms"));
    command.args(["view", run.to_str().unwrap(), "--quiet"]).env("PATH", path).output().unwrap()
}

#[test]
fn a_browser_that_does_not_open_is_told_with_the_page() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    copy_materialized_run(&run);
    let page = run.join("report").join("index.html");
    let told = |output: &Output| {
        assert!(output.status.success());
        String::from_utf8_lossy(&output.stderr).contains(&format!("file://{}", page.display()))
    };
    assert!(told(&view(&run, dir.path(), 3)), "no application can open the page");
    assert!(!told(&view(&run, dir.path(), 0)));
    assert!(page.is_file());
}
