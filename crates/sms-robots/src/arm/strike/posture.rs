//! Postures at the contact of a strike, and the share of the arm's limits that each uses.

use crate::{IkConfig, Jacobian, JointVector, MAX_JOINTS, RobotModel, Sweep, Unreachable, Workspace};
use glamx::{DPose3, DVec3};
use sms_core::Cholesky;

/// Continuation along a family of postures: the largest joint change per step, radians or metres, and the largest
/// number of steps in each direction.
const STRIDE: f64 = 0.15;
const MOST_STEPS: usize = 48;

/// Distance below which two postures belong to one family, radians or metres.
const SAME: f64 = 0.2;

/// Postures that put the tool at the pose `target`: the solutions of inverse kinematics, and their families under self-motion (a
/// redundant arm's elbow), followed in both directions up to the limits.
///
/// # Errors
/// [`Unreachable`] when there is none.
pub(crate) fn postures(
    model: &RobotModel,
    target: &DPose3,
    config: &IkConfig,
    ws: &mut Workspace,
) -> Result<Vec<Vec<f64>>, Unreachable> {
    let n = model.dof();
    let mut all: Vec<Vec<f64>> = Vec::new();
    for solution in model.inverse_kinematics(target, config, ws)? {
        let known = |q: &Vec<f64>| q.iter().zip(&solution.q).all(|(a, b)| (a - b).abs() < SAME);
        if all.iter().any(known) {
            continue;
        }
        all.push(solution.q.clone());
        let Some(first) = idle_direction(model, &solution.q, None, ws) else { continue };
        for sign in [1.0, -1.0] {
            let mut q = solution.q.clone();
            let mut direction = first;
            direction.iter_mut().for_each(|x| *x *= sign);
            for _ in 0..MOST_STEPS {
                let Some(next) = idle_direction(model, &q, Some(&direction), ws) else { break };
                direction = next;
                let ahead: Vec<f64> = (0..n).map(|i| q[i] + STRIDE * direction[i]).collect();
                let Ok(refined) = model.refine(target, &ahead, config, ws) else { break };
                let forward: f64 = (0..n).map(|i| (refined[i] - q[i]) * direction[i]).sum();
                let back =
                    all.iter().any(|k| k.iter().zip(&refined).all(|(a, b)| (a - b).abs() < 0.3 * STRIDE));
                if forward < 0.3 * STRIDE || back {
                    break;
                }
                all.push(refined.clone());
                q = refined;
            }
        }
    }
    Ok(all)
}

/// The null-space direction of the tool's Jacobian with largest entry 1, nearest to `before` if given. `None` without a
/// null space.
fn idle_direction(
    model: &RobotModel,
    q: &[f64],
    before: Option<&JointVector>,
    ws: &mut Workspace,
) -> Option<JointVector> {
    let n = model.dof();
    let mut jacobian = Jacobian::default();
    model.forward_kinematics(q, ws);
    model.jacobian(model.tool, ws, &mut jacobian);
    let project = |d: &JointVector| -> JointVector {
        let (v, w) = jacobian.times(d);
        let back = pull_back(&jacobian, &[1.0; MAX_JOINTS], v, w).unwrap_or([0.0; MAX_JOINTS]);
        let mut idle = *d;
        (0..n).for_each(|i| idle[i] -= back[i]);
        idle
    };
    let largest = |d: &JointVector| d[..n].iter().fold(0.0f64, |m, x| m.max(x.abs()));
    let mut idle = match before {
        Some(d) => project(d),
        None => (0..n)
            .map(|i| {
                let mut unit = [0.0; MAX_JOINTS];
                unit[i] = 1.0;
                project(&unit)
            })
            .max_by(|a, b| largest(a).total_cmp(&largest(b)))?,
    };
    let size = largest(&idle);
    if size < 0.02 {
        return None;
    }
    idle.iter_mut().for_each(|x| *x /= size);
    Some(idle)
}

/// Returns the joint speeds with the smallest Σ (q̇ᵢ²/wᵢ) that give the tool the velocities `v` and `w`.
fn pull_back(jacobian: &Jacobian, weight: &JointVector, v: DVec3, w: DVec3) -> Option<JointVector> {
    let n = jacobian.dof;
    let mut gram = [[0.0; 6]; 6];
    for r in 0..6 {
        for s in 0..=r {
            gram[r][s] = (0..n).map(|i| jacobian.get(r, i) * weight[i] * jacobian.get(s, i)).sum();
        }
        gram[r][r] += 1e-9;
    }
    let mut right = [v.x, v.y, v.z, w.x, w.y, w.z];
    Cholesky::<6>::new(&gram, 6)?.solve(&mut right);
    let mut qd = [0.0; MAX_JOINTS];
    for i in 0..n {
        qd[i] = weight[i] * (0..6).map(|r| jacobian.get(r, i) * right[r]).sum::<f64>();
    }
    Some(qd)
}

/// Returns the joint speeds for given tool velocities with the smallest sum of squared shares of the speed limits.
pub(crate) fn easiest_speeds(
    model: &RobotModel,
    jacobian: &Jacobian,
    v: DVec3,
    w: DVec3,
) -> Option<JointVector> {
    let mut weight = [0.0; MAX_JOINTS];
    for (weight, joint) in weight.iter_mut().zip(&model.joints) {
        *weight = joint.limits.velocity * joint.limits.velocity;
    }
    pull_back(jacobian, &weight, v, w)
}

/// The largest share of a position limit (0 in the middle of the range) or speed limit that a posture uses at the
/// contact of a sweep, where the tool is fastest.
pub(crate) fn strain(model: &RobotModel, sweep: &Sweep, q: &[f64], ws: &mut Workspace) -> f64 {
    let mut jacobian = Jacobian::default();
    model.forward_kinematics(q, ws);
    model.jacobian(model.tool, ws, &mut jacobian);
    let mut worst = 0.0f64;
    for (i, joint) in model.joints.iter().enumerate() {
        let l = &joint.limits;
        if l.lower.is_finite() && l.upper > l.lower {
            worst = worst.max((2.0 * q[i] - l.lower - l.upper).abs() / (l.upper - l.lower));
        }
    }
    let Some(qd) = easiest_speeds(model, &jacobian, sweep.speed * sweep.direction_w, DVec3::ZERO) else {
        return f64::INFINITY;
    };
    (0..model.dof()).map(|i| qd[i].abs() / model.joints[i].limits.velocity).fold(worst, f64::max)
}
