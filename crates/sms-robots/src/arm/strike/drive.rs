//! The arm executing a sweep, with external impulses.

use crate::arm::strike::sweep::SweepPath;
use crate::{ArmSim, JointVector, Osc, OscConfig, RobotModel, Sweep, SweepPlan, ToolPath, Workspace};
use glamx::{DMat3, DPose3, DQuat, DVec3};
use std::sync::Arc;

/// Shortest integration step, seconds.
const MIN_STEP_S: f64 = 1e-9;

/// A planned sweep of the arm: the input of [`SweepDrive`].
#[derive(Debug, Clone)]
pub struct ArmStrike {
    /// The robot, with its base in the world.
    pub model: Arc<RobotModel>,
    /// The sweep.
    pub sweep: Sweep,
    /// Attitude of the tool.
    pub rotation_w: DQuat,
    /// Posture at the start, also the null-space posture.
    pub q_start: Vec<f64>,
    /// The controller.
    pub osc: OscConfig,
    /// Half extents of the striking box about the tool's origin, in its frame, metres.
    pub half: DVec3,
}

impl ArmStrike {
    /// Creates the strike of a planned sweep.
    pub fn of_plan(model: Arc<RobotModel>, plan: &SweepPlan, osc: OscConfig, half: DVec3) -> Self {
        let (sweep, rotation_w, q_start) = (plan.sweep, plan.rotation_w, plan.q_start.clone());
        Self { model, sweep, rotation_w, q_start, osc, half }
    }

    /// The tool's motion.
    pub fn path(&self) -> SweepPath {
        self.sweep.path(self.rotation_w)
    }

    /// Returns the same strike at another place, with the same hold of the tool. `sweep_of` returns the sweep of a tool
    /// whose front is the given number of metres ahead of its origin. The posture of this strike is kept.
    pub fn moved_to(&self, sweep_of: impl FnOnce(f64) -> Sweep) -> Self {
        // Attitude of the tool in the frame of the sweep.
        let held = self.sweep.rotation_w().inverse() * self.rotation_w;
        let sweep = sweep_of((held.inverse() * DVec3::X).abs().dot(self.half));
        Self { rotation_w: sweep.rotation_w() * held, sweep, ..self.clone() }
    }

    /// Duration of the sweep, seconds.
    pub fn duration_s(&self) -> f64 {
        self.path().duration_s()
    }
}

/// The arm under operational-space control through a sweep, from rest at its start. It can be advanced by steps of any
/// length: the controller runs at its own period and holds its torques in between. External impulses change the joint
/// speeds through the mass matrix; the controller reacts within its limits of torque and torque rate.
#[derive(Debug, Clone)]
pub struct SweepDrive {
    strike: ArmStrike,
    arm: ArmSim,
    osc: Osc,
    tau: JointVector,
    time_s: f64,
    /// Number of control steps so far.
    ticks: usize,
    saturated: usize,
}

impl SweepDrive {
    /// The arm at the start of the sweep, at rest.
    pub fn new(strike: ArmStrike) -> Self {
        let osc = Osc::holding(&strike.model, strike.osc, &strike.q_start, &mut Workspace::default());
        let (arm, tau) = (ArmSim::new(&strike.q_start), osc.last_tau);
        Self { strike, arm, osc, tau, time_s: 0.0, ticks: 0, saturated: 0 }
    }

    /// The strike.
    pub fn strike(&self) -> &ArmStrike {
        &self.strike
    }

    /// Positions and speeds of the joints.
    pub fn joints(&self) -> (&[f64], &[f64]) {
        let n = self.strike.model.dof();
        (&self.arm.q[..n], &self.arm.qd[..n])
    }

    /// Current torques.
    pub fn torques(&self) -> &[f64] {
        &self.tau[..self.strike.model.dof()]
    }

    /// Number of control periods so far in which an effort limit cut a torque.
    pub fn saturated_periods(&self) -> usize {
        self.saturated
    }

    /// Advances to `until_s` seconds after the start.
    pub fn advance_to(&mut self, until_s: f64) {
        let (model, period) = (self.strike.model.clone(), self.strike.osc.period_s);
        let n = model.dof();
        let mut first = None;
        while until_s - self.time_s > MIN_STEP_S {
            let next = self.ticks as f64 * period;
            if next - self.time_s <= MIN_STEP_S {
                let reference = self.strike.path().held(next, period);
                let out = self.osc.step(&model, &self.arm.q[..n], &self.arm.qd[..n], &reference);
                self.tau = out.tau;
                first = self.osc.acceleration(&model, &self.arm.driven(&model, &self.arm.qd, &self.tau));
                self.saturated += usize::from(out.saturated.is_some());
                self.ticks += 1;
                continue;
            }
            let to = if next < until_s - MIN_STEP_S { next } else { until_s };
            // At a control step the controller has already computed the dynamics.
            match first.take() {
                Some(a) => self.arm.step_from(&model, &self.tau[..n], to - self.time_s, &a),
                None => self.arm.step(&model, &self.tau[..n], to - self.time_s),
            }
            self.time_s = to;
        }
        self.time_s = until_s.max(self.time_s);
    }

    /// Pose `X_WT`, velocity of the origin (m/s) and angular velocity (rad/s) of the tool.
    pub fn tool(&mut self) -> (DPose3, DVec3, DVec3) {
        self.arm.tool(&self.strike.model)
    }

    /// Acceleration of the tool's origin under the current torques, m/s².
    pub fn tool_acceleration(&mut self) -> DVec3 {
        let (model, q, qd) = (&self.strike.model, self.arm.q, self.arm.qd);
        let qdd = self.arm.acceleration(model, &q, &qd, &self.tau);
        let ws = self.arm.placed(model);
        model.forward_motion(&qd, &qdd, ws);
        model.frame_acceleration(model.tool(), ws).0
    }

    /// Effective mass of the tool at a point along a direction, kg: 1/(nᵀ J M⁻¹ Jᵀ n).
    pub fn effective_mass(&mut self, point_w: DVec3, direction_w: DVec3) -> f64 {
        let n = direction_w.normalize_or_zero();
        1.0 / n.dot(self.mobility(point_w) * n)
    }

    /// [`Self::effective_mass`] of the tool's origin along the sweep at the last control step, kg.
    pub fn mass_along_sweep(&mut self) -> f64 {
        let d = self.strike.sweep.direction_w;
        if self.ticks == 0 {
            return self.effective_mass(self.strike.path().at(0.0).x_wt.translation, d);
        }
        1.0 / d.dot(self.osc.mobility_w() * d)
    }

    /// [`RobotModel::point_mobility`] of a point of the tool.
    pub fn mobility(&mut self, point_w: DVec3) -> DMat3 {
        let model = &self.strike.model;
        model.point_mobility(model.tool(), point_w, self.arm.placed(model))
    }

    /// Applies an impulse (N·s) at a point of the tool as if it had acted `since_s` seconds ago. This suits engines
    /// that integrate with the velocity at the end of a step: they have already moved the tool by this impulse.
    pub fn push(&mut self, point_w: DVec3, impulse_w: DVec3, since_s: f64) {
        let model = &self.strike.model;
        let (before, mut after) = (self.arm.qd, self.arm.qd);
        model.apply_impulse(model.tool(), point_w, impulse_w, self.arm.placed(model), &mut after);
        self.arm.qd = after;
        for i in 0..model.dof() {
            self.arm.q[i] += since_s * (after[i] - before[i]);
        }
    }

    /// Kinetic energy of the arm, J.
    pub fn kinetic_energy(&mut self) -> f64 {
        let qd = self.arm.qd;
        self.strike.model.kinetic_energy(&qd, self.arm.placed(&self.strike.model))
    }
}
