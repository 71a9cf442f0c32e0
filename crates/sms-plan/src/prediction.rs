//! What a shot is predicted to do in a world that is not exactly the scanned one.

use crate::disturb::quantile;
use crate::worlds::Shot;
use serde::{Deserialize, Serialize};

/// What is minimised over disturbed worlds.
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
    /// The statistic of some values. Those that are infinite (invalid rollouts) are left out; infinite when there is no
    /// other.
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

    /// What candidates are ranked by: fewer invalid rollouts first, then the statistic. An invalid rollout has no
    /// value, so that no number of good ones makes up for it.
    pub(crate) fn rank(self, values: &[f64]) -> (usize, f64) {
        (values.iter().filter(|v| !v.is_finite()).count(), self.of(values))
    }
}

/// The order of two ranks.
pub(crate) fn compare(a: (usize, f64), b: (usize, f64)) -> std::cmp::Ordering {
    a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))
}

/// The distribution of the objective over disturbed worlds, in the task's unit.
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
    /// Number of worlds, those with invalid rollouts or refused strikes included.
    pub worlds: usize,
    /// Rollouts that could not be believed and are in none of the figures above but the share.
    pub invalid: usize,
    /// Worlds in which the robot cannot make the strike as it would be carried out there; treated likewise.
    #[serde(default)]
    pub refused: usize,
}

impl Prediction {
    /// What is in no figure but the share: "2 of 32 not valid, 1 not made by the robot". `None` where all is.
    pub fn missing_text(&self) -> Option<String> {
        let of_all = |first: bool| if first { format!(" of {}", self.worlds) } else { String::new() };
        let mut parts = Vec::new();
        for (count, what) in [(self.invalid, "not valid"), (self.refused, "not made by the robot")] {
            if count > 0 {
                parts.push(format!("{count}{} {what}", of_all(parts.is_empty())));
            }
        }
        (!parts.is_empty()).then(|| parts.join(", "))
    }

    /// The distribution of what comes of the same shot in several worlds. `None` when it was simulated well in none.
    pub(crate) fn of(shots: &[Shot], is_success: impl Fn(f64) -> bool) -> Option<Self> {
        let valid: Vec<f64> = shots.iter().map(|s| s.objective()).filter(|v| v.is_finite()).collect();
        let refused = shots.iter().filter(|s| **s == Shot::Refused).count();
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
    fn figures_are_those_of_a_ladder_and_invalid_rollouts_are_no_values() {
        let mut values: Vec<Shot> = (0..=10).map(|i| Shot::Done(0.01 * f64::from(i))).collect();
        let p = Prediction::of(&values, |v| v < 0.045).unwrap();
        let close = |a: f64, b: f64| (a - b).abs() < 1e-12;
        assert!(close(p.mean, 0.05) && close(p.q10, 0.01) && close(p.q50, 0.05) && close(p.q90, 0.09));
        assert!(close(p.success_share, 5.0 / 11.0) && (p.worlds, p.invalid) == (11, 0));
        values.push(Shot::Unbelievable);
        let q = Prediction::of(&values, |v| v < 0.045).unwrap();
        assert_eq!((q.mean, q.q90), (p.mean, p.q90));
        assert!(close(q.success_share, 5.0 / 12.0) && (q.worlds, q.invalid) == (12, 1));
        assert_eq!(q.refused, 0);
        assert_eq!(p.missing_text(), None);
        assert_eq!(q.missing_text().unwrap(), "1 of 12 not valid");
        // A refused strike is no simulation that cannot be believed, and no success either.
        values.push(Shot::Refused);
        let r = Prediction::of(&values, |v| v < 0.045).unwrap();
        assert_eq!((r.mean, r.worlds, r.invalid, r.refused), (p.mean, 13, 1, 1));
        assert_eq!(r.missing_text().unwrap(), "1 of 13 not valid, 1 not made by the robot");
        assert!(close(r.success_share, 5.0 / 13.0));
        assert!(Prediction::of(&[Shot::Unbelievable, Shot::Refused], |_| true).is_none());
    }

    #[test]
    fn one_invalid_rollout_outweighs_any_value() {
        let objective = RobustObjective::Mean;
        let order = compare(objective.rank(&[0.9, 0.9]), objective.rank(&[0.0, f64::INFINITY]));
        assert!(order.is_lt());
        assert_eq!(RobustObjective::Q90.of(&[f64::INFINITY; 2]), f64::INFINITY);
    }
}
