//! Planning on a table whose answers are known from geometry.

// One fixture serves the task and its planner.
#[path = "../../sms-task/tests/common/mod.rs"]
mod common;

use common::{RADIUS, two_balls};
use sms_core::glamx::DVec2;
use sms_core::{Cancel, NoProgress, Seed, Warnings};
use sms_plan::{Disturbances, PlanConfig, PlanError, PlanOutcome, load_plan, plan, read_trials, save_plan};
use sms_sim::RapierFactory;
use sms_task::{ActionForm, Billiards, ResolvedTask, Selector, Task};

fn config() -> PlanConfig {
    PlanConfig {
        starts: 4,
        evaluations: 120,
        candidates: 4,
        finalists: 2,
        suggestions: false,
        disturbances: Disturbances { worlds: 4, ..Disturbances::default() },
        ..PlanConfig::default()
    }
}

fn task(goal_w: DVec2, form: ActionForm) -> ResolvedTask {
    let (cue, target) = (Selector::sphere_of_color("white"), Selector::by_name("blue"));
    let mut task = Billiards::new(cue, target, goal_w.to_array());
    task.form = form;
    task.horizon_s = 3.0;
    Task::Billiards(task).resolve(&two_balls()).unwrap()
}

fn run(task: &ResolvedTask, config: &PlanConfig, warnings: &Warnings) -> Result<PlanOutcome, PlanError> {
    let factory = RapierFactory;
    plan(task, &two_balls(), &factory, config, Seed(11), &NoProgress, &Cancel::new(), warnings)
}

/// The angle that sends the target ball, without throw, towards a goal: at the ghost ball.
fn ghost_angle(goal_w: DVec2) -> f64 {
    let (cue, target) = (DVec2::new(0.3, 0.0), DVec2::new(0.6, 0.0));
    let ghost = target - (goal_w - target).normalize() * 2.0 * RADIUS;
    (ghost - cue).to_angle()
}

#[test]
fn a_straight_shot_and_a_cut_shot_are_those_of_geometry() {
    for turn in [0.0, 35.0f64.to_radians()] {
        let goal_w = DVec2::new(0.6, 0.0) + DVec2::from_angle(turn) * 0.25;
        let task = task(goal_w, ActionForm::SpeedAngle);
        let warnings = Warnings::new();
        let outcome = run(&task, &config(), &warnings).unwrap();
        let plan = &outcome.plan;
        assert!(plan.objective < 0.01, "{} m at a cut of {turn} rad", plan.objective);
        assert_eq!(warnings.snapshot().iter().filter(|w| w.code == "no_good_shot").count(), 0);
        // A miss of 1 cm at 0.25 m turns the target ball by 2.3°, and the cue ball by a fifth of that or less.
        let error = plan.action.0[1] - ghost_angle(goal_w);
        assert!(error.abs() < 0.5f64.to_radians(), "{:.3}° off at a cut of {turn} rad", error.to_degrees());
        assert!(plan.objective_q90 >= plan.objective && plan.objective_q90 < 0.1, "{}", plan.objective_q90);
        assert!(plan.trajectory.body("cue").is_some() && plan.trajectory.body("striker").is_some());
    }
}

#[test]
fn suggestions_are_the_ghost_ball() {
    let goal_w = DVec2::new(0.8, 0.1);
    let suggestions = task(goal_w, ActionForm::SpeedAngleContact).suggestions();
    assert_eq!(suggestions.len(), 4);
    for action in suggestions {
        assert!((action.0[1] - ghost_angle(goal_w)).abs() < 1e-12);
        assert_eq!(action.0[2..], [0.0, 0.0]);
    }
    assert!(
        task(DVec2::new(0.1, 0.0), ActionForm::SpeedAngle).suggestions().is_empty(),
        "behind the cue ball"
    );
}

#[test]
fn the_same_bytes_with_one_and_two_threads_and_they_read_back() {
    let dir = tempfile::tempdir().unwrap();
    let task = task(DVec2::new(0.8, 0.06), ActionForm::SpeedAngleContact);
    let small = PlanConfig { evaluations: 60, ..config() };
    let mut folders = Vec::new();
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let warnings = Warnings::new();
        let outcome = pool.install(|| run(&task, &small, &warnings)).unwrap();
        let folder = dir.path().join(threads.to_string());
        save_plan(&folder, &outcome).unwrap();
        assert_eq!(load_plan(&folder).unwrap(), outcome.plan);
        assert_eq!(read_trials(&folder.join("trials.parquet")).unwrap(), outcome.trials);
        // All rollouts are logged but the last one, which is the recorded motion.
        assert_eq!(outcome.trials.len() + 1, outcome.plan.evaluations);
        assert_eq!(outcome.metrics().number("plan.objective"), Some(outcome.plan.objective));
        folders.push(folder);
    }
    for file in ["plan.json", "trials.parquet", "trajectory.parquet"] {
        let [one, two] = [&folders[0], &folders[1]].map(|f| std::fs::read(f.join(file)).unwrap());
        assert!(one == two, "{file} differs");
    }
}

#[test]
fn an_unreachable_goal_is_said_so() {
    // Half a metre behind the cue ball, on a table without cushions.
    let task = task(DVec2::new(-0.2, 0.0), ActionForm::SpeedAngle);
    let warnings = Warnings::new();
    let small = PlanConfig { evaluations: 40, ..config() };
    let outcome = run(&task, &small, &warnings).unwrap();
    // Nothing brings the target ball nearer than it already is.
    assert!((outcome.plan.objective - 0.8).abs() < 1e-3, "{}", outcome.plan.objective);
    assert!(warnings.snapshot().iter().any(|w| w.code == "no_good_shot" && w.message.contains("80.0 cm")));
}

#[test]
fn interruption_and_bad_settings_end_the_plan() {
    let task = task(DVec2::new(0.8, 0.0), ActionForm::SpeedAngle);
    let (cancel, warnings) = (Cancel::new(), Warnings::new());
    cancel.cancel();
    let factory = RapierFactory;
    let stopped =
        plan(&task, &two_balls(), &factory, &config(), Seed(1), &NoProgress, &cancel, &warnings).unwrap_err();
    assert!(stopped.to_string().contains("interrupted"), "{stopped}");
    let none = run(&task, &PlanConfig { starts: 0, ..config() }, &warnings).unwrap_err();
    assert!(none.to_string().contains("`starts`"), "{none}");
}
