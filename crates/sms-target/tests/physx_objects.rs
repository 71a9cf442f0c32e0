//! PhysX worlds release all their objects, regardless of the thread that builds them. The test is a binary of its own
//! because it counts the objects of the process.
#![cfg(feature = "physx")]

#[path = "../../sms-sim/tests/it/common.rs"]
mod common;

use common::{DT, G, R, awake, ball, cuboid, floor, material, mesh_box, scene, simulate};
use glamx::{DPose3, DVec3};
use sms_scene::{BodyKind, Scene};
use sms_sim::{StrikerMotion, WorldFactory};
use sms_target::{PhysxFactory, physx_live_objects};

fn every_kind() -> Scene {
    let surface = || material(0.4, 0.6, 1e-4);
    let at = |x: f64, z: f64| DPose3::from_translation(DVec3::new(x, 0.0, z));
    scene(
        G,
        vec![
            floor(surface()),
            ball("cue", DVec3::new(0.0, 0.0, R), surface()),
            cuboid("hull", at(0.2, 0.03), DVec3::splat(0.03), BodyKind::Dynamic, surface()),
            mesh_box("mesh", at(0.5, 0.05), DVec3::splat(0.05), surface()),
        ],
    )
}

#[test]
fn two_hundred_worlds_leave_nothing_behind() {
    let scene = every_kind();
    let round = |factory: PhysxFactory| {
        let mut simulation = simulate(&factory, &scene, &awake());
        assert!(simulation.save());
        for speed in [0.3, 0.5] {
            let contact_w = DVec3::new(0.0, 0.0, R);
            simulation.strike(StrikerMotion { contact_w, angle: 0.0, speed, ball_radius: R }, 0.5, 0.5);
            simulation.advance(10.0 * DT).unwrap();
            assert!(simulation.restore());
        }
        assert!(physx_live_objects() > 0);
    };
    assert_eq!(physx_live_objects(), 0);
    for k in 0..100 {
        round(if k % 2 == 0 { PhysxFactory::Precise } else { PhysxFactory::Stock });
    }
    std::thread::scope(|threads| {
        for _ in 0..4 {
            threads.spawn(|| (0..25).for_each(|_| round(PhysxFactory::Precise)));
        }
    });
    assert_eq!(physx_live_objects(), 0, "200 worlds later");
    // A scene that is refused half-way releases its objects.
    let mut bad = scene.clone();
    bad.bodies[2].mass = None;
    assert!(PhysxFactory::Precise.build(&bad, &awake()).is_err());
    assert_eq!(physx_live_objects(), 0, "after a refused scene");
}
