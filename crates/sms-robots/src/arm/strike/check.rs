//! Checks of a planned strike before it is executed.

use crate::arm::shape::Clearance;
use crate::arm::strike::motion::unit;
use crate::arm::strike::tracking::ContactTracking;
use crate::{
    LimitKind, Obstacle, Phase, RobotModel, StrikeConfig, StrikePlan, Tracking, Use, Workspace,
    simulate_sweep,
};
use serde::{Deserialize, Serialize};

/// Tolerance of the speed error at the contact (a share).
pub(super) const SPEED_TOLERANCE: f64 = 0.02;
/// Tolerance of the direction error at the contact, radians.
pub(super) const DIRECTION_TOLERANCE_RAD: f64 = 0.3 * std::f64::consts::PI / 180.0;

/// Kind of a check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CheckKind {
    /// Joints' positions.
    JointPositions,
    /// Joints' speeds.
    JointSpeeds,
    /// Joints' torques, with gravity and friction.
    JointTorques,
    /// How fast torques change.
    TorqueRates,
    /// Links against each other.
    SelfCollision,
    /// Links against an obstacle or the floor.
    Obstacle,
    /// Speed of the tool at the contact, under control in free space.
    ContactSpeed,
    /// Direction of that speed.
    ContactDirection,
}

impl CheckKind {
    /// Name for messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::JointPositions => "joints' positions",
            Self::JointSpeeds => "joints' speeds",
            Self::JointTorques => "joints' torques",
            Self::TorqueRates => "changes of torques",
            Self::SelfCollision => "links against each other",
            Self::Obstacle => "links against obstacles",
            Self::ContactSpeed => "speed at the contact",
            Self::ContactDirection => "direction at the contact",
        }
    }
}

/// One check.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CheckItem {
    /// Kind.
    pub kind: CheckKind,
    /// Whether it passes.
    pub passed: bool,
    /// Remaining margin, in SI units (positions and distances: rad or m; speeds; torques; the contact speed as a
    /// share); negative when the check fails. `None` when there is nothing to measure.
    pub margin: Option<f64>,
    /// Description: value, limit, joint or links, phase and time.
    pub detail: String,
}

/// The result of all checks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StrikeCheck {
    /// The items, in a fixed order.
    pub items: Vec<CheckItem>,
    /// The sweep under control in free space.
    pub tracking: Tracking,
}

impl StrikeCheck {
    /// Whether everything passes.
    pub fn executable(&self) -> bool {
        self.items.iter().all(|i| i.passed)
    }

    /// The checks that failed.
    pub fn failed(&self) -> impl Iterator<Item = &CheckItem> {
        self.items.iter().filter(|i| !i.passed)
    }
}

/// Time between checked postures, seconds.
const LOOK_S: f64 = 0.01;

/// Checks a planned strike: positions, speeds, torques and torque rates over all phases; self-collision and obstacles
/// (including the floor, and the body to strike as [`Obstacle::struck`]) every 10 ms; and the sweep under control in
/// free space.
pub fn check_strike(
    model: &RobotModel,
    plan: &StrikePlan,
    obstacles: &[Obstacle],
    config: &StrikeConfig,
    ws: &mut Workspace,
) -> StrikeCheck {
    let mut items = limits(model, plan, config);
    items.extend(distances(model, plan, obstacles, config.clearance_m, ws));
    let tracking = simulate_sweep(model, &plan.sweep, &config.osc, model, 1.0, 0.5 * config.osc.period_s);
    let asked = plan.sweep.sweep.speed;
    let mut push = |kind: CheckKind, measured: Option<(f64, String)>| {
        let never = || "the tool does not reach the contact under control in free space".to_owned();
        let margin = measured.as_ref().map(|m| m.0);
        let passed = margin.is_some_and(|m| m >= 0.0);
        items.push(CheckItem { kind, passed, margin, detail: measured.map_or_else(never, |m| m.1) });
    };
    let speed = |c: ContactTracking| {
        let detail =
            format!("{:.4} m/s at the contact under control in free space, {asked:.4} requested", c.speed);
        (SPEED_TOLERANCE - (c.speed / asked - 1.0).abs(), detail)
    };
    push(CheckKind::ContactSpeed, tracking.contact.map(speed));
    let direction = |c: ContactTracking| {
        let (off, offset_mm) = (c.direction_error_rad.to_degrees(), 1e3 * c.offset_m);
        let detail = format!("{off:.3}° off the requested direction, {offset_mm:.2} mm off the line");
        (DIRECTION_TOLERANCE_RAD - c.direction_error_rad, detail)
    };
    push(CheckKind::ContactDirection, tracking.contact.map(direction));
    StrikeCheck { items, tracking }
}

fn limits(model: &RobotModel, plan: &StrikePlan, config: &StrikeConfig) -> Vec<CheckItem> {
    let mut worst: Vec<Option<(LimitKind, Use, Phase, f64)>> = vec![None; 4];
    let mut start_s = 0.0;
    for (phase, motion) in &plan.phases {
        for (slot, (kind, u)) in worst.iter_mut().zip(motion.uses(model, config.osc.torque_rate)) {
            if slot.as_ref().is_none_or(|w| u.share.is_nan() || u.share > w.1.share) {
                *slot = Some((kind, u, *phase, start_s + u.at_s));
            }
        }
        start_s += motion.duration_s();
    }
    worst
        .into_iter()
        .flatten()
        .map(|(kind, u, phase, at_s)| {
            let joint = &model.joints()[u.joint];
            let check = match kind {
                LimitKind::Position => CheckKind::JointPositions,
                LimitKind::Velocity => CheckKind::JointSpeeds,
                LimitKind::Torque => CheckKind::JointTorques,
                LimitKind::TorqueRate => CheckKind::TorqueRates,
            };
            let unit = unit(kind, joint.kind.turns());
            let margin = match kind {
                LimitKind::Position => (u.value - joint.limits.lower).min(joint.limits.upper - u.value),
                _ => u.bound - u.value.abs(),
            };
            CheckItem {
                kind: check,
                passed: u.share <= 1.0,
                margin: Some(margin),
                detail: format!(
                    "{} reaches {:.3} {unit} of {:.3} in the {} at {at_s:.2} s",
                    joint.name,
                    u.value,
                    u.bound,
                    phase.name()
                ),
            }
        })
        .collect()
}

fn distances(
    model: &RobotModel,
    plan: &StrikePlan,
    obstacles: &[Obstacle],
    clearance_m: f64,
    ws: &mut Workspace,
) -> Vec<CheckItem> {
    // Distances up to this value are exact, so that reported margins are exact as well.
    let enough = clearance_m + 0.05;
    let mut nearest: Vec<Option<(Clearance, Phase, f64)>> = vec![None; 1 + obstacles.len()];
    let mut poses = Vec::new();
    let mut start_s = 0.0;
    for (phase, motion) in &plan.phases {
        let last = motion.samples.len() - 1;
        let every = ((LOOK_S / motion.period_s) as usize).max(1);
        for k in (0..last).step_by(every).chain([last]) {
            model.forward_kinematics(&motion.samples[k].q, ws);
            model.shape_poses(ws, &mut poses);
            let at_s = k as f64 * motion.period_s;
            let with_struck = matches!(phase, Phase::Approach | Phase::Descent);
            let to_obstacle = |o: &Obstacle| {
                if o.is_struck && !with_struck { None } else { model.obstacle_clearance(&poses, o, enough) }
            };
            let itself = std::iter::once(model.self_clearance(&poses, enough));
            let found = itself.chain(obstacles.iter().map(to_obstacle));
            for (slot, c) in nearest.iter_mut().zip(found) {
                let Some(c) = c else { continue };
                if slot.as_ref().is_none_or(|n| c.distance_m < n.0.distance_m) {
                    *slot = Some((c, *phase, start_s + at_s));
                }
            }
        }
        start_s += motion.duration_s();
    }
    let names = std::iter::once("itself").chain(obstacles.iter().map(|o| o.name.as_str()));
    nearest
        .into_iter()
        .zip(names)
        .enumerate()
        .map(|(i, (found, name))| {
            let kind = if i == 0 { CheckKind::SelfCollision } else { CheckKind::Obstacle };
            let Some((c, phase, at_s)) = found else {
                // Without shapes the distance is unknown and the check fails. With shapes but without pairs that can
                // collide, it passes.
                let known = model.collisions().iter().any(|c| c.joint.is_some());
                let detail = if known {
                    format!("no shapes of the robot can touch {name}")
                } else {
                    format!(
                        "unknown whether the robot touches {name}: no moving link of its URDF has a \
                         <collision> shape"
                    )
                };
                return CheckItem { kind, passed: known, margin: None, detail };
            };
            // The moment of a distance beyond `enough` is not known: it was not measured any closer.
            let how = if c.distance_m > enough {
                format!("stays more than {:.1} mm away from {}", 1e3 * enough, c.other)
            } else {
                let (mm, phase) = (1e3 * c.distance_m, phase.name());
                format!("comes within {mm:.1} mm of {} in the {phase} at {at_s:.2} s", c.other)
            };
            CheckItem {
                kind,
                passed: c.distance_m >= clearance_m,
                margin: Some(c.distance_m - clearance_m),
                detail: format!("{} {how}; at least {:.1} mm are required", c.link, 1e3 * clearance_m),
            }
        })
        .collect()
}
