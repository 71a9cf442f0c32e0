//! Predicted distribution of the objective over perturbed worlds.

use crate::perturbation::quantile;
use serde::{Deserialize, Serialize};

/// Statistic that is minimised over perturbed worlds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RobustObjective {
    /// The mean.
    Mean,
    /// The median.
    Q50,
    /// The 75 % quantile.
    Q75,
    /// The 90 % quantile.
    Q90,
}

impl RobustObjective {
    /// Computes the statistic of the finite values (invalid rollouts are infinite); infinite if there are none.
    pub fn of(self, values: &[f64]) -> f64 {
        let valid: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
        if valid.is_empty() {
            return f64::INFINITY;
        }
        match self {
            Self::Mean => valid.iter().sum::<f64>() / valid.len() as f64,
            Self::Q50 => quantile(&valid, 0.5),
            Self::Q75 => quantile(&valid, 0.75),
            Self::Q90 => quantile(&valid, 0.9),
        }
    }

    /// Ranks by the number of invalid rollouts, then by the statistic: good outcomes never compensate for an invalid one.
    pub(crate) fn rank(self, values: &[f64]) -> (usize, f64) {
        (values.iter().filter(|v| !v.is_finite()).count(), self.of(values))
    }
}

/// Orders two ranks.
pub(crate) fn compare(a: (usize, f64), b: (usize, f64)) -> std::cmp::Ordering {
    a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))
}

/// The outcome of one rollout.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum RolloutOutcome {
    /// Valid, with its objective.
    Done(f64),
    /// The simulation failed.
    Invalid,
    /// The robot cannot carry out the strike; nothing was simulated.
    Refused,
}

impl RolloutOutcome {
    /// The value that searches minimise: infinite without an objective.
    pub(crate) fn objective(self) -> f64 {
        match self {
            Self::Done(objective) => objective,
            Self::Invalid | Self::Refused => f64::INFINITY,
        }
    }
}

/// The distribution of the objective over perturbed worlds, in the task's unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Prediction {
    /// Mean.
    pub mean: f64,
    /// 10 % quantile.
    pub q10: f64,
    /// Median.
    pub q50: f64,
    /// 90 % quantile.
    pub q90: f64,
    /// Share of the worlds in which the task succeeds; invalid rollouts and refused strikes count as failures.
    pub success_share: f64,
    /// Number of worlds, including those with invalid rollouts or refused strikes.
    pub worlds: usize,
    /// Number of invalid rollouts. Of the values above, only `success_share` includes them.
    pub invalid: usize,
    /// Number of worlds in which the robot cannot carry out the perturbed strike, treated like invalid rollouts.
    #[serde(default)]
    pub refused: usize,
}

impl Prediction {
    /// The outcomes without a value: "2 of 32 invalid, 1 refused by the robot". `None` if there are none.
    pub fn missing_text(&self) -> Option<String> {
        let of_all = |first: bool| if first { format!(" of {}", self.worlds) } else { String::new() };
        let mut parts = Vec::new();
        for (count, kind) in [(self.invalid, "invalid"), (self.refused, "refused by the robot")] {
            if count > 0 {
                parts.push(format!("{count}{} {kind}", of_all(parts.is_empty())));
            }
        }
        (!parts.is_empty()).then(|| parts.join(", "))
    }

    /// The distribution of the outcomes of one shot in several worlds. `None` without a valid outcome.
    pub(crate) fn of(shots: &[RolloutOutcome], is_success: impl Fn(f64) -> bool) -> Option<Self> {
        let valid: Vec<f64> = shots.iter().map(|s| s.objective()).filter(|v| v.is_finite()).collect();
        let refused = shots.iter().filter(|s| **s == RolloutOutcome::Refused).count();
        if valid.is_empty() {
            return None;
        }
        Some(Self {
            mean: RobustObjective::Mean.of(&valid),
            q10: quantile(&valid, 0.1),
            q50: quantile(&valid, 0.5),
            q90: quantile(&valid, 0.9),
            success_share: valid.iter().filter(|&&v| is_success(v)).count() as f64 / shots.len() as f64,
            worlds: shots.len(),
            invalid: shots.len() - valid.len() - refused,
            refused,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_of_a_ladder_leave_out_invalid_rollouts() {
        let mut values: Vec<RolloutOutcome> =
            (0..=10).map(|i| RolloutOutcome::Done(0.01 * f64::from(i))).collect();
        let p = Prediction::of(&values, |v| v < 0.045).unwrap();
        let close = |a: f64, b: f64| (a - b).abs() < 1e-12;
        assert!(close(p.mean, 0.05) && close(p.q10, 0.01) && close(p.q50, 0.05) && close(p.q90, 0.09));
        assert!(close(p.success_share, 5.0 / 11.0) && (p.worlds, p.invalid) == (11, 0));
        values.push(RolloutOutcome::Invalid);
        let q = Prediction::of(&values, |v| v < 0.045).unwrap();
        assert_eq!((q.mean, q.q90), (p.mean, p.q90));
        assert!(close(q.success_share, 5.0 / 12.0) && (q.worlds, q.invalid) == (12, 1));
        assert_eq!(q.refused, 0);
        assert_eq!(p.missing_text(), None);
        assert_eq!(q.missing_text().unwrap(), "1 of 12 invalid");
        // A refused strike is neither an invalid rollout nor a success.
        values.push(RolloutOutcome::Refused);
        let r = Prediction::of(&values, |v| v < 0.045).unwrap();
        assert_eq!((r.mean, r.worlds, r.invalid, r.refused), (p.mean, 13, 1, 1));
        assert_eq!(r.missing_text().unwrap(), "1 of 13 invalid, 1 refused by the robot");
        assert!(close(r.success_share, 5.0 / 13.0));
        assert!(Prediction::of(&[RolloutOutcome::Invalid, RolloutOutcome::Refused], |_| true).is_none());
    }

    #[test]
    fn one_invalid_rollout_outweighs_any_value() {
        let objective = RobustObjective::Mean;
        let order = compare(objective.rank(&[0.9, 0.9]), objective.rank(&[0.0, f64::INFINITY]));
        assert!(order.is_lt());
        assert_eq!(RobustObjective::Q90.of(&[f64::INFINITY; 2]), f64::INFINITY);
    }
}
