//! The target engines behind the `World` trait: finger, inertia, rest, sleep, snapshots and refused scenes, which the
//! closed-form suite does not cover.
#![cfg(any(feature = "physx", feature = "mujoco"))]

use crate::common::{
    DT, G, R, awake, ball, cuboid, floor, launch, material, mesh_box, run, scene, simulate, worst,
};
use glamx::{DMat3, DPose3, DQuat, DVec3};
use sms_core::{
    MassProperties, Mesh, box_mass_properties, cylinder_mass_properties, polyhedron_mass_properties,
};
use sms_scene::{Body, BodyKind, BodyShape, Scene, floor_body};
use sms_sim::{Simulation, StrikerMotion, WorldFactory, WorldOptions};
use sms_synth::FIXED_SCENES;
use sms_target::{TargetEngine, scene_from_truth};

/// Returns all engines other than Rapier that are available.
fn engines() -> Vec<(TargetEngine, Box<dyn WorldFactory>)> {
    let others = TargetEngine::ALL.into_iter().filter(|e| *e != TargetEngine::Rapier && e.is_built_in());
    others
        .filter_map(|engine| match engine.factory() {
            Ok(factory) => Some((engine, factory)),
            Err(e) => {
                println!("skipped {}: {e}", engine.name());
                None
            }
        })
        .collect()
}

/// Returns the relative error of the speed and the error of the direction, degrees, of a ball struck by the finger.
fn strike_error(factory: &dyn WorldFactory, speed: f64, angle: f64, offset: f64) -> (f64, f64) {
    let e = 0.5 * (0.75 + 0.9);
    let center = DVec3::new(0.4, 0.1, R);
    let bodies = vec![floor(material(0.0, 0.0, 0.0)), ball("cue", center, material(0.0, 0.9, 0.0))];
    let mut simulation = simulate(factory, &scene(G, bodies), &awake());
    let across = DVec3::new(-angle.sin(), angle.cos(), 0.0);
    let motion = StrikerMotion { contact_w: center + offset * across, angle, speed, ball_radius: R };
    let striker = simulation.strike(motion, 0.0, 0.75);
    run(&mut simulation, motion.contact_s() + 0.02);
    let v = simulation.state(1).v_w;
    let direction = (v.y.atan2(v.x) - angle).to_degrees();
    run(&mut simulation, motion.duration_s());
    assert!(simulation.is_strike_over());
    assert!(simulation.state(striker).x_wb.translation.z > 0.2, "the finger must be lifted");
    (v.x.hypot(v.y) / ((1.0 + e) * speed) - 1.0, direction)
}

#[test]
fn the_finger_gives_the_ball_one_plus_e_times_its_speed() {
    for (engine, factory) in engines() {
        let (mut speeds, mut directions) = (Vec::new(), Vec::new());
        for speed in [0.2, 0.5, 0.85] {
            for angle in [-2.0, 0.4] {
                for offset in [0.0, 0.004] {
                    let (s, d) = strike_error(&*factory, speed, angle, offset);
                    speeds.push(s);
                    directions.push(d);
                }
            }
        }
        let (speed, direction) = (worst(&speeds), worst(&directions));
        println!("{}: strike: speed {speed:.5}, direction {direction:.4}°", factory.engine());
        let (most_speed, most_direction) = match engine {
            TargetEngine::Physx => (3e-3, 0.02),
            // MuJoCo has soft contacts; the PhysX defaults take whole steps.
            _ => (0.1, 0.5),
        };
        assert!(speed < most_speed && direction < most_direction, "{}: {speeds:?}", factory.engine());
    }
}

/// Solvers batch contacts of one kind in groups of four; a shot must not depend on simultaneous other shots.
#[test]
fn shots_at_the_same_time_do_not_disturb_each_other() {
    let (e, mu, speed, gap) = (0.9, 0.1, 0.8, 0.02);
    for (engine, factory) in engines() {
        if engine != TargetEngine::Physx {
            continue;
        }
        for count in [1, 4, 8] {
            let mut bodies = Vec::new();
            let cut = 0.7f64;
            let line = DVec3::new(cut.cos(), -cut.sin(), 0.0);
            for k in 0..count {
                let target = DVec3::new(0.0, 0.3 * f64::from(k), 0.0);
                let start = target - 2.0 * R * line - DVec3::X * gap;
                bodies.push(ball(&format!("cue{k}"), start, material(mu, e, 0.0)));
                bodies.push(ball(&format!("target{k}"), target, material(mu, e, 0.0)));
            }
            let mut simulation = simulate(&*factory, &scene(0.0, bodies), &awake());
            let (v_w, w_w) = (DVec3::X * speed, DVec3::Y * (speed / R));
            for k in 0..count as usize {
                launch(&mut simulation, 2 * k, v_w, w_w);
            }
            run(&mut simulation, gap / speed + 0.1);
            let slip = v_w + w_w.cross(R * line) - line * v_w.dot(line);
            let normal = 0.5 * (1.0 + e) * speed * cut.cos();
            let expected = normal * line + (mu * normal).min(slip.length() / 7.0) * slip.normalize();
            for k in 0..count as usize {
                let off = simulation.state(2 * k + 1).v_w.angle_between(expected).to_degrees();
                assert!(off < 0.1, "{}: shot {k} of {count} is off by {off}°", factory.engine());
            }
        }
    }
}

/// A torque about a skew axis accelerates a skew body by its inertia: the whole tensor reaches the engine.
#[test]
fn the_whole_inertia_tensor_counts() {
    let skew = DPose3::from_parts(DVec3::ZERO, DQuat::from_scaled_axis(DVec3::new(0.4, -0.7, 0.3)));
    let mesh = Mesh::cuboid(DVec3::new(0.01, 0.02, 0.05)).transformed(&skew);
    let mass = polyhedron_mass_properties(&mesh, 900.0).unwrap();
    let mut body = cuboid("skew", DPose3::IDENTITY, DVec3::ONE, BodyKind::Dynamic, material(0.0, 0.0, 0.0));
    body.mass = Some(MassProperties::new(mass.mass(), DVec3::ZERO, mass.inertia()).unwrap());
    body.shape = BodyShape::Hulls { hulls: vec![mesh] };
    let (force, torque) = (DVec3::new(0.0, 0.02, 0.0), DVec3::new(2e-5, 1e-5, -3e-5));
    let inverse: DMat3 = mass.inertia().inverse();
    for (_, factory) in engines() {
        let mut simulation = simulate(&*factory, &scene(0.0, vec![body.clone()]), &awake());
        simulation.apply_wrench(0, force, torque);
        simulation.advance(DT).unwrap();
        let s = simulation.state(0);
        let name = factory.engine();
        assert!((s.w_w - inverse * torque * DT).length() < 1e-3 * s.w_w.length(), "{name}: {}", s.w_w);
        assert!((s.v_w - force * (DT / mass.mass())).length() < 1e-5 * s.v_w.length(), "{name}: {}", s.v_w);
        let before = s.v_w;
        simulation.advance(DT).unwrap();
        assert!((simulation.state(0).v_w - before).length() < 1e-9, "{name}: a wrench must act for one step");
    }
}

/// A centre of mass off the frame's origin falls freely, and the state is that of the centre.
#[test]
fn a_centre_of_mass_off_the_origin_is_where_a_force_acts() {
    let com = DVec3::new(0.01, -0.02, 0.015);
    let mut body =
        cuboid("lopsided", DPose3::IDENTITY, DVec3::splat(0.05), BodyKind::Dynamic, material(0.0, 0.0, 0.0));
    let inertia = body.mass.unwrap().inertia();
    body.mass = Some(MassProperties::new(0.4, com, inertia).unwrap());
    for (engine, factory) in engines() {
        if engine == TargetEngine::PhysxStock {
            continue;
        }
        let mut simulation = simulate(&*factory, &scene(0.0, vec![body.clone()]), &awake());
        launch(&mut simulation, 0, DVec3::ZERO, DVec3::new(0.0, 0.0, 3.0));
        run(&mut simulation, 0.5);
        let s = simulation.state(0);
        assert!((s.x_wb.transform_point(com) - com).length() < 2e-5, "{}: it drifts", factory.engine());
        assert!(s.v_w.length() < 1e-4, "{}: {}", factory.engine(), s.v_w);
        simulation.apply_wrench(0, DVec3::X * 0.1, DVec3::ZERO);
        simulation.advance(DT).unwrap();
        let s = simulation.state(0);
        assert!((s.v_w.x / (0.1 * DT / 0.4) - 1.0).abs() < 0.1, "{}: {}", factory.engine(), s.v_w);
        assert!((s.w_w.z - 3.0).abs() < 1e-2, "{}: a central force must not turn it", factory.engine());
    }
}

fn busy_scene() -> Scene {
    let surface = || material(0.4, 0.6, 1e-4);
    let mut bodies = vec![
        floor(surface()),
        ball("cue", DVec3::new(0.0, 0.0, R), surface()),
        ball("target", DVec3::new(0.25, 0.02, R), surface()),
    ];
    for k in 0..4 {
        let x_wb = DPose3::from_translation(DVec3::new(0.5, -0.15 + 0.1 * f64::from(k), 0.05));
        let half = DVec3::new(0.02, 0.03, 0.05);
        bodies.push(cuboid(&format!("box{k}"), x_wb, half, BodyKind::Dynamic, surface()));
    }
    scene(G, bodies)
}

fn strike(simulation: &mut Simulation, speed: f64) {
    let contact_w = DVec3::new(0.0, 0.0, R);
    simulation.strike(StrikerMotion { contact_w, angle: 0.05, speed, ball_radius: R }, 0.6, 0.7);
}

#[test]
fn restoring_a_snapshot_repeats_every_bit() {
    for (_, factory) in engines() {
        let options = WorldOptions { dt: DT, ..WorldOptions::default() };
        let mut simulation = simulate(&*factory, &busy_scene(), &options);
        assert!(!simulation.restore(), "no state was saved yet");
        assert!(simulation.save());
        let mut rollout = |speed: f64| {
            assert!(simulation.restore());
            strike(&mut simulation, speed);
            run(&mut simulation, 1.5);
            simulation.states().to_vec()
        };
        let first = rollout(0.7);
        let other = rollout(0.3);
        assert_eq!(first, rollout(0.7), "{}", factory.engine());
        assert_ne!(first, other);
        assert!(first[2].x_wb.translation.x > 0.3, "{}: the target must be hit", factory.engine());
        // A fresh world and a restored one are bitwise equal.
        let mut fresh = simulate(&*factory, &busy_scene(), &options);
        strike(&mut fresh, 0.7);
        run(&mut fresh, 1.5);
        assert_eq!(first[2], fresh.state(2), "{}", factory.engine());
    }
}

/// A snapshot of a moving scene continues the motion.
#[test]
fn a_snapshot_holds_what_moves() {
    for (_, factory) in engines() {
        let mut simulation = simulate(&*factory, &busy_scene(), &awake());
        launch(&mut simulation, 1, DVec3::new(0.5, 0.0, 0.0), DVec3::new(0.0, 0.5 / R, 0.0));
        run(&mut simulation, 0.2);
        let before = simulation.state(1);
        assert!(simulation.save());
        run(&mut simulation, 0.3);
        assert!(simulation.restore());
        assert_eq!(simulation.state(1), before, "{}", factory.engine());
        run(&mut simulation, 0.05);
        let moved = simulation.state(1).x_wb.translation.x - before.x_wb.translation.x;
        assert!((moved / (0.05 * before.v_w.x) - 1.0).abs() < 0.02, "{}: {moved}", factory.engine());
    }
}

#[test]
fn what_rests_falls_asleep_and_what_is_hit_wakes() {
    for (_, factory) in engines() {
        let options = WorldOptions { dt: DT, ..WorldOptions::default() };
        let mut simulation = simulate(&*factory, &busy_scene(), &options);
        run(&mut simulation, 1.0);
        assert!((0..7).all(|b| simulation.is_asleep(b)), "{}", factory.engine());
        launch(&mut simulation, 1, DVec3::new(0.8, 0.0, 0.0), DVec3::new(0.0, 0.8 / R, 0.0));
        assert!(!simulation.is_asleep(1));
        run(&mut simulation, 0.3);
        assert!(!simulation.is_asleep(2), "{}: the target must be hit", factory.engine());
        assert!(simulation.state(2).v_w.length() > 0.1);
    }
}

/// A slow ball is not put to sleep before its rolling resistance stops it.
#[test]
fn a_slow_ball_rolls_to_its_end() {
    let lever = 1e-4;
    let (v0, a) = (0.02, 5.0 / 7.0 * G * lever / R);
    let surface = || material(0.3, 0.0, lever);
    let bodies = vec![floor(surface()), ball("b", DVec3::new(0.0, 0.0, R), surface())];
    for (engine, factory) in engines() {
        // The defaults of PhysX put it to sleep.
        if engine == TargetEngine::PhysxStock {
            continue;
        }
        let options = WorldOptions { dt: DT, ..WorldOptions::default() };
        let mut simulation = simulate(&*factory, &scene(G, bodies.clone()), &options);
        launch(&mut simulation, 1, DVec3::new(v0, 0.0, 0.0), DVec3::new(0.0, v0 / R, 0.0));
        run(&mut simulation, 3.0);
        let travel = simulation.state(1).x_wb.translation.x;
        println!("{}: {travel:.5} m of {:.5}", factory.engine(), v0 * v0 / (2.0 * a));
        assert!((travel - v0 * v0 / (2.0 * a)).abs() < 3e-4, "{}: {travel}", factory.engine());
    }
}

#[test]
fn bodies_that_cannot_be_simulated_are_refused_by_name() {
    for (_, factory) in engines() {
        let flat = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
        let mut bad =
            cuboid("flat", DPose3::IDENTITY, DVec3::ONE, BodyKind::Dynamic, material(0.1, 0.1, 0.0));
        bad.shape = BodyShape::Hulls { hulls: vec![Mesh::new(flat, vec![[0, 1, 2]])] };
        let error = Simulation::new(&*factory, &scene(G, vec![bad.clone()]), &awake()).unwrap_err();
        assert!(error.to_string().contains("flat"), "{error}");
        bad.shape = BodyShape::Sphere { radius: R };
        bad.mass = None;
        let error = Simulation::new(&*factory, &scene(G, vec![bad]), &awake()).unwrap_err();
        assert!(error.to_string().contains("no mass"), "{error}");
    }
}

#[test]
fn a_state_that_is_not_finite_is_an_error_and_no_panic() {
    for (_, factory) in engines() {
        let bodies = vec![floor(material(0.3, 0.0, 0.0)), ball("b", DVec3::Z * R, material(0.3, 0.0, 0.0))];
        let mut simulation = simulate(&*factory, &scene(G, bodies), &awake());
        launch(&mut simulation, 1, DVec3::new(f64::NAN, 0.0, 0.0), DVec3::ZERO);
        let error = (0..3).find_map(|_| simulation.advance(DT).err()).expect("the error must be detected");
        assert!(error.to_string().contains("`b`"), "{error}");
    }
}

/// Exact boxes and cylinders, hulls and static meshes carry bodies that stand on them.
#[test]
fn every_shape_rests_where_it_stands() {
    let surface = || material(0.5, 0.0, 0.0);
    let solid = |name: &str, x_wb: DPose3, shape: BodyShape, mass: MassProperties| Body {
        name: name.into(),
        kind: BodyKind::Dynamic,
        x_wb,
        shape,
        mass: Some(mass),
        ..floor_body(0.0, surface())
    };
    let half = DVec3::new(0.03, 0.05, 0.02);
    let (radius, half_length) = (0.03, 0.06);
    let can = || cylinder_mass_properties(radius, half_length, 800.0).unwrap();
    let cylinder = BodyShape::Cylinder { radius, half_length };
    let on_mesh = DPose3::from_translation(DVec3::new(0.6, 0.0, 0.1 + half.z));
    let bodies = vec![
        floor(surface()),
        solid(
            "box",
            DPose3::from_translation(DVec3::Z * half.z),
            BodyShape::Box { half_extents: half },
            box_mass_properties(half, 500.0).unwrap(),
        ),
        solid("on_box", DPose3::from_translation(DVec3::Z * (2.0 * half.z + half_length)), cylinder, can()),
        mesh_box(
            "mesh",
            DPose3::from_translation(DVec3::new(0.6, 0.0, 0.05)),
            DVec3::new(0.1, 0.1, 0.05),
            surface(),
        ),
        cuboid("on_mesh", on_mesh, half, BodyKind::Dynamic, surface()),
    ];
    let scene = scene(G, bodies);
    for (engine, factory) in engines() {
        let mut simulation = simulate(&*factory, &scene, &awake());
        run(&mut simulation, 1.0);
        for (i, body) in scene.bodies.iter().enumerate() {
            let x_wb = simulation.state(i).x_wb;
            let drift = x_wb.translation.distance(body.x_wb.translation);
            let turn = x_wb.rotation.angle_between(body.x_wb.rotation);
            println!("{}: {} moved {drift:.1e} m, {turn:.1e} rad", factory.engine(), body.name);
            let most = if engine == TargetEngine::PhysxStock { 2e-3 } else { 5e-4 };
            assert!(drift < most && turn < 5e-3, "{}: {} {drift} m", factory.engine(), body.name);
        }
    }
}

/// Statues and bottles of many parts stand on many contacts and tremble, but must sleep.
#[test]
fn objects_of_many_parts_fall_asleep_in_place() {
    let truth = FIXED_SCENES.iter().find(|s| s.number == 8).unwrap().generate();
    let scene = scene_from_truth(&truth).unwrap();
    // With PhysX's defaults they tremble.
    for (_, factory) in engines().into_iter().filter(|e| e.0 != TargetEngine::PhysxStock) {
        let mut simulation = simulate(&*factory, &scene, &WorldOptions { dt: DT, ..WorldOptions::default() });
        run(&mut simulation, 0.4);
        for (i, body) in scene.bodies.iter().enumerate() {
            assert!(simulation.is_asleep(i), "{}: {} is awake", factory.engine(), body.name);
            let moved = simulation.state(i).x_wb.translation.distance(body.x_wb.translation);
            assert!(moved < 5e-5, "{}: {} moved by {moved} m", factory.engine(), body.name);
        }
    }
}

/// Sleeping bodies are not in MuJoCo's model, but wake before another body touches them.
#[test]
fn a_shot_among_sleepers_is_the_shot_among_what_is_awake() {
    let Some((_, factory)) = engines().into_iter().find(|e| e.0 == TargetEngine::Mujoco) else { return };
    let surface = || material(0.3, 0.3, 1e-3);
    let block = |name: &str, x: f64, y: f64, z: f64| {
        let x_wb = DPose3::from_translation(DVec3::new(x, y, z));
        cuboid(name, x_wb, DVec3::splat(0.03), BodyKind::Dynamic, surface())
    };
    let scene = scene(
        G,
        vec![
            floor(surface()),
            ball("cue", DVec3::new(0.0, 0.0, R), surface()),
            ball("struck", DVec3::new(0.2, 0.0, R), surface()),
            block("below", 0.4, 0.01, 0.03),
            block("on top", 0.4, 0.01, 0.09),
            block("beside", 0.4, 0.071, 0.03),
            block("far", -0.3, 0.4, 0.03),
        ],
    );
    let shoot = |sleep: bool| {
        let mut simulation = simulate(&*factory, &scene, &WorldOptions { sleep, ..awake() });
        run(&mut simulation, 0.25);
        assert_eq!((1..7).all(|b| simulation.is_asleep(b)), sleep);
        launch(&mut simulation, 1, DVec3::new(0.8, 0.0, 0.0), DVec3::new(0.0, 0.8 / R, 0.0));
        run(&mut simulation, 0.4);
        assert_eq!(simulation.is_asleep(6), sleep, "no body comes near it");
        assert!(!simulation.is_asleep(2));
        run(&mut simulation, 2.2);
        assert_eq!((1..7).all(|b| simulation.is_asleep(b)), sleep, "all bodies must rest again");
        (1..7).map(|b| simulation.state(b).x_wb.translation).collect::<Vec<_>>()
    };
    let (sleepers, others) = (shoot(true), shoot(false));
    for (body, (a, b)) in scene.bodies[1..].iter().zip(sleepers.iter().zip(&others)) {
        println!("{}: {:.1e} m apart", body.name, a.distance(*b));
        // A nanometre changes the short step in which MuJoCo begins an impact, which changes the rebound by some
        // percent.
        assert!(a.distance(*b) < 5e-3, "{}: {a} and {b}", body.name);
    }
    let pushed_m = others[2].distance(scene.bodies[3].x_wb.translation);
    assert!(pushed_m > 1e-3, "the lower block must be pushed: {pushed_m} m");
}

/// A slab a milliradian beyond its balance is as slow as a body at rest, but falls.
#[test]
fn what_falls_slowly_does_not_fall_asleep() {
    let half = DVec3::new(0.01, 0.02, 0.05);
    let lean = (half.x / half.z).atan() + 1e-3;
    // Its lower edge along y is at the origin.
    let turn = DQuat::from_rotation_y(lean);
    let x_wb = DPose3::from_parts(turn * DVec3::new(-half.x, 0.0, half.z), turn);
    let surface = || material(0.8, 0.0, 0.0);
    let bodies = vec![floor(surface()), cuboid("slab", x_wb, half, BodyKind::Dynamic, surface())];
    for (engine, factory) in engines() {
        // With PhysX's defaults it may fall asleep.
        if engine == TargetEngine::PhysxStock {
            continue;
        }
        let options = WorldOptions { dt: DT, ..WorldOptions::default() };
        let mut simulation = simulate(&*factory, &scene(G, bodies.clone()), &options);
        run(&mut simulation, 1.5);
        let low = simulation.state(1).x_wb.translation.z;
        assert!((low - half.x).abs() < 1e-3, "{}: it is at {low} m", factory.engine());
    }
}

/// PhysX's contact cache kept "no contacts" for a pair with overlapping bounds until a body had moved by 10 mm.
#[test]
fn what_came_near_without_a_touch_is_caught_when_it_touches() {
    // The axis-aligned bounds of a body rotated by 45° are larger than the body: the pair exists long before the
    // contact.
    let turn = DQuat::from_rotation_y(std::f64::consts::FRAC_PI_4);
    let surface = || material(0.3, 0.0, 0.0);
    let round = Mesh::icosphere(0.04, 1);
    let lowest = round.vertices.iter().map(|&v| (turn * v).z).fold(f64::INFINITY, f64::min);
    let gap = 0.003;
    let x_wb = |x: f64, z: f64| DPose3::from_parts(DVec3::new(x, 0.0, z), turn);
    let hull = Body {
        mass: Some(polyhedron_mass_properties(&round, 500.0).unwrap()),
        shape: BodyShape::Hulls { hulls: vec![round] },
        ..cuboid("hull", x_wb(0.0, gap - lowest), DVec3::ONE, BodyKind::Dynamic, surface())
    };
    let half = DVec3::new(0.05, 0.1, 0.02);
    // The ball is above the slope and will touch its middle.
    let over = turn * DVec3::Z * (half.z + R) + DVec3::Z * (0.1 + gap);
    let bodies = vec![
        floor(surface()),
        hull,
        cuboid("slope", x_wb(0.5, 0.1), half, BodyKind::Static, surface()),
        ball("ball", over + DVec3::X * 0.5, surface()),
    ];
    for (engine, factory) in engines() {
        // PhysX's defaults let all bodies sink in; MuJoCo's contacts are soft.
        if engine != TargetEngine::Physx {
            continue;
        }
        let mut simulation = simulate(&*factory, &scene(G, bodies.clone()), &awake());
        let [mut hull_m, mut ball_m] = [0.0f64; 2];
        let mut has_touched = false;
        while simulation.time_s() < 0.1 {
            run(&mut simulation, DT);
            hull_m = hull_m.max(simulation.penetration_at(1, simulation.states()));
            ball_m = ball_m.max(simulation.penetration_at(3, simulation.states()));
            has_touched |= simulation.state(3).v_w.x > 0.05;
        }
        println!("{}: hull {:.3} mm, ball {:.3} mm deep", factory.engine(), 1e3 * hull_m, 1e3 * ball_m);
        assert!(has_touched, "the slope must turn the ball");
        assert!(hull_m < 2e-4 && ball_m < 2e-4, "{}: hull {hull_m}, ball {ball_m}", factory.engine());
    }
}
