//! An arm as an articulation of the engine: the controller of [`crate::arm`] on the engine's own joints.

use crate::{BodyId, BodyState, World};
use sms_robots::{ArmStrike, MAX_JOINTS, Osc, ToolPath, Workspace};
use std::sync::Arc;

/// Tolerance for the start of a control period, seconds.
const TICK_S: f64 = 1e-6;

/// The controller of an engine's arm.
#[derive(Clone)]
pub(crate) struct EngineArm {
    pub(crate) strike: Arc<ArmStrike>,
    osc: Osc,
    tau: [f64; MAX_JOINTS],
    ticks: usize,
    /// State of the tool.
    pub(crate) state: BodyState,
}

impl EngineArm {
    pub(crate) fn new(strike: Arc<ArmStrike>, state: BodyState) -> Self {
        let mut hold = [0.0; MAX_JOINTS];
        strike.model.gravity_torques(&strike.q_start, &mut Workspace::default(), &mut hold);
        let osc = Osc::new(strike.osc, &strike.q_start, &hold[..strike.model.dof()]);
        Self { strike, osc, tau: hold, ticks: 0, state }
    }

    /// Sets the torques for a step from `from_s` seconds after the start. They are recomputed in each control period.
    pub(crate) fn before_step(&mut self, world: &mut dyn World, body: BodyId, from_s: f64) {
        let (n, period) = (self.strike.model.dof(), self.strike.osc.period_s);
        let (mut q, mut qd) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
        while self.ticks as f64 * period <= from_s + TICK_S {
            world.arm_joints(body, &mut q[..n], &mut qd[..n]);
            let reference = self.strike.path().held(self.ticks as f64 * period, period);
            self.tau = self.osc.step(&self.strike.model, &q[..n], &qd[..n], &reference).tau;
            self.ticks += 1;
        }
        world.set_arm_torques(body, &self.tau[..n]);
    }

    pub(crate) fn after_step(&mut self, world: &dyn World, body: BodyId) -> BodyState {
        self.state = world.state(body);
        self.state
    }
}
