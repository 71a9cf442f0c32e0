//! The shared rollout on a table with two balls.

use crate::common::{RADIUS, ball, material, two_balls};
use sms_core::glamx::{DPose3, DQuat, DVec2, DVec3};
use sms_core::{Mesh, polyhedron_mass_properties};
use sms_scene::{Body, BodyKind, BodyShape, Scene};
use sms_sim::{RapierFactory, Simulation};
use sms_task::{
    Action, ActionForm, Billiards, MotionRecording, ResolvedTask, Rollout, STRIKER, Selector, Task,
};

fn task_in(scene: &Scene, goal_w: DVec2, form: ActionForm) -> ResolvedTask {
    let (cue, target) = (Selector::by_name("cue"), Selector::by_name("blue"));
    let mut task = Billiards::new(cue, target, goal_w.to_array());
    task.form = form;
    Task::Billiards(task).resolve(scene).unwrap()
}

fn simulation(task: &ResolvedTask, scene: &Scene) -> Simulation {
    Simulation::new(&RapierFactory, scene, &task.world_options()).unwrap()
}

fn roll(task: &ResolvedTask, scene: &Scene, action: &[f64], recording: Option<MotionRecording>) -> Rollout {
    let bodies = task.bodies_in(scene, "blue").unwrap();
    let motion = task.strike(&Action(action.to_vec()));
    task.rollout(&mut simulation(task, scene), motion, &bodies, recording).unwrap()
}

#[test]
fn a_straight_shot_drives_the_target_ball_over_a_goal_ahead() {
    let scene = two_balls();
    let goal_w = DVec2::new(0.8, 0.0);
    let task = task_in(&scene, goal_w, ActionForm::SpeedAngle);
    assert!((task.initial_objective() - 0.2).abs() < 1e-12);
    let hit = roll(&task, &scene, &[0.6, 0.0], Some(MotionRecording { every_s: 1.0 / 120.0 }));
    assert!(hit.objective < 1e-3, "{}", hit.objective);
    let trajectory = hit.trajectory.unwrap();
    for name in ["cue", "blue", STRIKER] {
        let track = trajectory.body(name).unwrap_or_else(|| panic!("no track of {name}"));
        assert_eq!(track.states.len(), trajectory.times_s.len());
    }
    // The recorded positions agree with the objective within the travel between two of them.
    let nearest = trajectory.body("blue").unwrap().states.iter();
    let nearest = nearest.map(|s| DVec2::new(s.x_wb.translation.x, s.x_wb.translation.y).distance(goal_w));
    let nearest = nearest.fold(f64::INFINITY, f64::min);
    assert!(nearest >= hit.objective && nearest < 0.01, "{nearest}");
    assert!(trajectory.times_s.windows(2).all(|t| t[1] > t[0] && t[1] - t[0] < 0.0111));
    assert_eq!(trajectory.times_s.last(), Some(&hit.end_s));

    let miss = roll(&task, &scene, &[0.6, 0.6], None);
    assert!((miss.objective - 0.2).abs() < 1e-4, "the target ball stays: {}", miss.objective);
    assert!(miss.end_s < 4.0, "nothing can change after the miss, at {} s", miss.end_s);
}

#[test]
fn recording_and_reusing_a_world_do_not_change_the_objective() {
    let scene = two_balls();
    let task = task_in(&scene, DVec2::new(0.8, 0.05), ActionForm::SpeedAngleContact);
    let bodies = task.bodies_in(&scene, "blue").unwrap();
    let mut reused = simulation(&task, &scene);
    assert!(reused.save());
    let actions = [[0.5, -0.03, 0.0, 0.001], [0.85, -0.1, 0.004, -0.003], [0.3, 0.02, -0.005, 0.0]];
    for action in actions {
        let fresh = roll(&task, &scene, &action, None);
        let recorded = roll(&task, &scene, &action, Some(MotionRecording { every_s: 0.01 }));
        assert_eq!(fresh.objective, recorded.objective);
        assert!(fresh.end_s <= recorded.end_s);
        for _ in 0..2 {
            assert!(reused.restore());
            let again =
                task.rollout(&mut reused, task.strike(&Action(action.to_vec())), &bodies, None).unwrap();
            assert_eq!(again, fresh);
        }
    }
}

/// Two balls among boxes: one for a rebound, one that topples.
fn two_balls_and_boxes() -> Scene {
    let mut scene = two_balls();
    let boxes = [(0.85, 0.05, DVec3::new(0.03, 0.06, 0.04)), (0.7, -0.12, DVec3::new(0.015, 0.015, 0.06))];
    for (i, (x, y, half)) in boxes.into_iter().enumerate() {
        let mesh = Mesh::cuboid(half);
        scene.bodies.push(Body {
            name: format!("box_{i}"),
            x_wb: DPose3::from_translation(DVec3::new(x, y, half.z)),
            shape: BodyShape::Hulls { hulls: vec![mesh.clone()] },
            mass: Some(polyhedron_mass_properties(&mesh, 600.0).unwrap()),
            ..ball("box", 0.0, 0.0, [120, 90, 60], material(0.4, 0.4))
        });
    }
    scene
}

#[test]
fn stopping_early_changes_no_objective() {
    let scene = two_balls_and_boxes();
    let task = task_in(&scene, DVec2::new(0.65, 0.15), ActionForm::SpeedAngle);
    let bodies = task.bodies_in(&scene, "blue").unwrap();
    let mut world = task.prepare(&RapierFactory, &scene, &task.world_options(), &bodies).unwrap();
    let (mut stopped_early, mut bounced) = (0, 0);
    for i in 0..24 {
        let action = Action(vec![0.25 + 0.025 * f64::from(i), -0.2 + 0.4 * f64::from(i * 7 % 24) / 23.0]);
        let motion = task.strike(&action);
        assert!(world.restore());
        let full = task.rollout(&mut world, motion, &bodies, Some(MotionRecording { every_s: 0.1 })).unwrap();
        assert!(world.restore());
        let short = task.rollout(&mut world, motion, &bodies, None).unwrap();
        assert_eq!(short.objective, full.objective, "{action:?}");
        stopped_early += usize::from(short.end_s < full.end_s);
        bounced += usize::from(full.trajectory.unwrap().body("box_0").is_some());
    }
    assert!(stopped_early > 12, "{stopped_early} of 24 stopped early");
    assert!(bounced > 3, "{bounced} of 24 hit the box");
}

#[test]
fn a_prepared_world_sleeps_in_place_and_rolls_like_a_fresh_one() {
    let scene = two_balls_and_boxes();
    let task = task_in(&scene, DVec2::new(0.8, 0.0), ActionForm::SpeedAngle);
    let bodies = task.bodies_in(&scene, "blue").unwrap();
    let mut world = task.prepare(&RapierFactory, &scene, &task.world_options(), &bodies).unwrap();
    for (i, body) in scene.bodies.iter().enumerate() {
        assert!(world.is_asleep(i), "{} is awake", body.name);
        assert!(world.state(i).x_wb.translation.distance(body.x_wb.translation) < 1e-4);
    }
    assert!(world.restore(), "it is saved");
    let motion = task.strike(&Action(vec![0.5, 0.01]));
    let prepared = task.rollout(&mut world, motion, &bodies, None).unwrap();
    let fresh = roll(&task, &scene, &[0.5, 0.01], None);
    assert!((prepared.objective - fresh.objective).abs() < 1e-3, "{prepared:?} {fresh:?}");
}

#[test]
fn a_cut_shot_leaves_along_the_line_of_centres() {
    let scene = two_balls();
    // Aim 30° off: the ghost ball touches the target ball on the opposite side.
    let turn = 30.0f64.to_radians();
    let ghost = DVec2::new(0.6, 0.0) - DVec2::from_angle(turn) * 2.0 * RADIUS;
    let angle = (ghost - DVec2::new(0.3, 0.0)).to_angle();
    let goal_w = DVec2::new(0.6, 0.0) + DVec2::from_angle(turn) * 0.2;
    let task = task_in(&scene, goal_w, ActionForm::SpeedAngle);
    let hit = roll(&task, &scene, &[0.7, angle], None);
    // 0.5° error of the target ball's direction.
    assert!(hit.objective < 0.2 * 0.5f64.to_radians(), "{} mm", 1e3 * hit.objective);
}

#[test]
fn an_action_means_the_same_however_the_table_is_turned() {
    let turned = |angle: f64| {
        let mut scene = two_balls();
        let q = DQuat::from_rotation_z(angle);
        for body in &mut scene.bodies[1..] {
            body.x_wb.translation = q * body.x_wb.translation + DVec3::new(0.1, -0.2, 0.0);
        }
        let goal = q * DVec3::new(0.8, 0.03, 0.0) + DVec3::new(0.1, -0.2, 0.0);
        let task = task_in(&scene, DVec2::new(goal.x, goal.y), ActionForm::SpeedAngleContact);
        roll(&task, &scene, &[0.6, -0.04, 0.002, 0.001], None).objective
    };
    let straight = turned(0.0);
    for angle in [0.5, 2.0, -1.5] {
        assert!((turned(angle) - straight).abs() < 2e-3, "{} against {straight}", turned(angle));
    }
}

#[test]
fn a_target_world_with_other_names_carries_out_the_same_motion() {
    let scene = two_balls();
    let task = task_in(&scene, DVec2::new(0.8, 0.02), ActionForm::SpeedAngleContact);
    let motion = task.strike(&Action(vec![0.6, -0.02, 0.0, 0.0]));
    let here = roll(&task, &scene, &[0.6, -0.02, 0.0, 0.0], None);
    // The true world has another order, other names, and one more distant body.
    let mut truth = scene.clone();
    truth.bodies.swap(1, 2);
    truth.bodies[1].name = "ball_07".into();
    truth.bodies[2].name = "ball_01".into();
    truth.bodies.push(ball("bystander", -1.0, 1.0, [0, 0, 0], material(0.3, 0.9)));
    let bodies = task.bodies_in(&truth, "ball_07").unwrap();
    let recording = Some(MotionRecording { every_s: 0.02 });
    let there = task.rollout(&mut simulation(&task, &truth), motion, &bodies, recording).unwrap();
    assert!((there.objective - here.objective).abs() < 1e-4, "{} {}", there.objective, here.objective);
    let trajectory = there.trajectory.unwrap();
    assert!(trajectory.body("ball_07").is_some() && trajectory.body("bystander").is_none());
    let error = task.bodies_in(&truth, "blue").unwrap_err().to_string();
    assert!(error.contains("`blue`") && error.contains("ball_07"), "{error}");
}

#[test]
fn selectors_find_balls_and_errors_list_the_bodies() {
    let mut scene = two_balls();
    scene.bodies.push(ball("red", 0.5, 0.4, [190, 40, 30], material(0.2, 0.9)));
    let resolve = |cue: Selector, target: Selector| {
        Task::Billiards(Billiards::new(cue, target, [0.8, 0.0])).resolve(&scene)
    };
    let task = resolve(
        Selector::sphere_of_color("white"),
        Selector { near: Some([0.5, 0.3, 0.0]), ..Selector::default() },
    )
    .unwrap();
    assert_eq!((task.cue().name.as_str(), task.target().name.as_str()), ("cue", "red"));
    assert_eq!(task.target().radius, RADIUS);

    let message = resolve(Selector::by_name("yellow"), Selector::by_name("blue")).unwrap_err().to_string();
    for part in ["cue", "name = \"yellow\"", "blue (sphere", "red (sphere", "floor (static)"] {
        assert!(message.contains(part), "{part}: {message}");
    }
    let message =
        resolve(Selector::by_name("red"), Selector::sphere_of_color("red")).unwrap_err().to_string();
    for part in ["`cue`", "`target`", "`red`"] {
        assert!(message.contains(part), "{part}: {message}");
    }
    assert!(
        resolve(Selector::by_name("floor"), Selector::by_name("red")).is_err(),
        "static bodies do not move"
    );
}

#[test]
fn a_goal_that_no_ball_can_reach_is_refused_with_the_reason() {
    let fixed = |name: &str, center_w: DVec3, half_extents: DVec3| Body {
        kind: BodyKind::Static,
        x_wb: DPose3::from_translation(center_w),
        shape: BodyShape::Box { half_extents },
        mass: None,
        ..ball(name, 0.0, 0.0, [90, 90, 90], material(0.4, 0.5))
    };
    let mut scene = two_balls();
    scene.bodies.push(fixed("block", DVec3::new(0.9, 0.0, 0.1), DVec3::new(0.15, 0.15, 0.1)));
    let resolve = |scene: &Scene, goal_w: [f64; 2]| {
        let (cue, target) = (Selector::by_name("cue"), Selector::by_name("blue"));
        Task::Billiards(Billiards::new(cue, target, goal_w)).resolve(scene).map_err(|e| e.to_string())
    };
    let message = resolve(&scene, [0.9, 0.0]).unwrap_err();
    for part in ["goal_w", "`block`", "50 mm", "cure"] {
        assert!(message.contains(part), "{part}: {message}");
    }
    // 10 mm within the surface of the goal's disc: the centre comes as close as 39 mm.
    assert!(resolve(&scene, [0.76, 0.0]).is_ok());
    // An infinite floor has no other limits; a table has edges.
    assert!(resolve(&scene, [1.6, 0.9]).is_ok());
    scene.bodies[0] = fixed("table", DVec3::new(0.5, 0.0, -0.05), DVec3::new(0.6, 0.4, 0.05));
    assert!(resolve(&scene, [0.6, 0.3]).is_ok() && resolve(&scene, [0.6, 0.43]).is_ok());
    let message = resolve(&scene, [0.6, 0.5]).unwrap_err();
    assert!(
        message.contains("goal_w") && message.contains("`blue`") && message.contains("100 mm"),
        "{message}"
    );
}

#[test]
fn parameters_follow_the_form_and_the_direct_box_is_the_cone_of_contact() {
    let scene = two_balls();
    let full = task_in(&scene, DVec2::new(0.8, 0.0), ActionForm::SpeedAngleContact);
    let names: Vec<String> = full.parameters().into_iter().map(|p| p.name).collect();
    assert_eq!(names, ["speed", "angle", "contact_along", "contact_across"]);
    let short = task_in(&scene, DVec2::new(0.8, 0.0), ActionForm::SpeedAngle);
    assert_eq!(short.parameters().len(), 2);
    let ranges = full.direct_box().unwrap();
    let touch = (2.0 * RADIUS / 0.3f64).asin();
    assert!(ranges[1][1] < touch && ranges[1][1] > 0.95 * touch && ranges[1][0] == -ranges[1][1]);
    // Offsets are along and across the sweep, in world coordinates.
    let motion = full.strike(&Action(vec![0.5, std::f64::consts::FRAC_PI_2, 0.002, 0.003]));
    assert!((motion.contact_w - DVec3::new(0.3 - 0.003, 0.002, RADIUS)).length() < 1e-12);
    assert!((motion.angle - std::f64::consts::FRAC_PI_2).abs() < 1e-12 && motion.speed == 0.5);
    assert_eq!(full.clamped(&Action(vec![9.0, -9.0, 0.0, 0.0])).0[0], 0.85);
}
