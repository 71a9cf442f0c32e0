//! The tasks of `examples/tasks`, planned on the scene that they are written for.

use sms_core::{Cancel, NoProgress, Seed, StageContext, Warnings};
use sms_experiments::{PlanScene, SceneFamily};
use sms_plan::{Perturbation, Plan, PlanConfig, plan};
use sms_scene::Scene;
use sms_sim::RapierFactory;
use sms_task::{ResolvedTask, Task};
use std::path::Path;

/// Plans an example with `evaluations` shots in the search; returns the plan, the resolved task and the scene.
fn planned(file: &str, evaluations: usize) -> (Plan, ResolvedTask, Scene) {
    // The demo's scene: the examples name its places and colours.
    let scene = PlanScene::new(SceneFamily::Open, 1).unwrap().scene;
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/tasks").join(file);
    let task = Task::read(&path).unwrap().resolve(&scene).unwrap();
    let config = PlanConfig {
        starts: 4,
        robust_evaluations: evaluations,
        restarts: 0,
        scan: evaluations,
        descents: 4,
        candidates: 4,
        finalists: 2,
        polish_starts: 0,
        forecast_worlds: 4,
        sensitivity_rollouts: 0,
        perturbation: Perturbation { worlds: 4, ..Perturbation::default() },
        ..PlanConfig::default()
    };
    let (progress, cancel, warnings) = (NoProgress, Cancel::new(), Warnings::new());
    let plan = plan(
        &task,
        &scene,
        &RapierFactory,
        &config,
        StageContext::new(&progress, &cancel, &warnings).with_seed(Seed(1)),
    )
    .unwrap()
    .plan;
    println!("{file}: {:.4} of {:.4} m", plan.objective, task.initial_objective());
    for s in &plan.strategies {
        println!("  {}: {:.4} {:?}", s.name, s.objective, s.prediction.map(|p| [p.mean, p.q90]));
    }
    (plan, task, scene)
}

#[test]
#[ignore = "long: plans in many worlds"]
fn long_the_blue_ball_passes_and_the_others_stay() {
    let (plan, task, _) = planned("pass-and-leave.toml", 80);
    assert!(plan.objective < 0.3 * task.initial_objective(), "{}", plan.objective);
    assert_eq!(plan.strategies[0].outcomes.len(), 4);
}

#[test]
#[ignore = "long: plans in many worlds"]
fn long_the_blue_ball_comes_nearer_to_where_it_is_to_lie() {
    let (plan, task, _) = planned("park.toml", 240);
    assert!(plan.objective < 0.7 * task.initial_objective(), "{}", plan.objective);
}

#[test]
#[ignore = "long: plans in many worlds"]
fn long_the_box_is_pushed() {
    let (plan, task, scene) = planned("push-the-box.toml", 80);
    assert!(plan.objective < 0.4 * task.initial_objective(), "{}", plan.objective);
    let pushed = format!("pushes `{}`", task.cue().name);
    assert!(plan.strategies[0].name.starts_with(&pushed), "{}", plan.strategies[0].name);
    assert!(scene.body(&task.cue().name).is_some());
}

#[test]
#[ignore = "long: plans in many worlds"]
fn long_the_bottle_falls() {
    let (plan, task, _) = planned("topple.toml", 80);
    assert!(task.is_success(plan.objective), "{} of {}", plan.objective, task.initial_objective());
}
