//! `sms run`, `sms status` and the settings of the working folder.

use crate::common::{done, recording, said};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

/// Runs the program in a working folder.
fn sms_in(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sms"));
    command.current_dir(folder).args(arguments).arg("--quiet").output().unwrap()
}

fn json(output: &Output) -> Value {
    assert!(output.status.success(), "{}", said(output));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn all_stages_run_in_one_command_and_are_not_repeated() {
    let dir = tempfile::tempdir().unwrap();
    // The settings of the folder make the work quick.
    let settings = "[scan.fused]\nsteps = 60\n[entities]\npoint_budget = 2000\ntexture = { enabled = false }\n\
                    [plan]\nevaluations = 20\nanew = 0\ndisturbances = { worlds = 0 }\n";
    fs::write(dir.path().join("sms.toml"), settings).unwrap();
    let (recording, task) = (recording(), recording().join("task.toml"));
    let given =
        ["run", recording.to_str().unwrap(), "--task", task.to_str().unwrap(), "--preset", "draft", "--json"];
    let first = json(&sms_in(dir.path(), &given));
    assert!(first["execute.success"].is_boolean() && first["simulate.drift_m"].is_number(), "{first}");
    let root = dir.path().join("runs").join(recording.file_name().unwrap());
    let recorded: toml::Table = toml::from_str(&fs::read_to_string(root.join("run.toml")).unwrap()).unwrap();
    assert_eq!(recorded["scan"]["fused"]["steps"].as_integer(), Some(60));

    let status = json(&sms_in(&root, &["status", ".", "--json"]));
    for stage in ["frames", "masks", "gaussians", "entities", "scene", "plan", "target", "report"] {
        assert_eq!(status[format!("status.{stage}")], "complete", "{stage}: {status}");
    }
    assert_eq!(status["status.robot"], "absent");
    let stamp = |stage: &str| fs::metadata(root.join(stage).join("stage.json")).unwrap().modified().unwrap();
    let stamps = || ["gaussians", "scene", "plan", "target"].map(stamp);
    let before = stamps();
    json(&sms_in(dir.path(), &given));
    assert_eq!(stamps(), before, "nothing is made again");

    // The page shows the figures of a check and the names of the objects.
    let page = || json(&sms_in(&root, &["status", ".", "--json"]))["status.report"].clone();
    assert_eq!(page(), "complete");
    json(&sms_in(&root, &["simulate", ".", "--seconds", "0.5", "--json"]));
    assert_eq!(page(), "stale");
    json(&sms_in(&root, &["report", ".", "--json"]));
    assert_eq!(page(), "complete");
    json(&sms_in(&root, &["name", ".", "object_01=duck", "--json"]));
    assert_eq!(page(), "stale");

    // The folder belongs to this recording.
    let other = dir.path().join("other").join(recording.file_name().unwrap());
    fs::create_dir_all(&other).unwrap();
    let refused = sms_in(dir.path(), &["run", other.to_str().unwrap()]);
    assert_eq!(refused.status.code(), Some(2), "{}", said(&refused));
    assert!(said(&refused).contains("--out"));
}

#[test]
fn settings_of_the_working_folder_are_the_lowest() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("sms.toml"), "[scan]\nfinal_steps = 11\nholdout = 5\n").unwrap();
    fs::write(dir.path().join("mine.toml"), "[scan]\nfinal_steps = 12\n").unwrap();
    let scan = |more: &[&str]| -> toml::Table {
        let output = sms_in(dir.path(), &[&["settings"], more].concat());
        assert!(output.status.success(), "{}", said(&output));
        let all: toml::Table = toml::from_str(&String::from_utf8(output.stdout).unwrap()).unwrap();
        all["scan"].as_table().unwrap().clone()
    };
    let steps = |table: &toml::Table| (table["final_steps"].as_integer(), table["holdout"].as_integer());
    assert_eq!(steps(&scan(&[])), (Some(11), Some(5)));
    assert_eq!(steps(&scan(&["--settings", "mine.toml"])), (Some(12), Some(5)));
    assert_eq!(
        steps(&scan(&["--settings", "mine.toml", "--set", "scan.final_steps=13"])),
        (Some(13), Some(5))
    );
    fs::write(dir.path().join("sms.toml"), "[scan]\nfinal_stps = 11\n").unwrap();
    let refused = sms_in(dir.path(), &["settings"]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(said(&refused).contains("sms.toml"));
}

#[test]
fn a_scan_alone_asks_for_a_scene_next() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let paths = ["scan", recording().to_str().unwrap(), "--out", run.to_str().unwrap(), "--preset", "draft"];
    done(&[&paths[..], &["--set", "scan.fused.steps=20"]].concat());
    let status = json(&sms_in(dir.path(), &["status", "run", "--json"]));
    assert_eq!(
        (&status["status.gaussians"], &status["status.scene"]),
        (&"complete".into(), &"absent".into())
    );
    assert_eq!(status["status.next"], serde_json::json!(["sms materialize run"]));
    let nowhere = sms_in(dir.path(), &["status", "nowhere"]);
    assert_eq!(nowhere.status.code(), Some(2), "{}", said(&nowhere));
}
