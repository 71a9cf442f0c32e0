//! First touches of bodies, in both precisions.

use crate::common::*;
use glamx::{DPose3, DVec3};
use sms_scene::{BodyKind, Scene};
use sms_sim::{Simulation, StrikerMotion, WorldOptions};

const HALF: DVec3 = DVec3::new(0.03, 0.03, 0.03);

fn at(x: f64) -> DPose3 {
    DPose3::from_translation(DVec3::new(x, 0.0, 0.03))
}

/// A row of boxes: `a`, then `b` 3 cm behind it, in contact with `c`; `d` far away.
fn row() -> Scene {
    let surface = || material(0.3, 0.1, 0.0);
    let cube = |name: &str, x: f64| cuboid(name, at(x), HALF, BodyKind::Dynamic, surface());
    scene(G, vec![floor(surface()), cube("a", 0.0), cube("b", 0.09), cube("c", 0.15), cube("d", 0.5)])
}

fn pairs(simulation: &Simulation) -> Vec<(usize, usize)> {
    simulation.contacts().iter().map(|c| (c.body, c.other)).collect()
}

#[test]
fn a_row_of_boxes_is_pushed_in_order_and_what_stood_together_is_no_event() {
    for factory in factories() {
        let mut simulation = Simulation::new(factory, &row(), &WorldOptions::default()).unwrap();
        run(&mut simulation, 0.5);
        assert!(simulation.save());
        let motion = StrikerMotion {
            contact_w: DVec3::new(0.0, 0.0, 0.03),
            angle: 0.0,
            speed: 0.5,
            ball_radius: HALF.x,
        };
        for _ in 0..2 {
            assert!(simulation.restore());
            let finger = simulation.strike(motion, 0.5, 0.2);
            run(&mut simulation, 1.5);
            let engine = factory.engine();
            assert_eq!(pairs(&simulation), [(finger, 1), (1, 2)], "{engine}: {:?}", simulation.contacts());
            let times: Vec<f64> = simulation.contacts().iter().map(|c| c.time_s - 0.5).collect();
            assert!((times[0] - motion.contact_s()).abs() < 0.01, "{engine}: {times:?}");
            // `a` travels 3 cm at up to 0.6 m/s.
            assert!(times[1] - times[0] > 0.04 && times[1] - times[0] < 0.3, "{engine}: {times:?}");
        }
    }
}

#[test]
fn a_touch_slower_than_those_that_split_steps_is_seen() {
    for factory in factories() {
        let surface = || material(0.3, 0.1, 0.0);
        let scene = scene(
            G,
            vec![
                floor(surface()),
                ball("slow", DVec3::new(0.0, 0.0, R), surface()),
                ball("still", DVec3::new(2.0 * R + 0.005, 0.0, R), surface()),
            ],
        );
        let mut simulation = simulate(factory, &scene, &awake());
        launch(&mut simulation, 1, DVec3::new(0.01, 0.0, 0.0), DVec3::new(0.0, 0.01 / R, 0.0));
        run(&mut simulation, 1.0);
        assert_eq!(pairs(&simulation), [(1, 2)], "{}: {:?}", factory.engine(), simulation.contacts());
    }
}
