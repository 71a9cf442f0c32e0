//! The whole strike: from home to the start of the sweep, the sweep, and away from it.

use crate::arm::control::osc::TaskLaw;
use crate::arm::dynamics::linalg::MAX_JOINTS;
use crate::arm::dynamics::workspace::{JointVector, Workspace};
use crate::arm::model::RobotModel;
use crate::arm::shape::{Clearance, Obstacle};
use crate::arm::strike::motion::{
    Following, JointMotion, JointSample, LimitKind, Meter, SETTLE_S, joint_move, motor_torques, roll_out,
    within_limits,
};
use crate::arm::strike::sweep::{LinePath, Sweep};
use crate::arm::strike::sweep_plan::{StrikeConfig, StrikeError, SweepPlan, blocked_every, plan_sweep_where};
use glamx::DVec3;
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

/// [`plan_sweep`] that takes only what the arm can start: from home to above the start, and down to it, without links coming
/// too near each other or an obstacle. Other postures, other holds of the tool and other descents are tried before a strike
/// is refused. The way is worked out in coarse steps; [`crate::check_strike`] has the last word.
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
    let may = |plan: &SweepPlan, ws: &mut Workspace| {
        let way = way_to_start(model, &plan.q_start, &plan.sweep, obstacles, config, &COARSE, ws)?;
        way.blocked.map_or(Ok(()), |(phase, clearance)| Err(StrikeError::Unstartable { clearance, phase }))
    };
    plan_sweep_where(model, sweep, obstacles, config, Some(&may), ws)
}

/// Plans the whole strike: approach, descent, sweep and lift. Obstacles are noticed in the sweep, and, in coarse steps, on the
/// way to its start; what the motion comes near in the end is for [`crate::check_strike`] to say.
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
    // Of the tool as it is held.
    let (path, held) = (plan.path(), plan.sweep);
    let sweep = &held;
    plan.motion = roll_out(model, &path, &plan.q_start, &plan.q_start, &config.osc, config.period_s);
    plan.uses = plan.motion.check(model, rate)?;
    let last = plan.motion.samples[plan.motion.samples.len() - 1].q;
    let fine = Detail { period_s: config.period_s, settle: true, look_s: 0.01 };
    let way = way_to_start(model, &plan.q_start, sweep, obstacles, config, &fine, ws)?;
    let lift = ways_up(sweep, config)
        .into_iter()
        .take(STRAIGHT_UP)
        .find_map(|by_w| {
            let up = lift(model, &last, by_w, config, &fine, ws)?;
            let near = blocked_every(model, &up, fine.look_s, obstacles, false, config.clearance_m, ws);
            near.is_none().then_some(up)
        })
        // Where every lift meets something the arm stays where it is.
        .unwrap_or_else(|| standing(model, &last, config.period_s, ws));
    let phases = vec![
        (Phase::Approach, way.approach),
        (Phase::Descent, way.descent),
        (Phase::Sweep, plan.motion.clone()),
        (Phase::Lift, lift),
    ];
    Ok(StrikePlan { sweep: plan, phases })
}

/// How finely a way is worked out.
struct Detail {
    /// Time between samples, seconds.
    period_s: f64,
    /// Whether the joints' coming to rest is waited for.
    settle: bool,
    /// Time between the postures whose distances are looked at, seconds.
    look_s: f64,
}

/// For strikes that are only looked at: half of the time that their sweep takes to plan.
const COARSE: Detail = Detail { period_s: 0.02, settle: false, look_s: 0.05 };

/// From home to the start of a sweep.
struct Way {
    approach: JointMotion,
    descent: JointMotion,
    /// What is in the way, where every way has something: of the highest.
    blocked: Option<(Phase, Clearance)>,
}

/// The first way to the start that is clear; the first of all where none is.
fn way_to_start(
    model: &RobotModel,
    q_start: &[f64],
    sweep: &Sweep,
    obstacles: &[Obstacle],
    config: &StrikeConfig,
    detail: &Detail,
    ws: &mut Workspace,
) -> Result<Way, StrikeError> {
    let n = model.dof();
    let mut first = [0.0; MAX_JOINTS];
    first[..n].copy_from_slice(q_start);
    let (share, rate) = (config.approach_share, config.osc.torque_rate);
    let mut found: Option<Way> = None;
    for by_w in ways_up(sweep, config) {
        let Some(up) = lift(model, &first, by_w, config, detail, ws) else { continue };
        let near = |m: &JointMotion, phase: Phase, ws: &mut Workspace| {
            let (clearance, _) =
                blocked_every(model, m, detail.look_s, obstacles, true, config.clearance_m, ws)?;
            Some((phase, clearance))
        };
        let on_descent = near(&up, Phase::Descent, ws);
        if on_descent.is_some() && found.is_some() {
            continue;
        }
        let descent = up.reversed(model, ws);
        let above = descent.samples[0].q;
        let Ok(approach) =
            joint_move(model, model.home(), &above[..n], share, rate, 0.5, detail.period_s, ws)
        else {
            continue;
        };
        let blocked = on_descent.or_else(|| near(&approach, Phase::Approach, ws));
        let clear = blocked.is_none();
        if clear || found.is_none() {
            found = Some(Way { approach, descent, blocked });
        }
        if clear {
            break;
        }
    }
    if let Some(way) = found {
        return Ok(way);
    }
    // From home straight to the start, with the reason when even that fails.
    let approach = joint_move(model, model.home(), q_start, share, rate, 0.5, detail.period_s, ws)?;
    let blocked = blocked_every(model, &approach, detail.look_s, obstacles, true, config.clearance_m, ws)
        .map(|(clearance, _)| (Phase::Approach, clearance));
    Ok(Way { approach, descent: standing(model, &first, detail.period_s, ws), blocked })
}

/// The first of [`ways_up`] are straight up.
const STRAIGHT_UP: usize = 4;

/// Ways away from the start, metres in the world, the reverse of which are descents: straight up by the height of the
/// settings, a half, a quarter and an eighth of it; then slanted away from the struck body, by as much back as up.
fn ways_up(sweep: &Sweep, config: &StrikeConfig) -> Vec<DVec3> {
    let up = config.approach_height_m * sweep.up_w.normalize();
    let back = -config.approach_height_m * sweep.direction_w;
    let straight = (0..STRAIGHT_UP as i32).map(|halvings| 0.5f64.powi(halvings) * up);
    let slanted = (1..4).map(|halvings| 0.5f64.powi(halvings) * (up + back));
    straight.chain(slanted).collect()
}

/// The motion from a posture straight by `by_w` that keeps all limits; `None` where there is none.
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
        let mut motion = Following::new(model, &path, q, q, &config.osc, detail.period_s, settle_s);
        let mut meter = Meter::new(model, config.osc.torque_rate, motion.period_s);
        let mut broken = None;
        while broken.is_none() {
            let Some(sample) = motion.advance(&mut law) else { break };
            meter.note(sample);
            broken = within_limits(model, meter.uses).err();
        }
        match broken {
            None => return Some(motion.into_motion()),
            // No slower motion stays within a limit of position.
            Some(e) if e.limit == LimitKind::Position => return None,
            Some(_) => duration_s *= 1.5,
        }
    }
    None
}

/// No motion.
fn standing(model: &RobotModel, q: &JointVector, period_s: f64, ws: &mut Workspace) -> JointMotion {
    let zero = [0.0; MAX_JOINTS];
    let tau = motor_torques(model, q, &zero, &zero, ws);
    JointMotion { period_s, samples: vec![JointSample { q: *q, qd: zero, qdd: zero, tau }] }
}
