//! Planning with the arm: strikes that the arm cannot execute are counted and never chosen.

use crate::common::{ball, material, two_balls};
use crate::rehearsal::rehearse;
use sms_core::glamx::{DPose3, DQuat, DVec3};
use sms_core::{Cancel, Mesh, NoProgress, Seed, StageContext, Warnings};
use sms_plan::{
    Halton, Method, Perturbation, PlanConfig, PlanError, PlanOutcome, TrialPhase, optimiser, plan,
    search_nominal,
};
use sms_robots::{RobotConfig, ToolPath};
use sms_scene::{Body, BodyKind, BodyShape, Scene};
use sms_sim::{RapierFactory, Striker};
use sms_task::{Action, Billiards, ResolvedTask, Selector, Task};

fn standing_at(x: f64) -> RobotConfig {
    let x_world_robot =
        [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    RobotConfig { x_world_robot: Some(x_world_robot), ..RobotConfig::default() }
}

/// The two balls, and a wall to the right of the cue ball. In any hold, the hand would collide with the wall in shots
/// to the left.
fn scene() -> Scene {
    let half = DVec3::new(0.1, 0.02, 0.2);
    let post = Body {
        name: "post".into(),
        kind: BodyKind::Static,
        x_wb: DPose3::from_parts(DVec3::new(0.25, -0.06, half.z), DQuat::IDENTITY),
        shape: BodyShape::Box { half_extents: half },
        visual: Mesh::default(),
        mass: None,
        ..ball("post", 0.0, 0.0, [90, 90, 90], material(0.4, 0.5))
    };
    let mut scene = two_balls();
    scene.bodies.push(post);
    scene
}

fn task(scene: &Scene, x: f64) -> ResolvedTask {
    let (cue, target) = (Selector::by_name("cue"), Selector::by_name("blue"));
    let mut task = Billiards::new(cue, target, [0.8, 0.03]);
    task.horizon_s = 2.5;
    Task::Billiards(task).resolve(scene).unwrap().with_robot(&standing_at(x), scene).unwrap()
}

fn run(task: &ResolvedTask, scene: &Scene, threads: usize) -> Result<PlanOutcome, PlanError> {
    let config = PlanConfig {
        starts: 4,
        robust_evaluations: 200,
        scan: 100,
        descents: 4,
        candidates: 4,
        finalists: 2,
        polish_starts: 1,
        polish: 3,
        forecast_worlds: 4,
        sensitivity_rollouts: 0,
        perturbation: Perturbation { worlds: 4, ..Perturbation::default() },
        ..PlanConfig::default()
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let (progress, cancel, warnings) = (NoProgress, Cancel::new(), Warnings::new());
    pool.install(|| {
        plan(
            task,
            scene,
            &RapierFactory,
            &config,
            StageContext::new(&progress, &cancel, &warnings).with_seed(Seed(3)),
        )
    })
}

#[test]
fn refused_strikes_are_counted_and_never_chosen() {
    let scene = scene();
    let task = task(&scene, -0.1);
    let outcome = run(&task, &scene, 1).unwrap();
    // The plan is the same in a new task, without cached sweeps, and with two threads.
    let again = run(&self::task(&scene, -0.1), &scene, 2).unwrap();
    assert_eq!(outcome, again, "with one and two threads");
    let p = &outcome.plan;
    let refused: usize = p.refused.iter().map(|r| r.count).sum();
    println!("{} {:.4} m; {:?}", p.striker, p.objective, p.refused_text());
    assert!(p.striker.contains("fr3") && p.robot.is_some());
    assert!(refused > 0 && refused < p.searched, "{refused} of {}", p.searched);
    assert!(p.refused.iter().any(|r| r.reason.contains("post")), "{:?}", p.refused);
    // Infeasible draws do not count: the scan gets all of its rollouts.
    let screened: Vec<_> = outcome.trials.iter().filter(|t| t.phase == TrialPhase::Screen).collect();
    let scanned: Vec<_> =
        outcome.trials.iter().filter(|t| t.phase == TrialPhase::Perturbed && t.start == -1).collect();
    assert_eq!((screened.len(), scanned.len()), (60, 100), "30 % of 200, and the scan");
    for t in screened.iter().chain(&scanned) {
        assert!(task.striker(&task.strike(&t.action)).is_ok(), "{:?}", t.action);
    }
    assert_eq!(outcome.trials.len() + 1, p.evaluations);
    let in_search =
        outcome.trials.iter().filter(|t| matches!(t.phase, TrialPhase::Screen | TrialPhase::Search));
    let struck = in_search.clone().filter(|t| task.striker(&task.strike(&t.action)).is_err()).count();
    // Refused strikes do not reduce the budget of searches.
    assert_eq!(struck, 0);
    let met: usize = p.starts.iter().map(|s| s.refused).sum();
    assert!(p.starts.iter().all(|s| s.objective.is_finite() && !s.is_out_of_reach()));
    let passed_over = refused - struck;
    assert_eq!(p.searched, in_search.count() + scanned.len() + passed_over);
    let drawn = screened.len() + scanned.len() + passed_over;
    println!("{passed_over} of {drawn} draws passed over, {met} of them in nominal searches");
    assert!(passed_over > 0 && drawn <= 8 * 200, "{passed_over} of {drawn}");
    let strike = task.strike(&p.action);
    assert!(matches!(task.striker(&strike), Ok(Striker::Arm(_))));
    assert!(p.objective < 0.03, "{}", p.objective);
    // The plan's own robot executes the same strike.
    let same = self::task(&scene, 0.0).with_robot(p.robot.as_ref().unwrap(), &scene).unwrap();
    let [Ok(Striker::Arm(a)), Ok(Striker::Arm(b))] = [task.striker(&strike), same.striker(&strike)] else {
        panic!("both are arms")
    };
    assert_eq!((&a.q_start, a.sweep, a.rotation_w), (&b.q_start, b.sweep, b.rotation_w));
    let values = rehearse(&task, &scene, &Perturbation::default(), Seed(1), &p.action, 4);
    assert!(values.iter().all(|v| v.is_finite()), "{values:?}");
}

#[test]
fn refused_strikes_do_not_use_up_the_budget() {
    let scene = scene();
    let share = |task: &ResolvedTask| {
        let halton = Halton::new(4, Seed(8));
        let p = task.parameters();
        let can = |i: &u64| {
            let unit = halton.point(*i);
            let values = unit.iter().zip(&p).map(|(v, p)| p.low + v * (p.high - p.low)).collect();
            task.striker(&task.strike(&Action(values))).is_ok()
        };
        (0..48).filter(can).count() as f64 / 48.0
    };
    // The number of feasible strikes decreases with the distance of the robot.
    let first_below = |from: f64, step: f64| {
        (0..30)
            .map(|k| from - step * f64::from(k))
            .map(|x| (x, task(&scene, x)))
            .map(|(x, task)| (x, share(&task), task))
            .find(|(_, share, _)| *share <= 0.4)
            .unwrap()
    };
    let (x, ..) = first_below(-0.1, 0.04);
    let (_, share, task) = first_below(x + 0.03, 0.01);
    println!("{share:.2} of the strikes can be made");
    assert!(share > 0.15, "{share}");
    let config = PlanConfig {
        method: Method::Halving,
        evaluations: 40,
        screening_share: 1.0,
        suggestions: false,
        ..PlanConfig::default()
    };
    let cancel = Cancel::new();
    let found = search_nominal(
        &task,
        &scene,
        &RapierFactory,
        &|space, feasible| optimiser(space, &config, Seed(3).derive("search"), feasible),
        40,
        &cancel,
    )
    .unwrap();
    let simulated = found.trials.iter().filter(|t| t.phase == TrialPhase::Screen && t.valid);
    assert_eq!(simulated.count(), 40);
}

#[test]
fn a_robot_out_of_reach_is_an_input_error() {
    let scene = scene();
    let error = run(&task(&scene, -3.0), &scene, 1).unwrap_err();
    let PlanError::OutOfReach(e) = &error else { panic!("{error}") };
    assert!(e.path == "[robot]" && e.what.contains("`cue`"), "{error}");
}

#[test]
fn errors_of_the_execution_shift_the_planned_posture() {
    let scene = scene();
    let task = task(&scene, -0.1);
    let asked = task.strike(&Action(vec![0.5, 0.1, 0.0, 0.0]));
    let mut off = asked;
    off.contact_w += DVec3::new(3e-4, -2e-4, 0.0);
    (off.angle, off.speed) = (off.angle + 0.002, 1.02 * off.speed);
    let (Ok(Striker::Arm(a)), Ok(Striker::Arm(b))) = (task.striker(&asked), task.striker_near(&asked, &off))
    else {
        panic!("both can be made")
    };
    assert!((b.sweep.direction_w - off.direction_w()).length() < 1e-12 && b.sweep.speed == off.speed);
    let model = task.arm().unwrap().model();
    let mut ws = sms_robots::Workspace::default();
    model.forward_kinematics(&b.q_start, &mut ws);
    let tool = model.frame_pose(model.tool(), &ws);
    let start = b.path().at(0.0).x_wt;
    assert!((tool.translation - start.translation).length() < 1e-8);
    assert!(tool.rotation.angle_between(start.rotation) < 1e-6);
    let moved = a.q_start.iter().zip(&b.q_start).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(moved > 1e-5 && moved < 0.02, "{moved}");
}
