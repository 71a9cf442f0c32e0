//! A plan for the robot is one that the robot can carry out: `sms plan`, then `sms robot`, on the sample scene.

use crate::common::{copy_materialized_run, done, recording, said, sms};
use serde_json::Value;
use std::fs;
use std::path::Path;

fn json(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn what_is_planned_for_the_robot_passes_every_check() {
    let dir = tempfile::tempdir().unwrap();
    let (run, task) = (dir.path().join("run"), recording().join("task.toml"));
    let [out, task] = [&run, &task].map(|p| p.to_str().unwrap());
    copy_materialized_run(&run);
    let set = ["--set", "plan.evaluations=60"];
    done(&[&["plan", out, "--task", task, "--robust", "0", "--seed", "1"], &set[..]].concat());
    assert!(json(&run.join("plan/plan.json"))["robot"].is_object(), "planned for the arm");
    done(&["robot", out]);
    let program = json(&run.join("robot/program.json"));
    assert_eq!(program["executable"], true);
    assert_eq!(program["failed_checks"], Value::Array(Vec::new()));
    assert!(run.join("robot/program.parquet").exists());

    // Out of reach: no motion of another pose is left.
    let elsewhere = sms(&["robot", out, "--at", "-3,0,0,0"]);
    assert_eq!(elsewhere.status.code(), Some(2), "{}", said(&elsewhere));
    assert!(said(&elsewhere).contains("cure:"), "{}", said(&elsewhere));
    assert!(!run.join("robot").exists() && run.join("robot.earlier/program.json").exists());

    bad_input_is_refused(dir.path(), out, task);
}

/// Each mistake gives exit code 2 and a message with the wrong name and the cure.
fn bad_input_is_refused(dir: &Path, run: &str, task: &str) {
    let refused = |arguments: &[&str], words: &[&str]| {
        let output = sms(arguments);
        let text = said(&output);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {text}");
        assert!(!text.contains("panicked"), "{text}");
        for word in words.iter().chain(&["cure:"]) {
            assert!(text.contains(word), "{arguments:?}: {word}: {text}");
        }
    };
    let write = |name: &str, text: String| {
        let path = dir.join(name);
        fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let good = fs::read_to_string(task).unwrap();
    let goal = good.lines().find(|l| l.starts_with("goal_w")).unwrap();
    let plan = |task: &str| ["plan", run, "--task", task, "--robust", "0", "--seed", "1"].map(str::to_owned);
    let plan_refused = |task: &str, more: &[&str], words: &[&str]| {
        let arguments = plan(task);
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).chain(more.iter().copied()).collect();
        refused(&arguments, words);
    };
    let far = write("far.toml", good.replace(goal, "goal_w = [7.0, 0.2]"));
    plan_refused(&far, &[], &["goal_w", "far.toml", "from the nearest scanned body"]);
    let unknown = write("unknown.toml", good.replace("color = \"white\"", "name = \"teapot\""));
    plan_refused(&unknown, &[], &["teapot", "unknown.toml", "object_01"]);

    // A robot with a mesh that is not there.
    let urdf = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../crates/sms-robots/assets/fr3.urdf");
    let urdf = fs::read_to_string(urdf).unwrap();
    let shape = "<sphere radius=\"0.04\"/>";
    assert!(urdf.contains(shape));
    let bare = write("bare.urdf", urdf.replacen(shape, "<mesh filename=\"no/such.stl\"/>", 1));
    let set = format!("robot.urdf={bare}");
    plan_refused(task, &["--set", &set, "--set", "robot.tool=fr3_fist"], &["no/such.stl", "bare.urdf"]);

    // A scene that was edited.
    let path = Path::new(run).join("scene/scene.json");
    let scene = fs::read_to_string(&path).unwrap();
    let mut json: Value = serde_json::from_str(&scene).unwrap();
    let body = json["bodies"].as_array_mut().unwrap().iter_mut().find(|b| b["mass"].is_object()).unwrap();
    body["mass"]["mass_kg"] = 0.0.into();
    let name = body["name"].as_str().unwrap().to_owned();
    fs::write(&path, json.to_string()).unwrap();
    plan_refused(task, &[], &["scene.json", &name, "mass", "positive"]);
    fs::write(&path, scene).unwrap();
}
