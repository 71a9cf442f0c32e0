//! Time of a billiards rollout: 4 s in 1600 steps, 8 obstacles of 8 hulls each, two balls and the finger.
//!
//! Prints mean milliseconds of one core's time per rollout, the cost of building and of restoring a snapshot, and the
//! cost of contact timing. `cargo bench -p sms-sim`.

#[path = "../tests/it/common.rs"]
mod common;

use common::{G, R, ball, floor, material, scene};
use glamx::{DPose3, DQuat, DVec3};
use sms_core::{Mesh, polyhedron_mass_properties};
use sms_scene::{Body, BodyKind, BodyShape, Scene};
use sms_sim::{RapierF64Factory, RapierFactory, Simulation, StrikerMotion, WorldFactory, WorldOptions};
use std::time::Instant;

const CUE_W: DVec3 = DVec3::new(0.35, 0.0, R);
const TARGET_W: DVec3 = DVec3::new(0.6, 0.03, R);

/// A vessel of eight staves: each a hull of 16 corners.
fn vessel(name: &str, x: f64, y: f64, scale: f64) -> Body {
    let (inner, outer, height) = (0.030 * scale, 0.036 * scale, 0.09 * scale);
    let corner = |radius: f64, angle: f64, z: f64| DVec3::new(radius * angle.cos(), radius * angle.sin(), z);
    let stave = |k: usize| {
        let step = std::f64::consts::TAU / 8.0;
        let corners: Vec<DVec3> = (0..4)
            .flat_map(|i| {
                let angle = (k as f64 + f64::from(i) / 3.0) * step;
                [-0.5, 0.5]
                    .into_iter()
                    .flat_map(move |z| [corner(inner, angle, z * height), corner(outer, angle, z * height)])
            })
            .collect();
        Mesh::new(corners, Vec::new())
    };
    let solid = Mesh::cuboid(DVec3::new(outer, outer, 0.5 * height));
    let mass = polyhedron_mass_properties(&solid, 600.0).unwrap();
    Body {
        name: name.into(),
        kind: BodyKind::Dynamic,
        x_wb: DPose3::from_parts(DVec3::new(x, y, 0.5 * height), DQuat::from_rotation_z(x + y)),
        mass: Some(mass),
        shape: BodyShape::Hulls { hulls: (0..8).map(stave).collect() },
        ..floor(material(0.4, 0.5, 1e-4))
    }
}

fn billiards() -> Scene {
    let mut bodies = vec![
        floor(material(0.4, 0.5, 1e-4)),
        ball("cue", CUE_W, material(0.2, 0.9, 1e-4)),
        ball("target", TARGET_W, material(0.2, 0.9, 1e-4)),
    ];
    let places = [
        (0.45, 0.18),
        (0.70, 0.20),
        (0.85, 0.05),
        (0.80, -0.15),
        (0.55, -0.18),
        (0.95, 0.25),
        (1.05, -0.05),
        (0.65, 0.35),
    ];
    for (k, (x, y)) in places.into_iter().enumerate() {
        bodies.push(vessel(&format!("vessel{k}"), x, y, 1.0 + 0.05 * k as f64));
    }
    scene(G, bodies)
}

const REPEATS: u32 = 15;

/// CPU seconds of this thread if the system reports them (Linux), which excludes other programs; otherwise wall-clock
/// time.
fn thread_seconds(started: Instant) -> f64 {
    std::fs::read_to_string("/proc/thread-self/schedstat")
        .ok()
        .and_then(|text| text.split_whitespace().next()?.parse::<f64>().ok())
        .map_or(started.elapsed().as_secs_f64(), |ns| 1e-9 * ns)
}

/// Mean milliseconds of [`REPEATS`] calls.
fn mean_ms(mut work: impl FnMut(u32)) -> f64 {
    let clock = Instant::now();
    let before = thread_seconds(clock);
    (0..REPEATS).for_each(&mut work);
    1e3 * (thread_seconds(clock) - before) / f64::from(REPEATS)
}

/// Returns milliseconds per rollout, and the number of splits in the last one.
fn rollouts(factory: &dyn WorldFactory, options: &WorldOptions) -> (f64, usize) {
    let scene = billiards();
    let mut simulation = Simulation::new(factory, &scene, options).unwrap();
    simulation.save();
    let ms = mean_ms(|k| {
        simulation.restore();
        let motion = StrikerMotion {
            contact_w: CUE_W,
            angle: 0.02 * f64::from(k) - 0.1,
            speed: 0.4 + 0.03 * f64::from(k),
            ball_radius: R,
        };
        simulation.strike(motion, 0.65, 0.75);
        for _ in 0..1600 {
            simulation.advance(0.0025).unwrap();
        }
    });
    (ms, simulation.split_count())
}

fn main() {
    let factories: [&dyn WorldFactory; 2] = [&RapierFactory, &RapierF64Factory];
    let scene = billiards();
    for factory in factories {
        let options = WorldOptions::default();
        let build = mean_ms(|_| {
            Simulation::new(factory, &scene, &options).unwrap();
        });
        let mut simulation = Simulation::new(factory, &scene, &options).unwrap();
        simulation.save();
        // A single restore is too short for the thread's clock.
        let restore = 1e-2
            * mean_ms(|_| {
                for _ in 0..100 {
                    simulation.restore();
                }
            });
        let (timed, splits) = rollouts(factory, &options);
        let (untimed, _) = rollouts(factory, &WorldOptions { contact_timing: false, ..options });
        let (awake, _) = rollouts(factory, &WorldOptions { sleep: false, ..options });
        println!(
            "{}: 4 s billiards rollout {timed:.1} ms ({splits} splits), without contact timing {untimed:.1} ms, \
             without sleeping {awake:.1} ms; build {build:.2} ms, restore {restore:.3} ms",
            factory.engine()
        );
    }
}
