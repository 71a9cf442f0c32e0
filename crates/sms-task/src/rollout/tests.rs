use super::*;
use crate::{Billiards, Selector, Task};
use glamx::DPose3;
use sms_core::{Mesh, sphere_mass_properties};
use sms_scene::{Body, SCENE_VERSION, example_material, floor_body};
use sms_sim::RapierFactory;

fn ball(name: &str, x: f64) -> Body {
    let radius = 0.03;
    Body {
        name: name.into(),
        label: 1,
        description: String::new(),
        kind: BodyKind::Dynamic,
        x_wb: DPose3::from_translation(DVec3::new(x, 0.0, radius)),
        shape: BodyShape::Sphere { radius },
        visual: Mesh::default(),
        texture: None,
        mass: Some(sphere_mass_properties(DVec3::ZERO, radius, 1500.0).unwrap()),
        material: example_material(),
        color: [200, 0, 0],
        observed_share: 1.0,
        fit_se_m: 0.0,
    }
}

fn scene(others: impl IntoIterator<Item = Body>) -> Scene {
    let bodies = [floor_body(0.0, example_material()), ball("cue", 0.3), ball("blue", 0.6)];
    Scene {
        version: SCENE_VERSION,
        name: "two balls".into(),
        gravity_w: DVec3::new(0.0, 0.0, -9.81),
        size_sigma: 0.0,
        x_world_recording: DPose3::identity(),
        bodies: bodies.into_iter().chain(others).collect(),
    }
}

fn task(scene: &Scene) -> ResolvedTask {
    let task = Billiards::new(Selector::by_name("cue"), Selector::by_name("blue"), [0.8, 0.0]);
    Task::Billiards(task).resolve(scene).unwrap()
}

#[test]
fn a_ball_deep_inside_of_a_box_is_an_invalid_rollout() {
    let stuck = Body {
        name: "box".into(),
        kind: BodyKind::Static,
        x_wb: DPose3::from_translation(DVec3::new(0.6, 0.0, 0.05)),
        shape: BodyShape::Box { half_extents: DVec3::splat(0.05) },
        mass: None,
        ..ball("box", 0.6)
    };
    let scene = scene([stuck]);
    let task = task(&scene);
    let bodies = task.bodies_in(&scene, "blue").unwrap();
    let mut simulation = Simulation::new(&RapierFactory, &scene, &task.world_options()).unwrap();
    let motion = task.strike(&crate::Action(vec![0.5, 0.0, 0.0, 0.0]));
    let error = task.rollout(&mut simulation, motion, &bodies, None).unwrap_err();
    assert!(error.is_invalid_rollout(), "{error}");
    assert!(
        matches!(&error, SimError::Unphysical { why: PhysicsViolation::Inside { body, other, .. }, .. }
            if body == "blue" && other == "box"),
        "{error}"
    );
}

/// A strike that passed the checks up to `duration_s`, in a world of two balls.
fn checked_strike(duration_s: f64) -> (Simulation, WorldBodies, RolloutChecks, f64) {
    let scene = scene([]);
    let task = task(&scene);
    let bodies = task.bodies_in(&scene, "blue").unwrap();
    let options = task.world_options();
    let mut simulation = Simulation::new(&RapierFactory, &scene, &options).unwrap();
    let motion = task.strike(&crate::Action(vec![0.8, 0.0, 0.0, 0.0]));
    let mut checks = checks_of(&simulation, &bodies, motion.speed);
    checks.striker = simulation.strike(motion, 0.6, 0.7);
    let mut time_s = 0.0;
    while time_s < duration_s {
        simulation.advance(options.dt).unwrap();
        time_s += options.dt;
        checks.check(time_s, &simulation, &bodies).unwrap();
    }
    (simulation, bodies, checks, time_s)
}

#[test]
fn energy_from_nowhere_is_noticed_and_that_of_the_strike_is_not() {
    let (mut simulation, bodies, mut checks, time_s) = checked_strike(1.5);
    assert!(simulation.is_strike_over());
    let mut state = simulation.state(bodies.target);
    state.v_w += DVec3::new(0.0, 3.0, 0.0);
    simulation.set_state(bodies.target, &state);
    let error = checks.check(time_s, &simulation, &bodies).unwrap_err();
    assert!(
        matches!(&error, SimError::Unphysical { why: PhysicsViolation::Gained { body, .. }, .. } if body == "blue"),
        "{error}"
    );
    assert!(error.failure_reason().unwrap().contains("`blue`"));
}

fn checks_of(simulation: &Simulation, bodies: &WorldBodies, finger_speed: f64) -> RolloutChecks {
    let (rest, start) = (bodies.energy(simulation)[0], simulation.states().to_vec());
    RolloutChecks { left: None, rest, striker: start.len(), start, finger_speed }
}

#[test]
fn more_energy_than_the_finger_can_give_is_noticed_during_the_sweep() {
    let (mut simulation, bodies, mut checks, time_s) = checked_strike(0.3);
    assert!(!simulation.is_strike_over());
    let mut state = simulation.state(bodies.target);
    // Away from other bodies: only the energy is wrong.
    state.v_w += DVec3::new(0.0, 0.0, 5.0);
    simulation.set_state(bodies.target, &state);
    let error = checks.check(time_s, &simulation, &bodies).unwrap_err();
    assert!(
        matches!(&error, SimError::Unphysical { why: PhysicsViolation::MoreThanGiven { body, .. }, .. } if body == "blue"),
        "{error}"
    );
    assert!(error.failure_reason().unwrap().contains("`blue`"));
}

fn block(name: &str, kind: BodyKind, center_w: DVec3, half: DVec3) -> Body {
    Body {
        name: name.into(),
        kind,
        x_wb: DPose3::from_translation(center_w),
        shape: BodyShape::Hulls { hulls: vec![Mesh::cuboid(half)] },
        ..ball(name, 0.0)
    }
}

#[test]
fn a_body_that_sinks_into_the_floor_a_hull_or_a_mesh_is_noticed() {
    let cube = DVec3::splat(0.03);
    let crate_ = block("crate", BodyKind::Dynamic, DVec3::new(0.9, 0.0, 0.03), cube);
    // At the height of the plate, and beside it.
    let plate = DVec3::new(0.2, 0.2, 0.04);
    let post = Body { mass: None, ..block("post", BodyKind::Static, DVec3::new(0.9, 0.6, 0.04), plate) };
    let mesh = BodyShape::TriMesh { mesh: Mesh::cuboid(plate) };
    let shell = Body {
        name: "shell".into(),
        shape: mesh,
        x_wb: DPose3::from_translation(DVec3::new(0.9, -0.6, 0.04)),
        ..post.clone()
    };
    let scene = scene([crate_, post, shell]);
    let task = task(&scene);
    let bodies = task.bodies_in(&scene, "blue").unwrap();
    let mut simulation = Simulation::new(&RapierFactory, &scene, &task.world_options()).unwrap();
    let mut checks = checks_of(&simulation, &bodies, 0.5);
    let id = scene.bodies.iter().position(|b| b.name == "crate").unwrap();
    let at = |p: DVec3| BodyState { x_wb: DPose3::from_translation(p), v_w: DVec3::ZERO, w_w: DVec3::ZERO };
    let fine = [DVec3::new(0.9, 0.0, 0.025), DVec3::new(0.9, 0.375, 0.03), DVec3::new(0.9, -0.375, 0.03)];
    for (k, good) in fine.into_iter().enumerate() {
        simulation.set_state(id, &at(good));
        checks.check(0.1, &simulation, &bodies).unwrap();
        // 20 mm deeper.
        let into = [DVec3::NEG_Z, DVec3::Y, DVec3::NEG_Y][k];
        simulation.set_state(id, &at(good + 0.02 * into));
        let error = checks.check(0.1, &simulation, &bodies).unwrap_err();
        let expected = ["floor", "post", "shell"][k];
        let SimError::Unphysical { why: PhysicsViolation::Inside { body, other, depth_m }, .. } = &error
        else {
            panic!("{k}: {error}");
        };
        assert_eq!((body.as_str(), other.as_str()), ("crate", expected));
        // The crate's top is 20 mm below the top of the post, nearer than the post's side.
        let expected_m = [0.025, 0.02, 0.025][k];
        assert!((depth_m - expected_m).abs() < 1e-6, "{k}: {depth_m}");
        let reason = error.failure_reason().unwrap();
        assert!(reason.contains("`crate`") && reason.contains(&format!("`{expected}`")), "{reason}");
    }
    // An overlap from the start is accepted.
    simulation.set_state(id, &at(fine[0] - DVec3::Z * 0.02));
    let mut checks = checks_of(&simulation, &bodies, 0.5);
    checks.check(0.1, &simulation, &bodies).unwrap();
}
