//! From an asked strike to a motion of the arm that can be executed, or the reason why there is none.

use crate::ik::{IkConfig, IkTarget, Unreachable};
use crate::linalg::MAX_JOINTS;
use crate::model::RobotModel;
use crate::motion::{Infeasible, JointMotion, Uses, follow, joint_move, roll_out};
use crate::osc::OscConfig;
use crate::posture::{postures, strain};
use crate::shape::{Clearance, Obstacle};
use crate::sweep::{LinePath, SEGMENT_M, Sweep, ToolPath};
use crate::workspace::{JointVector, Workspace};
use glamx::{DPose3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// Settings of the search for a strike's motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StrikeConfig {
    /// The controller that executes it; its gains also shape the motion in the null space.
    pub osc: OscConfig,
    /// Inverse kinematics of the posture at the contact.
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
            // Few starts are enough: from each posture found, the elbow is moved through its whole range.
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
    let mut rotations = vec![sweep.rotation_w()];
    if config.symmetric_tool {
        rotations.push(sweep.reversed_rotation_w());
    }
    let mut all: Vec<(f64, DQuat, Vec<f64>)> = Vec::new();
    let mut unreachable: Option<Unreachable> = None;
    for rotation in rotations {
        let at_contact = IkTarget::Pose(DPose3::from_parts(sweep.contact_w, rotation));
        match postures(model, &at_contact, &config.ik, ws) {
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

fn keep_nearest(best: &mut Option<Unreachable>, e: Unreachable) {
    let measure = |u: &Unreachable| u.position_error_m + crate::LENGTH_M * u.angle_error_rad;
    if best.as_ref().is_none_or(|b| measure(&e) < measure(b)) {
        *best = Some(e);
    }
}

/// The first place where links come too near each other or an obstacle, looked at in twelve places of the motion.
fn blocked(
    model: &RobotModel,
    motion: &JointMotion,
    obstacles: &[Obstacle],
    clearance_m: f64,
    ws: &mut Workspace,
) -> Option<(Clearance, f64)> {
    let last = motion.samples.len() - 1;
    (0..=12).map(|k| k * last / 12).find_map(|index| {
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
    let up = |q: &JointVector, ws: &mut Workspace| -> Result<JointMotion, Infeasible> {
        model.forward_kinematics(&q[..n], ws);
        let start = model.frame_pose(model.tool(), ws);
        let mut failure = None;
        // Lower lifts where the arm cannot be raised that far.
        for halvings in 0..3 {
            let by_w = config.approach_height_m * 0.5f64.powi(halvings) * sweep.up_w.normalize();
            let mut duration_s = 1.2;
            for _ in 0..6 {
                let path = LinePath { start, by_w, duration_s };
                let motion = roll_out(model, &path, &q[..n], &q[..n], &config.osc, config.period_s);
                match motion.check(model, rate) {
                    Ok(_) => return Ok(motion),
                    Err(e) => failure = Some(e),
                }
                duration_s *= 1.5;
            }
        }
        match failure {
            Some(e) => Err(e),
            None => Ok(JointMotion { period_s: config.period_s, samples: Vec::new() }),
        }
    };
    let first = plan.motion.samples[0].q;
    let last = plan.motion.samples[plan.motion.samples.len() - 1].q;
    let descent = up(&first, ws)?.reversed(model, ws);
    let lift = up(&last, ws)?;
    let above = descent.samples[0].q;
    let approach =
        joint_move(model, model.home(), &above[..n], config.approach_share, rate, 0.5, config.period_s, ws)?;
    let phases = vec![
        (Phase::Approach, approach),
        (Phase::Descent, descent),
        (Phase::Sweep, plan.motion.clone()),
        (Phase::Lift, lift),
    ];
    Ok(StrikePlan { sweep: plan, phases })
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
    let mut hold = [0.0; MAX_JOINTS];
    model.gravity_torques(&plan.q_start, &mut ws, &mut hold);
    let mut osc = crate::Osc::new(*config, &plan.q_start, &hold[..n]);
    let mut sim = crate::ArmSim::new(&plan.q_start);
    sim.friction_scale = friction_scale;
    let path = plan.sweep.path(plan.rotation_w);
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
        let ahead = path.at(t + 0.5 * config.period_s);
        let mut reference = path.at(t);
        (reference.a_w, reference.alpha_w) = (ahead.a_w, ahead.alpha_w);
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
