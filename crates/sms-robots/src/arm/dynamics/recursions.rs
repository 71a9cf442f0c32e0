//! Inverse dynamics (recursive Newton-Euler), the mass matrix (composite rigid bodies) and forward dynamics, in world
//! axes (Featherstone, "Rigid Body Dynamics Algorithms", chapters 5 and 6).

use crate::arm::dynamics::workspace::{Composite, MassMatrix};
use crate::arm::model::point_inertia;
use crate::{FrameId, JointVector, MAX_JOINTS, RobotModel, Workspace};
use glamx::{DMat3, DVec3};
use sms_core::Cholesky;

impl RobotModel {
    /// Torques (forces) that give accelerations `qdd` at positions `q` and speeds `qd`, under gravity: M q̈ + C q̇ + g,
    /// with the rotors' inertia, without friction.
    pub fn inverse_dynamics(&self, q: &[f64], qd: &[f64], qdd: &[f64], ws: &mut Workspace, tau: &mut [f64]) {
        self.forward_kinematics(q, ws);
        self.forward_motion(qd, qdd, ws);
        self.torques_of_motion(ws, tau);
        for (i, joint) in self.joints.iter().enumerate() {
            tau[i] += joint.armature * qdd[i];
        }
    }

    /// C q̇ + g: the torques that hold the speeds constant.
    pub fn bias_torques(&self, q: &[f64], qd: &[f64], ws: &mut Workspace, tau: &mut [f64]) {
        self.inverse_dynamics(q, qd, &[0.0; MAX_JOINTS], ws, tau);
    }

    /// Torques that hold the robot still.
    pub fn gravity_torques(&self, q: &[f64], ws: &mut Workspace, tau: &mut [f64]) {
        self.inverse_dynamics(q, &[0.0; MAX_JOINTS], &[0.0; MAX_JOINTS], ws, tau);
    }

    /// The backward Newton-Euler pass over the result of [`Self::forward_motion`]; without rotors.
    pub(crate) fn torques_of_motion(&self, ws: &mut Workspace, tau: &mut [f64]) {
        for (i, joint) in self.joints.iter().enumerate() {
            let Some(mass) = &joint.mass else {
                ws.force[i] = DVec3::ZERO;
                ws.moment[i] = DVec3::ZERO;
                continue;
            };
            let r = &ws.placed[i].r_wj;
            let m = &ws.moving[i];
            let c = *r * mass.com();
            let a_com = m.a + m.alpha.cross(c) + m.w.cross(m.w.cross(c)) - self.gravity_w;
            let rt = r.transpose();
            let spin = *r * (mass.inertia() * (rt * m.w));
            ws.force[i] = mass.mass() * a_com;
            ws.moment[i] = *r * (mass.inertia() * (rt * m.alpha)) + m.w.cross(spin) + c.cross(ws.force[i]);
        }
        for i in (0..self.dof()).rev() {
            let joint = &self.joints[i];
            let along = if joint.kind.turns() { ws.moment[i] } else { ws.force[i] };
            tau[i] = ws.placed[i].axis_w.dot(along);
            if let Some(p) = joint.parent {
                let lever = ws.placed[i].p_w - ws.placed[p].p_w;
                let moment = ws.moment[i] + lever.cross(ws.force[i]);
                ws.moment[p] += moment;
                let force = ws.force[i];
                ws.force[p] += force;
            }
        }
    }

    /// The mass matrix M(q), with the rotors' inertia on its diagonal. After [`Self::forward_kinematics`].
    pub fn mass_matrix<'a>(&self, ws: &'a mut Workspace) -> &'a MassMatrix {
        let n = self.dof();
        for (i, joint) in self.joints.iter().enumerate() {
            ws.composite[i] = joint.mass.map_or(Composite::default(), |m| {
                let r = ws.placed[i].r_wj;
                Composite {
                    mass: m.mass(),
                    com: ws.placed[i].p_w + r * m.com(),
                    inertia: r * m.inertia() * r.transpose(),
                }
            });
        }
        for i in (0..n).rev() {
            if let Some(p) = self.joints[i].parent {
                ws.composite[p] = sum(&ws.composite[p], &ws.composite[i]);
            }
        }
        for i in 0..n {
            ws.mass_matrix[i][..n].fill(0.0);
            let body = &ws.composite[i];
            let placed = &ws.placed[i];
            let (force, moment) = if self.joints[i].kind.turns() {
                (body.mass * placed.axis_w.cross(body.com - placed.p_w), body.inertia * placed.axis_w)
            } else {
                (body.mass * placed.axis_w, DVec3::ZERO)
            };
            for j in self.chain(Some(i)) {
                let other = &ws.placed[j];
                let m = if self.joints[j].kind.turns() {
                    other.axis_w.dot(moment + (body.com - other.p_w).cross(force))
                } else {
                    other.axis_w.dot(force)
                };
                ws.mass_matrix[i][j] = m;
                ws.mass_matrix[j][i] = m;
            }
            ws.mass_matrix[i][i] += self.joints[i].armature;
        }
        &ws.mass_matrix
    }

    /// Accelerations under torques `tau`: q̈ = M⁻¹ (τ − C q̇ − g). Friction and damping have to be subtracted by the
    /// caller. Returns false and leaves `qdd` unchanged when the mass matrix is singular (a joint that moves no mass).
    pub fn forward_dynamics(
        &self,
        q: &[f64],
        qd: &[f64],
        tau: &[f64],
        ws: &mut Workspace,
        qdd: &mut [f64],
    ) -> bool {
        let n = self.dof();
        let mut bias: JointVector = [0.0; MAX_JOINTS];
        self.bias_torques(q, qd, ws, &mut bias);
        let Some(factor) = Cholesky::new(self.mass_matrix(ws), n) else { return false };
        for i in 0..n {
            qdd[i] = tau[i] - bias[i];
        }
        factor.solve(&mut qdd[..n]);
        true
    }

    /// Returns the mobility J M⁻¹ Jᵀ, 1/kg, of a point fixed to a frame: the velocity change of the point per impulse.
    /// The effective mass in a collision along a unit direction d is 1/(dᵀ X d), where X is the mobility; collisions
    /// are too short for the control to react. The mobility is zero for a point of the base. After
    /// [`Self::forward_kinematics`].
    pub fn point_mobility(&self, frame: FrameId, point_w: DVec3, ws: &mut Workspace) -> DMat3 {
        let mut rows = [[0.0; MAX_JOINTS]; 3];
        self.point_rows(frame, point_w, ws, &mut rows);
        let n = self.dof();
        let Some(factor) = Cholesky::new(self.mass_matrix(ws), n) else { return DMat3::ZERO };
        let columns = rows.map(|mut row| {
            factor.solve(&mut row[..n]);
            DVec3::from_array(std::array::from_fn(|r| (0..n).map(|i| rows[r][i] * row[i]).sum()))
        });
        DMat3::from_cols(columns[0], columns[1], columns[2])
    }

    /// Changes the speeds `qd` by an impulse, N·s in the world, at a point fixed to a frame: q̇ += M⁻¹ Jᵀ p. After
    /// [`Self::forward_kinematics`].
    pub fn apply_impulse(
        &self,
        frame: FrameId,
        point_w: DVec3,
        impulse_w: DVec3,
        ws: &mut Workspace,
        qd: &mut [f64],
    ) {
        let mut rows = [[0.0; MAX_JOINTS]; 3];
        self.point_rows(frame, point_w, ws, &mut rows);
        let n = self.dof();
        let mut change: JointVector = [0.0; MAX_JOINTS];
        for i in 0..n {
            change[i] = (0..3).map(|r| rows[r][i] * impulse_w[r]).sum();
        }
        if let Some(factor) = Cholesky::new(self.mass_matrix(ws), n) {
            factor.solve(&mut change[..n]);
            (0..n).for_each(|i| qd[i] += change[i]);
        }
    }

    /// Computes the rows of the Jacobian of a point fixed to a frame.
    fn point_rows(&self, frame: FrameId, point_w: DVec3, ws: &Workspace, rows: &mut [[f64; MAX_JOINTS]; 3]) {
        for i in self.chain(self.frames[frame.0].joint) {
            let placed = &ws.placed[i];
            let along = if self.joints[i].kind.turns() {
                placed.axis_w.cross(point_w - placed.p_w)
            } else {
                placed.axis_w
            };
            (0..3).for_each(|r| rows[r][i] = along[r]);
        }
    }

    /// Kinetic energy, J. After [`Self::forward_kinematics`].
    pub fn kinetic_energy(&self, qd: &[f64], ws: &mut Workspace) -> f64 {
        let (n, m) = (self.dof(), self.mass_matrix(ws));
        0.5 * (0..n).map(|i| qd[i] * (0..n).map(|j| m[i][j] * qd[j]).sum::<f64>()).sum::<f64>()
    }
}

fn sum(a: &Composite, b: &Composite) -> Composite {
    let mass = a.mass + b.mass;
    if mass == 0.0 {
        return Composite::default();
    }
    let com = (a.mass * a.com + b.mass * b.com) / mass;
    let about = |c: &Composite| c.inertia + c.mass * point_inertia(c.com - com);
    Composite { mass, com, inertia: about(a) + about(b) }
}
