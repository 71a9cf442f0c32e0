//! Planning of a sweep within the arm's limits.

use crate::arm::dynamics::ik::LENGTH_M;
use crate::arm::osc::TaskLaw;
use crate::arm::shape::Clearance;
use crate::arm::strike::hold::{Hold, groups, tool_blocked};
use crate::arm::strike::motion::roll_out;
use crate::arm::strike::obstruction::ClearanceCheck;
use crate::arm::strike::posture::{postures, strain};
use crate::arm::strike::sweep::SweepPath;
use crate::arm::strike::sweep_candidate::SweepCandidate;
use crate::{
    IkConfig, Infeasible, JointMotion, LimitKind, Obstacle, Osc, OscConfig, Phase, RobotModel, Sweep,
    ToolPath, Unreachable, Uses, Workspace,
};
use glamx::{DPose3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// Settings of the strike planner.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StrikeConfig {
    /// The controller of the sweep; its gains also shape the null-space motion.
    pub osc: OscConfig,
    /// Inverse kinematics at the contact; arms of six joints or fewer get eight times as many starts.
    pub ik: IkConfig,
    /// Number of postures for which a sweep is computed.
    pub candidates: usize,
    /// Whether the tool may be rotated about its z axis: by half a turn, and with `turned_tool` by a quarter.
    pub symmetric_tool: bool,
    /// Whether the tool may lean to a side if it cannot pass upright.
    pub turned_tool: bool,
    /// Half extents of the striking box about the tool's origin, in the tool's frame, metres. Its front face, `x` ahead
    /// of the origin, makes the contact.
    pub half_m: DVec3,
    /// Whether that box is checked for collisions besides the link shapes; the FR3's shapes include its fist.
    pub box_is_checked: bool,
    /// Clearance between links and to obstacles, metres.
    pub clearance_m: f64,
    /// Height of the descent before the sweep and of the lift after it, metres.
    pub approach_height_m: f64,
    /// Share of the speed and torque limits that the approach may use.
    pub approach_share: f64,
    /// Time between samples of a motion, seconds; a program interpolates between them.
    pub period_s: f64,
}

impl Default for StrikeConfig {
    fn default() -> Self {
        Self {
            osc: OscConfig::default(),
            ik: IkConfig { starts: 8, ..IkConfig::default() },
            candidates: 6,
            symmetric_tool: true,
            turned_tool: true,
            half_m: crate::FIST_HALF,
            box_is_checked: false,
            clearance_m: 0.002,
            approach_height_m: 0.2,
            approach_share: 0.5,
            period_s: 0.0025,
        }
    }
}

/// Largest number of rounds of `candidates` postures, if sweeps are feasible but their start is not reachable.
const MOST_ROUNDS: usize = 3;

/// A sweep that uses less than this share of every limit in coarse steps stays within them in fine steps.
pub(crate) const COARSE_ENOUGH: f64 = 0.8;

/// Largest distance by which another hold moves the wrist, metres.
const HOLD_REACH_M: f64 = 0.15;

/// Why a strike cannot be executed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum StrikeError {
    /// No posture reaches the contact, or the start of the sweep.
    #[error(transparent)]
    Unreachable(#[from] Unreachable),
    /// The sweep exceeds a limit in every posture.
    #[error(transparent)]
    Infeasible(#[from] Infeasible),
    /// The request is invalid.
    #[error("the strike is invalid: {what}")]
    Invalid {
        /// The fault.
        what: String,
    },
    /// An obstacle blocks the sweep in every posture that stays within the limits.
    #[error("the robot's {} would come within {:.1} mm of {} at {at_s:.3} s of the sweep", .clearance.link, 1e3 * .clearance.distance_m, .clearance.other)]
    Blocked {
        /// The pair that comes too near.
        clearance: Clearance,
        /// Time from the start of the sweep, seconds.
        at_s: f64,
    },
    /// The sweep is feasible, but the way to its start is blocked in every feasible posture.
    #[error("the robot's {} would come within {:.1} mm of {} in the {} before the sweep", .clearance.link, 1e3 * .clearance.distance_m, .clearance.other, .phase.name())]
    Unstartable {
        /// The pair that comes too near.
        clearance: Clearance,
        /// Phase of the collision.
        phase: Phase,
    },
}

impl StrikeError {
    /// Returns whether another hold of the tool may succeed. Speeds and torques hardly depend on the hold. No hold
    /// reaches a target far out of reach.
    fn depends_on_the_hold(&self) -> bool {
        match self {
            Self::Unreachable(e) => e.position_error_m < HOLD_REACH_M,
            Self::Infeasible(e) => e.limit == LimitKind::Position,
            Self::Blocked { .. } | Self::Unstartable { .. } => true,
            Self::Invalid { .. } => false,
        }
    }

    /// Returns the reason without numbers, for counting.
    pub fn reason(&self) -> String {
        match self {
            Self::Unreachable(_) => "no posture reaches it".to_owned(),
            Self::Infeasible(e) => {
                let limit = match e.limit {
                    LimitKind::Position => "its limit",
                    LimitKind::Velocity => "its limit of speed",
                    LimitKind::Torque => "its limit of torque",
                    LimitKind::TorqueRate => "its limit of the change of torque",
                };
                format!("{} would be beyond {limit}", e.joint)
            }
            Self::Blocked { clearance, .. } => {
                format!("{} would come too near {}", clearance.link, clearance.other)
            }
            Self::Unstartable { clearance, .. } => {
                format!("{} would come too near {} on the way to the start", clearance.link, clearance.other)
            }
            Self::Invalid { .. } => "there is no such strike".to_owned(),
        }
    }

    /// Returns the remedy.
    pub fn cure(&self) -> &'static str {
        match self {
            Self::Unreachable(_) => {
                "move or rotate the robot's base so that the strike is within reach (`x_world_robot` or `x_recording_robot` of [robot], or --at)"
            }
            // A slower strike does not help against a position limit.
            Self::Infeasible(e) if e.limit == LimitKind::Position => {
                "place the robot so that the strike is nearer to the middle of its reach, 0.4 to 0.6 m in front of it \
                 (`x_world_robot` or `x_recording_robot` of [robot], or --at)"
            }
            Self::Infeasible(_) => {
                "lower the task's speeds, or place the robot so that the strike goes across its front rather than towards or \
                 away from it (`x_world_robot` of [robot], or --at)"
            }
            Self::Blocked { .. } => {
                "place the robot on another side of the struck body (`x_world_robot` of [robot], or --at), or remove the \
                 obstacles beside it; all holds of the tool were tried (docs/book/src/reference/strikes.md)"
            }
            Self::Unstartable { .. } => {
                "place the robot 0.1 to 0.2 m further away from the struck body (`x_world_robot` of [robot], or --at), or \
                 remove the obstacles between; all postures and holds of the tool were tried (docs/book/src/reference/strikes.md)"
            }
            Self::Invalid { .. } => "check the task's action and the settings of [robot]",
        }
    }
}

/// A feasible sweep.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepPlan {
    /// The requested sweep. For a hold other than upright, it is shifted so that the front side touches at the same
    /// place.
    pub sweep: Sweep,
    /// Attitude of the tool.
    pub rotation_w: DQuat,
    /// Posture at the start, also the null-space posture.
    pub q_start: Vec<f64>,
    /// Joint motion of the sweep; in a [`crate::StrikePlan`] also the settling after it, until all joints are at rest.
    pub motion: JointMotion,
    /// Uses of the limits.
    pub uses: Uses,
}

impl SweepPlan {
    /// The tool's motion.
    pub fn path(&self) -> SweepPath {
        self.sweep.path(self.rotation_w)
    }

    /// Returns the controller of the sweep for a robot at rest at its start.
    pub fn controller(&self, model: &RobotModel, config: &OscConfig, ws: &mut Workspace) -> Osc {
        Osc::holding(model, *config, &self.q_start, ws)
    }
}

/// Plans the joint motion of a sweep. Postures at the contact come from inverse kinematics; from each, the control law
/// is integrated over the sweep, and the motion farthest from all limits is returned. If the upright tool fails because
/// of a collision or a position limit, the tool is rotated by a quarter turn or leaned to a side.
///
/// # Errors
/// [`StrikeError`] of the posture that came closest to success with the upright tool, or of a hold that failed at a
/// limit that no hold can avoid.
pub fn plan_sweep(
    model: &RobotModel,
    sweep: &Sweep,
    obstacles: &[Obstacle],
    config: &StrikeConfig,
    ws: &mut Workspace,
) -> Result<SweepPlan, StrikeError> {
    plan_sweep_where(&ReachProblem { model, sweep, obstacles, config }, None, ws)
}

/// A strike to plan.
#[derive(Clone, Copy)]
pub(crate) struct ReachProblem<'a> {
    pub(crate) model: &'a RobotModel,
    /// The sweep of an upright tool.
    pub(crate) sweep: &'a Sweep,
    pub(crate) obstacles: &'a [Obstacle],
    pub(crate) config: &'a StrikeConfig,
}

impl<'a> ReachProblem<'a> {
    /// The clearance check of motions, with postures at most `interval_s` seconds apart.
    pub(crate) fn clearance_check(&self, interval_s: f64, with_struck: bool) -> ClearanceCheck<'a> {
        let (obstacles, clearance_m) = (self.obstacles, self.config.clearance_m);
        ClearanceCheck { obstacles, with_struck, clearance_m, interval_s }
    }

    /// The clearance check of a sweep.
    pub(crate) fn sweep_check(&self) -> ClearanceCheck<'a> {
        self.clearance_check(0.1, false)
    }
}

/// Accepts a feasible sweep, or returns the reason to refuse it.
pub(crate) type Accept<'a> = &'a dyn Fn(&SweepPlan, &mut Workspace) -> Result<(), StrikeError>;

/// Like [`plan_sweep`], but also skips sweeps that `accept` rejects, and then tries other postures and holds. With
/// `accept`, a sweep that stays far from all limits keeps its motion of coarse steps.
pub(crate) fn plan_sweep_where(
    problem: &ReachProblem<'_>,
    accept: Option<Accept<'_>>,
    ws: &mut Workspace,
) -> Result<SweepPlan, StrikeError> {
    let config = problem.config;
    refuse_nonsense(problem.sweep, config)?;
    let mut upright: Option<StrikeError> = None;
    // There are many other holds, so each gets fewer starts.
    let ik = IkConfig { starts: config.ik.starts.div_ceil(2), ..config.ik };
    let fewer = StrikeConfig { ik, candidates: config.candidates.div_ceil(2), ..config.clone() };
    for holds in groups(config.symmetric_tool, config.turned_tool) {
        let config = if upright.is_none() { config } else { &fewer };
        match plan_held(&ReachProblem { config, ..*problem }, &holds, accept, ws) {
            Ok(plan) => return Ok(plan),
            Err((e, may_another_do)) => {
                if !may_another_do {
                    return Err(e);
                }
                upright.get_or_insert(e);
            }
        }
    }
    Err(upright.unwrap_or_else(|| StrikeError::Invalid { what: "no hold of the tool was tried".to_owned() }))
}

/// Runs [`plan_sweep`] for several holds of the tool. The error says whether another hold may succeed.
fn plan_held(
    problem: &ReachProblem<'_>,
    holds: &[Hold],
    accept: Option<Accept<'_>>,
    ws: &mut Workspace,
) -> Result<SweepPlan, (StrikeError, bool)> {
    let ReachProblem { model, sweep: upright, obstacles, config } = *problem;
    // The postures of a redundant arm form families, found from a few starts; those of other arms are isolated.
    let starts = config.ik.starts * if model.dof() > 6 { 1 } else { 8 };
    let ik = IkConfig { starts, ..config.ik };
    let mut all: Vec<(f64, SweepPath, Vec<f64>)> = Vec::new();
    let mut unreachable: Option<Unreachable> = None;
    let mut refused: Option<(f64, StrikeError)> = None;
    let mut blocked_tool = false;
    for hold in holds {
        let sweep = hold.sweep(upright, config.half_m);
        let path = sweep.path(hold.rotation_w(&sweep));
        // No posture avoids a collision of the hand itself.
        let striking = config.box_is_checked.then_some(config.half_m);
        if let Some((clearance, at_s)) = tool_blocked(model, &path, striking, obstacles, config.clearance_m) {
            keep_better(&mut refused, f64::INFINITY, StrikeError::Blocked { clearance, at_s });
            blocked_tool = true;
            continue;
        }
        let at_contact = DPose3::from_parts(sweep.contact_w, path.rotation_w);
        match postures(model, &at_contact, &ik, ws) {
            Ok(found) => all.extend(found.into_iter().map(|q| (strain(model, &sweep, &q, ws), path, q))),
            Err(e) => keep_nearest(&mut unreachable, e),
        }
    }
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    // Skips postures that are nearly equal.
    let mut followed: Vec<Vec<f64>> = Vec::new();
    let mut all = all.into_iter();
    let mut law = TaskLaw::default();
    for round in 1..=MOST_ROUNDS {
        // Errors by posture; `None` while undecided or feasible.
        let mut refusals: Vec<Option<(f64, StrikeError)>> = Vec::new();
        let mut running: Vec<(usize, SweepPath, Vec<f64>)> = Vec::new();
        while followed.len() < round * config.candidates.max(1) {
            let Some((strain, path, q_contact)) = all.next() else { break };
            if followed.iter().any(|f| f.iter().zip(&q_contact).all(|(a, b)| (a - b).abs() < 0.2)) {
                continue;
            }
            if let Some(clearance) = problem.sweep_check().violation(model, &q_contact, ws) {
                let at_s = path.sweep.contact_s();
                refusals.push(Some((strain, StrikeError::Blocked { clearance, at_s })));
                continue;
            }
            match model.refine(&path.at(0.0).x_wt, &q_contact, &config.ik, ws) {
                Ok(q_start) => {
                    running.push((refusals.len(), path, q_start));
                    refusals.push(None);
                }
                Err(e) => keep_nearest(&mut unreachable, e),
            }
            followed.push(q_contact);
        }
        let mut running: Vec<SweepCandidate<'_>> = running
            .iter()
            .map(|(slot, path, q_start)| SweepCandidate::new(model, *slot, path, q_start, config))
            .collect();
        let mut unstartable = false;
        let mut late: Vec<(f64, StrikeError)> = Vec::new();
        while let Some(next) = SweepCandidate::take_best(&mut running, &mut law) {
            let (slot, badness) = (next.slot, next.limit_share());
            match next.into_plan(&problem.sweep_check(), ws) {
                Err(e) => refusals[slot] = Some((badness, e)),
                Ok(plan) => match refined(problem, plan, badness, accept, ws) {
                    Ok(plan) => return Ok(plan),
                    Err(e) => {
                        // Closer to success than a sweep that exceeds a limit.
                        let could_be_made = !matches!(e, StrikeError::Infeasible(_));
                        unstartable |= could_be_made;
                        late.push((if could_be_made { f64::NEG_INFINITY } else { f64::INFINITY }, e));
                    }
                },
            }
        }
        for (badness, e) in refusals.into_iter().flatten().chain(late) {
            keep_better(&mut refused, badness, e);
        }
        // Another round is worthwhile only if the sweep itself is feasible.
        if !unstartable {
            break;
        }
    }
    let e = match (refused, unreachable) {
        (Some((_, e)), _) => e,
        (None, Some(e)) => StrikeError::Unreachable(e),
        (None, None) => StrikeError::Invalid { what: "no posture was tried".to_owned() },
    };
    let may_another_do = blocked_tool || e.depends_on_the_hold();
    Err((e, may_another_do))
}

/// Recomputes the plan in fine steps if needed, and applies `accept`.
fn refined(
    problem: &ReachProblem<'_>,
    mut plan: SweepPlan,
    badness: f64,
    accept: Option<Accept<'_>>,
    ws: &mut Workspace,
) -> Result<SweepPlan, StrikeError> {
    let ReachProblem { model, config, .. } = *problem;
    if accept.is_none() || badness > COARSE_ENOUGH {
        let path = plan.path();
        let fine = config.period_s.max(path.duration_s() / 200.0);
        plan.motion = roll_out(model, &path, &plan.q_start, &config.osc, fine, 0.0);
        plan.uses = plan.motion.check(model, config.osc.torque_rate)?;
    }
    accept.map_or(Ok(()), |accept| accept(&plan, ws))?;
    Ok(plan)
}

fn keep_better(best: &mut Option<(f64, StrikeError)>, badness: f64, e: StrikeError) {
    if best.as_ref().is_none_or(|(b, _)| badness < *b) {
        *best = Some((badness, e));
    }
}

/// Refuses values that make durations infinite or directions undefined.
fn refuse_nonsense(sweep: &Sweep, config: &StrikeConfig) -> Result<(), StrikeError> {
    let finite = sweep.contact_w.is_finite() && sweep.direction_w.is_finite() && sweep.up_w.is_finite();
    let across = sweep.direction_w.cross(sweep.up_w).length();
    let what = if !finite {
        "its contact, direction or up vector is not finite".to_owned()
    } else if !(sweep.speed > 1e-3 && sweep.speed < 100.0) {
        format!("its speed is {} m/s", sweep.speed)
    } else if (sweep.direction_w.length() - 1.0).abs() > 1e-6 {
        format!("its direction is not a unit vector but has length {}", sweep.direction_w.length())
    } else if across < 1e-3 * sweep.up_w.length() || sweep.up_w.length() < 1e-9 {
        "its direction is vertical, or its up vector is zero".to_owned()
    } else if !(config.period_s > 1e-5 && config.osc.period_s > 1e-5 && config.approach_share > 0.0) {
        "period_s, osc.period_s and approach_share of the settings must be positive".to_owned()
    } else {
        return Ok(());
    };
    Err(StrikeError::Invalid { what })
}

fn keep_nearest(best: &mut Option<Unreachable>, e: Unreachable) {
    let measure = |u: &Unreachable| u.position_error_m + LENGTH_M * u.angle_error_rad;
    if best.as_ref().is_none_or(|b| measure(&e) < measure(b)) {
        *best = Some(e);
    }
}
