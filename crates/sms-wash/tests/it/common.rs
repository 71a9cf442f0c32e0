//! The published vehicle and a few structures.

use glamx::{DPose3, DQuat, DVec3};
use sms_robots::Rotor;
use sms_wash::{BodyState, VehicleState, Wash, Wrench};

/// Weight of the published vehicle, N.
pub(crate) const WEIGHT: f64 = 1.182 * 9.81;

pub(crate) fn rotors() -> [Rotor; 4] {
    [(0.1, 0.1), (0.1, -0.1), (-0.1, 0.1), (-0.1, -0.1)]
        .map(|(x, y)| Rotor { p_v: DVec3::new(x, y, 0.0), radius: 0.0685 })
}

pub(crate) fn at(x: f64, y: f64, z: f64) -> DPose3 {
    DPose3::from_translation(DVec3::new(x, y, z))
}

/// A level hover with the vehicle at `p_w`.
pub(crate) fn hover<'a>(rotors: &'a [Rotor], thrusts: &'a [f64], p_w: DVec3) -> VehicleState<'a> {
    VehicleState { x_wv: DPose3::from_parts(p_w, DQuat::IDENTITY), v_w: DVec3::ZERO, rotors, thrusts }
}

/// Returns the wrenches on resting bodies after one step.
pub(crate) fn once(wash: &mut dyn Wash, vehicle: &VehicleState<'_>, poses: &[DPose3]) -> Vec<Wrench> {
    let bodies: Vec<_> = poses.iter().map(|x| BodyState::at_rest(*x)).collect();
    let mut wrenches = vec![Wrench::default(); poses.len()];
    wash.step(0.0025, vehicle, &bodies, &mut wrenches);
    wrenches
}
