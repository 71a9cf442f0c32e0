//! Sliding, rolling, resting, the striker and snapshots, in both precisions.

use crate::common::*;
use glamx::{DMat3, DPose3, DQuat, DVec3};
use sms_core::{
    MassProperties, Mesh, box_mass_properties, cylinder_mass_properties, polyhedron_mass_properties,
};
use sms_mesh::convex_hull;
use sms_scene::{Body, BodyKind, BodyShape, floor_body};
use sms_sim::{
    BodyState, LoadRamp, LoadTest, RestLimits, SimError, StrikerMotion, WorldFactory, WorldOptions,
    fix_restless, ramp_load_n, resting_drift, tipping_load_n,
};

fn floor_and_ball(mu: f64, rolling_m: f64) -> sms_scene::Scene {
    scene(
        G,
        vec![
            floor(material(mu, 0.0, rolling_m)),
            ball("b", DVec3::new(0.0, 0.0, R), material(mu, 0.0, rolling_m)),
        ],
    )
}

#[test]
fn without_rolling_resistance_a_ball_rolls_on() {
    for factory in factories() {
        let mut simulation = simulate(factory, &floor_and_ball(0.3, 0.0), &awake());
        launch(&mut simulation, 1, DVec3::new(0.5, 0.0, 0.0), DVec3::new(0.0, 0.5 / R, 0.0));
        run(&mut simulation, 4.0);
        let p = simulation.state(1).x_wb.translation;
        println!("{}: {:.6} m of 2, height {:.1e}", factory.engine(), p.x, p.z - R);
        assert!((p.x / 2.0 - 1.0).abs() < 1e-3 && p.y.abs() < 1e-4, "{}: {p}", factory.engine());
    }
}

/// A stack of two boxes, and a ball nearby that keeps bouncing, so that most steps are split.
#[test]
fn a_stack_rests_under_split_steps() {
    for factory in factories() {
        let surface = || material(0.5, 0.2, 0.0);
        let half = DVec3::new(0.04, 0.04, 0.03);
        let at = |z| DPose3::from_translation(DVec3::new(0.0, 0.0, z));
        let mut bodies = vec![
            floor(surface()),
            cuboid("lower", at(0.03), half, BodyKind::Dynamic, surface()),
            cuboid("upper", at(0.09), half, BodyKind::Dynamic, surface()),
        ];
        let slab = DPose3::from_translation(DVec3::new(0.5, 0.0, 0.05));
        bodies.push(cuboid(
            "slab",
            slab,
            DVec3::new(0.1, 0.1, 0.05),
            BodyKind::Static,
            material(0.0, 1.0, 0.0),
        ));
        for (k, x) in [0.44, 0.56].into_iter().enumerate() {
            let start = DVec3::new(x, 0.0, 0.1 + R + 0.002 + 0.001 * k as f64);
            bodies.push(ball(&format!("ball{k}"), start, material(0.0, 1.0, 0.0)));
        }
        let mut simulation = simulate(factory, &scene(G, bodies), &awake());
        run(&mut simulation, 4.0);
        let (lower, upper) = (simulation.state(1), simulation.state(2));
        let drift = |s: &BodyState, z: f64| (s.x_wb.translation - DVec3::new(0.0, 0.0, z)).length();
        let turned = upper.x_wb.rotation.angle_between(DQuat::IDENTITY);
        println!(
            "{}: {} splits in 1600 steps, lower {:.1e} m, upper {:.1e} m, {turned:.1e} rad",
            factory.engine(),
            simulation.split_count(),
            drift(&lower, 0.03),
            drift(&upper, 0.09)
        );
        assert!(simulation.split_count() > 100, "{} splits", simulation.split_count());
        // Rapier's boxes creep sideways by some 25 µm per second, with or without split steps.
        assert!(drift(&lower, 0.03) < 3e-4 && drift(&upper, 0.09) < 3e-4);
        assert!((lower.x_wb.translation.z - 0.03).abs() < 1e-4, "the lower box sinks");
        assert!((upper.x_wb.translation.z - 0.09).abs() < 1e-4, "the upper box sinks");
        assert!(turned < 2e-3, "{turned}");
    }
}

#[test]
fn resting_drift_names_what_moves() {
    for factory in factories() {
        let half = DVec3::splat(0.03);
        let surface = || material(0.5, 0.2, 0.0);
        let at = |x: f64, z: f64| DPose3::from_translation(DVec3::new(x, 0.0, z));
        let bodies = vec![
            floor(surface()),
            cuboid("rests", at(0.0, 0.03), half, BodyKind::Dynamic, surface()),
            cuboid("falls", at(0.3, 0.05), half, BodyKind::Dynamic, surface()),
        ];
        let drift = resting_drift(factory, &scene(G, bodies), 1.0).unwrap();
        println!("{}: {drift:?}", factory.engine());
        assert_eq!(drift.iter().map(|d| d.body.as_str()).collect::<Vec<_>>(), ["rests", "falls"]);
        assert!(drift[0].moved_m < 1e-4 && drift[0].turned_rad < 1e-3);
        assert!((drift[1].moved_m - 0.02).abs() < 1e-3 && drift[1].turned_rad < 1e-2);
    }
}

/// A pole topples onto its neighbour. Only the pole is fixed, because the neighbour then rests.
#[test]
fn the_body_that_leaves_first_is_fixed_and_no_others() {
    for factory in factories() {
        let surface = || material(0.5, 0.2, 0.0);
        let at = |x: f64, z: f64| DPose3::from_translation(DVec3::new(x, 0.0, z));
        let half = DVec3::new(0.015, 0.015, 0.15);
        let angle = 0.25;
        // The pole stands on its lower edge and leans towards +x.
        let height = half.z * f64::cos(angle) + half.x * f64::sin(angle);
        let pole = DPose3::from_parts(DVec3::new(0.0, 0.0, height), DQuat::from_rotation_y(angle));
        let bodies = vec![
            floor(surface()),
            cuboid("pole", pole, half, BodyKind::Dynamic, surface()),
            cuboid("neighbour", at(0.16, 0.08), DVec3::new(0.02, 0.03, 0.08), BodyKind::Dynamic, surface()),
            cuboid("lower", at(-0.3, 0.03), DVec3::splat(0.03), BodyKind::Dynamic, surface()),
            cuboid("upper", at(-0.3, 0.09), DVec3::splat(0.03), BodyKind::Dynamic, surface()),
        ];
        let mut scene = scene(G, bodies);
        let limits = RestLimits::default();
        let before = resting_drift(factory, &scene, limits.seconds).unwrap();
        println!("{}: {before:?}", factory.engine());
        assert!(before[1].moved_m > limits.moved_m, "the pole does not reach its neighbour");
        let fixed = fix_restless(factory, &mut scene, &limits).unwrap();
        assert_eq!(fixed.iter().map(|d| d.body.as_str()).collect::<Vec<_>>(), ["pole"]);
        let kinds: Vec<BodyKind> = scene.bodies[1..].iter().map(|b| b.kind).collect();
        assert_eq!(kinds, [BodyKind::Static, BodyKind::Dynamic, BodyKind::Dynamic, BodyKind::Dynamic]);
        let after = resting_drift(factory, &scene, limits.seconds).unwrap();
        assert!(after.iter().all(|d| d.moved_m < limits.moved_m && d.turned_rad < limits.turned_rad));
    }
}

/// Ball speed after a strike relative to the closed form (1 + e)·v for a striker of infinite mass.
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
    assert!(!simulation.is_strike_over());
    run(&mut simulation, motion.duration_s());
    assert!(simulation.is_strike_over());
    assert!(simulation.state(striker).x_wb.translation.z > 0.2, "the finger is lifted");
    ((v.x.hypot(v.y)) / ((1.0 + e) * speed) - 1.0, direction)
}

#[test]
fn the_finger_gives_the_ball_one_plus_e_times_its_speed() {
    for factory in factories() {
        let (mut speeds, mut directions) = (Vec::new(), Vec::new());
        for speed in [0.2, 0.33, 0.5, 0.7, 0.85] {
            for angle in [-2.0, 0.0, 0.4] {
                for offset in [0.0, 0.004] {
                    let (s, d) = strike_error(factory, speed, angle, offset);
                    speeds.push(s);
                    directions.push(d);
                }
            }
        }
        println!(
            "{}: strike: speed {:.5}, direction {:.4}°",
            factory.engine(),
            worst(&speeds),
            worst(&directions)
        );
        assert!(worst(&speeds) < 3e-3, "{}: {speeds:?}", factory.engine());
        assert!(worst(&directions) < 0.02, "{}: {directions:?}", factory.engine());
    }
}

/// A torque about a skew axis accelerates a skew body according to its inertia: the engine uses the whole tensor.
#[test]
fn the_whole_inertia_tensor_counts() {
    let skew = DPose3::from_parts(DVec3::ZERO, DQuat::from_scaled_axis(DVec3::new(0.4, -0.7, 0.3)));
    let mesh = Mesh::cuboid(DVec3::new(0.01, 0.02, 0.05)).transformed(&skew);
    let mass = polyhedron_mass_properties(&mesh, 900.0).unwrap();
    let mut body = cuboid("skew", DPose3::IDENTITY, DVec3::ONE, BodyKind::Dynamic, material(0.0, 0.0, 0.0));
    body.mass = Some(MassProperties::new(mass.mass(), DVec3::ZERO, mass.inertia()).unwrap());
    body.shape = BodyShape::Hulls { hulls: vec![mesh] };
    let torque = DVec3::new(2e-5, 1e-5, -3e-5);
    let inverse: DMat3 = mass.inertia().inverse();
    for factory in factories() {
        let mut simulation = simulate(factory, &scene(0.0, vec![body.clone()]), &awake());
        let force = DVec3::new(0.0, 0.02, 0.0);
        simulation.apply_wrench(0, force, torque);
        simulation.advance(DT).unwrap();
        let s = simulation.state(0);
        assert!((s.w_w - inverse * torque * DT).length() < 1e-3 * s.w_w.length(), "{}", s.w_w);
        assert!((s.v_w - force * (DT / mass.mass())).length() < 1e-5 * s.v_w.length());
        let before = s.v_w;
        simulation.advance(DT).unwrap();
        assert!((simulation.state(0).v_w - before).length() < 1e-9, "a wrench acts for one step only");
    }
}

fn busy_scene() -> sms_scene::Scene {
    let surface = || material(0.4, 0.6, 1e-4);
    let mut bodies = vec![
        floor(surface()),
        ball("cue", DVec3::new(0.0, 0.0, R), surface()),
        ball("target", DVec3::new(0.25, 0.02, R), surface()),
    ];
    for k in 0..4 {
        let x_wb = DPose3::from_translation(DVec3::new(0.5, -0.15 + 0.1 * k as f64, 0.05));
        bodies.push(cuboid(
            &format!("box{k}"),
            x_wb,
            DVec3::new(0.02, 0.03, 0.05),
            BodyKind::Dynamic,
            surface(),
        ));
    }
    scene(G, bodies)
}

#[test]
fn restoring_a_snapshot_repeats_every_bit() {
    for factory in factories() {
        let options = WorldOptions { dt: DT, ..WorldOptions::default() };
        let mut simulation = simulate(factory, &busy_scene(), &options);
        assert!(!simulation.restore(), "nothing saved yet");
        assert!(simulation.save());
        let mut rollout = |speed: f64| {
            assert!(simulation.restore());
            let motion =
                StrikerMotion { contact_w: DVec3::new(0.0, 0.0, R), angle: 0.05, speed, ball_radius: R };
            simulation.strike(motion, 0.6, 0.7);
            run(&mut simulation, 3.0);
            simulation.states().to_vec()
        };
        let first = rollout(0.7);
        let other = rollout(0.3);
        assert_eq!(first, rollout(0.7), "{}", factory.engine());
        assert_ne!(first, other);
        // A fresh world gives the same bits as a restored one.
        let mut fresh = simulate(factory, &busy_scene(), &options);
        let motion =
            StrikerMotion { contact_w: DVec3::new(0.0, 0.0, R), angle: 0.05, speed: 0.7, ball_radius: R };
        fresh.strike(motion, 0.6, 0.7);
        run(&mut fresh, 3.0);
        assert_eq!(first[2], fresh.state(2), "{}", factory.engine());
    }
}

#[test]
fn what_rests_falls_asleep_and_what_is_hit_wakes() {
    for factory in factories() {
        let mut simulation = simulate(factory, &busy_scene(), &WorldOptions { dt: DT, ..Default::default() });
        run(&mut simulation, 1.0);
        assert!((0..7).all(|b| simulation.is_asleep(b)), "{}", factory.engine());
        launch(&mut simulation, 1, DVec3::new(0.8, 0.0, 0.0), DVec3::new(0.0, 0.8 / R, 0.0));
        assert!(!simulation.is_asleep(1));
        run(&mut simulation, 0.3);
        assert!(!simulation.is_asleep(2), "{}: the target was hit", factory.engine());
        assert!(simulation.state(2).v_w.length() > 0.1);
    }
}

/// A slow ball is not put to sleep before its rolling resistance stops it.
#[test]
fn a_slow_ball_rolls_to_its_end() {
    let lever = 1e-4;
    let (v0, a) = (0.02, 5.0 / 7.0 * G * lever / R);
    for factory in factories() {
        let options = WorldOptions { dt: DT, ..WorldOptions::default() };
        let mut simulation = simulate(factory, &floor_and_ball(0.3, lever), &options);
        launch(&mut simulation, 1, DVec3::new(v0, 0.0, 0.0), DVec3::new(0.0, v0 / R, 0.0));
        run(&mut simulation, 3.0);
        let travel = simulation.state(1).x_wb.translation.x;
        println!("{}: {travel:.5} m of {:.5}", factory.engine(), v0 * v0 / (2.0 * a));
        assert!(simulation.is_asleep(1));
        assert!((travel - v0 * v0 / (2.0 * a)).abs() < 3e-4, "{}: {travel}", factory.engine());
    }
}

#[test]
fn bodies_that_cannot_be_simulated_are_refused_by_name() {
    for factory in factories() {
        let flat = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
        let mut bad =
            cuboid("flat", DPose3::IDENTITY, DVec3::ONE, BodyKind::Dynamic, material(0.1, 0.1, 0.0));
        bad.shape = BodyShape::Hulls { hulls: vec![Mesh::new(flat, vec![[0, 1, 2]])] };
        let error = sms_sim::Simulation::new(factory, &scene(G, vec![bad.clone()]), &awake()).unwrap_err();
        assert!(matches!(&error, SimError::Body { body, .. } if body == "flat"), "{error}");
        bad.shape = BodyShape::Sphere { radius: R };
        bad.mass = None;
        let error = sms_sim::Simulation::new(factory, &scene(G, vec![bad]), &awake()).unwrap_err();
        assert!(matches!(&error, SimError::Body { body, .. } if body == "flat"), "{error}");
    }
}

#[test]
fn a_state_that_is_not_finite_is_an_error_and_no_panic() {
    for factory in factories() {
        let mut simulation = simulate(factory, &floor_and_ball(0.3, 0.0), &awake());
        launch(&mut simulation, 1, DVec3::new(f64::NAN, 0.0, 0.0), DVec3::ZERO);
        let error = (0..3).find_map(|_| simulation.advance(DT).err()).expect("it is noticed");
        assert!(matches!(&error, SimError::Diverged { body, .. } if body == "b"), "{error}");
    }
}

/// Exact boxes and cylinders rest, upright and lying, and load the body below.
#[test]
fn boxes_and_cylinders_rest_where_they_stand() {
    let material = material(0.5, 0.0, 0.0);
    let solid = |name: &str, x_wb: DPose3, shape: BodyShape, mass: MassProperties| Body {
        name: name.into(),
        kind: BodyKind::Dynamic,
        x_wb,
        shape,
        mass: Some(mass),
        ..floor_body(0.0, material.clone())
    };
    let half = DVec3::new(0.03, 0.05, 0.02);
    let (radius, half_length) = (0.03, 0.06);
    let can = || cylinder_mass_properties(radius, half_length, 800.0).unwrap();
    let cylinder = BodyShape::Cylinder { radius, half_length };
    let lying = DPose3::from_parts(
        DVec3::new(0.3, 0.0, radius),
        DQuat::from_rotation_z(0.3) * DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2),
    );
    let bodies = vec![
        floor(material.clone()),
        solid(
            "box",
            DPose3::from_translation(DVec3::Z * half.z),
            BodyShape::Box { half_extents: half },
            box_mass_properties(half, 500.0).unwrap(),
        ),
        solid(
            "on_box",
            DPose3::from_translation(DVec3::Z * (2.0 * half.z + half_length)),
            cylinder.clone(),
            can(),
        ),
        solid("lying", lying, cylinder, can()),
    ];
    let scene = scene(9.81, bodies);
    for factory in factories() {
        let mut simulation = simulate(factory, &scene, &awake());
        run(&mut simulation, 1.0);
        for (i, body) in scene.bodies.iter().enumerate().skip(1) {
            let x_wb = simulation.state(i).x_wb;
            let drift = x_wb.translation.distance(body.x_wb.translation);
            let turn = x_wb.rotation.angle_between(body.x_wb.rotation);
            assert!(
                drift < 5e-4 && turn < 5e-3,
                "{} in {}: {drift} m, {turn} rad",
                body.name,
                factory.engine()
            );
        }
    }
}

/// A heavy bar on a light board with edges that slope by a degree, as those of scanned boards do. In single precision,
/// Parry joins the slopes with the level faces and may use the normal of a slope for all of them: the bar sank through
/// the board.
#[test]
fn a_bar_stands_on_a_board_whose_edges_slope() {
    let (half, bevel) = (DVec3::new(0.42, 0.2, 0.006), 0.02);
    let mut points = Vec::new();
    for (k, slope) in [0.006, 0.012, 0.018, 0.024].into_iter().enumerate() {
        points.clear();
        for side in [-1.0, 1.0] {
            for x in [-1.0, 1.0] {
                for y in [-1.0, 1.0] {
                    points.push(DVec3::new(x * (half.x - bevel), y * (half.y - bevel), side * half.z));
                    points.push(DVec3::new(
                        x * half.x,
                        y * (half.y - bevel),
                        side * (half.z - slope * bevel),
                    ));
                    points.push(DVec3::new(
                        x * (half.x - bevel),
                        y * half.y,
                        side * (half.z - slope * bevel),
                    ));
                }
            }
        }
        let hull = convex_hull(&points, usize::MAX, 0.0).unwrap();
        let surface = || material(0.4, 0.4, 0.0);
        let bar = DVec3::new(0.023, 0.075, 0.032);
        let x_board = DPose3::from_parts(DVec3::new(0.1, -0.2, 0.5), DQuat::from_rotation_z(0.7));
        let x_bar = x_board * DPose3::from_translation(DVec3::new(-0.2, 0.05, half.z + bar.z));
        let board = Body {
            name: "board".into(),
            kind: BodyKind::Static,
            x_wb: x_board,
            shape: BodyShape::Hulls { hulls: vec![hull] },
            ..floor_body(0.0, surface())
        };
        let weight = Body {
            mass: Some(box_mass_properties(bar, 8600.0).unwrap()),
            ..cuboid("bar", x_bar, bar, BodyKind::Dynamic, surface())
        };
        let scene = scene(G, vec![floor(surface()), board, weight]);
        for factory in factories() {
            let drift = resting_drift(factory, &scene, 1.0).unwrap();
            println!("{} slope {k}: {drift:?}", factory.engine());
            assert!(drift[0].moved_m < 2e-4 && drift[0].turned_rad < 2e-3, "{}: {drift:?}", factory.engine());
        }
    }
}

/// A prism on five corners. Its centre of mass is outside the four corners of its base description, but inside the
/// five.
#[test]
fn a_prism_stands_on_all_corners_of_its_base() {
    let half_height = 0.03;
    for left_out in 0..5 {
        let angle = |k: i32| std::f64::consts::TAU * f64::from(k) / 5.0;
        let weight = 0.02 * DVec3::new(angle(left_out).cos(), angle(left_out).sin(), 0.0);
        let corners = (0..5).map(|k| 0.05 * DVec3::new(angle(k).cos(), angle(k).sin(), 0.0) - weight);
        let points: Vec<DVec3> =
            corners.flat_map(|c| [c - half_height * DVec3::Z, c + half_height * DVec3::Z]).collect();
        let hull = convex_hull(&points, usize::MAX, 0.0).unwrap();
        let surface = || material(0.4, 0.4, 0.0);
        let on = |name: &str, center: DVec3| Body {
            mass: Some(box_mass_properties(DVec3::splat(0.03), 500.0).unwrap()),
            shape: BodyShape::Hulls { hulls: vec![hull.clone()] },
            ..cuboid(name, DPose3::from_translation(center), DVec3::splat(0.03), BodyKind::Dynamic, surface())
        };
        // One prism on the floor, one on a table.
        let table = DVec3::new(0.2, 0.2, 0.1);
        let at = DPose3::from_translation(DVec3::new(1.0, 0.0, table.z));
        let table_body = cuboid("table", at, table, BodyKind::Static, surface());
        let bodies = vec![
            floor(surface()),
            table_body,
            on("low", DVec3::Z * half_height),
            on("high", DVec3::new(1.0, 0.0, 2.0 * table.z + half_height)),
        ];
        let scene = scene(G, bodies);
        for factory in factories() {
            let drift = resting_drift(factory, &scene, 2.0).unwrap();
            let stands = drift.iter().all(|d| d.moved_m < 1e-3 && d.turned_rad < 2e-3);
            assert!(stands, "{} {left_out}: {drift:?}", factory.engine());
        }
    }
}

/// A plank on a block, with 24 cm of its 60 cm beyond the block's edge: the lever law about this edge.
#[test]
fn a_plank_tips_under_the_load_of_the_lever() {
    let surface = || material(0.6, 0.0, 0.0);
    let at = |x, z| DPose3::from_translation(DVec3::new(x, 0.0, z));
    let block = cuboid("block", at(0.0, 0.2), DVec3::new(0.1, 0.1, 0.2), BodyKind::Static, surface());
    let plank = cuboid("plank", at(0.04, 0.41), DVec3::new(0.3, 0.1, 0.01), BodyKind::Dynamic, surface());
    let mass = plank.mass.unwrap().mass();
    let world = scene(G, vec![floor(surface()), block, plank]);
    for factory in factories() {
        let load = |body: &str, x: f64| {
            let p_w = DVec3::new(x, 0.0, 0.42);
            tipping_load_n(factory, &world, body, p_w, &LoadTest::default()).unwrap()
        };
        let most = LoadTest::default().most_n;
        for x in [0.34, 0.2, -0.26] {
            // Lever arms of weight and load about the edge inside the load.
            let (weight_arm, load_arm) = if x > 0.0 { (0.06, x - 0.1) } else { (0.14, -0.1 - x) };
            let statics = mass * G * weight_arm / load_arm;
            let found = load("plank", x);
            println!("{}: {found:?} N of {statics:.3} at {x}", factory.engine());
            match found {
                Some(n) => assert!((n / statics - 1.0).abs() < 0.01, "{n} N, {statics} N"),
                None => assert!(statics > most),
            }
            // The load of a ramp is larger, because it increases while the plank sinks.
            let p_w = DVec3::new(x, 0.0, 0.42);
            let ramp = LoadRamp { most_n: 40.0, ..LoadRamp::default() };
            match ramp_load_n(factory, &world, "plank", p_w, &ramp).unwrap() {
                Some(n) => assert!(n > statics && n < statics + 3.0, "{n} N, {statics} N"),
                None => assert!(statics > ramp.most_n - 3.0),
            }
        }
        // Above the block nothing tips, and a static body bears any load.
        assert_eq!((load("plank", 0.05), load("block", 0.05), load("nobody", 0.0)), (None, None, None));
    }
}
