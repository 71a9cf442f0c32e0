//! The whole strike: from home to the start of the sweep, the sweep, and away from it.

use crate::linalg::MAX_JOINTS;
use crate::model::RobotModel;
use crate::motion::{JointMotion, JointSample, LimitKind, joint_move, motor_torques, roll_out};
use crate::shape::Obstacle;
use crate::strike::{StrikeConfig, StrikeError, SweepPlan, blocked, plan_sweep};
use crate::sweep::{LinePath, Sweep};
use crate::workspace::{JointVector, Workspace};
use serde::{Deserialize, Serialize};

/// What a part of a strike's motion is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Phase {
    /// From home to above the start, joint by joint.
    Approach,
    /// Straight down to the start.
    Descent,
    /// The sweep.
    Sweep,
    /// Straight up after the sweep.
    Lift,
}

/// A whole strike, from home to the lift after it.
#[derive(Debug, Clone, PartialEq)]
pub struct StrikePlan {
    /// The sweep.
    pub sweep: SweepPlan,
    /// All motions in their order; each begins and ends at rest, where the one before it ended.
    pub phases: Vec<(Phase, JointMotion)>,
}

impl StrikePlan {
    /// When the sweep begins, seconds from the start of the approach.
    pub fn sweep_start_s(&self) -> f64 {
        self.phases.iter().take_while(|(p, _)| *p != Phase::Sweep).map(|(_, m)| m.duration_s()).sum()
    }

    /// When the tool is at the contact, seconds from the start of the approach.
    pub fn contact_s(&self) -> f64 {
        self.sweep_start_s() + self.sweep.sweep.contact_s()
    }
}

/// Plans the whole strike: approach, descent, sweep and lift. Obstacles are noticed in the sweep; what the rest of the
/// motion comes near is for [`crate::check_strike`] to say.
///
/// # Errors
/// [`StrikeError`].
pub fn plan_strike(
    model: &RobotModel,
    sweep: &Sweep,
    obstacles: &[Obstacle],
    config: &StrikeConfig,
    ws: &mut Workspace,
) -> Result<StrikePlan, StrikeError> {
    let mut plan = plan_sweep(model, sweep, obstacles, config, ws)?;
    let n = model.dof();
    let rate = config.osc.torque_rate;
    // Of the tool as it is held.
    let (path, held) = (plan.path(), plan.sweep);
    let sweep = &held;
    plan.motion = roll_out(model, &path, &plan.q_start, &plan.q_start, &config.osc, config.period_s);
    plan.uses = plan.motion.check(model, rate)?;
    let first = plan.motion.samples[0].q;
    let last = plan.motion.samples[plan.motion.samples.len() - 1].q;
    let descents: Vec<JointMotion> =
        lifts(model, &first, sweep, config, ws).iter().map(|m| m.reversed(model, ws)).collect();
    // Lower descents where the highest, or the way to it, meets something.
    let mut found: Option<(bool, JointMotion, JointMotion)> = None;
    for descent in descents {
        let above = descent.samples[0].q;
        let to = (model.home(), &above[..n]);
        let Ok(approach) =
            joint_move(model, to.0, to.1, config.approach_share, rate, 0.5, config.period_s, ws)
        else {
            continue;
        };
        let clear = [&approach, &descent]
            .into_iter()
            .all(|m| blocked(model, m, obstacles, config.clearance_m, ws).is_none());
        if clear || found.is_none() {
            found = Some((clear, approach, descent));
        }
        if clear {
            break;
        }
    }
    let (approach, descent) = match found {
        Some((_, approach, descent)) => (approach, descent),
        // From home straight to the start, with the reason when even that fails.
        None => {
            let share = config.approach_share;
            let to_start =
                joint_move(model, model.home(), &first[..n], share, rate, 0.5, config.period_s, ws)?;
            (to_start, standing(model, &first, config.period_s, ws))
        }
    };
    let raised = lifts(model, &last, sweep, config, ws);
    // Where every lift meets something the arm stays where it is.
    let lift = raised
        .into_iter()
        .find(|m| blocked(model, m, obstacles, config.clearance_m, ws).is_none())
        .unwrap_or_else(|| standing(model, &last, config.period_s, ws));
    let phases = vec![
        (Phase::Approach, approach),
        (Phase::Descent, descent),
        (Phase::Sweep, plan.motion.clone()),
        (Phase::Lift, lift),
    ];
    Ok(StrikePlan { sweep: plan, phases })
}

/// Motions straight up from a posture that keep all limits, the highest first: by the height of the settings, a half, a
/// quarter and an eighth of it.
fn lifts(
    model: &RobotModel,
    q: &JointVector,
    sweep: &Sweep,
    config: &StrikeConfig,
    ws: &mut Workspace,
) -> Vec<JointMotion> {
    let q = &q[..model.dof()];
    model.forward_kinematics(q, ws);
    let start = model.frame_pose(model.tool(), ws);
    let mut found = Vec::new();
    for halvings in 0..4 {
        let by_w = config.approach_height_m * 0.5f64.powi(halvings) * sweep.up_w.normalize();
        let mut duration_s = 1.2;
        for _ in 0..4 {
            let path = LinePath { start, by_w, duration_s };
            let motion = roll_out(model, &path, q, q, &config.osc, config.period_s);
            match motion.check(model, config.osc.torque_rate) {
                Ok(_) => {
                    found.push(motion);
                    break;
                }
                // No slower motion stays within a limit of position.
                Err(e) if e.limit == LimitKind::Position => break,
                Err(_) => duration_s *= 1.5,
            }
        }
    }
    found
}

/// No motion.
fn standing(model: &RobotModel, q: &JointVector, period_s: f64, ws: &mut Workspace) -> JointMotion {
    let zero = [0.0; MAX_JOINTS];
    let tau = motor_torques(model, q, &zero, &zero, ws);
    JointMotion { period_s, samples: vec![JointSample { q: *q, qd: zero, qdd: zero, tau }] }
}
