//! The whole strike: approach, descent, sweep and lift.

use crate::arm::dynamics::workspace::joint_vector;
use crate::arm::osc::TaskLaw;
use crate::arm::shape::Clearance;
use crate::arm::strike::motion::{
    JointMove, JointSample, Meter, SETTLE_S, StepwiseRollout, motor_torques, roll_out, within_limits,
};
use crate::arm::strike::sweep::LinePath;
use crate::arm::strike::sweep_plan::{ReachProblem, plan_sweep_where};
use crate::{
    JointMotion, JointVector, LimitKind, MAX_JOINTS, Obstacle, RobotModel, StrikeConfig, StrikeError, Sweep,
    SweepPlan, Workspace,
};
use glamx::DVec3;
use serde::{Deserialize, Serialize};

/// Phase of a strike's motion.
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

/// A whole strike, from home to the lift.
#[derive(Debug, Clone, PartialEq)]
pub struct StrikePlan {
    /// The sweep.
    pub sweep: SweepPlan,
    /// All motions in order; each begins and ends at rest and starts at the end of the preceding one.
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

/// Runs [`plan_sweep`], but accepts only sweeps whose start the arm can reach from home without a collision. Other
/// postures, holds of the tool and descents are tried before the function fails. The approach is checked in coarse
/// steps; [`crate::check_strike`] makes the final check.
///
/// # Errors
/// [`StrikeError`].
///
/// [`plan_sweep`]: crate::plan_sweep
pub fn plan_startable_sweep(
    model: &RobotModel,
    sweep: &Sweep,
    obstacles: &[Obstacle],
    config: &StrikeConfig,
    ws: &mut Workspace,
) -> Result<SweepPlan, StrikeError> {
    let problem = ReachProblem { model, sweep, obstacles, config };
    let accept = |plan: &SweepPlan, ws: &mut Workspace| {
        let held = ReachProblem { sweep: &plan.sweep, ..problem };
        let way = approach_path(&held, &plan.q_start, &COARSE, ws)?;
        way.blocked.map_or(Ok(()), |(phase, clearance)| Err(StrikeError::Unstartable { clearance, phase }))
    };
    plan_sweep_where(&problem, Some(&accept), ws)
}

/// Plans the whole strike: approach, descent, sweep and lift. The sweep is checked for collisions, and the approach in
/// coarse steps; [`crate::check_strike`] checks the whole motion.
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
    let mut plan = plan_startable_sweep(model, sweep, obstacles, config, ws)?;
    let rate = config.osc.torque_rate;
    // The sweep with the chosen hold of the tool.
    let (path, held) = (plan.path(), plan.sweep);
    let problem = ReachProblem { model, sweep: &held, obstacles, config };
    plan.motion = roll_out(model, &path, &plan.q_start, &config.osc, config.period_s, SETTLE_S);
    plan.uses = plan.motion.check(model, rate)?;
    let last = plan.motion.samples[plan.motion.samples.len() - 1].q;
    let fine = Detail { period_s: config.period_s, settle: true, interval_s: 0.01 };
    let way = approach_path(&problem, &plan.q_start, &fine, ws)?;
    let check = problem.clearance_check(fine.interval_s, false);
    let lift = ways_up(&held, config)
        .into_iter()
        .take(STRAIGHT_UP)
        .find_map(|by_w| {
            let up = lift(model, &last, by_w, config, &fine, ws)?;
            check.first_violation(model, &up, ws).is_none().then_some(up)
        })
        // Without a clear lift the arm stays where it is.
        .unwrap_or_else(|| standing(model, &last, config.period_s, ws));
    let phases = vec![
        (Phase::Approach, way.approach),
        (Phase::Descent, way.descent),
        (Phase::Sweep, plan.motion.clone()),
        (Phase::Lift, lift),
    ];
    Ok(StrikePlan { sweep: plan, phases })
}

/// Resolution of an approach.
struct Detail {
    /// Time between samples, seconds.
    period_s: f64,
    /// Whether the joints come to rest after the path.
    settle: bool,
    /// Time between checked postures, seconds.
    interval_s: f64,
}

/// Resolution for strikes that are only evaluated; it takes half the time of planning their sweep.
const COARSE: Detail = Detail { period_s: 0.02, settle: false, interval_s: 0.05 };

/// From home to the start of a sweep.
struct ApproachPath {
    approach: JointMotion,
    descent: JointMotion,
    /// The first obstruction on the highest descent, if every approach has one.
    blocked: Option<(Phase, Clearance)>,
}

/// Finds the first clear approach to the start of the sweep, or the first one if none is clear.
fn approach_path(
    problem: &ReachProblem<'_>,
    q_start: &[f64],
    detail: &Detail,
    ws: &mut Workspace,
) -> Result<ApproachPath, StrikeError> {
    let ReachProblem { model, sweep, config, .. } = *problem;
    let check = problem.clearance_check(detail.interval_s, true);
    let n = model.dof();
    let first = joint_vector(q_start);
    let from_home = |to: &[f64], ws: &mut Workspace| {
        let approach = JointMove {
            from: model.home(),
            to,
            limit_share: config.approach_share,
            torque_rate: config.osc.torque_rate,
            min_duration_s: 0.5,
            period_s: detail.period_s,
        };
        approach.plan(model, ws)
    };
    let mut found: Option<ApproachPath> = None;
    for by_w in ways_up(sweep, config) {
        let Some(up) = lift(model, &first, by_w, config, detail, ws) else { continue };
        let near = |m: &JointMotion, phase: Phase, ws: &mut Workspace| {
            check.first_violation(model, m, ws).map(|(clearance, _)| (phase, clearance))
        };
        let on_descent = near(&up, Phase::Descent, ws);
        if on_descent.is_some() && found.is_some() {
            continue;
        }
        let descent = up.reversed(model, ws);
        let above = descent.samples[0].q;
        let Ok(approach) = from_home(&above[..n], ws) else { continue };
        let blocked = on_descent.or_else(|| near(&approach, Phase::Approach, ws));
        let clear = blocked.is_none();
        if clear || found.is_none() {
            found = Some(ApproachPath { approach, descent, blocked });
        }
        if clear {
            break;
        }
    }
    if let Some(way) = found {
        return Ok(way);
    }
    // Directly from home to the start; returns the error if that fails too.
    let approach = from_home(q_start, ws)?;
    let blocked =
        check.first_violation(model, &approach, ws).map(|(clearance, _)| (Phase::Approach, clearance));
    Ok(ApproachPath { approach, descent: standing(model, &first, detail.period_s, ws), blocked })
}

/// Number of straight lifts at the beginning of [`ways_up`].
const STRAIGHT_UP: usize = 4;

/// Returns lifts from the start, metres in the world; descents are their reverse. The first go straight up by the
/// configured height, a half, a quarter and an eighth of it. The others are slanted away from the struck body at 45°.
fn ways_up(sweep: &Sweep, config: &StrikeConfig) -> Vec<DVec3> {
    let up = config.approach_height_m * sweep.up_w.normalize();
    let back = -config.approach_height_m * sweep.direction_w;
    let straight = (0..STRAIGHT_UP as i32).map(|halvings| 0.5f64.powi(halvings) * up);
    let slanted = (1..4).map(|halvings| 0.5f64.powi(halvings) * (up + back));
    straight.chain(slanted).collect()
}

/// Plans the straight motion by `by_w` from a posture, within all limits; `None` if there is none.
fn lift(
    model: &RobotModel,
    q: &JointVector,
    by_w: DVec3,
    config: &StrikeConfig,
    detail: &Detail,
    ws: &mut Workspace,
) -> Option<JointMotion> {
    let q = &q[..model.dof()];
    model.forward_kinematics(q, ws);
    let start = model.frame_pose(model.tool(), ws);
    let mut duration_s = 1.2;
    let mut law = TaskLaw::default();
    for _ in 0..4 {
        let path = LinePath { start, by_w, duration_s };
        let settle_s = if detail.settle { SETTLE_S } else { 0.0 };
        let mut motion = StepwiseRollout::new(model, &path, q, &config.osc, detail.period_s, settle_s);
        let mut meter = Meter::new(model, config.osc.torque_rate, motion.period_s);
        let mut broken = None;
        while broken.is_none() {
            let Some(sample) = motion.advance(&mut law) else { break };
            meter.note(sample);
            broken = within_limits(model, meter.uses).err();
        }
        match broken {
            None => return Some(motion.into_motion()),
            // A slower motion breaks a position limit too.
            Some(e) if e.limit == LimitKind::Position => return None,
            Some(_) => duration_s *= 1.5,
        }
    }
    None
}

/// A motion of one sample, at rest.
fn standing(model: &RobotModel, q: &JointVector, period_s: f64, ws: &mut Workspace) -> JointMotion {
    let zero = [0.0; MAX_JOINTS];
    let tau = motor_torques(model, q, &zero, &zero, ws);
    JointMotion { period_s, samples: vec![JointSample { q: *q, qd: zero, qdd: zero, tau }] }
}
