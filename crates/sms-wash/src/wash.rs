//! The interface of wash models, between the propellers and the bodies.

use crate::{ActuatorDisk, Emission, Emitted};
use glamx::{DPose3, DVec3};
use serde::{Deserialize, Serialize};
use sms_robots::Rotor;

/// State of a vehicle. Its propellers blow along −z of `V`.
#[derive(Debug, Clone, Copy)]
pub struct VehicleState<'a> {
    /// Pose of the vehicle in the world.
    pub x_wv: DPose3,
    /// Velocity of its origin in the world, m/s.
    pub v_w: DVec3,
    /// Its propellers.
    pub rotors: &'a [Rotor],
    /// Thrust of each propeller, N; zero for a stopped motor.
    pub thrusts: &'a [f64],
}

/// Stream of a propeller at the disk.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stream {
    /// Index of the propeller.
    pub(crate) rotor: usize,
    /// Centre of the disk in the world.
    pub(crate) p_w: DVec3,
    /// Direction of the flow.
    pub(crate) axis_w: DVec3,
    pub(crate) emitted: Emitted,
}

impl VehicleState<'_> {
    /// The streams of all propellers with thrust.
    pub(crate) fn streams(
        &self,
        air_density: f64,
        emission: Emission,
    ) -> impl Iterator<Item = Stream> + use<'_> {
        let axis_w = self.x_wv.rotation * DVec3::NEG_Z;
        self.rotors.iter().zip(self.thrusts).enumerate().filter(|(_, (_, thrust))| **thrust > 0.0).map(
            move |(i, (rotor, &thrust))| {
                let disk = ActuatorDisk { thrust, radius: rotor.radius, air_density };
                let p_w = self.x_wv.transform_point(rotor.p_v);
                Stream { rotor: i, p_w, axis_w, emitted: disk.emitted(emission) }
            },
        )
    }
}

/// Motion state of one body.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BodyState {
    /// Pose in the world; the origin is the centre of mass and the reference point of torques.
    pub x_wb: DPose3,
    /// Linear velocity of the origin, m/s, in the world.
    pub v_w: DVec3,
    /// Angular velocity, rad/s, in the world.
    pub w_w: DVec3,
}

impl BodyState {
    /// A body at rest.
    pub fn at_rest(x_wb: DPose3) -> Self {
        Self { x_wb, v_w: DVec3::ZERO, w_w: DVec3::ZERO }
    }

    /// Velocity of the body's material at a point of the world, m/s.
    pub fn velocity_at(&self, p_w: DVec3) -> DVec3 {
        self.v_w + self.w_w.cross(p_w - self.x_wb.translation)
    }
}

/// A force and the torque about a body's origin, in the world.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Wrench {
    /// Force, N.
    pub force_w: DVec3,
    /// Torque about the origin of the body, N·m.
    pub torque_w: DVec3,
}

impl Wrench {
    /// Adds a force (N) that acts at `p_w` on a body whose origin is at `origin_w`.
    pub(crate) fn push(&mut self, force_w: DVec3, p_w: DVec3, origin_w: DVec3) {
        self.force_w += force_w;
        self.torque_w += (p_w - origin_w).cross(force_w);
    }
}

/// A model of propeller wash for bodies of fixed surfaces ([`crate::BodySurface`]) in a fixed order.
pub trait Wash: Send {
    /// Name of the model.
    fn name(&self) -> &'static str;

    /// Advances the air by `dt` seconds with the vehicle and the bodies in their current states, and writes the mean
    /// wrench on each body over this time.
    ///
    /// # Panics
    /// When the number of `bodies` or `wrenches` differs from that of the surfaces, or thrusts from propellers.
    fn step(&mut self, dt: f64, vehicle: &VehicleState<'_>, bodies: &[BodyState], wrenches: &mut [Wrench]);

    /// Whether air moves near the structure. If not, wrenches are zero until the vehicle's wash reaches the structure.
    fn is_active(&self) -> bool;

    /// Saves the state of the air for [`Wash::restore`].
    fn save(&mut self);

    /// Restores the saved state of the air, or still air if none was saved.
    fn restore(&mut self);

    /// Positions of the particles for rendering; empty for models without particles.
    fn particles_w(&self) -> Vec<[f32; 3]> {
        Vec::new()
    }
}
