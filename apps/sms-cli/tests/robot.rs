//! A plan for the robot is one that the robot can carry out: `sms plan`, then `sms robot`, on the sample scene.

use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn sms(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sms"));
    command.args(arguments).arg("--quiet").output().expect("the program starts")
}

fn done(arguments: &[&str]) -> String {
    let output = sms(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", said(&output));
    said(&output)
}

fn said(output: &Output) -> String {
    [&output.stdout, &output.stderr].map(|s| String::from_utf8_lossy(s).into_owned()).concat()
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn what_is_planned_for_the_robot_passes_every_check() {
    let dir = tempfile::tempdir().unwrap();
    let (recording, run) = (dir.path().join("sample"), dir.path().join("run"));
    let task = recording.join("task.toml");
    let [recording, out, task] = [&recording, &run, &task].map(|p| p.to_str().unwrap());
    done(&["sample", recording]);
    done(&["scan", recording, "--out", out, "--preset", "draft"]);
    done(&["materialize", out]);
    let set = ["--set", "plan.evaluations=60"];
    done(&[&["plan", out, "--task", task, "--robust", "0", "--seed", "1"], &set[..]].concat());
    assert!(json(&run.join("plan/plan.json"))["robot"].is_object(), "planned for the arm");
    done(&["robot", out]);
    let program = json(&run.join("robot/program.json"));
    assert_eq!(program["executable"], true);
    assert_eq!(program["failed_checks"], Value::Array(Vec::new()));
    assert!(run.join("robot/program.parquet").exists());

    // Elsewhere than planned: the note says so, and no motion is left that does not pass.
    let elsewhere = sms(&["robot", out, "--at", "-3,0,0,0"]);
    assert_eq!(elsewhere.status.code(), Some(2), "{}", said(&elsewhere));
    assert!(said(&elsewhere).contains("cure:"), "{}", said(&elsewhere));
}
