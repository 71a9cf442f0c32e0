//! Material values follow renamed objects; results stay until their successors are complete, and are marked as stale.

use crate::common::{CopiedRun, done, recording, said};
use serde_json::Value;
use std::fs;

/// Settings of `materialize` that make it quick; the same as those of the copied run.
const QUICK: [&str; 2] = ["--set", "entities.point_budget=4000"];

impl CopiedRun {
    fn json(&self, command: &str) -> Value {
        serde_json::from_str(&self.done(command, &["--json"])).unwrap()
    }

    fn rename(&self, from: &str, to: &str) {
        self.edit_labels(&format!("\"name\": \"{from}\""), &format!("\"name\": \"{to}\""));
    }

    /// Plans the recording's task with little search.
    fn plan(&self) {
        let task = recording().join("task.toml");
        let few = ["--robust", "0", "--set", "plan.evaluations=20", "--set", "plan.anew=0"];
        self.done("plan", &[&["--task", task.to_str().unwrap()], &few[..]].concat());
    }
}

#[test]
fn material_values_follow_an_object_through_renames() {
    let run = CopiedRun::new();
    run.done("materials", &["--set", "object_03.class=rubber", "--set", "floor.friction=0.7"]);
    run.rename("object_03", "duck");
    // Before the scene has the new name, both names are known.
    assert_eq!(run.json("materials")["materials.duck.class"], "rubber");
    run.done("materials", &["--set", "object_03.friction=0.9", "--unset", "floor"]);
    run.done("materialize", &QUICK);
    let scene: Value = serde_json::from_slice(&fs::read(run.path("scene/scene.json")).unwrap()).unwrap();
    let duck = scene["bodies"].as_array().unwrap().iter().find(|b| b["name"] == "duck").unwrap();
    assert_eq!(duck["material"]["class"], "rubber");
    assert_eq!(duck["material"]["friction"]["best"], 0.9);
    let edits = fs::read_to_string(run.path("materials.toml")).unwrap();
    assert!(edits.contains("object.duck") && !edits.contains("object_03"), "{edits}");
    // An exchange of names: the values stay with the object.
    run.done("name", &["duck=object_02", "object_02=duck"]);
    assert_eq!(run.json("materials")["materials.object_02.class"], "rubber");
    assert_ne!(run.json("materials")["materials.duck.class"], "rubber");
}

#[test]
fn values_of_an_object_that_is_gone_name_their_cure_and_leave_the_scene() {
    let run = CopiedRun::new();
    let before = fs::read(run.path("scene/scene.json")).unwrap();
    fs::write(run.path("materials.toml"), "[object.teapot]\nclass = \"rubber\"\n").unwrap();
    run.rename("object_03", "duck");
    let refused = run.run("materialize", &QUICK);
    let message = said(&refused);
    assert_eq!(refused.status.code(), Some(2), "{message}");
    assert!(message.contains("--unset teapot") && message.contains("duck"), "{message}");
    assert_eq!(fs::read(run.path("scene/scene.json")).unwrap(), before, "the scene stays");
    assert!(run.path("entities/object_03").is_dir());
    // A file with unknown names is refused before any work, too.
    let file = run.path("mine.toml");
    fs::write(&file, "[object.teapot]\nclass = \"rubber\"\n").unwrap();
    run.done("materials", &["--unset", "teapot"]);
    let given = ["--materials", file.to_str().unwrap()];
    let refused = run.run("materialize", &[&given[..], &QUICK].concat());
    assert_eq!(refused.status.code(), Some(2), "{}", said(&refused));
    assert!(run.path("entities/object_03").is_dir(), "nothing was made");
    run.done("materialize", &QUICK);
    assert!(run.path("entities/duck").is_dir());
}

#[test]
fn values_are_taken_back_without_a_scene() {
    let run = CopiedRun::new();
    run.done("materials", &["--set", "object_03.class=rubber", "--set", "object_02.class=steel"]);
    fs::remove_dir_all(run.path("scene")).unwrap();
    run.rename("object_03", "duck");
    run.done("materials", &["--unset", "duck"]);
    let edits = fs::read_to_string(run.path("materials.toml")).unwrap();
    assert!(
        edits.contains("object_02") && !edits.contains("duck") && !edits.contains("object_03"),
        "{edits}"
    );
    assert_eq!(run.run("materials", &["--unset", "teapot"]).status.code(), Some(2));
    assert_eq!(run.run("materials", &[]).status.code(), Some(2), "there is nothing to list");
}

#[test]
fn a_plan_for_another_scene_stays_and_is_stale_until_the_scene_returns() {
    let run = CopiedRun::new();
    run.plan();
    run.done("execute", &["--engine", "rapier"]);
    let files = ["plan/plan.json", "target/execution.json"];
    let contents = || files.map(|file| fs::read(run.path(file)).unwrap());
    let before = contents();
    let condition = |stage: &str| run.json("status")[format!("status.{stage}")].as_str().unwrap().to_owned();
    assert_eq!((condition("plan"), condition("target")), ("complete".into(), "complete".into()));

    run.done("materials", &["--set", "floor.friction=0.9"]);
    assert_eq!((condition("scene"), condition("plan")), ("stale".into(), "stale".into()));
    // The plan still fits the scene, to which the edit was not applied yet.
    run.done("execute", &["--engine", "rapier"]);
    let made = run.done("materialize", &QUICK);
    assert!(made.contains("plan, target"), "{made}");
    assert_eq!(contents(), before, "the plan and its execution stay");
    assert_eq!((condition("scene"), condition("plan")), ("complete".into(), "stale".into()));
    assert!(run.json("status")["status.plan.reasons"][0].as_str().unwrap().contains("scene"));
    for command in ["execute", "robot"] {
        let refused = run.run(command, &[]);
        let message = said(&refused);
        assert_eq!(refused.status.code(), Some(2), "{command}: {message}");
        assert!(message.contains("stale") && message.contains("sms plan"), "{command}: {message}");
    }
    run.done("report", &[]);
    let page = fs::read_to_string(run.path("report/index.html")).unwrap();
    assert!(page.contains("`plan` is stale"), "the report tells");
    assert!(run.json("report")["stale.plan"].is_string());

    // The same scene as before: the plan is right again.
    run.done("materials", &["--unset", "floor"]);
    run.done("materialize", &QUICK);
    assert_eq!((condition("plan"), condition("target")), ("complete".into(), "complete".into()));
    assert_eq!(contents(), before);
}

#[test]
fn a_scene_that_was_edited_by_hand_is_kept_when_another_is_made() {
    let run = CopiedRun::new();
    let scene = run.path("scene/scene.json");
    let edited = fs::read_to_string(&scene).unwrap() + "\n";
    fs::write(&scene, &edited).unwrap();
    run.done("materialize", &QUICK);
    assert_eq!(fs::read_to_string(&scene).unwrap(), edited, "nothing was to be made");
    run.done("materials", &["--set", "floor.friction=0.9"]);
    let codes = |run: &CopiedRun| {
        let warnings: Value = serde_json::from_slice(&fs::read(run.path("warnings.json")).unwrap()).unwrap();
        let codes = warnings.as_array().unwrap().iter().map(|w| w["code"].as_str().unwrap().to_owned());
        codes.collect::<Vec<_>>()
    };
    assert!(!codes(&run).contains(&"edits_set_aside".to_owned()));
    run.done("materialize", &QUICK);
    assert_ne!(fs::read_to_string(&scene).unwrap(), edited);
    assert_eq!(fs::read_to_string(run.path("scene.earlier/scene.json")).unwrap(), edited);
    assert!(codes(&run).contains(&"edits_set_aside".to_owned()), "{:?}", codes(&run));
    // Without an edit, the earlier scene is not kept.
    fs::remove_dir_all(run.path("scene.earlier")).unwrap();
    run.done("materials", &["--unset", "floor"]);
    run.done("materialize", &QUICK);
    assert!(!run.path("scene.earlier").exists());
}

#[test]
fn a_merge_is_no_new_name() {
    let run = CopiedRun::new();
    run.edit_labels("\"merge_into\": null", "\"merge_into\": \"object_02\"");
    let status = run.json("status");
    let reasons = status["status.entities.reasons"].to_string();
    assert!(reasons.contains("merged") && !reasons.contains("names"), "{reasons}");
}

#[test]
fn a_new_scan_leaves_the_scene_as_it_is() {
    let run = CopiedRun::new();
    let before = fs::read(run.path("scene/scene.json")).unwrap();
    let paths =
        ["scan", recording().to_str().unwrap(), "--out", run.path("").to_str().unwrap()].map(str::to_owned);
    let paths = paths.iter().map(String::as_str).collect::<Vec<_>>();
    done(&[&paths[..], &["--preset", "draft", "--set", "scan.fused.steps=30"]].concat());
    assert_eq!(fs::read(run.path("scene/scene.json")).unwrap(), before);
    let status = run.json("status");
    for stage in ["entities", "scene"] {
        assert_eq!(status[format!("status.{stage}")], "stale", "{status}");
    }
    assert!(status["status.next"][0].as_str().unwrap().starts_with("sms materialize"), "{status}");
    let refused = run.run("plan", &["--task", recording().join("task.toml").to_str().unwrap()]);
    assert_eq!(refused.status.code(), Some(2), "{}", said(&refused));
    // The page shows the scan without the earlier scene.
    run.done("report", &[]);
}

#[test]
fn names_that_cannot_be_are_refused_with_the_known_ones() {
    let run = CopiedRun::new();
    let before = fs::read(run.path("masks/labels.json")).unwrap();
    for (names, word) in [
        (&["teapot=cup"][..], "object_01"),
        (&["object_01=object_02"], "object_02"),
        (&["object_01=a", "object_02=a"], "two objects"),
        (&["object_01=floor"], "floor"),
        (&["object_01"], "OBJECT=NAME"),
    ] {
        let refused = run.run("name", names);
        let message = said(&refused);
        assert_eq!(refused.status.code(), Some(2), "{message}");
        assert!(message.contains("cure:") && message.contains(word), "{message}");
        assert_eq!(fs::read(run.path("masks/labels.json")).unwrap(), before);
    }
    let named = run.json("name");
    assert_eq!(named["names.1"], "object_01");
    run.done("name", &["object_01=duck"]);
    assert_eq!(run.json("name")["names.1"], "duck");
    assert_eq!(run.json("status")["status.entities"], "stale");
}
