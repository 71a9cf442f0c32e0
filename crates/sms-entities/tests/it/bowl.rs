//! Dishes: a ball dropped into a scanned bowl stays in it.

use crate::common::{Observation, observe, round_bowl};
use sms_core::glamx::{DPose3, DVec3};
use sms_core::{Cancel, Seed, StageContext, Warnings, sphere_mass_properties};
use sms_entities::{EntitiesConfig, build_entities};
use sms_scene::{Body, BodyKind, BodyShape, build_scene, example_material, floor_body};
use sms_sim::{RapierF64Factory, RapierFactory, Simulation, WorldFactory, WorldOptions};

#[test]
fn a_ball_dropped_into_a_scanned_bowl_stays_in_it() {
    let (outer, height, wall, r) = (0.08, 0.05, 0.007, 0.012);
    let objects = [round_bowl(DVec3::ZERO, outer, height, wall)];
    let fixture = observe(&objects, &[], &Observation { frames: 16, ..Default::default() }, 11);
    let set = build_entities(
        &fixture.model,
        &fixture.sequence,
        &fixture.labels,
        &EntitiesConfig::default(),
        StageContext::quiet(&Cancel::new(), &Warnings::new()).with_seed(Seed(1)),
    )
    .unwrap();
    let support = set.support_height.zip(Some(example_material()));
    let materials = vec![example_material(); set.entities.len()];
    let mut scene = build_scene("bowl", &set.entities, &materials, support, DPose3::IDENTITY).unwrap();
    let bowl = scene.bodies.iter().position(|b| b.kind == BodyKind::Dynamic).unwrap();
    println!(
        "{} parts",
        match &scene.bodies[bowl].shape {
            BodyShape::Hulls { hulls } => hulls.len(),
            _ => 0,
        }
    );
    let bottom = scene.bodies[bowl].x_wb.translation.with_z(0.0);
    // From five places above the slope of the wall.
    for (turn, out) in [(0.3, 0.045), (1.7, 0.04), (2.9, 0.05), (4.1, 0.03), (5.5, 0.05)] {
        let start = bottom + DVec3::new(out * f64::cos(turn), out * f64::sin(turn), height + 2.0 * r);
        let ball = Body {
            name: "ball".into(),
            kind: BodyKind::Dynamic,
            x_wb: DPose3::from_translation(start),
            shape: BodyShape::Sphere { radius: r },
            mass: Some(sphere_mass_properties(DVec3::ZERO, r, 2500.0).unwrap()),
            ..floor_body(0.0, example_material())
        };
        scene.bodies.push(ball);
        let engines: [&dyn WorldFactory; 2] = [&RapierFactory, &RapierF64Factory];
        for engine in engines {
            let mut simulation = Simulation::new(engine, &scene, &WorldOptions::default()).unwrap();
            for _ in 0..2400 {
                simulation.advance(0.0025).unwrap();
            }
            let (ball, dish) = (simulation.state(scene.bodies.len() - 1), simulation.state(bowl));
            let moved = dish.x_wb.translation.distance(scene.bodies[bowl].x_wb.translation);
            let p = ball.x_wb.translation - dish.x_wb.translation.with_z(0.0);
            println!(
                "{}: {:.1} mm from the middle, {:.1} mm high, {:.4} m/s, the bowl moved {:.2} mm",
                engine.engine(),
                1e3 * p.truncate().length(),
                1e3 * p.z,
                ball.v_w.length(),
                1e3 * moved
            );
            // The ball lies in the bowl: inside the rim, on the bottom and not on the floor below, and the bowl does
            // not tip. (Sixteen parts are too few for the exact centre.)
            assert!(p.truncate().length() < 0.03, "{}: {p}", engine.engine());
            assert!(p.z - r > 0.001 && p.z - r < 0.02, "{}: {p}", engine.engine());
            let tilt = (dish.x_wb.rotation * DVec3::Z).angle_between(DVec3::Z);
            assert!(ball.v_w.length() < 0.01 && moved < 0.005 && tilt < 0.01, "{}: {tilt}", engine.engine());
        }
        scene.bodies.pop();
    }
}
