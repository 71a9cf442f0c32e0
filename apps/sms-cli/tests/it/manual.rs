//! Shell completions and man pages.

use crate::common::done;
use std::fs;

#[test]
fn every_command_has_a_man_page_and_every_shell_its_completions() {
    let dir = tempfile::tempdir().unwrap();
    done(&["manual", dir.path().to_str().unwrap()]);
    let man: Vec<String> = fs::read_dir(dir.path().join("man"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    for page in ["sms.1", "sms-scan.1", "sms-plan.1"] {
        assert!(man.iter().any(|m| m == page), "{man:?}");
    }
    let completions = dir.path().join("completions");
    assert!(fs::read_to_string(completions.join("sms.bash")).unwrap().contains("materialize"));
    assert!(fs::read_dir(&completions).unwrap().count() >= 3);
}
