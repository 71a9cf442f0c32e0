//! Smoothed-particle hydrodynamics, compared with momentum theory.

use crate::common::{WEIGHT, at, hover, rotors};
use glamx::{DPose3, DVec3};
use sms_robots::Rotor;
use sms_wash::{BodyState, BodySurface, Emission, SphSettings, SphWash, VehicleState, Wash, Wrench};

const DT: f64 = 0.0025;

/// Mean wrenches on resting bodies from `from_s` to `to_s`.
fn mean(
    wash: &mut dyn Wash,
    vehicle: &VehicleState<'_>,
    poses: &[DPose3],
    from_s: f64,
    to_s: f64,
) -> Vec<Wrench> {
    let bodies: Vec<_> = poses.iter().map(|x| BodyState::at_rest(*x)).collect();
    let mut wrenches = vec![Wrench::default(); poses.len()];
    let mut sums = vec![Wrench::default(); poses.len()];
    let (first, last) = ((from_s / DT).round() as usize, (to_s / DT).round() as usize);
    for k in 0..last {
        wash.step(DT, vehicle, &bodies, &mut wrenches);
        if k >= first {
            for (sum, w) in sums.iter_mut().zip(&wrenches) {
                sum.force_w += w.force_w / (last - first) as f64;
                sum.torque_w += w.torque_w / (last - first) as f64;
            }
        }
    }
    sums
}

fn plate(half: f64) -> BodySurface {
    BodySurface::cuboid(DVec3::new(half, half, 0.005)).unwrap()
}

/// One propeller: the plate receives all of its momentum.
#[test]
fn a_plate_carries_the_thrust_of_a_propeller() {
    let rotor = [rotors()[0]];
    for (settings, expected) in [
        (SphSettings::default(), 1.0),
        (SphSettings { spacing: 0.015, ..SphSettings::default() }, 1.0),
        (SphSettings { emission: Emission::Paper, ..SphSettings::default() }, 0.5),
        (SphSettings { spacing: 0.04, ..SphSettings::default() }.independent(), 1.0),
    ] {
        let mut wash = SphWash::new(vec![plate(0.3)], settings).unwrap();
        let vehicle = hover(&rotor, &[2.9], DVec3::Z * 0.35);
        let w = mean(&mut wash, &vehicle, &[DPose3::IDENTITY], 0.15, 0.4)[0];
        let part = w.force_w.z / -2.9;
        println!("{} m: {part:.4} of the thrust, {} particles", settings.spacing, wash.particles().count());
        assert!((part / expected - 1.0).abs() < 0.05, "{settings:?}: {part}");
        // The force acts below the propeller.
        let lever = DVec3::new(w.torque_w.y, -w.torque_w.x, 0.0) / -w.force_w.z;
        assert!(lever.distance(DVec3::new(0.1, 0.1, 0.0)) < 0.004, "{lever}");
        assert_eq!(wash.ledger().dropped, 0);
    }
}

/// Four propellers: a fountain rises where their streams meet on the plate, and the plate also carries the reaction to
/// its momentum.
#[test]
fn a_plate_carries_the_thrust_and_the_fountain() {
    let (rotors, thrusts) = (rotors(), [0.25 * WEIGHT; 4]);
    let mut wash = SphWash::new(vec![plate(0.3)], SphSettings::default()).unwrap();
    let vehicle = hover(&rotors, &thrusts, DVec3::Z * 0.35);
    mean(&mut wash, &vehicle, &[DPose3::IDENTITY], 0.0, 0.15);
    let before = wash.ledger();
    let w = mean(&mut wash, &vehicle, &[DPose3::IDENTITY], 0.0, 0.5)[0];
    let fountain = (wash.ledger().retired_w - before.retired_w).z / 0.5;
    let (part, risen) = (w.force_w.z / -WEIGHT, fountain / WEIGHT);
    println!("plate {part:.4}, fountain {risen:.4} of the weight");
    assert!((0.0..0.15).contains(&risen));
    assert!((part / (1.0 + risen) - 1.0).abs() < 0.02);
    assert!(w.force_w.truncate().length() < 0.02 * WEIGHT && w.torque_w.length() < 0.002 * WEIGHT);
}

/// Emitted momentum is in flight, retired or on the bodies. An inclined plate above a post has edges, corners and
/// contacts with two bodies.
#[test]
fn momentum_balances() {
    let (rotors, thrusts) = (rotors(), [2.0, 3.0, 2.5, 4.0]);
    let post = BodySurface::cuboid(DVec3::new(0.05, 0.08, 0.3)).unwrap();
    let mut wash = SphWash::new(vec![plate(0.1), post], SphSettings::default()).unwrap();
    let vehicle = VehicleState {
        x_wv: DPose3::from_parts(DVec3::new(0.05, 0.02, 1.0), glamx::DQuat::from_rotation_x(0.15)),
        v_w: DVec3::ZERO,
        rotors: &rotors,
        thrusts: &thrusts,
    };
    let tilted = DPose3::from_parts(DVec3::new(0.0, 0.0, 0.7), glamx::DQuat::from_rotation_y(0.4));
    let mut moving = BodyState::at_rest(tilted);
    moving.v_w = DVec3::new(0.1, 0.0, -0.5);
    moving.w_w = DVec3::new(0.0, 2.0, 0.0);
    let bodies = [moving, BodyState::at_rest(at(0.12, 0.0, 0.3))];
    let mut wrenches = [Wrench::default(); 2];
    let (mut impulse_w, mut on_post) = (DVec3::ZERO, 0.0);
    for k in 1..=200 {
        wash.step(DT, &vehicle, &bodies, &mut wrenches);
        impulse_w += DT * (wrenches[0].force_w + wrenches[1].force_w);
        on_post += DT * wrenches[1].force_w.length();
        if k % 50 == 0 {
            let l = wash.ledger();
            let error_w = l.emitted_w - l.in_flight_w - l.retired_w - l.on_bodies_w;
            let scale = l.emitted_w.length();
            assert!(error_w.length() < 1e-5 * scale, "step {k}: {error_w} of {scale}");
            assert!(impulse_w.distance(l.on_bodies_w) < 1e-9 * scale);
            assert!(l.on_bodies_w.z < -0.2 * scale && l.emitted_w.length() > 0.3);
        }
    }
    assert!(on_post > 0.01, "the post is met as well: {on_post} N·s");
}

/// A plate smaller than the wash, on pools of one, two and five threads, and without a pool.
#[test]
fn the_number_of_threads_does_not_matter_and_restored_air_is_the_same() {
    let run = |threads: usize, parallel: bool| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let (rotors, thrusts) = (rotors(), [0.25 * WEIGHT; 4]);
            let settings = SphSettings { parallel, ..SphSettings::default() };
            let mut wash = SphWash::new(vec![plate(0.15)], settings).unwrap();
            let vehicle = hover(&rotors, &thrusts, DVec3::new(0.03, 0.0, 0.4));
            let poses = [DPose3::IDENTITY];
            mean(&mut wash, &vehicle, &poses, 0.0, 0.1);
            wash.save();
            let first = mean(&mut wash, &vehicle, &poses, 0.0, 0.1);
            wash.restore();
            let again = mean(&mut wash, &vehicle, &poses, 0.0, 0.1);
            assert_eq!(first, again);
            let bits: Vec<[u32; 3]> = wash.particles_w().iter().map(|p| p.map(f32::to_bits)).collect();
            (first, bits)
        })
    };
    let one = run(1, false);
    assert!(one.1.len() > 300);
    assert!(one == run(1, true) && one == run(2, true) && one == run(5, true));
}

#[test]
fn air_is_there_only_near_the_structure() {
    let (rotors, thrusts) = (rotors(), [0.25 * WEIGHT; 4]);
    let mut wash = SphWash::new(vec![plate(0.2), BodySurface::half_space()], SphSettings::default()).unwrap();
    let poses = [at(0.0, 0.0, 0.5), DPose3::IDENTITY];
    // Beside the plate, and too high above the plate.
    for p_w in [DVec3::new(0.8, 0.0, 0.9), DVec3::new(0.0, 0.0, 2.2)] {
        mean(&mut wash, &hover(&rotors, &thrusts, p_w), &poses, 0.0, 0.05);
        assert!(!wash.is_active(), "at {p_w}");
    }
    let over = hover(&rotors, &thrusts, DVec3::new(0.0, 0.0, 0.9));
    mean(&mut wash, &over, &poses, 0.0, 0.2);
    assert!(wash.is_active());
    for (x, _) in wash.particles() {
        // No particle is farther away than the margin plus the travel of a step.
        assert!(x[0].abs() < 0.4 && x[1].abs() < 0.4 && x[2] > 0.3, "{x:?}");
    }
    // With the motors off, all particles leave within a second.
    mean(&mut wash, &hover(&rotors, &[0.0; 4], DVec3::new(0.0, 0.0, 0.9)), &poses, 0.0, 1.0);
    assert!(!wash.is_active());
}

/// A free jet keeps its width and speed, because there is no other air to mix with.
#[test]
fn a_free_jet_flies_straight() {
    let rotor = [Rotor { p_v: DVec3::ZERO, radius: 0.0685 }];
    let mut wash = SphWash::new(vec![plate(0.3)], SphSettings::default()).unwrap();
    mean(&mut wash, &hover(&rotor, &[2.9], DVec3::Z * 0.9), &[DPose3::IDENTITY], 0.0, 0.2);
    let (mut count, mut radius2, mut speed) = (0.0, 0.0, 0.0);
    for (x, v) in wash.particles().filter(|(x, _)| (0.2..0.5).contains(&x[2])) {
        count += 1.0;
        radius2 += f64::from(x[0] * x[0] + x[1] * x[1]);
        speed -= f64::from(v[2]);
    }
    // A uniform disk has the mean squared radius R²/2.
    let radius = (2.0 * radius2 / count).sqrt();
    assert!((radius / (0.0685 / 2f64.sqrt()) - 1.0).abs() < 0.15, "{radius}");
    assert!((speed / count / 17.92 - 1.0).abs() < 0.02, "{}", speed / count);
}

#[test]
fn settings_out_of_range_are_refused() {
    for settings in [
        SphSettings { spacing: 0.0, ..SphSettings::default() },
        SphSettings { support_spacings: 9.0, ..SphSettings::default() },
        SphSettings { viscosity: f64::NAN, ..SphSettings::default() },
    ] {
        assert!(SphWash::new(vec![plate(0.1)], settings).is_err());
    }
}

/// Steps far beyond the stable length give finite or non-finite forces, but never panic.
#[test]
fn what_blows_up_does_not_panic() {
    let (rotors, thrusts) = (rotors(), [0.25 * WEIGHT; 4]);
    let wild = SphSettings { cfl: 400.0, sound_speed: 5000.0, slack: 0.0, ..SphSettings::default() };
    let mut wash = SphWash::new(vec![plate(0.2)], wild).unwrap();
    mean(&mut wash, &hover(&rotors, &thrusts, DVec3::Z * 0.3), &[DPose3::IDENTITY], 0.0, 0.3);
    assert!(wash.particles().count() < 30_000);
}

/// The air of a moving propeller continues to fall at the place of its emission, as predicted by the lag of the tube
/// model.
#[test]
fn the_wash_of_a_moving_vehicle_lags_behind() {
    let rotor = [Rotor { p_v: DVec3::ZERO, radius: 0.0685 }];
    let mut wash = SphWash::new(vec![plate(0.5)], SphSettings::default()).unwrap();
    let body = [BodyState::at_rest(DPose3::IDENTITY)];
    let v_w = DVec3::X * 1.5;
    let mut wrench = [Wrench::default()];
    let (mut lag, mut weight) = (0.0, 0.0);
    for k in 0..160 {
        let x = -0.3 + 1.5 * DT * f64::from(k);
        let p_w = DVec3::new(x, 0.0, 0.5);
        wash.step(DT, &VehicleState { v_w, ..hover(&rotor, &[2.9], p_w) }, &body, &mut wrench);
        if k >= 40 {
            lag += -wrench[0].force_w.z * x - wrench[0].torque_w.y;
            weight -= wrench[0].force_w.z;
        }
    }
    let expected = 1.5 * 0.5 / 17.92;
    assert!((lag / weight / expected - 1.0).abs() < 0.15, "{} m, expected {expected}", lag / weight);
}
