//! The arm in a world: the engine simulates only the tool, as a body with the arm's effective mass.
//!
//! In each step, the arm first advances under its torques. The tool's body starts at the arm's pose, with the velocity
//! that leads to the arm's next pose. The change of this velocity by the engine, times the mass of the body, is the
//! received impulse p. The joints receive it as q̇ += M⁻¹ Jᵀ p. Contact timing knows the touched point just before a
//! touch. With the effective mass 1/(nᵀ J M⁻¹ Jᵀ n) of this point along the normal n, tool and body have the same speed
//! along n afterwards. So the struck body is hit by the whole arm, and momentum and energy are conserved. Across n, and
//! for unforeseen touches (a box, a slow ball), the effective mass along the sweep is used; momentum is still
//! conserved.
//!
//! The alternative, joints simulated by the engine, would have to be set up for every engine behind [`World`], and
//! rotors, friction and inertia would depend on its solver. The approach here needs only one kind of body, and every
//! engine uses the arm that is tested against Pinocchio.

use crate::{BodyId, BodyState, World};
use glamx::{DPose3, DQuat, DVec3};
use sms_robots::{ArmStrike, SweepDrive};

/// An arm in a world.
#[derive(Clone)]
pub(crate) struct ArmInWorld {
    pub(crate) drive: SweepDrive,
    /// State of the tool.
    pub(crate) state: BodyState,
    /// The touch expected in the next step: point on the tool and direction.
    touch: Option<(DVec3, DVec3)>,
    /// Acceleration of the free tool, m/s²; see [`Self::look_ahead`].
    pub(crate) acceleration_w: DVec3,
    mass: f64,
    speed_before_w: DVec3,
    /// Sum of the received impulses, N·s.
    pub(crate) impulse_w: DVec3,
    /// Energy given to touched bodies, J.
    pub(crate) work_j: f64,
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

    /// Announces a touch in the next step.
    pub(crate) fn expect(&mut self, point_w: DVec3, normal_w: DVec3) {
        self.touch = Some((point_w, normal_w));
    }

    /// Computes the tool's current acceleration.
    pub(crate) fn look_ahead(&mut self) {
        self.acceleration_w = self.drive.tool_acceleration();
    }

    /// Advances the arm to `until_s` seconds after its start and passes the tool to the engine for a step of `dt`.
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
        // The value rounded by the engine.
        self.speed_before_w = world.state(body).v_w;
    }

    /// Applies the impulse of a step of `dt` to the arm and returns the tool's state after it.
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
}

fn state_of(drive: &mut SweepDrive) -> BodyState {
    let (x_wb, v_w, w_w) = drive.tool();
    BodyState { x_wb, v_w, w_w }
}

/// The rotation from one attitude to another as a vector.
fn turn(from: &DPose3, to: &DPose3) -> DVec3 {
    let q: DQuat = to.rotation * from.rotation.inverse();
    if q.w < 0.0 { (-q).to_scaled_axis() } else { q.to_scaled_axis() }
}
