//! Rigid bodies with one degree of freedom under wash: they move exactly when the closed form predicts it.

use crate::common::hover;
use glamx::{DPose3, DQuat, DVec3};
use sms_robots::Rotor;
use sms_wash::{
    BodyState, BodySurface, SphSettings, SphWash, StreamSettings, StreamWash, VehicleState, Wash, Wrench,
};

const DT: f64 = 0.0025;
const G: f64 = 9.81;
const THRUST: f64 = 2.9;
const ROTOR: [Rotor; 1] = [Rotor { p_v: DVec3::ZERO, radius: 0.0685 }];

fn models(surface: &BodySurface) -> [Box<dyn Wash>; 3] {
    let streams = StreamSettings { rings: 16, spokes: 24, ..StreamSettings::default() };
    [
        Box::new(StreamWash::disk(vec![surface.clone()], streams).unwrap()),
        Box::new(StreamWash::jet(vec![surface.clone()], streams).unwrap()),
        Box::new(SphWash::new(vec![surface.clone()], SphSettings::default()).unwrap()),
    ]
}

/// Position of the edge along x, metres.
const EDGE: f64 = 0.1;
/// Position of the propeller along x, metres.
const BLOWN: f64 = 0.25;

/// Returns the tilt (radians) after half a second of a board that can rotate downwards about the edge, while the
/// propeller blows on it.
fn lean(wash: &mut dyn Wash, half: DVec3, mass: f64) -> f64 {
    let edge_w = DVec3::new(EDGE, 0.0, 0.0);
    let inertia = mass * ((half.x.powi(2) + half.z.powi(2)) / 3.0 + EDGE.powi(2));
    let vehicle = hover(&ROTOR, &[THRUST], DVec3::new(BLOWN, 0.0, 0.15));
    let (mut angle, mut rate) = (0.0, 0.0);
    let mut wrench = [Wrench::default()];
    for _ in 0..200 {
        let rotation = DQuat::from_rotation_y(angle);
        let center_w = edge_w + rotation * DVec3::new(-EDGE, 0.0, 0.0);
        let w_w = DVec3::Y * rate;
        let body = BodyState {
            x_wb: DPose3::from_parts(center_w, rotation),
            v_w: w_w.cross(center_w - edge_w),
            w_w,
        };
        wash.step(DT, &vehicle, &[body], &mut wrench);
        let force_w = wrench[0].force_w - DVec3::Z * mass * G;
        let torque = (wrench[0].torque_w + (center_w - edge_w).cross(force_w)).y;
        rate += DT * torque / inertia;
        angle += DT * rate;
        if angle <= 0.0 {
            (angle, rate) = (0.0, rate.max(0.0));
        }
    }
    angle
}

/// Thrust × (distance of the propeller from the edge) against weight × (distance of the centre from the edge).
#[test]
fn a_board_tips_at_the_threshold() {
    let half = DVec3::new(0.5, 0.3, 0.005);
    let surface = BodySurface::cuboid(half).unwrap();
    let threshold = THRUST * (BLOWN - EDGE) / (EDGE * G);
    for (heavier, tips) in [(0.96, true), (1.04, false)] {
        for mut wash in models(&surface) {
            let angle = lean(&mut *wash, half, heavier * threshold);
            let name = wash.name();
            println!("{name}: {heavier} of the threshold leans {angle:.4}");
            assert!(if tips { angle > 0.02 } else { angle < 0.002 }, "{name} at {heavier}: {angle}");
        }
    }
}

/// An inverted propeller below a box lifts the box when the thrust exceeds the weight.
#[test]
fn a_box_is_lifted_at_the_threshold() {
    let half = DVec3::new(0.2, 0.2, 0.05);
    let surface = BodySurface::cuboid(half).unwrap();
    for (heavier, rises) in [(0.96, true), (1.04, false)] {
        for mut wash in models(&surface) {
            let mass = heavier * THRUST / G;
            let vehicle = VehicleState {
                x_wv: DPose3::from_parts(DVec3::Z * -0.25, DQuat::from_rotation_x(std::f64::consts::PI)),
                v_w: DVec3::ZERO,
                rotors: &ROTOR,
                thrusts: &[THRUST],
            };
            let (mut z, mut speed) = (0.0, 0.0);
            let mut wrench = [Wrench::default()];
            for _ in 0..160 {
                let body = BodyState {
                    x_wb: DPose3::from_translation(DVec3::Z * z),
                    v_w: DVec3::Z * speed,
                    w_w: DVec3::ZERO,
                };
                wash.step(DT, &vehicle, &[body], &mut wrench);
                speed += DT * (wrench[0].force_w.z / mass - G);
                z += DT * speed;
                if z <= 0.0 {
                    (z, speed) = (0.0, f64::max(speed, 0.0));
                }
            }
            let name = wash.name();
            println!("{name}: {heavier} of the threshold rises {z:.4} m");
            assert!(if rises { z > 0.01 } else { z < 0.002 }, "{name} at {heavier}: {z}");
        }
    }
}
