//! Motions of the joints in time: rolled out from motions of the tool, or from posture to posture.

use crate::arm::control::osc::{OscConfig, TaskLaw, joint_friction};
use crate::arm::dynamics::linalg::MAX_JOINTS;
use crate::arm::dynamics::workspace::{JointVector, Workspace};
use crate::arm::model::RobotModel;
use crate::arm::strike::sweep::{ToolPath, ToolReference, minimum_jerk};
use serde::{Deserialize, Serialize};

/// The joints at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointSample {
    /// Positions, rad (m).
    pub q: JointVector,
    /// Speeds, rad/s (m/s).
    pub qd: JointVector,
    /// Accelerations, rad/s² (m/s²).
    pub qdd: JointVector,
    /// Torques of the motors with gravity and friction, N·m (N).
    pub tau: JointVector,
}

/// A motion sampled at a fixed period, from rest to rest.
#[derive(Debug, Clone, PartialEq)]
pub struct JointMotion {
    /// Time between samples, seconds.
    pub period_s: f64,
    /// The samples; the first is the start.
    pub samples: Vec<JointSample>,
}

impl JointMotion {
    /// Duration, seconds.
    pub fn duration_s(&self) -> f64 {
        self.period_s * self.samples.len().saturating_sub(1) as f64
    }

    /// The motion run backwards; torques are worked out anew.
    pub fn reversed(&self, model: &RobotModel, ws: &mut Workspace) -> Self {
        let mut samples: Vec<JointSample> = self.samples.iter().rev().copied().collect();
        for s in &mut samples {
            s.qd.iter_mut().for_each(|v| *v = -*v);
            s.tau = motor_torques(model, &s.q, &s.qd, &s.qdd, ws);
        }
        Self { period_s: self.period_s, samples }
    }
}

/// Which of a joint's limits a motion breaks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LimitKind {
    /// Position.
    Position,
    /// Speed.
    Velocity,
    /// Torque or force.
    Torque,
    /// Change of torque per second.
    TorqueRate,
}

/// A motion that the robot cannot make: the limit that it breaks by the largest share.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("the robot cannot do that: {}", self.reason())]
pub struct Infeasible {
    /// The joint.
    pub joint: String,
    /// Which limit.
    pub limit: LimitKind,
    /// What the motion needs, in SI units.
    pub value: f64,
    /// The limit.
    pub bound: f64,
    /// When, seconds from the start of the motion.
    pub at_s: f64,
    /// Whether the joint turns (radians, N·m) or slides (metres, N).
    pub turns: bool,
}

/// Times a limit beyond which a figure tells nothing but that the arm has lost a direction.
const SINGULAR: f64 = 20.0;

impl Infeasible {
    fn reason(&self) -> String {
        let Self { joint, value, bound, at_s, .. } = self;
        let unit = unit(self.limit, self.turns);
        if self.limit != LimitKind::Position && value.abs() > SINGULAR * bound.abs() {
            format!(
                "at {at_s:.3} s the arm is so near to a posture in which it cannot move the tool that way (stretched, or \
                 folded) that {joint} would need more than {SINGULAR:.0} times its limit of {bound:.4} {unit}"
            )
        } else {
            format!("{joint} would need {value:.4} {unit} at {at_s:.3} s, its limit is {bound:.4}")
        }
    }
}

fn unit(limit: LimitKind, turns: bool) -> &'static str {
    match (limit, turns) {
        (LimitKind::Position, true) => "rad",
        (LimitKind::Position, false) => "m",
        (LimitKind::Velocity, true) => "rad/s",
        (LimitKind::Velocity, false) => "m/s",
        (LimitKind::Torque, true) => "N·m",
        (LimitKind::Torque, false) => "N",
        (LimitKind::TorqueRate, true) => "N·m/s",
        (LimitKind::TorqueRate, false) => "N/s",
    }
}

/// The largest use that a motion makes of one kind of limit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Use {
    /// Share of the limit in use; more than 1 is too much. For positions the share of the half range.
    pub share: f64,
    /// Index of the joint.
    pub joint: usize,
    /// What is needed there.
    pub value: f64,
    /// The limit there.
    pub bound: f64,
    /// When, seconds from the start.
    pub at_s: f64,
}

/// The largest uses of positions, speeds, torques and changes of torque, in this order.
pub type Uses = [(LimitKind, Use); 4];

impl JointMotion {
    /// How far the motion goes to the limits; `torque_rate` is the largest change of torque per second, without that
    /// of Coulomb friction where a joint turns round (the joints' own controllers see to it).
    pub fn uses(&self, model: &RobotModel, torque_rate: f64) -> Uses {
        let mut meter = Meter::new(model, torque_rate, self.period_s);
        self.samples.iter().for_each(|s| meter.note(s));
        meter.uses
    }

    /// Checks all limits.
    ///
    /// # Errors
    /// [`Infeasible`]: the limit that is broken by the largest share.
    pub fn check(&self, model: &RobotModel, torque_rate: f64) -> Result<Uses, Infeasible> {
        within_limits(model, self.uses(model, torque_rate))
    }
}

/// The uses where all are within the limits.
///
/// # Errors
/// [`Infeasible`]: the limit that is broken by the largest share.
pub(crate) fn within_limits(model: &RobotModel, uses: Uses) -> Result<Uses, Infeasible> {
    let worst = uses.iter().max_by(|a, b| a.1.share.total_cmp(&b.1.share));
    match worst {
        // NaN counts as broken.
        Some((limit, u)) if u.share.is_nan() || u.share > 1.0 => {
            let joint = &model.joints()[u.joint];
            Err(Infeasible {
                joint: joint.name.clone(),
                limit: *limit,
                value: u.value,
                bound: u.bound,
                at_s: u.at_s,
                turns: joint.kind.turns(),
            })
        }
        _ => Ok(uses),
    }
}

/// The uses of a motion as it grows, sample by sample.
pub(crate) struct Meter<'a> {
    model: &'a RobotModel,
    torque_rate: f64,
    period_s: f64,
    /// Of the samples so far.
    pub(crate) uses: Uses,
    count: usize,
    /// Torques of the last sample without Coulomb friction.
    smooth: JointVector,
}

impl<'a> Meter<'a> {
    pub(crate) fn new(model: &'a RobotModel, torque_rate: f64, period_s: f64) -> Self {
        let none = Use { share: 0.0, joint: 0, value: 0.0, bound: f64::INFINITY, at_s: 0.0 };
        let uses = [LimitKind::Position, LimitKind::Velocity, LimitKind::Torque, LimitKind::TorqueRate]
            .map(|kind| (kind, none));
        Self { model, torque_rate, period_s, uses, count: 0, smooth: [0.0; MAX_JOINTS] }
    }

    pub(crate) fn note(&mut self, s: &JointSample) {
        let at_s = self.count as f64 * self.period_s;
        let uses = &mut self.uses;
        let mut note = |kind: usize, share: f64, joint: usize, value: f64, bound: f64| {
            if share.is_nan() || share > uses[kind].1.share {
                uses[kind].1 = Use { share, joint, value, bound, at_s };
            }
        };
        for (i, joint) in self.model.joints().iter().enumerate() {
            let l = &joint.limits;
            if l.lower.is_finite() {
                let (middle, half) = (0.5 * (l.lower + l.upper), 0.5 * (l.upper - l.lower));
                let bound = if s.q[i] > middle { l.upper } else { l.lower };
                note(0, (s.q[i] - middle).abs() / half, i, s.q[i], bound);
            }
            note(1, s.qd[i].abs() / l.velocity, i, s.qd[i], l.velocity);
            note(2, s.tau[i].abs() / l.effort, i, s.tau[i], l.effort);
            let smooth = s.tau[i] - joint_friction(0.0, joint.friction, s.qd[i]);
            if self.count > 0 {
                let rate = (smooth - self.smooth[i]) / self.period_s;
                note(3, rate.abs() / self.torque_rate, i, rate, self.torque_rate);
            }
            self.smooth[i] = smooth;
        }
        self.count += 1;
    }

    /// The largest share of any limit.
    pub(crate) fn largest(&self) -> f64 {
        self.uses.iter().map(|u| u.1.share).fold(0.0, f64::max)
    }
}

/// Torques of the motors for a motion: inverse dynamics and friction.
pub fn motor_torques(
    model: &RobotModel,
    q: &JointVector,
    qd: &JointVector,
    qdd: &JointVector,
    ws: &mut Workspace,
) -> JointVector {
    let mut tau = [0.0; MAX_JOINTS];
    model.inverse_dynamics(q, qd, qdd, ws, &mut tau);
    for (i, joint) in model.joints().iter().enumerate() {
        tau[i] += joint_friction(joint.damping, joint.friction, qd[i]);
    }
    tau
}

/// Share of the speed limits below which a joint is at rest, and how long that is waited for, seconds.
const STILL: f64 = 2e-4;
pub(crate) const SETTLE_S: f64 = 2.0;

/// The motion of the joints under operational-space control along `path`, on a robot that is exactly its model: from
/// `q` at rest, near `posture` where the tool leaves it free, in steps of about `period_s` (adjusted to divide the
/// duration), by the midpoint rule. After the path's end the tool rests, and the motion goes on until the joints do.
pub fn roll_out(
    model: &RobotModel,
    path: &dyn ToolPath,
    q: &[f64],
    posture: &[f64],
    gains: &OscConfig,
    period_s: f64,
) -> JointMotion {
    follow(model, path, q, posture, gains, period_s, SETTLE_S)
}

/// [`roll_out`], which waits `settle_s` seconds at most for the joints to rest.
pub(crate) fn follow(
    model: &RobotModel,
    path: &dyn ToolPath,
    q: &[f64],
    posture: &[f64],
    gains: &OscConfig,
    period_s: f64,
    settle_s: f64,
) -> JointMotion {
    let mut law = TaskLaw::default();
    let mut following = Following::new(model, path, q, posture, gains, period_s, settle_s);
    while following.advance(&mut law).is_some() {}
    following.into_motion()
}

/// [`follow`], sample by sample: what is not to be looked at to the end need not be worked out to the end.
pub(crate) struct Following<'a, P: ToolPath + ?Sized> {
    model: &'a RobotModel,
    path: &'a P,
    posture: JointVector,
    gains: OscConfig,
    /// Time between samples, seconds.
    pub(crate) period_s: f64,
    steps: usize,
    longest: usize,
    /// The last sample's state, moved on to where the next one is.
    next: JointSample,
    samples: Vec<JointSample>,
    ended: bool,
}

impl<'a, P: ToolPath + ?Sized> Following<'a, P> {
    pub(crate) fn new(
        model: &'a RobotModel,
        path: &'a P,
        q: &[f64],
        posture: &[f64],
        gains: &OscConfig,
        period_s: f64,
        settle_s: f64,
    ) -> Self {
        let n = model.dof();
        let duration = path.duration_s();
        let steps = (duration / period_s).ceil().max(1.0);
        let h = duration / steps;
        let zero = [0.0; MAX_JOINTS];
        let (mut rest, mut first) = (zero, zero);
        rest[..n].copy_from_slice(posture);
        first[..n].copy_from_slice(q);
        Self {
            model,
            path,
            posture: rest,
            gains: OscConfig { friction_compensation: true, ..*gains },
            period_s: h,
            steps: steps as usize,
            longest: steps as usize + (settle_s / h) as usize,
            next: JointSample { q: first, qd: zero, qdd: zero, tau: zero },
            samples: Vec::with_capacity(steps as usize + 1),
            ended: false,
        }
    }

    /// Works out one more sample; `None` where the motion is over.
    pub(crate) fn advance(&mut self, law: &mut TaskLaw) -> Option<&JointSample> {
        if self.ended {
            return None;
        }
        let (n, h, k) = (self.model.dof(), self.period_s, self.samples.len());
        let (model, rest, gains) = (self.model, &self.posture, &self.gains);
        let t = k as f64 * h;
        let s = &mut self.next;
        s.qdd = law.torques(model, &s.q, &s.qd, &self.path.at(t), rest, gains, &mut s.tau);
        self.samples.push(*s);
        let still = (0..n).all(|i| s.qd[i].abs() < STILL * model.joints[i].limits.velocity);
        self.ended = k >= self.longest || (k >= self.steps && still);
        if !self.ended {
            let (mut q_mid, mut v_mid) = (s.q, s.qd);
            for i in 0..n {
                q_mid[i] += 0.5 * h * s.qd[i];
                v_mid[i] += 0.5 * h * s.qdd[i];
            }
            let a_mid = law.accelerations(model, &q_mid, &v_mid, &self.path.at(t + 0.5 * h), rest, gains);
            for i in 0..n {
                s.q[i] += h * v_mid[i];
                s.qd[i] += h * a_mid[i];
            }
        }
        self.samples.last()
    }

    /// Whether [`Self::advance`] has nothing left to do.
    pub(crate) fn is_over(&self) -> bool {
        self.ended
    }

    /// What was worked out.
    pub(crate) fn into_motion(self) -> JointMotion {
        JointMotion { period_s: self.period_s, samples: self.samples }
    }
}

/// A motion from posture to posture, straight in joint space with minimum jerk, as fast as `share` of all limits of
/// speed, torque and change of torque lets it be, but not faster than in `least_s` seconds. Where the arm's weight
/// takes more torque than that share, a tenth of the limit is added to it.
///
/// # Errors
/// [`Infeasible`] when a posture on the way cannot even be held.
pub fn joint_move(
    model: &RobotModel,
    from: &[f64],
    to: &[f64],
    share: f64,
    torque_rate: f64,
    least_s: f64,
    period_s: f64,
    ws: &mut Workspace,
) -> Result<JointMotion, Infeasible> {
    // Largest speed of the minimum-jerk motion is 15/8 of the mean.
    let fastest = model
        .joints()
        .iter()
        .enumerate()
        .map(|(i, j)| 1.875 * (to[i] - from[i]).abs() / (share * j.limits.velocity))
        .fold(least_s, f64::max);
    let mut duration = fastest.max(period_s);
    // What it takes to hold the arm on the way cannot be saved by being slow.
    let held = timed_move(model, from, to, 1e3, 20.0, ws).uses(model, torque_rate)[2].1.share;
    let torque_share = share.max(held + 0.1).min(1.0);
    // Slower motions need less torque: what speed adds falls with the square of the duration.
    for _ in 0..40 {
        let allowed = |uses: &Uses| {
            uses[2].1.share <= torque_share && uses[3].1.share <= share && uses[1].1.share <= share * 1.001
        };
        // Given up at the first sample that uses more.
        let (motion, uses) = timed_move_while(model, from, to, duration, period_s, torque_rate, &allowed, ws);
        if allowed(&uses) {
            return within_limits(model, uses).map(|_| motion);
        }
        duration *= 1.15;
    }
    let motion = timed_move(model, from, to, duration, period_s, ws);
    motion.check(model, torque_rate).map(|_| motion)
}

fn timed_move(
    model: &RobotModel,
    from: &[f64],
    to: &[f64],
    duration: f64,
    period_s: f64,
    ws: &mut Workspace,
) -> JointMotion {
    timed_move_while(model, from, to, duration, period_s, f64::INFINITY, &|_| true, ws).0
}

/// [`timed_move`] as far as the uses of all samples so far are `allowed`, with the uses: a motion that is not allowed to its
/// end ends at the first sample at which it is not.
fn timed_move_while(
    model: &RobotModel,
    from: &[f64],
    to: &[f64],
    duration: f64,
    period_s: f64,
    torque_rate: f64,
    allowed: &dyn Fn(&Uses) -> bool,
    ws: &mut Workspace,
) -> (JointMotion, Uses) {
    let steps = (duration / period_s).ceil().max(1.0);
    let h = duration / steps;
    let mut meter = Meter::new(model, torque_rate, h);
    let mut samples = Vec::with_capacity(steps as usize + 1);
    for k in 0..=steps as usize {
        let [p, v, a] = minimum_jerk(k as f64 * h, duration);
        let zero = [0.0; MAX_JOINTS];
        let mut s = JointSample { q: zero, qd: zero, qdd: zero, tau: zero };
        for i in 0..model.dof() {
            let by = to[i] - from[i];
            s.q[i] = from[i] + p * by;
            s.qd[i] = v * by;
            s.qdd[i] = a * by;
        }
        s.tau = motor_torques(model, &s.q, &s.qd, &s.qdd, ws);
        meter.note(&s);
        samples.push(s);
        if !allowed(&meter.uses) {
            break;
        }
    }
    (JointMotion { period_s: h, samples }, meter.uses)
}

/// The reference of a robot that stands still with its tool where it is.
pub fn hold_reference(model: &RobotModel, q: &[f64], ws: &mut Workspace) -> ToolReference {
    model.forward_kinematics(q, ws);
    ToolReference::at_rest(model.frame_pose(model.tool(), ws))
}
