//! The analytic models, compared with closed forms.

use crate::common::{WEIGHT, at, hover, once, rotors};
use glamx::{DPose3, DQuat, DVec3};
use sms_wash::{BodySurface, Emission, StreamSettings, StreamWash, Wash};

fn models(surfaces: &[BodySurface]) -> [StreamWash; 2] {
    let settings = StreamSettings::default();
    [
        StreamWash::disk(surfaces.to_vec(), settings).unwrap(),
        StreamWash::jet(surfaces.to_vec(), settings).unwrap(),
    ]
}

fn plate(half: f64) -> BodySurface {
    BodySurface::cuboid(DVec3::new(half, half, 0.005)).unwrap()
}

#[test]
fn a_large_plate_carries_the_thrust() {
    let (rotors, thrusts) = (rotors(), [0.25 * WEIGHT; 4]);
    for height in [0.1, 0.4, 1.0] {
        for mut wash in models(&[plate(1.5)]) {
            let w = once(&mut wash, &hover(&rotors, &thrusts, DVec3::Z * height), &[DPose3::IDENTITY])[0];
            let name = wash.name();
            assert!((w.force_w.z / -WEIGHT - 1.0).abs() < 0.01, "{name} at {height}: {}", w.force_w);
            assert!(w.force_w.truncate().length() < 1e-9 && w.torque_w.length() < 1e-2 * WEIGHT * 0.1);
        }
    }
}

#[test]
fn the_paper_s_emission_presses_half_as_much() {
    let (rotors, thrusts) = (rotors(), [0.25 * WEIGHT; 4]);
    let settings = StreamSettings { emission: Emission::Paper, ..StreamSettings::default() };
    let mut wash = StreamWash::disk(vec![plate(0.5)], settings).unwrap();
    let w = once(&mut wash, &hover(&rotors, &thrusts, DVec3::Z * 0.3), &[DPose3::IDENTITY])[0];
    assert!((w.force_w.z / -WEIGHT - 0.5).abs() < 1e-9);
    assert!(wash.is_active());
    let off = once(&mut wash, &hover(&rotors, &[0.0; 4], DVec3::Z * 0.3), &[DPose3::IDENTITY])[0];
    assert_eq!(off.force_w, DVec3::ZERO);
    assert!(!wash.is_active());
}

/// A stream F that meets a plate under the angle θ presses with F·cos θ along the plate's normal. Its torque is F·cos θ
/// times the distance from the centre to the point where the axis meets the plate.
#[test]
fn an_inclined_plate_is_pressed_along_its_normal() {
    let rotor = [sms_robots::Rotor { p_v: DVec3::ZERO, radius: 0.05 }];
    for angle in [0.2f64, 0.6, 1.0] {
        let x_wb = DPose3::from_parts(DVec3::ZERO, DQuat::from_rotation_y(angle));
        let normal_w = x_wb.rotation * DVec3::Z;
        let offset = 0.1;
        let mut wash = StreamWash::disk(vec![plate(0.6)], StreamSettings::default()).unwrap();
        let w = once(&mut wash, &hover(&rotor, &[3.0], DVec3::new(offset, 0.0, 0.8)), &[x_wb])[0];
        assert!(w.force_w.distance(-3.0 * angle.cos() * normal_w) < 1e-9, "{angle}: {}", w.force_w);
        // The lever is the distance of this point along the upper side, 5 mm above the centre.
        let lever = (offset - 0.005 * angle.sin()) / angle.cos();
        let torque = 3.0 * angle.cos() * lever;
        assert!((w.torque_w.y - torque).abs() < 1e-3 * torque, "{angle}: {}", w.torque_w);
    }
}

#[test]
fn what_stands_in_the_shadow_feels_nothing() {
    let (rotors, thrusts) = (rotors(), [0.25 * WEIGHT; 4]);
    let surfaces = [plate(0.6), plate(0.8)];
    for mut wash in models(&surfaces) {
        let w = once(
            &mut wash,
            &hover(&rotors, &thrusts, DVec3::Z * 0.9),
            &[at(0.0, 0.0, 0.6), DPose3::IDENTITY],
        );
        let upper = w[0].force_w.z / -WEIGHT;
        assert!(upper > 0.99 && w[1].force_w.z.abs() < 0.01 * WEIGHT, "{}: {w:?}", wash.name());
    }
    // A plate under two of the four propellers receives half of the force; the floor receives the rest.
    for mut wash in models(&[plate(0.3), BodySurface::half_space()]) {
        let w = once(
            &mut wash,
            &hover(&rotors, &thrusts, DVec3::new(0.0, 0.0, 0.75)),
            &[at(0.3, 0.0, 0.6), DPose3::IDENTITY],
        );
        let (upper, lower) = (w[0].force_w.z / -WEIGHT, w[1].force_w.z / -WEIGHT);
        assert!((upper - 0.5).abs() < 0.01 && (upper + lower - 1.0).abs() < 0.01, "{w:?}");
    }
}

/// The share of the jet on a round target grows with the target's size as in the published profile.
#[test]
fn a_small_target_far_below_takes_its_share_of_the_jet() {
    let (rotors, thrusts) = (rotors(), [0.25 * WEIGHT; 4]);
    let fine = StreamSettings { rings: 60, spokes: 48, ..StreamSettings::default() };
    for (z, half) in [(0.9f64, 0.05f64), (1.2, 0.1), (1.2, 0.2)] {
        let mut wash = StreamWash::jet(vec![plate(half)], fine).unwrap();
        let w = once(&mut wash, &hover(&rotors, &thrusts, DVec3::Z * (z + 0.005)), &[DPose3::IDENTITY])[0];
        // All jets have merged. The reference is ∫ f² over the square, f = 1/(1 + aη²)², by midpoints.
        let a = (2f64.sqrt() - 1.0) / sms_wash::SPREADING_RATE.powi(2);
        let n = 400;
        let mut share = 0.0;
        for i in 0..n {
            for j in 0..n {
                let at = |k: i32| half * (2.0 * (f64::from(k) + 0.5) / f64::from(n) - 1.0) / z;
                share += (1.0 + a * (at(i).powi(2) + at(j).powi(2))).powi(-4);
            }
        }
        share *= (2.0 * half / f64::from(n) / z).powi(2) * 3.0 * a / std::f64::consts::PI;
        let got = w.force_w.z / -WEIGHT;
        // The width of the nozzle still has an effect of a few per cent (blended out with the fourth power).
        assert!((got / share - 1.0).abs() < 0.08, "{z} {half}: {got} {share}");
    }
}

/// A body that moves away at the air's speed has no force; one that approaches has a larger force.
#[test]
fn the_speed_of_the_body_counts() {
    let rotor = [sms_robots::Rotor { p_v: DVec3::ZERO, radius: 0.05 }];
    let exit = sms_wash::ActuatorDisk { thrust: 3.0, radius: 0.05, air_density: 1.225 }.exit_speed();
    let mut wash = StreamWash::disk(vec![plate(0.6)], StreamSettings::default()).unwrap();
    let mut wrench = [sms_wash::Wrench::default()];
    for (part, expected) in [(1.0, 0.0), (0.5, 0.25), (-0.5, 2.25)] {
        let body = sms_wash::BodyState {
            v_w: DVec3::NEG_Z * exit * part,
            ..sms_wash::BodyState::at_rest(DPose3::IDENTITY)
        };
        wash.step(0.0025, &hover(&rotor, &[3.0], DVec3::Z * 0.5), &[body], &mut wrench);
        assert!((wrench[0].force_w.z / -3.0 - expected).abs() < 1e-9);
    }
}

/// Air takes height / exit speed to reach the plate, and the propeller moves on meanwhile.
#[test]
fn the_wash_of_a_moving_vehicle_lags_behind() {
    let rotor = [sms_robots::Rotor { p_v: DVec3::ZERO, radius: 0.05 }];
    let exit = sms_wash::ActuatorDisk { thrust: 3.0, radius: 0.05, air_density: 1.225 }.exit_speed();
    let v_w = DVec3::new(2.0, -1.0, 0.0);
    for (mut wash, slower) in models(&[plate(0.9)]).into_iter().zip([1.001, 1.35]) {
        let vehicle = sms_wash::VehicleState { v_w, ..hover(&rotor, &[3.0], DVec3::Z * 0.505) };
        let w = once(&mut wash, &vehicle, &[DPose3::IDENTITY])[0];
        let center = DVec3::new(w.torque_w.y, -w.torque_w.x, 0.0) / -w.force_w.z;
        let behind = -0.5 / exit * v_w;
        // A jet slows down, its outer parts most, so its lag is larger.
        let by = center.dot(behind) / behind.length_squared();
        assert!((0.999..=slower).contains(&by), "{}: {by}", wash.name());
        assert!((center - by * behind).length() < 1e-3, "{center}");
    }
}
