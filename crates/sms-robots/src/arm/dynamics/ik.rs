//! Inverse kinematics: Levenberg-Marquardt with limits from many starts.

use crate::arm::dynamics::workspace::joint_vector;
use crate::{Jacobian, JointVector, MAX_JOINTS, RobotModel, Workspace};
use glamx::{DMat3, DPose3, DQuat, DVec3};
use serde::{Deserialize, Serialize};
use sms_core::Cholesky;

/// Settings of the inverse kinematics.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct IkConfig {
    /// Number of starts: home, the middle of the ranges, then postures spread over the ranges. Every other start is
    /// pulled to the middle of the ranges.
    pub starts: usize,
    /// Largest number of iterations per start.
    pub iterations: usize,
    /// Position tolerance, metres.
    pub position_tolerance_m: f64,
    /// Attitude tolerance, radians.
    pub angle_tolerance_rad: f64,
    /// Distance that a solution keeps from position limits, radians or metres.
    pub limit_margin: f64,
}

impl Default for IkConfig {
    fn default() -> Self {
        Self {
            starts: 16,
            iterations: 100,
            position_tolerance_m: 1e-9,
            angle_tolerance_rad: 1e-9,
            limit_margin: 0.02,
        }
    }
}

/// A posture that reaches the target.
#[derive(Debug, Clone, PartialEq)]
pub struct IkSolution {
    /// Positions of the joints.
    pub q: Vec<f64>,
    /// Smallest distance from a position limit as a share of the joint's half range: 0 at a limit, 1 in the middle.
    pub limit_share: f64,
    /// Manipulability √det(J Jᵀ) of the tool (Yoshikawa 1985), angles scaled by 0.2 m: 0 at a singularity.
    pub manipulability: f64,
}

/// No posture reaches the target; holds the nearest one.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "the robot cannot reach the target: its nearest posture is {:.1} mm and {:.2}° off{}",
    1e3 * .position_error_m, .angle_error_rad.to_degrees(), fmt_binding(.binding)
)]
pub struct Unreachable {
    /// Remaining error of the position, metres.
    pub position_error_m: f64,
    /// Remaining error of the attitude, radians.
    pub angle_error_rad: f64,
    /// The nearest posture.
    pub best_q: Vec<f64>,
    /// Joints at a limit in that posture: name, and true for the upper limit. If empty, the target is beyond the arm's
    /// reach or too close to its base.
    pub binding: Vec<(String, bool)>,
}

fn fmt_binding(binding: &[(String, bool)]) -> String {
    if binding.is_empty() {
        return ", out of the arm's reach".to_owned();
    }
    let parts: Vec<String> = binding
        .iter()
        .map(|(name, upper)| format!("{name} at its {} limit", if *upper { "upper" } else { "lower" }))
        .collect();
    format!(", with {}", parts.join(", "))
}

/// Length that scales angles to distances, metres: about the size of a hand.
pub(crate) const LENGTH_M: f64 = 0.2;

/// Settings of one Levenberg-Marquardt step.
struct StepSettings {
    damping: f64,
    /// Step of the null space as a share of the way to the middle of the ranges.
    pull: f64,
    /// Distance from the position limits, radians or metres.
    margin: f64,
}

impl RobotModel {
    /// Returns all distinct postures found that put the tool at the pose `target` in the world, ordered by distance from
    /// limits times manipulability, best first.
    ///
    /// # Errors
    /// [`Unreachable`] when no start converges.
    pub fn inverse_kinematics(
        &self,
        target: &DPose3,
        config: &IkConfig,
        ws: &mut Workspace,
    ) -> Result<Vec<IkSolution>, Unreachable> {
        let mut found: Vec<IkSolution> = Vec::new();
        let mut nearest: Option<(f64, Unreachable)> = None;
        for start in 0..config.starts.max(1) {
            let from = if start == 0 { self.home.clone() } else { self.spread_posture(start - 1) };
            let mut q = joint_vector(&from);
            let pull = if start % 2 == 0 { 0.3 } else { 0.0 };
            let (position, angle) = self.descend(target, &mut q, config, pull, ws);
            if position <= config.position_tolerance_m && angle <= config.angle_tolerance_rad {
                let q = q[..self.dof()].to_vec();
                let same = |s: &IkSolution| s.q.iter().zip(&q).all(|(a, b)| (a - b).abs() < 1e-2);
                if !found.iter().any(same) {
                    let (limit_share, manipulability) = self.quality(&q, ws);
                    found.push(IkSolution { q, limit_share, manipulability });
                }
            } else {
                let error = position + LENGTH_M * angle;
                if nearest.as_ref().is_none_or(|(e, _)| error < *e) {
                    nearest = Some((error, self.unreachable(&q, position, angle, config)));
                }
            }
        }
        if found.is_empty()
            && let Some((_, unreachable)) = nearest
        {
            return Err(unreachable);
        }
        found.sort_by(|a, b| {
            (b.limit_share * b.manipulability).total_cmp(&(a.limit_share * a.manipulability))
        });
        Ok(found)
    }

    /// Returns the posture nearest to `q` that puts the tool at `target`: short steps without the pull to the middle of
    /// the ranges.
    ///
    /// # Errors
    /// [`Unreachable`] when the iteration does not converge.
    pub fn refine(
        &self,
        target: &DPose3,
        q: &[f64],
        config: &IkConfig,
        ws: &mut Workspace,
    ) -> Result<Vec<f64>, Unreachable> {
        let mut moved = joint_vector(q);
        let (position, angle) = self.descend(target, &mut moved, config, 0.0, ws);
        if position <= config.position_tolerance_m && angle <= config.angle_tolerance_rad {
            Ok(moved[..self.dof()].to_vec())
        } else {
            Err(self.unreachable(&moved, position, angle, config))
        }
    }

    fn unreachable(&self, q: &JointVector, position: f64, angle: f64, config: &IkConfig) -> Unreachable {
        let mut binding = Vec::new();
        for (i, joint) in self.joints.iter().enumerate() {
            let (low, high) = self.bounds(i, config.limit_margin);
            if q[i] <= low + 1e-9 || q[i] >= high - 1e-9 {
                binding.push((joint.name.clone(), q[i] >= high - 1e-9));
            }
        }
        Unreachable {
            position_error_m: position,
            angle_error_rad: angle,
            best_q: q[..self.dof()].to_vec(),
            binding,
        }
    }

    fn bounds(&self, i: usize, margin: f64) -> (f64, f64) {
        let limits = &self.joints[i].limits;
        if limits.upper - limits.lower <= 2.0 * margin {
            let middle = 0.5 * (limits.lower + limits.upper);
            return (middle, middle);
        }
        (limits.lower + margin, limits.upper - margin)
    }

    /// Distance from the limits as a share of the half range, and manipulability.
    fn quality(&self, q: &[f64], ws: &mut Workspace) -> (f64, f64) {
        let share = (0..self.dof())
            .filter(|&i| self.joints[i].limits.lower.is_finite())
            .map(|i| {
                let l = &self.joints[i].limits;
                let half = 0.5 * (l.upper - l.lower);
                if half > 0.0 { (q[i] - l.lower).min(l.upper - q[i]) / half } else { 1.0 }
            })
            .fold(1.0, f64::min);
        self.forward_kinematics(q, ws);
        let mut jacobian = Jacobian::default();
        self.jacobian(self.tool, ws, &mut jacobian);
        (share.max(0.0), manipulability(&jacobian))
    }

    /// Levenberg-Marquardt iteration from `q`. Leaves the nearest posture in `q` and returns its position and angle
    /// errors.
    ///
    /// Steps move the joints that no limit blocks. In their null space the step leads to the middle of the ranges.
    fn descend(
        &self,
        target: &DPose3,
        q: &mut JointVector,
        config: &IkConfig,
        pull: f64,
        ws: &mut Workspace,
    ) -> (f64, f64) {
        let n = self.dof();
        for i in 0..n {
            let (low, high) = self.bounds(i, config.limit_margin);
            q[i] = q[i].clamp(low, high);
        }
        let mut damping = 1e-3;
        let mut jacobian = Jacobian::default();
        self.forward_kinematics(&q[..n], ws);
        let mut error = residual(target, &self.frame_pose(self.tool, ws));
        let mut stalled = 0;
        for iteration in 0..config.iterations {
            let (position, angle) = magnitudes(&error);
            let arrived = position <= config.position_tolerance_m && angle <= config.angle_tolerance_rad;
            if arrived || stalled > 12 {
                break;
            }
            self.jacobian(self.tool, ws, &mut jacobian);
            // The pull to the middle fades, so that the last steps converge quadratically.
            let fading = pull * 0.85f64.powi(iteration as i32);
            let settings = StepSettings { damping, pull: fading, margin: config.limit_margin };
            let step = self.step(q, &error, &jacobian, &settings);
            // Long steps are shortened as a whole: the model of the arm is linear only nearby.
            let longest = step[..n].iter().fold(0.0f64, |m, x| m.max(x.abs()));
            let share = if longest > 0.5 { 0.5 / longest } else { 1.0 };
            let mut tried = *q;
            for i in 0..n {
                let (low, high) = self.bounds(i, config.limit_margin);
                tried[i] = (q[i] + share * step[i]).clamp(low, high);
            }
            self.forward_kinematics(&tried[..n], ws);
            let after = residual(target, &self.frame_pose(self.tool, ws));
            if squared(&after) < squared(&error) || (iteration < 8 && squared(&after) < 1.5 * squared(&error))
            {
                stalled = if squared(&after) < 0.999 * squared(&error) { 0 } else { stalled + 1 };
                *q = tried;
                error = after;
                damping = (damping * 0.2).max(1e-12);
            } else {
                stalled += 1;
                damping = (damping * 8.0).min(10.0);
                self.forward_kinematics(&q[..n], ws);
            }
        }
        magnitudes(&error)
    }

    fn step(
        &self,
        q: &JointVector,
        error: &[f64; 6],
        jacobian: &Jacobian,
        settings: &StepSettings,
    ) -> JointVector {
        let StepSettings { damping, pull, margin } = *settings;
        let n = self.dof();
        let rows: [[f64; MAX_JOINTS]; 6] =
            std::array::from_fn(|r| std::array::from_fn(|i| weight(r) * jacobian.get(r, i)));
        let mut free = [true; MAX_JOINTS];
        let mut step: JointVector = [0.0; MAX_JOINTS];
        let mut goal = *error;
        // A joint that the step would move through its limit stops there, and the step of the other joints is
        // recomputed for the remaining error.
        for _ in 0..=n {
            let mut wish: JointVector = [0.0; MAX_JOINTS];
            for i in (0..n).filter(|&i| free[i] && self.joints[i].limits.lower.is_finite()) {
                let l = &self.joints[i].limits;
                wish[i] = pull * (0.5 * (l.lower + l.upper) - q[i]);
            }
            let mut gram = [[0.0; 6]; 6];
            let mut right = [0.0; 6];
            for r in 0..6 {
                for s in 0..=r {
                    gram[r][s] = (0..n).filter(|&i| free[i]).map(|i| rows[r][i] * rows[s][i]).sum();
                }
                gram[r][r] += damping * damping + 1e-14;
                right[r] = goal[r] - (0..n).map(|i| rows[r][i] * wish[i]).sum::<f64>();
            }
            let Some(factor) = Cholesky::<6>::new(&gram, 6) else { return step };
            factor.solve(&mut right);
            let mut worst = (1e-12, None);
            for i in (0..n).filter(|&i| free[i]) {
                step[i] = wish[i] + (0..6).map(|r| rows[r][i] * right[r]).sum::<f64>();
                let (low, high) = self.bounds(i, margin);
                let beyond = (low - q[i] - step[i]).max(q[i] + step[i] - high);
                if beyond > worst.0 {
                    worst = (beyond, Some(i));
                }
            }
            let Some(i) = worst.1 else { break };
            let (low, high) = self.bounds(i, margin);
            step[i] = if step[i] > 0.0 { high - q[i] } else { low - q[i] };
            free[i] = false;
            for r in 0..6 {
                goal[r] -= rows[r][i] * step[i];
            }
        }
        step
    }
}

/// Position error (m) and attitude error (times [`LENGTH_M`]) in world axes.
fn residual(target: &DPose3, x_wt: &DPose3) -> [f64; 6] {
    let p = target.translation - x_wt.translation;
    let t = LENGTH_M * rotation_vector(target.rotation * x_wt.rotation.inverse());
    [p.x, p.y, p.z, t.x, t.y, t.z]
}

/// Factor on row `r` of the Jacobian: angles are scaled by [`LENGTH_M`].
fn weight(r: usize) -> f64 {
    if r < 3 { 1.0 } else { LENGTH_M }
}

fn magnitudes(e: &[f64; 6]) -> (f64, f64) {
    (DVec3::new(e[0], e[1], e[2]).length(), DVec3::new(e[3], e[4], e[5]).length() / LENGTH_M)
}

fn squared(e: &[f64; 6]) -> f64 {
    e.iter().map(|x| x * x).sum()
}

/// √det(J Jᵀ), angles scaled by [`LENGTH_M`].
pub(crate) fn manipulability(jacobian: &Jacobian) -> f64 {
    let mut gram = [[0.0; 6]; 6];
    for r in 0..6 {
        for s in 0..=r {
            gram[r][s] = weight(r)
                * weight(s)
                * (0..jacobian.dof).map(|i| jacobian.get(r, i) * jacobian.get(s, i)).sum::<f64>();
        }
    }
    Cholesky::<6>::new(&gram, 6).map_or(0.0, |c| c.sqrt_determinant())
}

/// The rotation vector of a quaternion, of angle at most π.
pub(crate) fn rotation_vector(q: DQuat) -> DVec3 {
    let q = if q.w < 0.0 { -q } else { q };
    let v = DVec3::new(q.x, q.y, q.z);
    let s = v.length();
    // 2 atan2(s, w) / s → 2 / w for small s.
    if s < 1e-9 { 2.0 * v } else { v * (2.0 * s.atan2(q.w) / s) }
}

/// The rotation vector from attitude `r` to `goal`, given as matrices.
pub(crate) fn attitude_error(goal: &DMat3, r: &DMat3) -> DVec3 {
    rotation_vector(DQuat::from_mat3(&(*goal * r.transpose())))
}
