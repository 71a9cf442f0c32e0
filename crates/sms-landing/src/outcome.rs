//! Outcome of a landing: success or failure, objective and motion.

use crate::{LandingSuccess, LandingTask};
use glamx::{DPose3, DVec3};
use serde::{Deserialize, Deserializer, Serialize};
use sms_sim::BodyState;
use sms_task::Trajectory;

/// Name of the vehicle's track in [`LandingOutcome::trajectory`].
pub const QUADROTOR: &str = "quadrotor";

/// Displacement of a body of the structure, and the wash forces on it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BodyChange {
    /// Name of the body.
    pub body: String,
    /// Distance of its centre of mass from its position in the scene, metres.
    pub moved_m: f64,
    /// Angle from its orientation in the scene, radians.
    pub turned_rad: f64,
    /// Impulse of the wash on it, N·s in the world.
    pub wash_impulse_w: DVec3,
    /// Largest force of the wash on it, N (mean over a step).
    pub wash_peak_n: f64,
}

/// Why a landing failed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum LandingFailure {
    /// The simulation is invalid.
    Invalid {
        /// The reason.
        why: String,
    },
    /// A body of the structure moved too far.
    Moved {
        /// The body.
        body: String,
        /// Displacement, metres.
        moved_m: f64,
    },
    /// A body of the structure turned too far.
    Turned {
        /// The body.
        body: String,
        /// Angle, radians.
        turned_rad: f64,
    },
    /// The vehicle rests too far from the landing point.
    Missed {
        /// Distance, metres.
        landing_m: f64,
    },
    /// The vehicle leans or lies on its side.
    NotUpright {
        /// Angle of its axis to the vertical, radians.
        tilt_rad: f64,
    },
    /// The vehicle still moves.
    NotAtRest {
        /// Speed, m/s.
        speed: f64,
    },
}

impl LandingFailure {
    /// Returns the name of the kind, for tables.
    pub fn as_str(&self) -> &'static str {
        match self {
            Self::Invalid { .. } => "invalid",
            Self::Moved { .. } => "moved",
            Self::Turned { .. } => "turned",
            Self::Missed { .. } => "missed",
            Self::NotUpright { .. } => "not_upright",
            Self::NotAtRest { .. } => "not_at_rest",
        }
    }
}

impl std::fmt::Display for LandingFailure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Invalid { why } => write!(f, "the simulation is invalid: {why}"),
            Self::Moved { body, moved_m } => write!(f, "`{body}` moved by {:.0} cm", 1e2 * moved_m),
            Self::Turned { body, turned_rad } => {
                write!(f, "`{body}` turned by {:.0}°", turned_rad.to_degrees())
            }
            Self::Missed { landing_m } => {
                write!(f, "the vehicle came to rest {:.0} cm from the landing point", 1e2 * landing_m)
            }
            Self::NotUpright { tilt_rad } => write!(f, "the vehicle leans by {:.0}°", tilt_rad.to_degrees()),
            Self::NotAtRest { speed } => write!(f, "the vehicle still moves at {speed:.2} m/s"),
        }
    }
}

/// Outcome of one landing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LandingOutcome {
    /// Name of the engine.
    pub engine: String,
    /// Wash model ("none" without one).
    pub wash: String,
    /// The paper's objective: the sum of the displacements (metres) and rotations (radians) of the structure's bodies,
    /// plus the vehicle's distance from the landing point (metres). `None` if the simulation is invalid.
    pub objective: Option<f64>,
    /// The first condition of success that failed, the structure before the vehicle; `None` for a success.
    pub failure: Option<LandingFailure>,
    /// The structure, in the task's order.
    pub bodies: Vec<BodyChange>,
    /// Distance of the vehicle's centre from its intended resting position, metres.
    #[serde(deserialize_with = "nan_if_null")]
    pub landing_error_m: f64,
    /// Angle of its axis to the vertical, radians.
    #[serde(deserialize_with = "nan_if_null")]
    pub tilt_rad: f64,
    /// Speed of the vehicle at the judgement, m/s.
    #[serde(deserialize_with = "nan_if_null")]
    pub speed: f64,
    /// Time of motor cut, seconds from the start of the flight; `None` if the simulation ended before.
    pub cut_s: Option<f64>,
    /// Whether the motors were cut above the planned height because the vehicle touched something.
    pub touched_early: bool,
    /// Time at which a body of the structure first exceeded the limits of a success, seconds. If this is before
    /// `cut_s`, the wash toppled it.
    pub toppled_s: Option<f64>,
    /// End of the simulation, seconds: the judgement, or earlier if nothing could change any more.
    pub end_s: f64,
    /// Motion of the structure and of the vehicle ([`QUADROTOR`]); empty if it was not recorded.
    pub trajectory: Trajectory,
    /// The wash particles at some times, if they were recorded; not written to files.
    #[serde(skip)]
    pub particles: Vec<ParticleFrame>,
}

/// The wash particles at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct ParticleFrame {
    /// Seconds from the start of the flight.
    pub time_s: f64,
    /// Particle positions in the world, metres.
    pub particles_w: Vec<[f32; 3]>,
}

impl LandingOutcome {
    /// Returns whether the landing succeeded.
    pub fn is_success(&self) -> bool {
        self.failure.is_none()
    }

    /// Returns whether the wash toppled the structure before the vehicle touched anything.
    pub fn is_toppled_by_wash(&self) -> bool {
        self.toppled_s.is_some_and(|t| self.cut_s.is_none_or(|cut| t < cut))
    }

    /// Returns the objective for a search: at most `cap`, because all toppled structures count the same, and infinite
    /// if the simulation is invalid.
    pub fn score(&self, cap: f64) -> f64 {
        self.objective.map_or(f64::INFINITY, |o| o.min(cap))
    }

    /// Returns the outcome of an invalid simulation.
    pub(crate) fn invalid(engine: &str, wash: &str, end_s: f64, why: String) -> Self {
        Self {
            engine: engine.to_owned(),
            wash: wash.to_owned(),
            objective: None,
            failure: Some(LandingFailure::Invalid { why }),
            bodies: Vec::new(),
            landing_error_m: f64::NAN,
            tilt_rad: f64::NAN,
            speed: f64::NAN,
            cut_s: None,
            touched_early: false,
            toppled_s: None,
            end_s,
            trajectory: Trajectory::default(),
            particles: Vec::new(),
        }
    }
}

/// Reads `null` as NaN, which JSON does not have.
fn nan_if_null<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f64::NAN))
}

/// Distance between two poses: metres, and radians of the shortest rotation (2·arccos|q·q'|, without its rounding
/// errors near 0).
pub(crate) fn change(from: &DPose3, to: &DPose3) -> (f64, f64) {
    let turn = from.rotation.inverse() * to.rotation;
    let turned = 2.0 * turn.xyz().length().atan2(turn.w.abs());
    (from.translation.distance(to.translation), turned)
}

/// Angle of the vehicle's axis to the vertical, radians.
pub(crate) fn tilt(state: &BodyState) -> f64 {
    (state.x_wb.rotation * DVec3::Z).angle_between(DVec3::Z)
}

/// Returns the first condition of success that is not met.
pub(crate) fn failure(
    success: &LandingSuccess,
    bodies: &[BodyChange],
    landing_m: f64,
    tilt_rad: f64,
    speed: f64,
) -> Option<LandingFailure> {
    for b in bodies {
        if b.moved_m > success.moved_m {
            return Some(LandingFailure::Moved { body: b.body.clone(), moved_m: b.moved_m });
        }
        if b.turned_rad > success.turned_rad {
            return Some(LandingFailure::Turned { body: b.body.clone(), turned_rad: b.turned_rad });
        }
    }
    if landing_m > success.landing_m {
        return Some(LandingFailure::Missed { landing_m });
    }
    if tilt_rad > success.tilt_rad {
        return Some(LandingFailure::NotUpright { tilt_rad });
    }
    (speed > success.rest_speed).then_some(LandingFailure::NotAtRest { speed })
}

impl LandingTask {
    /// Computes the objective (paper, quadrotor section): Σ‖Δp‖ + Σ 2·arccos|q·q'| + the landing error.
    pub(crate) fn objective(bodies: &[BodyChange], landing_m: f64) -> f64 {
        bodies.iter().map(|b| b.moved_m + b.turned_rad).sum::<f64>() + landing_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DQuat;

    #[test]
    fn turns_are_the_shortest_and_small_ones_exact() {
        let at = |q: DQuat| DPose3::from_parts(DVec3::X, q);
        for angle in [1e-9, 1e-4, 0.3, 3.0] {
            let q = DQuat::from_rotation_y(angle);
            let (moved, turned) = change(&at(DQuat::IDENTITY), &at(q));
            assert!(moved == 0.0 && (turned / angle - 1.0).abs() < 1e-6, "{angle} {turned}");
            let same = change(&at(DQuat::IDENTITY), &at(DQuat::from_xyzw(-q.x, -q.y, -q.z, -q.w))).1;
            assert!((same - turned).abs() < 1e-12, "q and −q are the same turn");
        }
    }

    #[test]
    fn the_first_broken_condition_is_named() {
        let success = LandingSuccess::default();
        let body = |moved_m: f64, turned_rad: f64| BodyChange {
            body: "box".into(),
            moved_m,
            turned_rad,
            wash_impulse_w: DVec3::ZERO,
            wash_peak_n: 0.0,
        };
        let of = |b: BodyChange, l: f64, t: f64, v: f64| failure(&success, &[b], l, t, v).map(|f| f.as_str());
        assert_eq!(of(body(0.049, 0.17), 0.19, 0.26, 0.0), None);
        assert_eq!(of(body(0.051, 0.5), 0.5, 0.5, 1.0), Some("moved"));
        assert_eq!(of(body(0.0, 0.18), 0.5, 0.5, 1.0), Some("turned"));
        assert_eq!(of(body(0.0, 0.0), 0.21, 0.5, 1.0), Some("missed"));
        assert_eq!(of(body(0.0, 0.0), 0.0, 0.27, 1.0), Some("not_upright"));
        assert_eq!(of(body(0.0, 0.0), 0.0, 0.0, 1.0), Some("not_at_rest"));
    }
}
