//! The arm as a PhysX articulation, compared with the arm model that all engines share.
#![cfg(feature = "physx")]

use glamx::DVec3;
use sms_core::{Interval, Material, Property, PropertySource, sphere_mass_properties};
use sms_robots::{ArmStrike, FIST_HALF, OscConfig, RobotModel, StrikeConfig, Sweep, Workspace, plan_sweep};
use sms_scene::{Body, BodyKind, BodyShape, GRAVITY, SCENE_VERSION, Scene, floor_body};
use sms_sim::{ArmKind, Simulation, Striker, WorldOptions};
use sms_target::PhysxFactory;
use std::sync::Arc;

const R: f64 = 0.03;
/// Nominal step of the target.
const DT: f64 = 0.25 * 0.0025;
/// Places (x, y), directions and speeds of the strikes.
const STRIKES: [(f64, f64, f64, f64); 4] =
    [(0.5, 0.1, 0.4, 0.3), (0.45, 0.0, 0.0, 0.6), (0.5, -0.1, -0.3, 0.8), (0.4, 0.15, 1.2, 0.5)];

fn material() -> Material {
    let exact = |v| Property::new(Interval::exact(v), PropertySource::User);
    Material {
        class: "test".into(),
        density: exact(1700.0),
        friction: exact(0.2),
        restitution: exact(0.6),
        rolling_m: exact(0.0),
        youngs_modulus_pa: exact(1e9),
        fill_factor: exact(1.0),
        poissons_ratio: exact(0.3),
    }
}

fn strike((x, y, angle, speed): (f64, f64, f64, f64)) -> Arc<ArmStrike> {
    let model = Arc::new(RobotModel::fr3());
    let sweep = Sweep::of_ball(DVec3::new(x, y, R), R, angle, speed, FIST_HALF.x);
    let plan = plan_sweep(&model, &sweep, &[], &StrikeConfig::default(), &mut Workspace::default()).unwrap();
    Arc::new(ArmStrike::of_plan(model, &plan, OscConfig::default(), FIST_HALF))
}

/// Returns a floor and, optionally, the struck ball.
fn simulation(strike: &ArmStrike, with_ball: bool, arm: ArmKind) -> Simulation {
    let mut bodies = vec![floor_body(0.0, material())];
    if with_ball {
        let sweep = &strike.sweep;
        let center_w = sweep.contact_w + (FIST_HALF.x + R) * sweep.direction_w;
        let mass = sphere_mass_properties(DVec3::ZERO, R, 1700.0).unwrap();
        bodies.push(Body {
            name: "ball".into(),
            kind: BodyKind::Dynamic,
            x_wb: glamx::DPose3::from_translation(center_w.with_z(R)),
            shape: BodyShape::Sphere { radius: R },
            mass: Some(mass),
            ..floor_body(0.0, material())
        });
    }
    let scene = Scene {
        version: SCENE_VERSION,
        name: "arm".into(),
        gravity_w: DVec3::new(0.0, 0.0, -GRAVITY),
        size_sigma: 0.0,
        x_world_recording: glamx::DPose3::IDENTITY,
        bodies,
    };
    let options = WorldOptions { dt: DT, arm, ..WorldOptions::default() };
    Simulation::new(&PhysxFactory::Precise, &scene, &options).unwrap()
}

/// Returns the velocity of the tool at the contact position, m/s, and its position.
fn sweep_velocity(strike: &Arc<ArmStrike>, arm: ArmKind) -> (DVec3, DVec3) {
    let mut simulation = simulation(strike, false, arm);
    let body = simulation.strike(Striker::Arm(strike.clone()), 0.6, 0.7);
    assert_eq!(simulation.arm(body).is_none(), arm == ArmKind::Articulation, "owner of the joints");
    simulation.advance(strike.sweep.contact_s()).unwrap();
    let state = simulation.state(body);
    (state.v_w, state.x_wb.translation)
}

/// Returns the velocity of the ball shortly after the strike, m/s.
fn ball_velocity(strike: &Arc<ArmStrike>, arm: ArmKind, friction: f64) -> DVec3 {
    let mut simulation = simulation(strike, true, arm);
    simulation.strike(Striker::Arm(strike.clone()), friction, 0.7);
    simulation.advance(strike.sweep.contact_s() + 5e-3).unwrap();
    simulation.state(1).v_w
}

#[test]
fn its_sweep_in_free_space_is_that_of_the_shared_arm() {
    for from in STRIKES {
        let strike = strike(from);
        let (shared, at) = sweep_velocity(&strike, ArmKind::Shared);
        let (own, own_at) = sweep_velocity(&strike, ArmKind::Articulation);
        let speed = own.length() / shared.length() - 1.0;
        let turn = own.angle_between(shared).to_degrees();
        println!("{from:?}: speed {speed:.5}, direction {turn:.4}°, place {:.2e} m", at.distance(own_at));
        assert!(speed.abs() < 5e-3 && turn < 0.3, "{from:?}: speed {speed}, direction {turn}°");
        assert!((shared.length() / from.3 - 1.0).abs() < 0.02, "it must have the requested speed");
    }
}

/// The goal is 1 % of the speed. PhysX's contacts of articulations restitute up to 3.5 % too little, so balls are up to
/// 2 % slower (experiments/studies/target.md). Without friction between fist and ball, both arms strike it in the same
/// direction; with friction, the articulation's tip recoils sideways and drags the ball along.
#[test]
fn a_struck_ball_is_hardly_slower_than_by_the_shared_arm() {
    for from in STRIKES {
        let strike = strike(from);
        // A pair uses the mean of both surfaces, so the first has no friction at all.
        for (friction, most_turn) in [(-0.2, 0.01), (0.6, 1.5)] {
            let of = |arm| ball_velocity(&strike, arm, friction);
            let (shared, own) = (of(ArmKind::Shared), of(ArmKind::Articulation));
            let speed = own.length() / shared.length() - 1.0;
            let turn = own.angle_between(shared).to_degrees();
            println!("{from:?}, {friction}: {:.4} m/s, {speed:.5}, {turn:.4}°", shared.length());
            assert!(shared.length() > from.3, "the ball must be struck: {shared}");
            assert!(speed.abs() < 0.025 && turn < most_turn, "{from:?}: speed {speed}, {turn}°");
        }
    }
}

#[test]
fn it_leaves_when_the_sweep_is_over_and_a_restored_world_has_none() {
    let strike = strike(STRIKES[1]);
    let mut simulation = simulation(&strike, true, ArmKind::Articulation);
    assert!(simulation.save());
    let mut ends = Vec::new();
    for _ in 0..2 {
        assert!(simulation.restore());
        simulation.strike(Striker::Arm(strike.clone()), 0.6, 0.7);
        assert!(!simulation.is_strike_over());
        simulation.advance(strike.duration_s() + 0.1).unwrap();
        assert!(simulation.is_strike_over());
        ends.push(simulation.state(1));
    }
    assert_eq!(ends[0], ends[1], "bitwise equal");
}
