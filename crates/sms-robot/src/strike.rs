//! From an asked strike to a motion of the arm that can be executed, or the reason why there is none.

use crate::arm_sim::ArmSim;
use crate::ik::{IkConfig, IkTarget, Unreachable};
use crate::linalg::MAX_JOINTS;
use crate::model::RobotModel;
use crate::motion::{
    Infeasible, JointMotion, JointSample, LimitKind, Uses, follow, joint_move, motor_torques, roll_out,
};
use crate::osc::{Osc, OscConfig};
use crate::posture::{postures, strain};
use crate::shape::{Clearance, Obstacle};
use crate::sweep::{LinePath, SEGMENT_M, Sweep, SweepPath, ToolPath};
use crate::workspace::{JointVector, Workspace};
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
    /// Whether the tool may be turned by half a turn about its z axis.
    pub symmetric_tool: bool,
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
            clearance_m: 0.002,
            approach_height_m: 0.2,
            approach_share: 0.5,
            period_s: 0.0025,
        }
    }
}

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
}

/// A sweep that the arm can make.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepPlan {
    /// The sweep asked for.
    pub sweep: Sweep,
    /// Attitude of the tool.
    pub rotation_w: DQuat,
    /// Posture at the start; also the posture that the null space is drawn to.
    pub q_start: Vec<f64>,
    /// The joints' motion through the sweep; in a [`StrikePlan`] also the rest after it, until all joints stand still.
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
/// from the start to the end by the controller's law; the one that stays farthest from all limits is taken.
///
/// # Errors
/// [`StrikeError`] with the reason for the posture that came nearest to being executable.
pub fn plan_sweep(
    model: &RobotModel,
    sweep: &Sweep,
    obstacles: &[Obstacle],
    config: &StrikeConfig,
    ws: &mut Workspace,
) -> Result<SweepPlan, StrikeError> {
    refuse_nonsense(sweep, config)?;
    let mut rotations = vec![sweep.rotation_w()];
    if config.symmetric_tool {
        rotations.push(sweep.reversed_rotation_w());
    }
    // The postures of an arm with joints to spare are found from a few by moving along their families; those of other
    // arms stand alone.
    let starts = config.ik.starts * if model.dof() > 6 { 1 } else { 8 };
    let ik = IkConfig { starts, ..config.ik };
    let mut all: Vec<(f64, DQuat, Vec<f64>)> = Vec::new();
    let mut unreachable: Option<Unreachable> = None;
    for rotation in rotations {
        let at_contact = IkTarget::Pose(DPose3::from_parts(sweep.contact_w, rotation));
        match postures(model, &at_contact, &ik, ws) {
            Ok(found) => all.extend(found.into_iter().map(|q| (strain(model, sweep, &q, ws), rotation, q))),
            Err(e) => keep_nearest(&mut unreachable, e),
        }
    }
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut refused: Option<(f64, StrikeError)> = None;
    let mut best: Option<(f64, SweepPlan)> = None;
    let mut followed: Vec<Vec<f64>> = Vec::new();
    for (badness, rotation, q_contact) in all {
        if followed.len() >= config.candidates {
            break;
        }
        if followed.iter().any(|f| f.iter().zip(&q_contact).all(|(a, b)| (a - b).abs() < 0.2)) {
            continue;
        }
        if let Some(clearance) = too_near(model, &q_contact, obstacles, config.clearance_m, ws) {
            let blocked = StrikeError::Blocked { clearance, at_s: sweep.contact_s() };
            if refused.is_none() {
                refused = Some((badness, blocked));
            }
            continue;
        }
        followed.push(q_contact.clone());
        let path = sweep.path(rotation);
        let start = IkTarget::Pose(path.at(0.0).x_wt);
        let q_start = match model.refine(&start, &q_contact, &config.ik, ws) {
            Ok(q) => q,
            Err(e) => {
                keep_nearest(&mut unreachable, e);
                continue;
            }
        };
        let coarse = 0.005f64.max(path.duration_s() / 40.0);
        let motion = follow(model, &path, &q_start, &q_start, &config.osc, coarse, 0.0);
        let rate = config.osc.torque_rate;
        let badness = motion.uses(model, rate).iter().map(|u| u.1.share).fold(0.0, f64::max);
        let refusal = match motion.check(model, rate) {
            Err(e) => Some(StrikeError::Infeasible(e)),
            Ok(_) => blocked(model, &motion, obstacles, config.clearance_m, ws)
                .map(|(clearance, at_s)| StrikeError::Blocked { clearance, at_s }),
        };
        if let Some(e) = refusal {
            if refused.as_ref().is_none_or(|(b, _)| badness < *b) {
                refused = Some((badness, e));
            }
        } else if best.as_ref().is_none_or(|(b, _)| badness < *b) {
            let plan = SweepPlan {
                sweep: *sweep,
                rotation_w: rotation,
                uses: motion.uses(model, rate),
                q_start,
                motion,
            };
            best = Some((badness, plan));
        }
    }
    let Some((_, mut plan)) = best else {
        return Err(match (refused, unreachable) {
            (Some((_, e)), _) => e,
            (None, Some(e)) => StrikeError::Unreachable(e),
            (None, None) => StrikeError::Unreachable(Unreachable {
                position_error_m: f64::INFINITY,
                angle_error_rad: f64::INFINITY,
                best_q: model.home().to_vec(),
                binding: Vec::new(),
            }),
        });
    };
    let path = sweep.path(plan.rotation_w);
    let fine = config.period_s.max(path.duration_s() / 200.0);
    plan.motion = follow(model, &path, &plan.q_start, &plan.q_start, &config.osc, fine, 0.0);
    plan.uses = plan.motion.check(model, config.osc.torque_rate)?;
    Ok(plan)
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

/// The first place where links come too near each other or an obstacle, looked at in thirteen places of the motion, and
/// not farther apart than 0.1 s.
fn blocked(
    model: &RobotModel,
    motion: &JointMotion,
    obstacles: &[Obstacle],
    clearance_m: f64,
    ws: &mut Workspace,
) -> Option<(Clearance, f64)> {
    let last = motion.samples.len() - 1;
    let places = 12.max((motion.duration_s() / 0.1) as usize).min(last.max(1));
    (0..=places).map(|k| k * last / places).find_map(|index| {
        let near = too_near(model, &motion.samples[index].q, obstacles, clearance_m, ws)?;
        Some((near, index as f64 * motion.period_s))
    })
}

/// The nearest pair of a posture, when it is nearer than `clearance_m`.
fn too_near(
    model: &RobotModel,
    q: &[f64],
    obstacles: &[Obstacle],
    clearance_m: f64,
    ws: &mut Workspace,
) -> Option<Clearance> {
    let mut poses = Vec::new();
    model.forward_kinematics(q, ws);
    model.shape_poses(ws, &mut poses);
    let with_itself = model.self_clearance(&poses, clearance_m);
    let with_others = obstacles.iter().map(|o| model.obstacle_clearance(&poses, o, clearance_m));
    std::iter::once(with_itself)
        .chain(with_others)
        .flatten()
        .min_by(|a, b| a.distance_m.total_cmp(&b.distance_m))
        .filter(|c| c.distance_m < clearance_m)
}

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
    let path = sweep.path(plan.rotation_w);
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

/// How a sweep went under control, in free space.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Tracking {
    /// Speed along the sweep when the tool passed the contact, m/s; NaN when it never did.
    pub contact_speed: f64,
    /// Angle between the velocity there and the sweep, radians.
    pub direction_error_rad: f64,
    /// Distance of the tool from the sweep's line there, metres.
    pub offset_m: f64,
    /// When it passed, seconds from the start of the sweep.
    pub contact_s: f64,
    /// Largest distance of the tool from where it should have been at that time, metres, over the sweep.
    pub largest_error_m: f64,
    /// Control periods in which an effort limit cut a torque.
    pub saturated_periods: usize,
    /// Control periods in which a torque could not change fast enough.
    pub rate_limited_periods: usize,
    /// Control periods in which a joint was beyond its speed limit.
    pub over_speed_periods: usize,
}

/// Executes a sweep in free space: the controller with the robot's model drives `real`, which may differ from it, in
/// steps of `dt` seconds.
pub fn simulate_sweep(
    model: &RobotModel,
    plan: &SweepPlan,
    config: &OscConfig,
    real: &RobotModel,
    friction_scale: f64,
    dt: f64,
) -> Tracking {
    let n = model.dof();
    let mut ws = Workspace::default();
    let mut osc = plan.controller(model, config, &mut ws);
    let mut sim = ArmSim::new(&plan.q_start);
    sim.friction_scale = friction_scale;
    let path = plan.path();
    let d = plan.sweep.direction_w.normalize();
    let start_w = plan.sweep.contact_w - SEGMENT_M * d;
    let mut tracking = Tracking {
        contact_speed: f64::NAN,
        direction_error_rad: f64::NAN,
        offset_m: f64::NAN,
        contact_s: f64::NAN,
        largest_error_m: 0.0,
        saturated_periods: 0,
        rate_limited_periods: 0,
        over_speed_periods: 0,
    };
    let sub_steps = (config.period_s / dt).round().max(1.0) as usize;
    let h = config.period_s / sub_steps as f64;
    let periods = (path.duration_s() / config.period_s).ceil() as usize + 40;
    let (mut before_p, mut before_v) = (start_w, DVec3::ZERO);
    for k in 0..periods {
        let t = k as f64 * config.period_s;
        let reference = path.held(t, config.period_s);
        let error = (before_p - reference.x_wt.translation).length();
        tracking.largest_error_m = tracking.largest_error_m.max(error);
        let out = osc.step(model, &sim.q[..n], &sim.qd[..n], &reference);
        tracking.saturated_periods += usize::from(out.saturated.is_some());
        tracking.rate_limited_periods += usize::from(out.rate_limited.is_some());
        tracking.over_speed_periods += usize::from(out.over_speed.is_some());
        for s in 0..sub_steps {
            sim.step(real, &out.tau[..n], h);
            let (x, v) = sim.tool(real);
            let p = x.translation;
            let (was, is) = ((before_p - start_w).dot(d), (p - start_w).dot(d));
            if tracking.contact_s.is_nan() && is >= SEGMENT_M {
                let share = (SEGMENT_M - was) / (is - was);
                let v_at = before_v + share * (v - before_v);
                let p_at = before_p + share * (p - before_p) - start_w;
                tracking.contact_speed = v_at.dot(d);
                tracking.direction_error_rad = v_at.cross(d).length().atan2(v_at.dot(d));
                tracking.offset_m = (p_at - p_at.dot(d) * d).length();
                tracking.contact_s = t + (s as f64 + share) * h;
            }
            (before_p, before_v) = (p, v);
        }
    }
    tracking
}
