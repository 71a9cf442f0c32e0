//! Forward kinematics, Jacobians, velocities and accelerations, in world axes.

use crate::arm::dynamics::workspace::Moving;
use crate::{FrameId, Jacobian, RobotModel, Workspace};
use glamx::{DMat3, DPose3, DQuat, DVec3};

impl RobotModel {
    /// Computes the joint frames at positions `q` (one per joint), which all other kinematics read from `ws`.
    pub fn forward_kinematics(&self, q: &[f64], ws: &mut Workspace) {
        let base_r = DMat3::from_quat(self.x_wr.rotation);
        for (i, joint) in self.joints.iter().enumerate() {
            let (r_wp, p_w) = match joint.parent {
                Some(p) => (ws.placed[p].r_wj, ws.placed[p].p_w),
                None => (base_r, self.x_wr.translation),
            };
            let r_tree = r_wp * DMat3::from_quat(joint.x_pj.rotation);
            let axis_w = r_tree * joint.axis;
            let placed = &mut ws.placed[i];
            placed.axis_w = axis_w;
            placed.p_w = p_w + r_wp * joint.x_pj.translation;
            if joint.kind.turns() {
                placed.r_wj = r_tree * rotation_about(joint.axis, q[i]);
            } else {
                placed.r_wj = r_tree;
                placed.p_w += q[i] * axis_w;
            }
        }
    }

    /// Pose `X_WJ` of a joint's body in the world; `None` is the base. After [`Self::forward_kinematics`].
    pub fn body_pose(&self, joint: Option<usize>, ws: &Workspace) -> DPose3 {
        match joint {
            Some(i) => DPose3::from_parts(ws.placed[i].p_w, DQuat::from_mat3(&ws.placed[i].r_wj)),
            None => self.x_wr,
        }
    }

    /// Pose `X_WF` of a frame in the world. After [`Self::forward_kinematics`].
    pub fn frame_pose(&self, frame: FrameId, ws: &Workspace) -> DPose3 {
        let data = &self.frames[frame.0];
        self.body_pose(data.joint, ws) * data.x_jf
    }

    /// Position and rotation matrix of a frame in the world: [`Self::frame_pose`] without the quaternion.
    pub(crate) fn frame_placed(&self, frame: FrameId, ws: &Workspace) -> (DVec3, DMat3) {
        let data = &self.frames[frame.0];
        let (r, p) = match data.joint {
            Some(i) => (ws.placed[i].r_wj, ws.placed[i].p_w),
            None => (DMat3::from_quat(self.x_wr.rotation), self.x_wr.translation),
        };
        (p + r * data.x_jf.translation, r * DMat3::from_quat(data.x_jf.rotation))
    }

    /// The Jacobian of a frame. After [`Self::forward_kinematics`].
    pub fn jacobian(&self, frame: FrameId, ws: &Workspace, out: &mut Jacobian) {
        let data = &self.frames[frame.0];
        out.dof = self.dof();
        out.linear_w = Default::default();
        out.angular_w = Default::default();
        let Some(last) = data.joint else { return };
        let p_w = ws.placed[last].p_w + ws.placed[last].r_wj * data.x_jf.translation;
        for i in self.chain(data.joint) {
            let axis = ws.placed[i].axis_w;
            if self.joints[i].kind.turns() {
                out.linear_w[i] = axis.cross(p_w - ws.placed[i].p_w);
                out.angular_w[i] = axis;
            } else {
                out.linear_w[i] = axis;
            }
        }
    }

    /// Velocities and accelerations of all joint frames for speeds `qd` and accelerations `qdd`, gravity not included.
    /// After [`Self::forward_kinematics`].
    pub fn forward_motion(&self, qd: &[f64], qdd: &[f64], ws: &mut Workspace) {
        for (i, joint) in self.joints.iter().enumerate() {
            let (parent, r) = match joint.parent {
                Some(p) => (ws.moving[p], ws.placed[i].p_w - ws.placed[p].p_w),
                None => (Moving::default(), ws.placed[i].p_w - self.x_wr.translation),
            };
            let z = ws.placed[i].axis_w;
            let carried = parent.w.cross(r);
            let mut m = Moving {
                v: parent.v + carried,
                w: parent.w,
                a: parent.a + parent.alpha.cross(r) + parent.w.cross(carried),
                alpha: parent.alpha,
            };
            if joint.kind.turns() {
                m.w += z * qd[i];
                m.alpha += z * qdd[i] + parent.w.cross(z) * qd[i];
            } else {
                m.v += z * qd[i];
                m.a += z * qdd[i] + 2.0 * parent.w.cross(z) * qd[i];
            }
            ws.moving[i] = m;
        }
    }

    /// Velocity of a frame's origin, m/s, and its angular velocity, rad/s, in world axes. After
    /// [`Self::forward_motion`].
    pub fn frame_velocity(&self, frame: FrameId, ws: &Workspace) -> (DVec3, DVec3) {
        let data = &self.frames[frame.0];
        let Some(i) = data.joint else { return (DVec3::ZERO, DVec3::ZERO) };
        let m = &ws.moving[i];
        (m.v + m.w.cross(ws.placed[i].r_wj * data.x_jf.translation), m.w)
    }

    /// Acceleration of a frame's origin, m/s², and its angular acceleration, rad/s², in world axes. After
    /// [`Self::forward_motion`]; with q̈ = 0 there, this is J̇ q̇.
    pub fn frame_acceleration(&self, frame: FrameId, ws: &Workspace) -> (DVec3, DVec3) {
        let data = &self.frames[frame.0];
        let Some(i) = data.joint else { return (DVec3::ZERO, DVec3::ZERO) };
        let m = &ws.moving[i];
        let r = ws.placed[i].r_wj * data.x_jf.translation;
        (m.a + m.alpha.cross(r) + m.w.cross(m.w.cross(r)), m.alpha)
    }
}

/// The rotation by `angle` about a unit axis (Rodrigues).
fn rotation_about(axis: DVec3, angle: f64) -> DMat3 {
    if axis == DVec3::Z {
        return DMat3::from_rotation_z(angle);
    }
    DMat3::from_axis_angle(axis, angle)
}
