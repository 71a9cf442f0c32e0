//! A landing from a recording to the target world, and one that cannot be planned: the reason is printed and shown in
//! the report, and no earlier plan is taken for it.

use crate::common::{copy_materialized_run, done, recording, said, sms};
use std::fs;

#[test]
fn where_nothing_can_be_landed_on_the_reason_stands_in_the_report_and_the_earlier_plan_is_set_aside() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let (run, landing) = (path("run"), path("landing.toml"));
    copy_materialized_run(&dir.path().join("run"));
    // Another task was planned before.
    let task = recording().join("task.toml");
    done(&[
        "plan",
        &run,
        "--task",
        task.to_str().unwrap(),
        "--robust",
        "0",
        "--seed",
        "1",
        "--set",
        "plan.evaluations=20",
        "--set",
        "plan.anew=0",
    ]);
    assert!(dir.path().join("run/plan").is_dir());

    let planned = fs::read(dir.path().join("run/plan/plan.json")).unwrap();

    // A mistake in the task's file says nothing about the plan.
    fs::write(&landing, "kind = \"landing\"\nstart = [2.0, 0.0]\n").unwrap();
    assert_eq!(sms(&["plan", &run, "--task", &landing]).status.code(), Some(2));
    assert_eq!(fs::read(dir.path().join("run/plan/plan.json")).unwrap(), planned);

    // Balls and boxes on a floor: nothing faces up half a metre above it.
    fs::write(&landing, "kind = \"landing\"\nstart_w = [2.0, 0.0]\n").unwrap();
    let refused = sms(&["plan", &run, "--task", &landing]);
    let text = said(&refused);
    assert_eq!(refused.status.code(), Some(2), "{text}");
    assert!(text.contains("surface") && text.contains("cure:"), "{text}");
    assert!(!dir.path().join("run/plan").exists(), "it could be carried out by mistake");
    assert_eq!(fs::read(dir.path().join("run/plan.earlier/plan.json")).unwrap(), planned);
    let executed = sms(&["execute", &run]);
    assert_eq!(executed.status.code(), Some(2), "{}", said(&executed));

    done(&["report", &run]);
    let page = fs::read_to_string(dir.path().join("run/report/index.html")).unwrap();
    assert!(page.contains("no landing was planned"), "the report tells why there is no plan");
}

/// The paper's second experiment from a recording to a flight in the target world, in the engine that is preferred there.
#[test]
#[ignore = "long: scans, plans and flies"]
fn long_a_recorded_structure_is_landed_on_in_the_target_world() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let (recording, run) = (path("ladder"), path("run"));
    done(&["synth", &recording, "--family", "landing", "--seed", "1", "--frames", "16", "--width", "320"]);
    done(&["scan", &recording, "--out", &run, "--preset", "draft", "--masks", "truth"]);
    done(&["materialize", &run]);
    let task = format!("{recording}/task.toml");
    let mut plan = vec!["plan", &run, "--task", &task, "--seed", "1"];
    for setting in [
        "landing.screening=24",
        "landing.draws=8",
        "landing.candidates=2",
        "landing.refine=1",
        "landing.polish_starts=0",
        "landing.worlds=2",
        "landing.forecast_worlds=2",
        "landing.sph.spacing=0.05",
    ] {
        plan.extend(["--set", setting]);
    }
    done(&plan);
    let json = |file: &str| -> serde_json::Value {
        serde_json::from_slice(&fs::read(dir.path().join("run").join(file)).unwrap()).unwrap()
    };
    let planned = json("plan/landing.json");
    assert_eq!(planned["surface"]["body"], "flat_box");
    let executed = sms(&["execute", &run]);
    let text = said(&executed);
    assert!(executed.status.success() && text.contains("realised: success"), "{text}");
    let flown = json("target/landing_execution.json");
    assert_eq!(flown["action"], planned["action"], "what was planned is what is flown");
    let engine = flown["engine"].as_str().unwrap();
    assert!(engine.contains(if cfg!(feature = "physx") { "physx" } else { "rapier" }), "{engine}");
    // Both parts of the structure had to stay, and each was seen.
    assert_eq!(flown["outcome"]["bodies"].as_array().unwrap().len(), 2);
    assert_eq!(flown["matches"].as_array().unwrap().len(), 2);

    done(&["report", &run]);
    let page = fs::read_to_string(dir.path().join("run/report/index.html")).unwrap();
    assert!(
        page.contains("realised") && page.contains(engine),
        "the report shows what became of it, and where"
    );

    // The truth is not the planner's: without it the same is planned.
    fs::remove_dir_all(dir.path().join("ladder/truth")).unwrap();
    done(&[&plan[..], &["--force"]].concat());
    assert_eq!(json("plan/landing.json")["action"], planned["action"]);
}
