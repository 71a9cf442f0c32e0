//! Wash on bodies of a simulation, against closed forms.

use glamx::{DPose3, DVec3};
use sms_core::box_mass_properties;
use sms_robots::{Quadrotor, Rotor};
use sms_scene::{Body, BodyKind, BodyShape, SCENE_VERSION, Scene, example_material, floor_body};
use sms_sim::{RapierF64Factory, Simulation, WashInWorld, WorldOptions, wash_surfaces};
use sms_wash::{SphSettings, SphWash, StreamSettings, StreamWash, VehicleState, Wash};

const G: f64 = 9.81;
const DT: f64 = 0.0025;
/// Upper side of the post that carries the plank, and half the width of the post.
const TOP: f64 = 0.3;
const POST: f64 = 0.08;
const THRUST: f64 = 2.9;
/// Position of the propeller along the plank.
const ALONG: f64 = 0.2;

/// A plank of mass `mass`, centred on a fixed post.
fn scene(mass: f64) -> Scene {
    let half = DVec3::new(0.35, 0.12, 0.01);
    let volume = 8.0 * half.x * half.y * half.z;
    let plank = Body {
        name: "plank".into(),
        kind: BodyKind::Dynamic,
        x_wb: DPose3::from_translation(DVec3::new(0.0, 0.0, TOP + half.z)),
        shape: BodyShape::Box { half_extents: half },
        mass: Some(box_mass_properties(half, mass / volume).unwrap()),
        ..floor_body(0.0, example_material())
    };
    let post = Body {
        name: "post".into(),
        x_wb: DPose3::from_translation(DVec3::new(0.0, 0.0, 0.5 * TOP)),
        shape: BodyShape::Box { half_extents: DVec3::new(POST, POST, 0.5 * TOP) },
        ..floor_body(0.0, example_material())
    };
    Scene {
        version: SCENE_VERSION,
        name: "plank".into(),
        gravity_w: DVec3::new(0.0, 0.0, -G),
        size_sigma: 0.0,
        x_world_recording: DPose3::IDENTITY,
        bodies: vec![floor_body(0.0, example_material()), post, plank],
    }
}

/// Returns the tilt of the plank after a while of wash, radians.
fn lean(mass: f64, make: &dyn Fn(&Scene) -> Box<dyn Wash>) -> f64 {
    let scene = scene(mass);
    let options = WorldOptions { dt: DT, ..WorldOptions::default() };
    let mut simulation = Simulation::new(&RapierF64Factory, &scene, &options).unwrap();
    let mut wash = WashInWorld::new(make(&scene), scene.bodies.len());
    let rotors = [Rotor { p_v: DVec3::ZERO, radius: 0.0685 }];
    let vehicle = VehicleState {
        x_wv: DPose3::from_translation(DVec3::new(ALONG, 0.0, TOP + 0.25)),
        v_w: DVec3::ZERO,
        rotors: &rotors,
        thrusts: &[THRUST],
    };
    for _ in 0..200 {
        wash.advance(&mut simulation, &vehicle, DT).unwrap();
    }
    assert_eq!(simulation.state(1).x_wb, scene.bodies[1].x_wb, "the post stays");
    (simulation.state(2).x_wb.rotation * DVec3::Z).angle_between(DVec3::Z)
}

/// A plank with its centre `POST` inside the edge tips when thrust × lever exceeds weight × POST.
fn tips_at_the_threshold(margin: f64, make: &dyn Fn(&Scene) -> Box<dyn Wash>) {
    let threshold = THRUST * (ALONG - POST) / (G * POST);
    let light = lean((1.0 - margin) * threshold, make);
    let heavy = lean((1.0 + margin) * threshold, make);
    assert!(light > 0.03, "a plank lighter than the threshold leans {light}");
    assert!(heavy < 0.005, "a plank heavier than the threshold leans {heavy}");
}

#[test]
fn an_overhanging_plank_tips_under_the_disk_s_wash_at_the_threshold() {
    tips_at_the_threshold(0.03, &|scene| {
        Box::new(StreamWash::disk(wash_surfaces(scene).unwrap(), StreamSettings::default()).unwrap())
    });
}

#[test]
fn an_overhanging_plank_tips_under_the_particles_at_the_threshold() {
    tips_at_the_threshold(0.05, &|scene| {
        Box::new(SphWash::new(wash_surfaces(scene).unwrap(), SphSettings::default()).unwrap())
    });
}

/// Bodies without wash fall asleep, and the air is restored with the world.
#[test]
fn a_restored_run_repeats_itself() {
    let scene = scene(0.5);
    let mut simulation =
        Simulation::new(&RapierF64Factory, &scene, &WorldOptions { dt: DT, ..WorldOptions::default() })
            .unwrap();
    let sph = SphWash::new(wash_surfaces(&scene).unwrap(), SphSettings::default()).unwrap();
    let mut wash = WashInWorld::new(Box::new(sph), scene.bodies.len());
    let rotors = [Rotor { p_v: DVec3::ZERO, radius: 0.0685 }];
    let over = |x: f64| VehicleState {
        x_wv: DPose3::from_translation(DVec3::new(x, 0.0, TOP + 0.2)),
        v_w: DVec3::ZERO,
        rotors: &rotors,
        thrusts: &[THRUST],
    };
    for _ in 0..20 {
        wash.advance(&mut simulation, &over(0.0), DT).unwrap();
    }
    assert!(simulation.save());
    wash.save();
    let mut run = |simulation: &mut Simulation| {
        for _ in 0..60 {
            wash.advance(simulation, &over(0.25), DT).unwrap();
        }
        let end = simulation.state(2);
        assert!(simulation.restore());
        wash.restore();
        end
    };
    let first = run(&mut simulation);
    assert_eq!(first, run(&mut simulation));
    assert!(first.w_w.length() > 0.1, "it was set in motion");
}

/// The vehicle cuts its motors 1 cm above a platform and touches down as a free body: on its feet, upright, at the same
/// place.
#[test]
fn the_quadrotor_stands_on_its_legs() {
    let vehicle = Quadrotor::default();
    let mut scene = scene(2.0);
    let top = TOP + 0.02;
    let x_wv = DPose3::from_translation(DVec3::new(0.02, 0.01, top + 0.01 + vehicle.standing_height()));
    let mass = vehicle.mass_properties().unwrap();
    scene.bodies.push(vehicle.body("quadrotor", x_wv, Some(mass), example_material()));
    let mut simulation =
        Simulation::new(&RapierF64Factory, &scene, &WorldOptions { dt: DT, ..WorldOptions::default() })
            .unwrap();
    let quadrotor = scene.bodies.len() - 1;
    let falling = sms_sim::BodyState { v_w: DVec3::Z * -0.3, ..simulation.state(quadrotor) };
    simulation.set_state(quadrotor, &falling);
    simulation.advance(2.0).unwrap();
    let end = simulation.state(quadrotor);
    assert!(
        (end.x_wb.translation.z - top - vehicle.standing_height()).abs() < 2e-3,
        "{}",
        end.x_wb.translation
    );
    assert!(end.x_wb.translation.distance(falling.x_wb.translation) < 0.02);
    assert!((end.x_wb.rotation * DVec3::Z).angle_between(DVec3::Z) < 0.01);
    assert!(end.v_w.length() < 1e-2);
}
