//! Joint motions: rollouts of tool motions, and point-to-point motions.

use crate::arm::dynamics::workspace::joint_vector;
use crate::arm::osc::{TaskGoal, TaskLaw};
use crate::arm::strike::sweep::minimum_jerk;
use crate::{Joint, JointVector, MAX_JOINTS, OscConfig, RobotModel, ToolPath, Workspace, joint_friction};
use serde::{Deserialize, Serialize};

/// State of the joints at one time.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
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

    /// Returns the time-reversed motion with its torques.
    pub fn reversed(&self, model: &RobotModel, ws: &mut Workspace) -> Self {
        let mut samples: Vec<JointSample> = self.samples.iter().rev().copied().collect();
        for s in &mut samples {
            s.qd.iter_mut().for_each(|v| *v = -*v);
            s.tau = motor_torques(model, &s.q, &s.qd, &s.qdd, ws);
        }
        Self { period_s: self.period_s, samples }
    }

    /// Computes the uses of all limits; `torque_rate` is the largest change of torque per second. Steps of Coulomb
    /// friction at a reversal do not count: the joint controllers compensate them.
    pub fn uses(&self, model: &RobotModel, torque_rate: f64) -> Uses {
        let mut meter = Meter::new(model, torque_rate, self.period_s);
        self.samples.iter().for_each(|s| meter.note(s));
        meter.uses
    }

    /// Checks all limits.
    ///
    /// # Errors
    /// [`Infeasible`] for the limit that is exceeded by the largest share.
    pub fn check(&self, model: &RobotModel, torque_rate: f64) -> Result<Uses, Infeasible> {
        within_limits(model, self.uses(model, torque_rate))
    }
}

/// Kind of a joint limit.
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

/// A motion exceeds a joint limit: the one exceeded by the largest share.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("the motion exceeds a limit of the robot: {}", self.reason())]
pub struct Infeasible {
    /// The joint.
    pub joint: String,
    /// Kind of the limit.
    pub limit: LimitKind,
    /// Required value, in SI units.
    pub value: f64,
    /// The limit.
    pub bound: f64,
    /// Time from the start of the motion, seconds.
    pub at_s: f64,
    /// Whether the joint turns (radians, N·m) or slides (metres, N).
    pub turns: bool,
}

/// Multiple of a limit that indicates a singular posture.
const SINGULAR: f64 = 20.0;

impl Infeasible {
    fn reason(&self) -> String {
        let Self { joint, value, bound, at_s, .. } = self;
        let unit = unit(self.limit, self.turns);
        if self.limit != LimitKind::Position && value.abs() > SINGULAR * bound.abs() {
            format!(
                "at {at_s:.3} s the arm is close to a singular posture (stretched or folded): {joint} would need more than \
                 {SINGULAR:.0} times its limit of {bound:.4} {unit}"
            )
        } else {
            format!("{joint} would need {value:.4} {unit} at {at_s:.3} s, its limit is {bound:.4}")
        }
    }
}

pub(super) fn unit(limit: LimitKind, turns: bool) -> &'static str {
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

/// The largest use of one kind of limit in a motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Use {
    /// Share of the limit; more than 1 exceeds it. For positions the share of the half range.
    pub share: f64,
    /// Index of the joint.
    pub joint: usize,
    /// Value at that time.
    pub value: f64,
    /// Limit of that joint.
    pub bound: f64,
    /// Time from the start, seconds.
    pub at_s: f64,
}

/// The largest uses of position, speed, torque and torque-rate limits, in this order.
pub type Uses = [(LimitKind, Use); 4];

/// Returns the uses if all are within the limits.
///
/// # Errors
/// [`Infeasible`] for the limit that is exceeded by the largest share.
pub(crate) fn within_limits(model: &RobotModel, uses: Uses) -> Result<Uses, Infeasible> {
    let worst = uses.iter().max_by(|a, b| a.1.share.total_cmp(&b.1.share));
    // NaN exceeds the limit.
    let Some(&(limit, u)) = worst.filter(|(_, u)| u.share.is_nan() || u.share > 1.0) else { return Ok(uses) };
    let Use { value, bound, at_s, .. } = u;
    let Joint { name, kind, .. } = &model.joints()[u.joint];
    Err(Infeasible { joint: name.clone(), limit, value, bound, at_s, turns: kind.turns() })
}

/// Accumulates the uses of a motion sample by sample.
pub(crate) struct Meter<'a> {
    model: &'a RobotModel,
    torque_rate: f64,
    period_s: f64,
    /// Uses of the samples so far.
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

/// Motor torques of a motion: inverse dynamics plus friction.
pub(super) fn motor_torques(
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

/// A joint is at rest below this share of its speed limit; the longest wait for this, seconds.
const STILL: f64 = 2e-4;
pub(crate) const SETTLE_S: f64 = 2.0;

/// Integrates the motion of the joints under operational-space control along `path`, for a robot that matches its model
/// exactly. The motion starts from rest at `q`, which is also the null-space posture, and uses the midpoint rule with
/// steps of about `period_s` (adjusted to divide the duration). After the path's end, the tool's reference is constant,
/// and the motion continues until the joints are at rest, for at most `settle_s` seconds.
pub(crate) fn roll_out(
    model: &RobotModel,
    path: &dyn ToolPath,
    q: &[f64],
    gains: &OscConfig,
    period_s: f64,
    settle_s: f64,
) -> JointMotion {
    let mut law = TaskLaw::default();
    let mut rollout = StepwiseRollout::new(model, path, q, gains, period_s, settle_s);
    while rollout.advance(&mut law).is_some() {}
    rollout.into_motion()
}

/// [`roll_out`] sample by sample, so that a caller can stop early.
pub(crate) struct StepwiseRollout<'a, P: ToolPath + ?Sized> {
    model: &'a RobotModel,
    path: &'a P,
    posture: JointVector,
    gains: OscConfig,
    /// Time between samples, seconds.
    pub(crate) period_s: f64,
    steps: usize,
    longest: usize,
    /// The state of the next sample.
    next: JointSample,
    samples: Vec<JointSample>,
    ended: bool,
}

impl<'a, P: ToolPath + ?Sized> StepwiseRollout<'a, P> {
    pub(crate) fn new(
        model: &'a RobotModel,
        path: &'a P,
        q: &[f64],
        gains: &OscConfig,
        period_s: f64,
        settle_s: f64,
    ) -> Self {
        let duration = path.duration_s();
        let steps = (duration / period_s).ceil().max(1.0);
        let h = duration / steps;
        let q = joint_vector(q);
        Self {
            model,
            path,
            posture: q,
            gains: OscConfig { friction_compensation: true, ..*gains },
            period_s: h,
            steps: steps as usize,
            longest: steps as usize + (settle_s / h) as usize,
            next: JointSample { q, ..JointSample::default() },
            samples: Vec::with_capacity(steps as usize + 1),
            ended: false,
        }
    }

    /// Computes the next sample; `None` after the end.
    pub(crate) fn advance(&mut self, law: &mut TaskLaw) -> Option<&JointSample> {
        if self.ended {
            return None;
        }
        let (n, h, k) = (self.model.dof(), self.period_s, self.samples.len());
        let (model, posture, gains) = (self.model, &self.posture, &self.gains);
        let goal_at = |t: f64| TaskGoal { reference: self.path.at(t), posture, gains };
        let t = k as f64 * h;
        let s = &mut self.next;
        s.qdd = law.torques(model, &s.q, &s.qd, &goal_at(t), &mut s.tau);
        self.samples.push(*s);
        let still = (0..n).all(|i| s.qd[i].abs() < STILL * model.joints[i].limits.velocity);
        self.ended = k >= self.longest || (k >= self.steps && still);
        if !self.ended {
            let (mut q_mid, mut v_mid) = (s.q, s.qd);
            for i in 0..n {
                q_mid[i] += 0.5 * h * s.qd[i];
                v_mid[i] += 0.5 * h * s.qdd[i];
            }
            let a_mid = law.accelerations(model, &q_mid, &v_mid, &goal_at(t + 0.5 * h));
            for i in 0..n {
                s.q[i] += h * v_mid[i];
                s.qd[i] += h * a_mid[i];
            }
        }
        self.samples.last()
    }

    /// Whether the motion is complete.
    pub(crate) fn is_over(&self) -> bool {
        self.ended
    }

    /// The samples so far as a motion.
    pub(crate) fn into_motion(self) -> JointMotion {
        JointMotion { period_s: self.period_s, samples: self.samples }
    }
}

/// A point-to-point motion, straight in joint space with minimum jerk.
#[derive(Clone, Copy)]
pub(crate) struct JointMove<'a> {
    pub(crate) from: &'a [f64],
    pub(crate) to: &'a [f64],
    /// Share of the limits of speed, torque and torque rate that the motion may use.
    pub(crate) limit_share: f64,
    /// Largest change of a torque per second.
    pub(crate) torque_rate: f64,
    /// Shortest duration, seconds.
    pub(crate) min_duration_s: f64,
    /// Time between samples, seconds.
    pub(crate) period_s: f64,
}

impl JointMove<'_> {
    /// Plans the fastest motion within the share of the limits. If the torque that holds the arm exceeds this share,
    /// the limit is the holding torque plus a tenth of the torque limit.
    ///
    /// # Errors
    /// [`Infeasible`] when the arm cannot be held in a posture on the way.
    pub(crate) fn plan(&self, model: &RobotModel, ws: &mut Workspace) -> Result<JointMotion, Infeasible> {
        let Self { from, to, limit_share: share, torque_rate, period_s, .. } = *self;
        // The largest speed of the minimum-jerk motion is 15/8 of the mean.
        let fastest = model
            .joints()
            .iter()
            .enumerate()
            .map(|(i, j)| 1.875 * (to[i] - from[i]).abs() / (share * j.limits.velocity))
            .fold(self.min_duration_s, f64::max);
        let mut duration = fastest.max(period_s);
        // The torque that holds the arm does not depend on the speed.
        let held = Self { period_s: 20.0, ..*self }.timed(model, 1e3, ws).uses(model, torque_rate)[2].1.share;
        let torque_share = share.max(held + 0.1).min(1.0);
        // Slower motions need less torque: the part due to speed falls with the square of the duration.
        for _ in 0..40 {
            let allowed = |uses: &Uses| {
                uses[2].1.share <= torque_share
                    && uses[3].1.share <= share
                    && uses[1].1.share <= share * 1.001
            };
            let (motion, uses) = self.timed_while(model, duration, &allowed, ws);
            if allowed(&uses) {
                return within_limits(model, uses).map(|_| motion);
            }
            duration *= 1.15;
        }
        let motion = self.timed(model, duration, ws);
        motion.check(model, torque_rate).map(|_| motion)
    }

    /// The motion of this duration, seconds.
    fn timed(&self, model: &RobotModel, duration: f64, ws: &mut Workspace) -> JointMotion {
        self.timed_while(model, duration, &|_| true, ws).0
    }

    /// Returns the motion of this duration with its uses. The motion is cut after the first sample at which the uses so
    /// far are not `allowed`.
    fn timed_while(
        &self,
        model: &RobotModel,
        duration: f64,
        allowed: &dyn Fn(&Uses) -> bool,
        ws: &mut Workspace,
    ) -> (JointMotion, Uses) {
        let steps = (duration / self.period_s).ceil().max(1.0);
        let h = duration / steps;
        let mut meter = Meter::new(model, self.torque_rate, h);
        let mut samples = Vec::with_capacity(steps as usize + 1);
        for k in 0..=steps as usize {
            let [p, v, a] = minimum_jerk(k as f64 * h, duration);
            let mut s = JointSample::default();
            for i in 0..model.dof() {
                let by = self.to[i] - self.from[i];
                s.q[i] = self.from[i] + p * by;
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
}
