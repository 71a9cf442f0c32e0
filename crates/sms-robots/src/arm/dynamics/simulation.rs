//! Forward simulation of the arm in free space, for tests of the controller and for prediction.

use crate::arm::dynamics::workspace::joint_vector;
use crate::{JointVector, MAX_JOINTS, RobotModel, Workspace, joint_friction};
use glamx::{DPose3, DVec3};

/// A robot under joint torques, with damping, Coulomb friction and rotor inertia. It has no contacts, and position
/// limits do not stop it.
#[derive(Debug, Clone)]
pub struct ArmSim {
    /// Positions; the first `dof` are in use.
    pub q: JointVector,
    /// Speeds.
    pub qd: JointVector,
    /// Factor on the model's damping and friction: 1 if the real robot equals its model.
    pub friction_scale: f64,
    ws: Workspace,
}

impl ArmSim {
    /// A robot at rest.
    pub fn new(q: &[f64]) -> Self {
        Self { q: joint_vector(q), qd: [0.0; MAX_JOINTS], friction_scale: 1.0, ws: Workspace::default() }
    }

    /// Advances by `dt` seconds under constant torques, in one step of the classic Runge-Kutta method.
    pub fn step(&mut self, model: &RobotModel, tau: &[f64], dt: f64) {
        let first = self.acceleration(model, &self.q.clone(), &self.qd.clone(), tau);
        self.step_from(model, tau, dt, &first);
    }

    /// Like [`Self::step`], from a state with known accelerations.
    pub(crate) fn step_from(&mut self, model: &RobotModel, tau: &[f64], dt: f64, first: &JointVector) {
        let n = model.dof();
        let (q0, v0) = (self.q, self.qd);
        let (mut dq, mut dv) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
        let (mut q, mut v) = (q0, v0);
        for (stage, (ahead, weight)) in
            [(0.5, 1.0), (0.5, 2.0), (1.0, 2.0), (0.0, 1.0)].into_iter().enumerate()
        {
            let a = if stage == 0 { *first } else { self.acceleration(model, &q, &v, tau) };
            for i in 0..n {
                dq[i] += weight / 6.0 * v[i];
                dv[i] += weight / 6.0 * a[i];
                q[i] = q0[i] + ahead * dt * v[i];
                v[i] = v0[i] + ahead * dt * a[i];
            }
        }
        for i in 0..n {
            self.q[i] = q0[i] + dt * dq[i];
            self.qd[i] = v0[i] + dt * dv[i];
        }
    }

    pub(crate) fn acceleration(
        &mut self,
        model: &RobotModel,
        q: &JointVector,
        v: &JointVector,
        tau: &[f64],
    ) -> JointVector {
        let n = model.dof();
        let mut a = [0.0; MAX_JOINTS];
        let driven = self.driven(model, v, tau);
        model.forward_dynamics(&q[..n], &v[..n], &driven[..n], &mut self.ws, &mut a[..n]);
        a
    }

    /// Torques minus friction.
    pub(crate) fn driven(&self, model: &RobotModel, v: &JointVector, tau: &[f64]) -> JointVector {
        let mut driven = [0.0; MAX_JOINTS];
        for (i, joint) in model.joints().iter().enumerate() {
            driven[i] = tau[i] - self.friction_scale * joint_friction(joint.damping, joint.friction, v[i]);
        }
        driven
    }

    /// The workspace with the joint frames at the current positions.
    pub(crate) fn placed(&mut self, model: &RobotModel) -> &mut Workspace {
        model.forward_kinematics(&self.q, &mut self.ws);
        &mut self.ws
    }

    /// Pose `X_WT`, velocity of the origin (m/s) and angular velocity (rad/s) of the tool.
    pub fn tool(&mut self, model: &RobotModel) -> (DPose3, DVec3, DVec3) {
        let qd = self.qd;
        let ws = self.placed(model);
        model.forward_motion(&qd, &[0.0; MAX_JOINTS], ws);
        let (v_w, w_w) = model.frame_velocity(model.tool(), ws);
        (model.frame_pose(model.tool(), ws), v_w, w_w)
    }
}
