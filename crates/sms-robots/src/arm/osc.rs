//! Operational-space torque control (Khatib 1987): the controller of the arm, and the same law on an ideal plant, for
//! predicted motions.

use crate::arm::dynamics::ik::attitude_error;
use crate::arm::dynamics::workspace::joint_vector;
use crate::{Jacobian, JointVector, MAX_JOINTS, RobotModel, ToolReference, Workspace};
use glamx::DMat3;
use serde::{Deserialize, Serialize};
use sms_core::Cholesky;

/// Speed scale of Coulomb friction, rad/s or m/s: friction is τ_c tanh(q̇ / this).
pub(crate) const FRICTION_SPEED: f64 = 0.01;

/// Settings of the controller. Gains are accelerations per error: stiffness in 1/s², damping in 1/s.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OscConfig {
    /// Control period, seconds (paper: 400 Hz).
    pub period_s: f64,
    /// Stiffness of the tool's position.
    pub position_stiffness: f64,
    /// Damping of the tool's velocity.
    pub position_damping: f64,
    /// Stiffness of the tool's attitude.
    pub rotation_stiffness: f64,
    /// Damping of the tool's angular velocity.
    pub rotation_damping: f64,
    /// Stiffness of the posture, in the null space of the tool's motion.
    pub posture_stiffness: f64,
    /// Damping of the joints, in the null space.
    pub posture_damping: f64,
    /// Largest change of a torque per second, N·m/s. The FR3 aborts above 1000 (libfranka's `kMaxTorqueRate`).
    pub torque_rate: f64,
    /// Adds the model's damping and Coulomb friction to the torques, as the FR3's own joint controllers do.
    pub friction_compensation: bool,
}

impl Default for OscConfig {
    fn default() -> Self {
        Self {
            period_s: 0.0025,
            position_stiffness: 900.0,
            position_damping: 60.0,
            rotation_stiffness: 900.0,
            rotation_damping: 60.0,
            posture_stiffness: 100.0,
            posture_damping: 20.0,
            torque_rate: 1000.0,
            friction_compensation: true,
        }
    }
}

/// Torques of one control period, and the limits that were active.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OscOutput {
    /// Torques (forces) of the joints, with gravity.
    pub tau: JointVector,
    /// The joint with the largest torque cut by its effort limit.
    pub saturated: Option<usize>,
    /// The joint with the largest torque cut by the rate limit.
    pub rate_limited: Option<usize>,
    /// The joint farthest above its speed limit; its torque brakes.
    pub over_speed: Option<usize>,
}

/// The controller. A step does not allocate.
#[derive(Debug, Clone)]
pub struct Osc {
    config: OscConfig,
    posture: JointVector,
    /// Torques of the last period.
    pub(crate) last_tau: JointVector,
    law: TaskLaw,
}

impl Osc {
    /// Creates a controller with the null-space posture `posture`, for a robot that was held by the torques `tau` so
    /// far (see [`RobotModel::gravity_torques`]).
    ///
    /// # Panics
    /// When there are more than [`MAX_JOINTS`] entries.
    pub fn new(config: OscConfig, posture: &[f64], tau: &[f64]) -> Self {
        let (posture, last_tau) = (joint_vector(posture), joint_vector(tau));
        Self { config, posture, last_tau, law: TaskLaw::default() }
    }

    /// The controller of a robot at rest in the posture `q`.
    pub(crate) fn holding(model: &RobotModel, config: OscConfig, q: &[f64], ws: &mut Workspace) -> Self {
        let mut tau = [0.0; MAX_JOINTS];
        model.gravity_torques(q, ws, &mut tau);
        Self::new(config, q, &tau)
    }

    /// Computes the torques of the next period from measured positions and speeds. `reference` holds the pose and
    /// velocities at the start of the period, and the accelerations at its middle.
    pub fn step(
        &mut self,
        model: &RobotModel,
        q: &[f64],
        qd: &[f64],
        reference: &ToolReference,
    ) -> OscOutput {
        let n = model.dof();
        let mut tau = [0.0; MAX_JOINTS];
        let goal = TaskGoal { reference: *reference, posture: &self.posture, gains: &self.config };
        self.law.torques(model, q, qd, &goal, &mut tau);
        let mut worst = [(0.0, None); 3];
        let mut note = |kind: usize, excess: f64, joint: usize| {
            if excess > worst[kind].0 {
                worst[kind] = (excess, Some(joint));
            }
        };
        let rate = self.config.torque_rate * self.config.period_s;
        for i in 0..n {
            let joint = &model.joints[i];
            let limits = &joint.limits;
            let excess = qd[i].abs() - limits.velocity;
            if excess > 0.0 {
                note(2, excess / limits.velocity, i);
                // Brakes within about ten periods, with priority over the tool.
                let brake = self.law.bias[i]
                    - qd[i].signum() * excess * self.law.inertia(i) / (10.0 * self.config.period_s);
                tau[i] = if qd[i] > 0.0 { tau[i].min(brake) } else { tau[i].max(brake) };
            }
            let limited = tau[i].clamp(-limits.effort, limits.effort);
            note(0, (tau[i] - limited).abs() / limits.effort, i);
            let slow = limited.clamp(self.last_tau[i] - rate, self.last_tau[i] + rate);
            note(1, (limited - slow).abs(), i);
            tau[i] = slow;
        }
        self.last_tau = tau;
        OscOutput { tau, saturated: worst[0].1, rate_limited: worst[1].1, over_speed: worst[2].1 }
    }

    /// Returns the accelerations under `driven` torques (friction subtracted) in the state of the last step. They equal
    /// those of [`RobotModel::forward_dynamics`], but the dynamics are not recomputed. `None` before the first step.
    pub(crate) fn acceleration(&self, model: &RobotModel, driven: &JointVector) -> Option<JointVector> {
        let n = model.dof();
        let mut a = [0.0; MAX_JOINTS];
        for i in 0..n {
            a[i] = driven[i] - self.law.bias[i];
        }
        self.law.factor.as_ref()?.solve(&mut a[..n]);
        Some(a)
    }

    /// [`RobotModel::point_mobility`] of the tool's origin in the state of the last step.
    pub(crate) fn mobility_w(&self) -> DMat3 {
        self.law.mobility_w
    }
}

/// Friction of a joint at speed `qd`: viscous and Coulomb, N·m or N.
pub fn joint_friction(damping: f64, coulomb: f64, qd: f64) -> f64 {
    damping * qd + coulomb * (qd / FRICTION_SPEED).tanh()
}

/// The references of [`TaskLaw`] at one time.
pub(crate) struct TaskGoal<'a> {
    /// Motion of the tool.
    pub(crate) reference: ToolReference,
    /// Target posture of the null space.
    pub(crate) posture: &'a JointVector,
    pub(crate) gains: &'a OscConfig,
}

/// The law of operational-space control with its buffers.
#[derive(Debug, Clone, Default)]
pub(crate) struct TaskLaw {
    ws: Workspace,
    jacobian: Jacobian,
    bias: JointVector,
    /// Factor of the mass matrix.
    factor: Option<Cholesky<MAX_JOINTS>>,
    /// J M⁻¹ Jᵀ of the tool's origin.
    mobility_w: DMat3,
}

impl TaskLaw {
    fn inertia(&self, i: usize) -> f64 {
        self.ws.mass_matrix[i][i]
    }

    /// Computes the law's torques and returns the model's joint accelerations under them ([`Self::accelerations`]).
    pub(crate) fn torques(
        &mut self,
        model: &RobotModel,
        q: &[f64],
        qd: &[f64],
        goal: &TaskGoal<'_>,
        tau: &mut JointVector,
    ) -> JointVector {
        let n = model.dof();
        let qdd = self.accelerations(model, q, qd, goal);
        let mass_matrix = &self.ws.mass_matrix;
        for i in 0..n {
            tau[i] = self.bias[i] + (0..n).map(|j| mass_matrix[i][j] * qdd[j]).sum::<f64>();
            if goal.gains.friction_compensation {
                tau[i] += joint_friction(model.joints[i].damping, model.joints[i].friction, qd[i]);
            }
        }
        qdd
    }

    /// Computes the joint accelerations of the law.
    ///
    /// With A = M⁻¹, Λ = (J A Jᵀ)⁻¹, desired accelerations a of the tool and p of the posture, q̈ = p + A Jᵀ Λ (a − J̇
    /// q̇ − J p): the tool has priority, and the posture acts in the dynamically consistent null space.
    pub(crate) fn accelerations(
        &mut self,
        model: &RobotModel,
        q: &[f64],
        qd: &[f64],
        goal: &TaskGoal<'_>,
    ) -> JointVector {
        let TaskGoal { reference, posture, gains: config } = goal;
        let n = model.dof();
        let ws = &mut self.ws;
        model.bias_torques(q, qd, ws, &mut self.bias);
        model.mass_matrix(ws);
        model.jacobian(model.tool, ws, &mut self.jacobian);
        let jacobian = &self.jacobian;
        let (p_w, r_w) = model.frame_placed(model.tool, ws);
        let (v_w, w_w) = model.frame_velocity(model.tool, ws);
        let (drift_v, drift_w) = model.frame_acceleration(model.tool, ws);
        let turn = attitude_error(&DMat3::from_quat(reference.x_wt.rotation), &r_w);
        let linear = reference.a_w
            + config.position_stiffness * (reference.x_wt.translation - p_w)
            + config.position_damping * (reference.v_w - v_w)
            - drift_v;
        let angular = reference.alpha_w
            + config.rotation_stiffness * turn
            + config.rotation_damping * (reference.w_w - w_w)
            - drift_w;
        let mut qdd = [0.0; MAX_JOINTS];
        for i in 0..n {
            qdd[i] = config.posture_stiffness * (posture[i] - q[i]) - config.posture_damping * qd[i];
        }
        let (posture_v, posture_w) = jacobian.times(&qdd);
        let (linear, angular) = (linear - posture_v, angular - posture_w);
        let mut wanted = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z];
        // A model without inertia, whose mass matrix is singular, is refused when it is read.
        self.factor = Cholesky::new(&ws.mass_matrix, n);
        if let Some(mass) = &self.factor {
            let mut rows = [[0.0; 6]; MAX_JOINTS];
            for (row, (v, w)) in rows[..n].iter_mut().zip(jacobian.linear_w.iter().zip(&jacobian.angular_w)) {
                *row = [v.x, v.y, v.z, w.x, w.y, w.z];
            }
            let mut columns = rows;
            mass.solve_each(&mut columns[..n]);
            let mut mobility = [[0.0; 6]; 6];
            for (row, column) in rows[..n].iter().zip(&columns[..n]) {
                for r in 0..6 {
                    (0..6).for_each(|s| mobility[r][s] += row[r] * column[s]);
                }
            }
            for r in 0..6 {
                // Bounds the force near singularities; elsewhere it changes 0.0001 %.
                mobility[r][r] += 1e-6;
            }
            let entry = |r: usize, s: usize| mobility[r.max(s)][r.min(s)];
            self.mobility_w = DMat3::from_cols_array_2d(&[0, 1, 2].map(|c| [0, 1, 2].map(|r| entry(r, c))));
            if let Some(factor) = Cholesky::<6>::new(&mobility, 6) {
                factor.solve(&mut wanted);
                for i in 0..n {
                    qdd[i] += (0..6).map(|r| columns[i][r] * wanted[r]).sum::<f64>();
                }
            }
        }
        qdd
    }
}
