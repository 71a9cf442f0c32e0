//! Strikes of the FR3: planned over its workspace, executed under torque control in free space.

use glamx::{DPose3, DVec3};
use sms_core::Mesh;
use sms_robots::{
    CheckKind, FIST_HALF, FR3_URDF, LimitKind, LinkShape, Obstacle, ObstacleShape, OscConfig, RobotModel,
    StrikeCheck, StrikeConfig, StrikeError, Sweep, SweepProfile, UrdfOptions, Workspace, check_strike, floor,
    plan_strike, plan_sweep, simulate_sweep,
};
use std::path::Path;

const RADIUS: f64 = 0.03;

fn ball_at(x: f64, y: f64, degrees: f64, speed: f64) -> Sweep {
    Sweep::of_ball(DVec3::new(x, y, RADIUS), RADIUS, degrees.to_radians(), speed, FIST_HALF.x)
}

/// Strikes over the workspace in front of the robot.
fn workspace() -> impl Iterator<Item = (f64, f64, f64)> {
    [0.35, 0.45, 0.55, 0.65].into_iter().flat_map(|x| {
        [-0.2, 0.0, 0.2].into_iter().flat_map(move |y| {
            [-90.0, -45.0, -20.0, 0.0, 20.0, 45.0, 90.0].into_iter().map(move |angle| (x, y, angle))
        })
    })
}

/// Smallest number of the 84 strikes with a motion within all limits at each speed. The others fail at a limiting joint
/// (mostly the elbow's 2.62 rad/s).
const FEASIBLE: [(f64, usize); 5] = [(0.2, 84), (0.5, 84), (0.85, 64), (1.2, 40), (1.5, 10)];

#[test]
fn the_contact_is_passed_at_the_asked_speed_and_direction_over_the_workspace() {
    let model = RobotModel::fr3();
    let config = StrikeConfig::default();
    let mut ws = Workspace::default();
    for (speed, least) in FEASIBLE {
        let mut feasible = 0;
        let mut worst = [0.0f64; 4];
        for (x, y, angle) in workspace() {
            match plan_sweep(&model, &ball_at(x, y, angle, speed), &[floor(0.0)], &config, &mut ws) {
                Ok(plan) => {
                    feasible += 1;
                    let t = simulate_sweep(&model, &plan, &config.osc, &model, 1.0, 0.00125);
                    let case = format!("{x} {y} {angle}° at {speed} m/s: {t:?}");
                    let c = t.contact.expect(&case);
                    assert!((c.speed / speed - 1.0).abs() <= 0.02, "{case}");
                    assert!(c.direction_error_rad <= 0.3f64.to_radians(), "{case}");
                    assert!(c.offset_m <= 1e-3, "{case}");
                    assert_eq!((t.saturated_periods, t.over_speed_periods), (0, 0), "{case}");
                    let values = [
                        (c.speed / speed - 1.0).abs() * 100.0,
                        c.direction_error_rad.to_degrees(),
                        1e3 * c.offset_m,
                        1e3 * t.largest_error_m,
                    ];
                    for (w, v) in worst.iter_mut().zip(values) {
                        *w = w.max(v);
                    }
                }
                Err(StrikeError::Infeasible(e)) => {
                    assert!(e.value.abs() > e.bound.abs(), "{e}");
                    assert!(model.joints().iter().any(|j| j.name == e.joint), "{e}");
                }
                Err(StrikeError::Blocked { clearance, .. }) => {
                    assert!(clearance.distance_m < config.clearance_m, "{clearance:?}");
                }
                Err(e) => panic!("{x} {y} {angle}°: {e}"),
            }
        }
        println!(
            "{speed} m/s: {feasible} of 84; speed {:.3} %, direction {:.3}°, off the line {:.2} mm, behind {:.2} mm",
            worst[0], worst[1], worst[2], worst[3]
        );
        assert!(feasible >= least, "{feasible} of 84 at {speed} m/s");
    }
}

#[test]
fn the_contact_is_passed_well_enough_when_the_robot_is_not_its_model() {
    // A third more friction, and an unknown load of 0.2 kg at the hand (a heavier link of the URDF).
    let model = RobotModel::fr3();
    let heavier = sms_robots::FR3_URDF.replacen("<mass value=\"0.6544\"/>", "<mass value=\"0.8544\"/>", 1);
    assert_ne!(heavier, sms_robots::FR3_URDF);
    let options = sms_robots::UrdfOptions { tool: Some("fr3_fist".into()), ..Default::default() };
    let real = RobotModel::from_urdf_text(&heavier, std::path::Path::new("heavier.urdf"), &options).unwrap();
    let config = StrikeConfig::default();
    let mut ws = Workspace::default();
    for (x, y, angle, speed) in [(0.5, 0.0, 0.0, 0.6), (0.45, 0.15, -30.0, 0.4), (0.6, -0.1, 45.0, 0.8)] {
        let plan = plan_sweep(&model, &ball_at(x, y, angle, speed), &[floor(0.0)], &config, &mut ws).unwrap();
        let t = simulate_sweep(&model, &plan, &config.osc, &real, 1.33, 0.00125);
        println!("{t:?}");
        let c = t.contact.unwrap();
        assert!((c.speed / speed - 1.0).abs() < 0.05 && c.direction_error_rad < 2f64.to_radians(), "{t:?}");
    }
}

#[test]
fn the_smooth_profile_tracks_better_than_the_uniform_one() {
    let model = RobotModel::fr3();
    let mut config = StrikeConfig::default();
    // The torques of the uniform profile jump; this setting permits jumps.
    config.osc.torque_rate = 1e9;
    let mut ws = Workspace::default();
    let smooth = ball_at(0.6, 0.0, 90.0, 1.2);
    let uniform = Sweep { profile: SweepProfile::Uniform, ..smooth };
    let run = |sweep: &Sweep, ws: &mut Workspace| {
        let plan = plan_sweep(&model, sweep, &[], &config, ws).unwrap();
        simulate_sweep(&model, &plan, &OscConfig::default(), &model, 1.0, 0.00125)
    };
    let (a, b) = (run(&smooth, &mut ws), run(&uniform, &mut ws));
    assert!(a.largest_error_m < 0.1 * b.largest_error_m, "{a:?} {b:?}");
    assert!(b.rate_limited_periods > 10);
}

#[test]
fn what_cannot_be_done_is_said_with_the_reason() {
    let model = RobotModel::fr3();
    let config = StrikeConfig::default();
    let mut ws = Workspace::default();
    let far = plan_sweep(&model, &ball_at(1.2, 0.0, 0.0, 0.5), &[], &config, &mut ws).unwrap_err();
    let StrikeError::Unreachable(e) = &far else { panic!("{far}") };
    assert!(e.position_error_m > 0.1, "{far}");
    let fast = plan_sweep(&model, &ball_at(0.5, 0.0, 0.0, 1.4), &[], &config, &mut ws).unwrap_err();
    let StrikeError::Infeasible(e) = &fast else { panic!("{fast}") };
    assert_eq!((e.limit, e.joint.as_str()), (LimitKind::Velocity, "fr3_joint4"));
    assert_eq!(e.bound, 2.62, "{fast}");
    let wall = Obstacle::new(
        "wall",
        DPose3::from_translation(DVec3::new(0.55, 0.0, 0.15)),
        ObstacleShape::Link(LinkShape::Box { half: DVec3::new(0.02, 0.5, 0.15) }),
    );
    let blocked = plan_sweep(&model, &ball_at(0.55, 0.0, 0.0, 0.5), &[wall], &config, &mut ws).unwrap_err();
    let StrikeError::Blocked { clearance, .. } = blocked else { panic!("{blocked}") };
    assert!(clearance.other == "wall" && clearance.distance_m < 0.0, "{clearance:?}");
}

#[test]
fn settings_are_read_with_defaults_and_unknown_ones_refused() {
    let read = serde_json::from_str::<StrikeConfig>;
    assert_eq!(read("{}").unwrap(), StrikeConfig::default());
    let changed = read("{\"osc\": {\"torque_rate\": 500.0}, \"candidates\": 3}").unwrap();
    assert_eq!((changed.osc.torque_rate, changed.candidates), (500.0, 3));
    assert_eq!(changed.osc.period_s, OscConfig::default().period_s);
    assert!(read("{\"torque_rat\": 1}").is_err());
}

#[test]
fn a_contact_that_is_never_reached_does_not_pass() {
    let model = RobotModel::fr3();
    let mut ws = Workspace::default();
    let mut config = StrikeConfig::default();
    let plan = plan_strike(&model, &ball_at(0.5, 0.0, 0.0, 0.5), &[], &config, &mut ws).unwrap();
    // With a rate limit near zero the sweep never starts.
    config.osc.torque_rate = 1e-9;
    let check = check_strike(&model, &plan, &[], &config, &mut ws);
    assert!(!check.executable() && check.tracking.contact.is_none());
    let failed = |kind| check.items.iter().any(|i| i.kind == kind && !i.passed && i.margin.is_none());
    assert!(failed(CheckKind::ContactSpeed) && failed(CheckKind::ContactDirection), "{:?}", check.items);
}

/// Without collision shapes the distances are unknown, and the check fails.
#[test]
fn a_robot_without_shapes_is_not_executable() {
    let mut bare = String::new();
    let mut rest = FR3_URDF;
    while let Some((before, after)) = rest.split_once("<collision") {
        bare.push_str(before);
        rest = after.split_once("</collision>").unwrap().1;
    }
    bare.push_str(rest);
    let options = UrdfOptions { tool: Some("fr3_fist".to_owned()), ..UrdfOptions::default() };
    let model = RobotModel::from_urdf_text(&bare, Path::new("bare.urdf"), &options).unwrap();
    let (mut ws, config) = (Workspace::default(), StrikeConfig::default());
    let around = [floor(0.0)];
    let plan = plan_strike(&model, &ball_at(0.5, 0.0, 0.0, 0.3), &around, &config, &mut ws).unwrap();
    let check = check_strike(&model, &plan, &around, &config, &mut ws);
    let failed: Vec<CheckKind> = check.items.iter().filter(|i| !i.passed).map(|i| i.kind).collect();
    assert_eq!(failed, [CheckKind::SelfCollision, CheckKind::Obstacle], "{:?}", check.items);
}

#[test]
fn the_fist_weighs_some_kilograms() {
    let model = RobotModel::fr3();
    let mut ws = Workspace::default();
    for (x, y, angle) in workspace().step_by(5) {
        let sweep = ball_at(x, y, angle, 0.4);
        let plan = plan_sweep(&model, &sweep, &[], &StrikeConfig::default(), &mut ws).unwrap();
        model.forward_kinematics(&plan.motion.samples[plan.motion.samples.len() / 2].q, &mut ws);
        let mobility = model.point_mobility(model.tool(), sweep.contact_w, &mut ws);
        let mass = 1.0 / sweep.direction_w.dot(mobility * sweep.direction_w);
        println!("{x} {y} {angle}°: {mass:.2} kg");
        assert!((1.0..30.0).contains(&mass), "{mass} kg");
    }
}

#[test]
fn strikes_that_make_no_sense_are_refused() {
    let model = RobotModel::fr3();
    let good = ball_at(0.5, 0.0, 0.0, 0.5);
    let config = StrikeConfig::default();
    let stopped = StrikeConfig { period_s: 0.0, ..StrikeConfig::default() };
    for (sweep, config) in [
        (Sweep { speed: 0.0, ..good }, &config),
        (Sweep { speed: f64::NAN, ..good }, &config),
        (Sweep { direction_w: DVec3::ZERO, ..good }, &config),
        (Sweep { direction_w: DVec3::Z, ..good }, &config),
        (Sweep { contact_w: DVec3::NAN, ..good }, &config),
        (Sweep { up_w: DVec3::ZERO, ..good }, &config),
        (good, &stopped),
    ] {
        let e = plan_sweep(&model, &sweep, &[], config, &mut Workspace::default()).unwrap_err();
        assert!(matches!(e, StrikeError::Invalid { .. }), "{e}");
    }
}

/// The distance of an obstacle is independent of its representation, and of culling.
#[test]
fn obstacles_count_the_same_as_box_hulls_and_surface() {
    let model = RobotModel::fr3();
    let mut ws = Workspace::default();
    model.forward_kinematics(model.home(), &mut ws);
    let mut poses = Vec::new();
    model.shape_poses(&ws, &mut poses);
    let half = DVec3::new(0.05, 0.08, 0.03);
    let mesh = Mesh::cuboid(half);
    let away = DVec3::new(0.0, 0.0, 0.4);
    let far: Vec<DVec3> = mesh.vertices.iter().map(|&p| p + away).collect();
    for place in [DVec3::new(0.6, 0.1, 0.3), DVec3::new(0.3, -0.3, 0.5), DVec3::new(0.8, 0.4, 0.1)] {
        let x_wo = DPose3::from_parts(place, glamx::DQuat::from_rotation_z(0.4));
        let shapes = [
            ObstacleShape::Link(LinkShape::Box { half }),
            ObstacleShape::Hulls(vec![
                LinkShape::convex(&mesh.vertices).unwrap(),
                LinkShape::convex(&far.iter().map(|p| *p + 20.0 * away).collect::<Vec<_>>()).unwrap(),
            ]),
            ObstacleShape::surface(&mesh).unwrap(),
        ];
        let distances = shapes.map(|shape| {
            let obstacle = Obstacle::new("box", x_wo, shape);
            let c = model.obstacle_clearance(&poses, &obstacle, 10.0).unwrap();
            let quick = model.obstacle_clearance(&poses, &obstacle, 0.01).unwrap();
            assert!(quick.distance_m > 0.01 && c.distance_m > 0.01, "{c:?} {quick:?}");
            c.distance_m
        });
        // Parry's iterations end within some ten micrometres.
        assert!(distances.iter().all(|d| (d - distances[0]).abs() < 1e-4), "{distances:?}");
    }
}

#[test]
fn every_slow_strike_of_the_workspace_is_executable_from_home() {
    let model = RobotModel::fr3();
    let config = StrikeConfig::default();
    let mut ws = Workspace::default();
    let mut failed = Vec::new();
    for (x, y, angle) in workspace().step_by(3) {
        let plan = plan_strike(&model, &ball_at(x, y, angle, 0.4), &[floor(0.0)], &config, &mut ws);
        let plan = plan.unwrap_or_else(|e| panic!("{x} {y} {angle}°: {e}"));
        let check = check_strike(&model, &plan, &[floor(0.0)], &config, &mut ws);
        if !check.executable() {
            failed.push((x, y, angle, check.items.into_iter().find(|i| !i.passed)));
        }
        assert!(plan.duration_s() < 15.0, "{x} {y} {angle}° takes {} s", plan.duration_s());
    }
    assert!(failed.is_empty(), "{failed:?}");
}

#[test]
fn a_whole_strike_is_one_continuous_motion_from_home() {
    let model = RobotModel::fr3();
    let mut ws = Workspace::default();
    let config = StrikeConfig::default();
    let plan = plan_strike(&model, &ball_at(0.5, 0.1, -20.0, 0.6), &[floor(0.0)], &config, &mut ws).unwrap();
    let n = model.dof();
    let mut end = model.home().to_vec();
    for (phase, motion) in &plan.phases {
        let first = &motion.samples[0];
        let gap = (0..n).map(|i| (first.q[i] - end[i]).abs()).fold(0.0, f64::max);
        assert!(gap < 1e-6, "{phase:?} begins {gap} rad from the end before");
        for s in [first, &motion.samples[motion.samples.len() - 1]] {
            assert!(s.qd[..n].iter().all(|v| v.abs() < 0.01), "{phase:?} is not at rest: {:?}", &s.qd[..n]);
        }
        // Speeds are the derivatives of positions, and positions never jump.
        for pair in motion.samples.windows(2) {
            for i in 0..n {
                let mean = 0.5 * (pair[0].qd[i] + pair[1].qd[i]);
                let off = (pair[1].q[i] - pair[0].q[i]) / motion.period_s - mean;
                assert!(off.abs() < 2e-3, "{phase:?} joint {i}: {off}");
            }
        }
        end = motion.samples[motion.samples.len() - 1].q[..n].to_vec();
    }
    let check = check_strike(&model, &plan, &[floor(0.0)], &config, &mut ws);
    for item in &check.items {
        println!("{:?} {} {:.4?}: {}", item.kind, item.passed, item.margin, item.detail);
    }
    assert!(check.executable());
    assert_eq!(check.items.len(), 8);
    let text = serde_json::to_string(&check).unwrap();
    let back: StrikeCheck = serde_json::from_str(&text).unwrap();
    assert_eq!(back, check);
}

#[test]
fn the_check_finds_what_is_in_the_way_of_the_approach() {
    let model = RobotModel::fr3();
    let mut ws = Workspace::default();
    let config = StrikeConfig::default();
    let plan = plan_strike(&model, &ball_at(0.5, 0.1, -20.0, 0.6), &[floor(0.0)], &config, &mut ws).unwrap();
    // The hand is at this place in the home posture, above the strike.
    let lamp = Obstacle::new(
        "lamp",
        DPose3::from_translation(DVec3::new(0.5545, 0.0, 0.5)),
        ObstacleShape::surface(&Mesh::icosphere(0.05, 2)).unwrap(),
    );
    let check = check_strike(&model, &plan, &[floor(0.0), lamp], &config, &mut ws);
    assert!(!check.executable());
    let failed: Vec<_> = check.items.iter().filter(|i| !i.passed).collect();
    assert_eq!(failed.len(), 1, "{failed:?}");
    assert!(failed[0].detail.contains("lamp") && failed[0].margin.unwrap() < 0.0, "{failed:?}");
    // A floor that is too high is detected, too.
    let check = check_strike(&model, &plan, &[floor(0.022)], &config, &mut ws);
    assert!(!check.executable());
}

#[test]
fn what_is_struck_is_in_the_way_before_the_sweep_and_not_in_it() {
    let model = RobotModel::fr3();
    let config = StrikeConfig::default();
    let mut ws = Workspace::default();
    let (x, y) = (0.5, 0.1);
    let ball = |x: f64, y: f64| {
        let shape = ObstacleShape::Link(LinkShape::Sphere { radius: RADIUS });
        Obstacle::new("ball", DPose3::from_translation(DVec3::new(x, y, RADIUS)), shape).struck()
    };
    let sweep = ball_at(x, y, 0.0, 0.6);
    let alone = plan_strike(&model, &sweep, &[floor(0.0)], &config, &mut ws).unwrap();
    // The ball at the contact is not an obstacle for the sweep.
    let around = [floor(0.0), ball(x, y)];
    let plan = plan_strike(&model, &sweep, &around, &config, &mut ws).unwrap();
    assert_eq!(plan.sweep.q_start, alone.sweep.q_start);
    let check = check_strike(&model, &plan, &around, &config, &mut ws);
    assert!(check.executable(), "{:?}", check.failed().collect::<Vec<_>>());
    let of_ball = check.items.iter().find(|i| i.detail.contains("ball")).unwrap();
    assert!(of_ball.detail.contains("descent") || of_ball.detail.contains("approach"), "{}", of_ball.detail);
    // On the path of the descent, the ball would be pushed before the strike.
    let around = [floor(0.0), ball(x - 0.1 - RADIUS, y)];
    match plan_strike(&model, &sweep, &around, &config, &mut ws) {
        Err(StrikeError::Unstartable { clearance, .. }) => assert_eq!(clearance.other, "ball"),
        other => panic!("{other:?}"),
    }
    let check = check_strike(&model, &alone, &around, &config, &mut ws);
    let failed: Vec<&str> = check.failed().map(|i| i.detail.as_str()).collect();
    assert!(failed.len() == 1 && failed[0].contains("ball in the descent"), "{failed:?}");
}

#[test]
fn the_posture_of_a_strike_is_pinned() {
    let model = RobotModel::fr3();
    let config = StrikeConfig::default();
    let sweep = ball_at(0.45, -0.1, 30.0, 0.5);
    let plan = plan_sweep(&model, &sweep, &[floor(0.0)], &config, &mut Workspace::default()).unwrap();
    let expected =
        [-1.941_471_03, 0.868_010_40, 1.152_262_49, -2.631_146_93, -1.506_058_95, 2.368_088_85, 0.768_796_13];
    for (q, expected) in plan.q_start.iter().zip(expected) {
        assert!((q - expected).abs() < 1e-6, "{:?}", plan.q_start);
    }
}

#[test]
fn a_robot_elsewhere_strikes_there() {
    let x_wr = DPose3::from_parts(DVec3::new(2.0, -1.0, 0.4), glamx::DQuat::from_rotation_z(1.1));
    let here = RobotModel::fr3();
    let there = RobotModel::fr3().with_base(x_wr);
    let config = StrikeConfig::default();
    let mut ws = Workspace::default();
    let sweep = ball_at(0.5, 0.1, 10.0, 0.5);
    let moved = Sweep {
        contact_w: x_wr.transform_point(sweep.contact_w),
        direction_w: x_wr.rotation * sweep.direction_w,
        ..sweep
    };
    let a = plan_sweep(&here, &sweep, &[floor(0.0)], &config, &mut ws).unwrap();
    let b = plan_sweep(&there, &moved, &[floor(0.4)], &config, &mut ws).unwrap();
    let off = a.q_start.iter().zip(&b.q_start).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(off < 1e-6, "{off}");
}

#[test]
fn near_the_robot_what_is_planned_passes_every_check_or_is_refused() {
    let model = RobotModel::fr3();
    let config = StrikeConfig::default();
    let mut ws = Workspace::default();
    let around = [floor(0.0)];
    let (mut swept, mut passed, mut mended, mut refused) = (0, 0, 0, 0);
    for (x, y) in [(0.22, 0.0), (0.27, 0.1), (0.32, 0.0), (0.32, -0.15), (0.37, 0.1)] {
        for degrees in [-150.0, -100.0, -60.0, -20.0, 20.0, 60.0, 100.0, 150.0] {
            let sweep = ball_at(x, y, degrees, 0.4);
            let Ok(alone) = plan_sweep(&model, &sweep, &around, &config, &mut ws) else { continue };
            swept += 1;
            match plan_strike(&model, &sweep, &around, &config, &mut ws) {
                Ok(plan) => {
                    let check = check_strike(&model, &plan, &around, &config, &mut ws);
                    let failed: Vec<&str> = check.failed().map(|i| i.detail.as_str()).collect();
                    assert!(failed.is_empty(), "{x} {y} {degrees}°: {failed:?}");
                    passed += 1;
                    mended += usize::from(plan.sweep.q_start != alone.q_start);
                }
                Err(e @ StrikeError::Unstartable { .. }) => {
                    assert!(e.reason().contains("on the way to the start"), "{e}");
                    assert!(e.cure().contains("further away"), "{}", e.cure());
                    refused += 1;
                }
                // Only the whole motion, including the settling after the sweep, reaches the joint limit.
                Err(StrikeError::Infeasible(e)) => assert!(e.limit == LimitKind::Position, "{e}"),
                Err(e) => panic!("{x} {y} {degrees}°: {e}"),
            }
        }
    }
    println!("of {swept} sweeps {passed} pass, {mended} in another posture; {refused} cannot be started");
    assert!(swept > 20 && 4 * passed > 3 * swept, "{passed} of {swept}");
}
