//! From an asked strike to a sweep that the arm can make, or the reason why there is none.

use crate::arm::control::osc::{Osc, OscConfig, TaskLaw};
use crate::arm::dynamics::ik::{IkConfig, IkTarget, Unreachable};
use crate::arm::dynamics::linalg::MAX_JOINTS;
use crate::arm::dynamics::workspace::Workspace;
use crate::arm::model::RobotModel;
use crate::arm::shape::{Clearance, Obstacle};
use crate::arm::strike::approach::Phase;
use crate::arm::strike::followed::Followed;
use crate::arm::strike::hold::{Hold, groups, tool_blocked};
use crate::arm::strike::motion::{Infeasible, JointMotion, LimitKind, Uses, follow};
use crate::arm::strike::posture::{postures, strain};
use crate::arm::strike::sweep::{Sweep, SweepPath, ToolPath};
use glamx::{DPose3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// Settings of the search for a strike's motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StrikeConfig {
    /// The controller that executes it; its gains also shape the motion in the null space.
    pub osc: OscConfig,
    /// Inverse kinematics of the posture at the contact; arms of six joints or fewer get eight times as many starts.
    pub ik: IkConfig,
    /// How many postures are followed through the sweep.
    pub candidates: usize,
    /// Whether the tool may be turned about its z axis: by half a turn, and, where it may be `turned`, by a quarter.
    pub symmetric_tool: bool,
    /// Whether the tool may be held otherwise than upright where it cannot pass upright: leaned to a side.
    pub turned_tool: bool,
    /// Half extents of the box about the tool's origin that strikes, in the tool's frame, metres. Sweeps are those of the
    /// front face, `x` ahead of the origin.
    pub half_m: DVec3,
    /// Whether that box is looked at beside the shapes of the robot's links. Those of the FR3's fist are among them.
    pub box_is_checked: bool,
    /// Distance that links keep from each other and from obstacles, metres.
    pub clearance_m: f64,
    /// Height from which the tool comes down to the start, and to which it is lifted after the sweep, metres.
    pub approach_height_m: f64,
    /// Share of the limits of speed and torque that the approach uses.
    pub approach_share: f64,
    /// Time between samples of the motions, seconds; a program interpolates between them.
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

/// How many times `candidates` postures are followed at most, where the first can make the sweep but not come to its start.
const MOST_ROUNDS: usize = 3;

/// A sweep that uses less than this share of every limit in coarse steps stays within them in fine ones.
pub(crate) const COARSE_ENOUGH: f64 = 0.8;

/// How far the wrist moves at most when the tool is held otherwise, metres.
const HOLD_REACH_M: f64 = 0.15;

/// Why a strike cannot be executed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum StrikeError {
    /// No posture puts the tool at the contact, or at the start of the sweep.
    #[error(transparent)]
    Unreachable(#[from] Unreachable),
    /// The sweep breaks a limit in every posture that was followed.
    #[error(transparent)]
    Infeasible(#[from] Infeasible),
    /// There is no such strike.
    #[error("this strike cannot be: {what}")]
    Invalid {
        /// What is wrong.
        what: String,
    },
    /// Something is in the way in every posture that keeps the limits.
    #[error("the robot's {} would come within {:.1} mm of {} at {at_s:.3} s of the sweep", .clearance.link, 1e3 * .clearance.distance_m, .clearance.other)]
    Blocked {
        /// What comes near what.
        clearance: Clearance,
        /// When, seconds from the start of the sweep.
        at_s: f64,
    },
    /// The sweep could be made, but something is in the way to its start in every posture that can make it.
    #[error("the robot's {} would come within {:.1} mm of {} in the {} before the sweep", .clearance.link, 1e3 * .clearance.distance_m, .clearance.other, .phase.name())]
    Unstartable {
        /// What comes near what.
        clearance: Clearance,
        /// On which part of the way.
        phase: Phase,
    },
}

impl StrikeError {
    /// Whether a tool that is held otherwise might do what this one cannot: speeds and torques hardly depend on how it is
    /// held, nor does what is far out of reach.
    fn depends_on_the_hold(&self) -> bool {
        match self {
            Self::Unreachable(e) => e.position_error_m < HOLD_REACH_M,
            Self::Infeasible(e) => e.limit == LimitKind::Position,
            Self::Blocked { .. } | Self::Unstartable { .. } => true,
            Self::Invalid { .. } => false,
        }
    }

    /// The reason without figures, for counting.
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

    /// What to do about it, in words.
    pub fn cure(&self) -> &'static str {
        match self {
            Self::Unreachable(_) => {
                "place the robot nearer or turned otherwise (`x_world_robot` or `x_recording_robot` of [robot], or --at)"
            }
            // No slower strike keeps a joint from its end.
            Self::Infeasible(e) if e.limit == LimitKind::Position => {
                "place the robot so that the strike is nearer to the middle of its reach, 0.4 to 0.6 m in front of it \
                 (`x_world_robot` or `x_recording_robot` of [robot], or --at)"
            }
            Self::Infeasible(_) => {
                "lower the task's speeds, or place the robot so that the strike goes across its front rather than towards or \
                 away from it (`x_world_robot` of [robot], or --at)"
            }
            Self::Blocked { .. } => {
                "place the robot on another side of the struck body (`x_world_robot` of [robot], or --at), or take away what \
                 stands beside that; all holds of the tool were tried (docs/robot.md, \"The strike\")"
            }
            Self::Unstartable { .. } => {
                "place the robot 0.1 to 0.2 m further away from the struck body (`x_world_robot` of [robot], or --at), or \
                 take away what stands between; all postures and holds of the tool were tried (docs/robot.md, \"The strike\")"
            }
            Self::Invalid { .. } => "check the task's action and the settings of [robot]",
        }
    }
}

/// A sweep that the arm can make.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepPlan {
    /// The sweep asked for; of a tool that is held otherwise than upright, moved so that the side in front touches in the
    /// same place.
    pub sweep: Sweep,
    /// Attitude of the tool.
    pub rotation_w: DQuat,
    /// Posture at the start; also the posture that the null space is drawn to.
    pub q_start: Vec<f64>,
    /// The joints' motion through the sweep; in a [`crate::StrikePlan`] also the rest after it, until all joints stand still.
    pub motion: JointMotion,
    /// How far it goes to the limits.
    pub uses: Uses,
}

impl SweepPlan {
    /// The tool's motion.
    pub fn path(&self) -> SweepPath {
        self.sweep.path(self.rotation_w)
    }

    /// The controller for the sweep, taking over from a robot that stands at the start.
    pub fn controller(&self, model: &RobotModel, config: &OscConfig, ws: &mut Workspace) -> Osc {
        let mut hold = [0.0; MAX_JOINTS];
        model.gravity_torques(&self.q_start, ws, &mut hold);
        Osc::new(*config, &self.q_start, &hold[..model.dof()])
    }
}

/// Finds a posture and the joints' motion for a sweep: postures at the contact from inverse kinematics, each followed
/// from the start to the end by the controller's law; the one that stays farthest from all limits is taken. Where the tool
/// cannot be held upright, because the hand would meet something or a joint its end, it is turned by a quarter or leaned
/// to a side ([`Hold`]).
///
/// # Errors
/// [`StrikeError`] with the reason for the posture that came nearest to being executable, of the tool held upright; or of a
/// hold that met nothing but a limit that no hold avoids.
pub fn plan_sweep(
    model: &RobotModel,
    sweep: &Sweep,
    obstacles: &[Obstacle],
    config: &StrikeConfig,
    ws: &mut Workspace,
) -> Result<SweepPlan, StrikeError> {
    plan_sweep_where(model, sweep, obstacles, config, None, ws)
}

/// Says of a sweep that the arm can make whether it may be taken, or why not.
pub(crate) type May<'a> = &'a dyn Fn(&SweepPlan, &mut Workspace) -> Result<(), StrikeError>;

/// [`plan_sweep`] that passes over sweeps which `may` refuses, as it does over those that break a limit: other postures and
/// other holds are tried. With `may`, the motion of a sweep that stays far from all limits is that of coarse steps.
pub(crate) fn plan_sweep_where(
    model: &RobotModel,
    sweep: &Sweep,
    obstacles: &[Obstacle],
    config: &StrikeConfig,
    may: Option<May<'_>>,
    ws: &mut Workspace,
) -> Result<SweepPlan, StrikeError> {
    refuse_nonsense(sweep, config)?;
    let mut upright: Option<StrikeError> = None;
    // There are many others: less is spent on each.
    let ik = IkConfig { starts: config.ik.starts.div_ceil(2), ..config.ik };
    let fewer = StrikeConfig { ik, candidates: config.candidates.div_ceil(2), ..config.clone() };
    for holds in groups(config.symmetric_tool, config.turned_tool) {
        let config = if upright.is_none() { config } else { &fewer };
        match plan_held(model, sweep, &holds, obstacles, config, may, ws) {
            Ok(plan) => return Ok(plan),
            Err((e, may_another_do)) => {
                if !may_another_do {
                    return Err(e);
                }
                upright.get_or_insert(e);
            }
        }
    }
    Err(upright.unwrap_or_else(|| StrikeError::Invalid { what: "no hold was looked at".to_owned() }))
}

/// [`plan_sweep`] with some holds of the tool; with the error, whether another hold may do.
fn plan_held(
    model: &RobotModel,
    upright: &Sweep,
    holds: &[Hold],
    obstacles: &[Obstacle],
    config: &StrikeConfig,
    may: Option<May<'_>>,
    ws: &mut Workspace,
) -> Result<SweepPlan, (StrikeError, bool)> {
    // The postures of an arm with joints to spare are found from a few by moving along their families; those of other
    // arms stand alone.
    let starts = config.ik.starts * if model.dof() > 6 { 1 } else { 8 };
    let ik = IkConfig { starts, ..config.ik };
    let mut all: Vec<(f64, SweepPath, Vec<f64>)> = Vec::new();
    let mut unreachable: Option<Unreachable> = None;
    let mut refused: Option<(f64, StrikeError)> = None;
    let mut blocked_tool = false;
    for hold in holds {
        let sweep = hold.sweep(upright, config.half_m);
        let path = sweep.path(hold.rotation_w(&sweep));
        // What the hand itself meets, no posture of the arm avoids.
        let striking = config.box_is_checked.then_some(config.half_m);
        if let Some((clearance, at_s)) = tool_blocked(model, &path, striking, obstacles, config.clearance_m) {
            keep_better(&mut refused, f64::INFINITY, StrikeError::Blocked { clearance, at_s });
            blocked_tool = true;
            continue;
        }
        let at_contact = IkTarget::Pose(DPose3::from_parts(sweep.contact_w, path.rotation_w));
        match postures(model, &at_contact, &ik, ws) {
            Ok(found) => all.extend(found.into_iter().map(|q| (strain(model, &sweep, &q, ws), path, q))),
            Err(e) => keep_nearest(&mut unreachable, e),
        }
    }
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    // Postures that are nearly the same would be followed for nothing.
    let mut followed: Vec<Vec<f64>> = Vec::new();
    let mut all = all.into_iter();
    let mut law = TaskLaw::default();
    for round in 1..=MOST_ROUNDS {
        // What is refused, in the order of the postures; `None` where that is not known yet, or the sweep can be made.
        let mut refusals: Vec<Option<(f64, StrikeError)>> = Vec::new();
        let mut running: Vec<(usize, SweepPath, Vec<f64>)> = Vec::new();
        while followed.len() < round * config.candidates.max(1) {
            let Some((strain, path, q_contact)) = all.next() else { break };
            if followed.iter().any(|f| f.iter().zip(&q_contact).all(|(a, b)| (a - b).abs() < 0.2)) {
                continue;
            }
            if let Some(clearance) = too_near(model, &q_contact, obstacles, false, config.clearance_m, ws) {
                let at_s = path.sweep.contact_s();
                refusals.push(Some((strain, StrikeError::Blocked { clearance, at_s })));
                continue;
            }
            let start = IkTarget::Pose(path.at(0.0).x_wt);
            match model.refine(&start, &q_contact, &config.ik, ws) {
                Ok(q_start) => {
                    running.push((refusals.len(), path, q_start));
                    refusals.push(None);
                }
                Err(e) => keep_nearest(&mut unreachable, e),
            }
            followed.push(q_contact);
        }
        let mut running: Vec<Followed<'_>> = running
            .iter()
            .map(|(slot, path, q_start)| Followed::new(model, *slot, path, q_start, config))
            .collect();
        let mut unstartable = false;
        let mut late: Vec<(f64, StrikeError)> = Vec::new();
        while let Some(next) = Followed::least(&mut running, &mut law) {
            let (slot, badness) = (next.slot, next.badness());
            match next.into_plan(obstacles, config, ws) {
                Err(e) => refusals[slot] = Some((badness, e)),
                Ok(plan) => match accepted(model, plan, badness, config, may, ws) {
                    Ok(plan) => return Ok(plan),
                    Err(e) => {
                        // Nearer to being executable than what breaks a limit.
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
        // More postures are looked at only where the sweep itself is none of the difficulties.
        if !unstartable {
            break;
        }
    }
    let e = match (refused, unreachable) {
        (Some((_, e)), _) => e,
        (None, Some(e)) => StrikeError::Unreachable(e),
        (None, None) => StrikeError::Invalid { what: "no posture was looked at".to_owned() },
    };
    let may_another_do = blocked_tool || e.depends_on_the_hold();
    Err((e, may_another_do))
}

/// The plan worked out finely, where it keeps all limits then and may be taken.
fn accepted(
    model: &RobotModel,
    mut plan: SweepPlan,
    badness: f64,
    config: &StrikeConfig,
    may: Option<May<'_>>,
    ws: &mut Workspace,
) -> Result<SweepPlan, StrikeError> {
    if may.is_none() || badness > COARSE_ENOUGH {
        let path = plan.path();
        let fine = config.period_s.max(path.duration_s() / 200.0);
        plan.motion = follow(model, &path, &plan.q_start, &plan.q_start, &config.osc, fine, 0.0);
        plan.uses = plan.motion.check(model, config.osc.torque_rate)?;
    }
    may.map_or(Ok(()), |may| may(&plan, ws))?;
    Ok(plan)
}

fn keep_better(best: &mut Option<(f64, StrikeError)>, badness: f64, e: StrikeError) {
    if best.as_ref().is_none_or(|(b, _)| badness < *b) {
        *best = Some((badness, e));
    }
}

/// What would make durations infinite or directions undefined.
fn refuse_nonsense(sweep: &Sweep, config: &StrikeConfig) -> Result<(), StrikeError> {
    let finite = sweep.contact_w.is_finite() && sweep.direction_w.is_finite() && sweep.up_w.is_finite();
    let across = sweep.direction_w.cross(sweep.up_w).length();
    let what = if !finite {
        "its contact, direction or up is no number".to_owned()
    } else if !(sweep.speed > 1e-3 && sweep.speed < 100.0) {
        format!("its speed is {} m/s", sweep.speed)
    } else if (sweep.direction_w.length() - 1.0).abs() > 1e-6 {
        format!("its direction has the length {}", sweep.direction_w.length())
    } else if across < 1e-3 * sweep.up_w.length() || sweep.up_w.length() < 1e-9 {
        "its direction is up or down, or there is no up".to_owned()
    } else if !(config.period_s > 1e-5 && config.osc.period_s > 1e-5 && config.approach_share > 0.0) {
        "period_s, osc.period_s and approach_share of the settings have to be positive".to_owned()
    } else {
        return Ok(());
    };
    Err(StrikeError::Invalid { what })
}

fn keep_nearest(best: &mut Option<Unreachable>, e: Unreachable) {
    let measure = |u: &Unreachable| u.position_error_m + crate::LENGTH_M * u.angle_error_rad;
    if best.as_ref().is_none_or(|b| measure(&e) < measure(b)) {
        *best = Some(e);
    }
}

/// The first place of a sweep where links come too near each other or an obstacle, looked at in thirteen places of the motion,
/// and not farther apart than 0.1 s.
pub(crate) fn blocked(
    model: &RobotModel,
    motion: &JointMotion,
    obstacles: &[Obstacle],
    clearance_m: f64,
    ws: &mut Workspace,
) -> Option<(Clearance, f64)> {
    blocked_every(model, motion, 0.1, obstacles, false, clearance_m, ws)
}

/// The first place of a motion where links come too near each other or an obstacle, looked at in thirteen places and not
/// farther apart than `look_s` seconds; `with_struck` says whether what is to be struck is an obstacle.
pub(crate) fn blocked_every(
    model: &RobotModel,
    motion: &JointMotion,
    look_s: f64,
    obstacles: &[Obstacle],
    with_struck: bool,
    clearance_m: f64,
    ws: &mut Workspace,
) -> Option<(Clearance, f64)> {
    let last = motion.samples.len() - 1;
    let places = 12.max((motion.duration_s() / look_s) as usize).min(last.max(1));
    (0..=places).map(|k| k * last / places).find_map(|index| {
        let near = too_near(model, &motion.samples[index].q, obstacles, with_struck, clearance_m, ws)?;
        Some((near, index as f64 * motion.period_s))
    })
}

/// The nearest pair of a posture, when it is nearer than `clearance_m`; with or without what is to be struck.
fn too_near(
    model: &RobotModel,
    q: &[f64],
    obstacles: &[Obstacle],
    with_struck: bool,
    clearance_m: f64,
    ws: &mut Workspace,
) -> Option<Clearance> {
    let mut poses = Vec::new();
    model.forward_kinematics(q, ws);
    model.shape_poses(ws, &mut poses);
    let near = |c: Clearance| (c.distance_m < clearance_m).then_some(c);
    let with_itself = model.self_clearance(&poses, clearance_m).and_then(near);
    let with_others = obstacles
        .iter()
        .filter(|o| (with_struck || !o.is_struck) && model.may_be_near(&poses, o, clearance_m))
        .filter_map(|o| model.obstacle_clearance(&poses, o, clearance_m).and_then(near));
    with_itself.into_iter().chain(with_others).min_by(|a, b| a.distance_m.total_cmp(&b.distance_m))
}
