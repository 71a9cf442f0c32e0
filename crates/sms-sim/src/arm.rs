//! The arm in a world: the engine sees the tool alone, as a body of the mass that the arm has there.
//!
//! In each step the arm moves on under its torques; the tool's body starts where the arm was, with the speed that leads
//! to where it will be. What the engine changes of that speed, times the body's mass, is the impulse that was received,
//! and the joints take it as q̇ += M⁻¹ Jᵀ p. With the mass 1/(nᵀ J M⁻¹ Jᵀ n) of the touched point along the normal n, which
//! contact timing knows just before a touch, tool and body have the same speed along n afterwards: what is struck feels
//! the whole arm, and momentum and energy are neither made nor lost. Across n, and where a touch was not foreseen (a box,
//! a ball that creeps), the mass along the sweep is taken; momentum balances all the same.
//!
//! An engine's own joints were the alternative. They would have to be set up for every engine behind [`World`], with
//! rotors, friction and inertia at the mercy of its solver; this needs one kind of body of an engine, and the arm in every
//! engine is the one that is tested against Pinocchio.

use crate::{BodyId, BodyState, KinematicShape, World};
use glamx::{DPose3, DQuat, DVec3};
use sms_robots::{ArmStrike, SweepDrive};

/// An arm in a world.
#[derive(Clone)]
pub(crate) struct ArmInWorld {
    drive: SweepDrive,
    state: BodyState,
    /// The touch for which the next step is made: where on the tool, and in which direction.
    touch: Option<(DVec3, DVec3)>,
    /// Of the next step.
    acceleration_w: DVec3,
    mass: f64,
    speed_before_w: DVec3,
    /// Sum of the impulses received, N·s.
    impulse_w: DVec3,
    /// Energy that was given to what was touched, J.
    work_j: f64,
}

impl ArmInWorld {
    pub(crate) fn new(strike: &ArmStrike) -> Self {
        let mut drive = SweepDrive::new(strike.clone());
        Self {
            state: state_of(&mut drive),
            drive,
            touch: None,
            acceleration_w: DVec3::ZERO,
            mass: 1.0,
            speed_before_w: DVec3::ZERO,
            impulse_w: DVec3::ZERO,
            work_j: 0.0,
        }
    }

    pub(crate) fn shape(&self) -> KinematicShape {
        KinematicShape::Cuboid { half: self.drive.strike().half }
    }

    pub(crate) fn duration_s(&self) -> f64 {
        self.drive.strike().duration_s()
    }

    /// Where the tool is, and how it moves.
    pub(crate) fn state(&self) -> BodyState {
        self.state
    }

    /// Says that the next step is one in which a touch is expected.
    pub(crate) fn expect(&mut self, point_w: DVec3, normal_w: DVec3) {
        self.touch = Some((point_w, normal_w));
    }

    /// Acceleration of the tool, where it is not touched, m/s²; see [`Self::look_ahead`].
    pub(crate) fn acceleration_w(&self) -> DVec3 {
        self.acceleration_w
    }

    /// Works out the tool's acceleration from now on.
    pub(crate) fn look_ahead(&mut self) {
        self.acceleration_w = self.drive.tool_acceleration();
    }

    /// Moves the arm on until `until_s` seconds after its start and hands the tool to the engine for that step of `dt`.
    pub(crate) fn before_step(&mut self, world: &mut dyn World, body: BodyId, until_s: f64, dt: f64) {
        let from = self.state.x_wb;
        self.mass = match self.touch {
            Some((point_w, normal_w)) => self.drive.effective_mass(point_w, normal_w),
            None => self.drive.mass_along_sweep(),
        };
        self.drive.advance_to(until_s);
        self.state = state_of(&mut self.drive);
        let to = self.state.x_wb;
        let v_w = (to.translation - from.translation) / dt;
        world.set_tool(body, &BodyState { x_wb: from, v_w, w_w: turn(&from, &to) / dt }, self.mass);
        // As the engine has it, rounded.
        self.speed_before_w = world.state(body).v_w;
    }

    /// Takes what the tool received in a step of `dt`; its state after it.
    pub(crate) fn after_step(&mut self, world: &dyn World, body: BodyId, dt: f64) -> BodyState {
        let impulse_w = self.mass * (world.state(body).v_w - self.speed_before_w);
        let touch = self.touch.take();
        if impulse_w != DVec3::ZERO {
            let point_w = touch.map_or(self.state.x_wb.translation, |t| t.0);
            self.drive.push(point_w, impulse_w, dt);
            self.impulse_w += impulse_w;
            self.work_j -= impulse_w.dot(0.5 * (self.speed_before_w + world.state(body).v_w));
            self.state = state_of(&mut self.drive);
        }
        self.state
    }

    /// Takes the arm out of the world.
    pub(crate) fn park(&mut self) {
        self.state.x_wb.translation.z += crate::striker::RETRACTION_M;
        (self.state.v_w, self.state.w_w) = (DVec3::ZERO, DVec3::ZERO);
    }

    pub(crate) fn work_j(&self) -> f64 {
        self.work_j
    }

    pub(crate) fn impulse_w(&self) -> DVec3 {
        self.impulse_w
    }

    pub(crate) fn drive(&self) -> &SweepDrive {
        &self.drive
    }
}

fn state_of(drive: &mut SweepDrive) -> BodyState {
    let (x_wb, v_w, w_w) = drive.tool();
    BodyState { x_wb, v_w, w_w }
}

/// The rotation from one attitude to another, as a vector.
fn turn(from: &DPose3, to: &DPose3) -> DVec3 {
    let q: DQuat = to.rotation * from.rotation.inverse();
    if q.w < 0.0 { (-q).to_scaled_axis() } else { q.to_scaled_axis() }
}
