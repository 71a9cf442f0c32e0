//! A landing that cannot be planned: the reason is told, stands in the report, and no earlier plan is taken for it.

mod common;

use common::{done, said, sms};
use std::fs;

#[test]
fn where_nothing_can_be_landed_on_the_reason_stands_in_the_report_and_no_plan_is_left() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let (recording, run, landing) = (path("sample"), path("run"), path("landing.toml"));
    done(&["sample", &recording]);
    done(&["scan", &recording, "--out", &run, "--preset", "draft"]);
    done(&["materialize", &run]);
    // Another task was planned before.
    let task = format!("{recording}/task.toml");
    done(&["plan", &run, "--task", &task, "--robust", "0", "--seed", "1", "--set", "plan.evaluations=20"]);
    assert!(dir.path().join("run/plan").is_dir());

    // Balls and boxes on a floor: nothing faces up half a metre above it.
    fs::write(&landing, "kind = \"landing\"\nstart_w = [2.0, 0.0]\n").unwrap();
    let refused = sms(&["plan", &run, "--task", &landing]);
    let text = said(&refused);
    assert_eq!(refused.status.code(), Some(2), "{text}");
    assert!(text.contains("surface") && text.contains("cure:"), "{text}");
    assert!(!dir.path().join("run/plan").exists(), "what is left would be flown");
    let executed = sms(&["execute", &run]);
    assert_eq!(executed.status.code(), Some(2), "{}", said(&executed));

    done(&["report", &run]);
    let page = fs::read_to_string(dir.path().join("run/report/index.html")).unwrap();
    assert!(page.contains("no landing was planned"), "the report tells why there is no plan");
}
