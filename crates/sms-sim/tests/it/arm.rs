//! Strikes of the arm: free sweeps, limits and obstacles, in both precisions. The closed-form suite tests the struck
//! ball.

use crate::common::*;
use glamx::{DPose3, DVec3};
use sms_core::sphere_mass_properties;
use sms_robots::{
    ArmStrike, FIST_HALF, OscConfig, RobotModel, StrikeConfig, Sweep, SweepPlan, Workspace, plan_sweep,
    simulate_sweep,
};
use sms_scene::{Body, BodyKind};
use sms_sim::{BodyId, Simulation, Striker, StrikerMotion, WorldFactory, WorldOptions};
use std::sync::Arc;

/// Places, directions and speeds of the strikes.
const STRIKES: [(f64, f64, f64, f64); 4] =
    [(0.5, 0.1, 0.4, 0.3), (0.45, 0.0, 0.0, 0.6), (0.5, -0.1, -0.3, 0.8), (0.4, 0.15, 1.2, 0.5)];

fn model() -> Arc<RobotModel> {
    Arc::new(RobotModel::fr3())
}

fn planned(model: &RobotModel, sweep: &Sweep) -> SweepPlan {
    plan_sweep(model, sweep, &[], &StrikeConfig::default(), &mut Workspace::default()).unwrap()
}

fn arm(model: &Arc<RobotModel>, sweep: &Sweep) -> ArmStrike {
    ArmStrike::of_plan(model.clone(), &planned(model, sweep), OscConfig::default(), FIST_HALF)
}

fn heavy(name: &str, center: DVec3, mass: f64, e: f64) -> Body {
    let density = mass / (4.0 / 3.0 * std::f64::consts::PI * R.powi(3));
    Body {
        mass: Some(sphere_mass_properties(DVec3::ZERO, R, density).unwrap()),
        ..ball(name, center, material(0.0, e, 0.0))
    }
}

/// A world without gravity: the model of the arm handles its own weight.
fn strike_of(
    factory: &dyn WorldFactory,
    bodies: Vec<Body>,
    strike: ArmStrike,
    e: f64,
) -> (Simulation, BodyId) {
    let mut simulation = simulate(factory, &scene(0.0, bodies), &awake());
    let striker = simulation.strike(Striker::Arm(Arc::new(strike)), 0.0, e);
    (simulation, striker)
}

/// Steps until the ball moves. Returns the arm before this step.
fn until_touched(simulation: &mut Simulation, ball: BodyId) {
    for _ in 0..4000 {
        simulation.advance(1e-4).unwrap();
        if simulation.state(ball).v_w.length() > 0.01 {
            return;
        }
    }
    panic!("the ball was not touched");
}

#[test]
fn a_light_ball_leaves_as_from_a_finger_that_gives_no_way() {
    let model = model();
    for factory in factories() {
        for (x, y, angle, speed) in STRIKES {
            let center = DVec3::new(x, y, R);
            let motion = StrikerMotion { contact_w: center, angle, speed, ball_radius: R };
            let sweep = motion.sweep(FIST_HALF.x);
            let strikers =
                [Striker::Finger(motion), Striker::Arm(Arc::new(arm(&model, &sweep)))].map(|striker| {
                    let cue = heavy("cue", center, 1e-4, 0.7);
                    let mut simulation = simulate(factory, &scene(0.0, vec![cue]), &awake());
                    simulation.strike(striker, 0.0, 0.7);
                    simulation.advance(sweep.contact_s() + 0.02).unwrap();
                    simulation.state(0).v_w
                });
            let off = (strikers[0] - strikers[1]).length() / strikers[0].length();
            println!("{}: {speed} m/s: {off:.5}", factory.engine());
            assert!(off < 3e-3, "{}: {strikers:?}", factory.engine());
        }
    }
}

#[test]
fn a_free_sweep_is_that_of_the_arm_alone() {
    let model = model();
    for factory in factories() {
        for (x, y, angle, speed) in STRIKES {
            let sweep = Sweep::of_ball(DVec3::new(x, y, R), R, angle, speed, FIST_HALF.x);
            let plan = planned(&model, &sweep);
            // A distant ball, so that the world has a body.
            let far = ball("far", DVec3::new(-1.0, 0.0, R), material(0.0, 0.5, 0.0));
            let (mut simulation, striker) = strike_of(factory, vec![far], arm(&model, &sweep), 0.7);
            let alone = simulate_sweep(&model, &plan, &OscConfig::default(), &model, 1.0, DT);
            let finer = simulate_sweep(&model, &plan, &OscConfig::default(), &model, 1.0, 0.25 * DT);
            let (mut before, mut passed) = (simulation.state(striker), None);
            let d = sweep.direction_w;
            let along = |p: DVec3| (p - sweep.contact_w).dot(d);
            while !simulation.is_strike_over() {
                simulation.advance(DT).unwrap();
                let now = simulation.state(striker);
                let (was, is) = (along(before.x_wb.translation), along(now.x_wb.translation));
                if was < 0.0 && is >= 0.0 {
                    passed = Some(before.v_w + was / (was - is) * (now.v_w - before.v_w));
                }
                before = now;
            }
            assert!(simulation.state(striker).x_wb.translation.z > 0.2, "the arm is taken away");
            let (v, contact) = (passed.unwrap(), alone.contact.unwrap());
            let direction = v.cross(d).length().atan2(v.dot(d));
            println!(
                "{}: {:.1e} m/s, {:.1e} rad; finer steps {:.1e} m/s",
                factory.engine(),
                v.dot(d) - contact.speed,
                direction - contact.direction_error_rad,
                finer.contact.unwrap().speed - contact.speed
            );
            assert!((v.dot(d) - contact.speed).abs() < 1e-6);
            assert!((direction - contact.direction_error_rad).abs() < 1e-6);
            assert!((v.dot(d) / speed - 1.0).abs() < 0.02 && direction < 0.3f64.to_radians());
            assert_eq!(simulation.received_impulse_w(striker).unwrap(), DVec3::ZERO);
        }
    }
}

#[test]
fn what_does_not_move_stops_the_arm_within_its_limits() {
    let model = model();
    for factory in factories() {
        let sweep = Sweep::of_ball(DVec3::new(0.5, 0.0, R), R, 0.0, 0.5, FIST_HALF.x);
        // The front face is where that of the ball would be.
        let half = DVec3::new(0.1, 0.1, 0.1);
        let face = 0.5 - R;
        let wall = DPose3::from_translation(DVec3::new(face + half.x, 0.0, 0.05));
        let fixed = cuboid("wall", wall, half, BodyKind::Static, material(0.3, 0.1, 0.0));
        let (mut simulation, striker) = strike_of(factory, vec![fixed], arm(&model, &sweep), 0.1);
        let mut deepest = 0.0f64;
        let mut largest = [0.0f64; 7];
        while !simulation.is_strike_over() {
            simulation.advance(DT).unwrap();
            if simulation.is_strike_over() {
                break;
            }
            let front = simulation.state(striker).x_wb.translation.x + FIST_HALF.x;
            deepest = deepest.max(front - face);
            let drive = simulation.arm(striker).unwrap();
            for (most, tau) in largest.iter_mut().zip(drive.torques()) {
                *most = most.max(tau.abs());
            }
        }
        let drive = simulation.arm(striker).unwrap();
        let push = simulation.received_impulse_w(striker).unwrap();
        println!(
            "{}: {:.2} mm into the wall, {push:.2} N·s, {} saturated periods, {largest:.0?} N·m",
            factory.engine(),
            1e3 * deepest,
            drive.saturated_periods()
        );
        assert!(deepest < 1e-3, "{}: {deepest}", factory.engine());
        assert!(push.x < -1.0);
        for (joint, most) in model.joints().iter().zip(largest) {
            assert!(most <= joint.limits.effort, "{}", joint.name);
        }
    }
}

#[test]
fn a_box_is_pushed_and_slows_the_arm() {
    let model = model();
    for factory in factories() {
        let sweep = Sweep::of_ball(DVec3::new(0.5, 0.0, R), R, 0.0, 0.5, FIST_HALF.x);
        let half = DVec3::new(0.05, 0.08, 0.1);
        let place = DPose3::from_translation(DVec3::new(0.5 - R + half.x, 0.0, 0.1));
        let load = cuboid("box", place, half, BodyKind::Dynamic, material(0.4, 0.1, 0.0));
        let mass = load.mass.unwrap().mass();
        let bodies = vec![floor(material(0.4, 0.1, 0.0)), load];
        let mut simulation = simulate(factory, &scene(G, bodies), &awake());
        let striker = simulation.strike(Striker::Arm(Arc::new(arm(&model, &sweep))), 0.4, 0.1);
        let mut slowest = f64::INFINITY;
        while !simulation.is_strike_over() {
            simulation.advance(DT).unwrap();
            let t = simulation.time_s() - sweep.contact_s();
            if (0.0..0.01).contains(&t) {
                slowest = slowest.min(simulation.state(striker).v_w.x);
            }
        }
        let (x, v) = (simulation.state(1).x_wb.translation.x, simulation.state(1).v_w);
        println!("{}: {mass:.2} kg pushed to {x:.3} m, {v:.3}; tool down to {slowest:.3}", factory.engine());
        assert!(slowest < 0.4, "{slowest}");
        assert!(x - place.translation.x > 0.02);
    }
}

#[test]
fn strikes_repeat_to_the_bit() {
    let model = model();
    let sweep = Sweep::of_ball(DVec3::new(0.5, 0.1, R), R, 0.4, 0.6, FIST_HALF.x);
    let strike = Striker::Arm(Arc::new(arm(&model, &sweep)));
    for factory in factories() {
        let surface = || material(0.4, 0.6, 1e-4);
        let bodies = vec![floor(surface()), ball("cue", DVec3::new(0.5, 0.1, R), surface())];
        let options = WorldOptions { dt: DT, ..WorldOptions::default() };
        let mut simulation = simulate(factory, &scene(G, bodies), &options);
        simulation.save();
        let mut shot = || {
            assert!(simulation.restore());
            simulation.strike(&strike, 0.65, 0.75);
            run(&mut simulation, 1.5);
            simulation.states().to_vec()
        };
        assert_eq!(shot(), shot(), "{}", factory.engine());
    }
}

#[test]
fn parts_of_steps_are_no_affair_of_the_arm() {
    let model = model();
    let sweep = Sweep::of_ball(DVec3::new(0.5, 0.1, R), R, 0.4, 0.6, FIST_HALF.x);
    let strike = arm(&model, &sweep);
    for factory in factories() {
        let [whole, split] = [vec![DT], vec![0.3 * DT, 1e-5, 0.7 * DT - 1e-5]].map(|parts| {
            let (mut simulation, striker) = strike_of(factory, Vec::new(), strike.clone(), 0.7);
            for _ in 0..100 {
                parts.iter().for_each(|&dt| simulation.advance(dt).unwrap());
            }
            simulation.state(striker)
        });
        let off = (whole.x_wb.translation - split.x_wb.translation).length();
        println!("{}: {off:.1e} m, {:.1e} m/s", factory.engine(), (whole.v_w - split.v_w).length());
        assert!(off < 1e-6 && (whole.v_w - split.v_w).length() < 1e-5);
    }
}

/// Shortly after the touch the controller has had hardly any effect.
#[test]
fn the_arm_recoils_as_the_ball_leaves() {
    let model = model();
    for factory in factories() {
        let center = DVec3::new(0.5, 0.0, R);
        let sweep = Sweep::of_ball(center, R, 0.0, 0.6, FIST_HALF.x);
        let (mut simulation, striker) =
            strike_of(factory, vec![heavy("cue", center, 2.0, 0.8)], arm(&model, &sweep), 0.8);
        until_touched(&mut simulation, 0);
        let v = simulation.state(striker).v_w.x;
        println!("{}: tool at {v:.3} m/s", factory.engine());
        assert!(v < 0.2, "{v}");
        // The controller returns the tool to its motion, which ends at rest.
        while !simulation.is_strike_over() {
            let before = simulation.state(striker);
            simulation.advance(DT).unwrap();
            if simulation.is_strike_over() {
                assert!(before.v_w.length() < 0.02, "{}", before.v_w);
            }
        }
    }
}
