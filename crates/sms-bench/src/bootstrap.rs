//! Is one method better than another on the same scenes?

use rand::RngExt;
use sms_core::Seed;

/// Resamples of the scenes.
const RESAMPLES: usize = 4000;

/// A mean difference with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Paired {
    /// Mean of a − b.
    pub mean: f64,
    /// Its 2.5 % quantile over resampled scenes.
    pub low: f64,
    /// Its 97.5 % quantile.
    pub high: f64,
}

/// The mean of `a − b` over scenes, with the percentile bootstrap (Efron 1979) over scenes: each resample takes whole
/// pairs. Seeded, so that the same figures give the same interval. `None` without pairs.
pub fn paired_difference(a: &[f64], b: &[f64]) -> Option<Paired> {
    let differences: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - b).collect();
    let n = differences.len();
    if n == 0 {
        return None;
    }
    let mut rng = Seed(1979).rng();
    let mut means: Vec<f64> = (0..RESAMPLES)
        .map(|_| (0..n).map(|_| differences[rng.random_range(0..n)]).sum::<f64>() / n as f64)
        .collect();
    means.sort_by(f64::total_cmp);
    let at = |q: f64| means[(q * (RESAMPLES - 1) as f64).round() as usize];
    Some(Paired { mean: differences.iter().sum::<f64>() / n as f64, low: at(0.025), high: at(0.975) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interval_is_that_of_the_normal_law_for_many_scenes() {
        // Differences alternate between 0 and 2: mean 1, standard error 1/√n.
        let a: Vec<f64> = (0..400).map(|i| f64::from(i % 2) * 2.0 + 5.0).collect();
        let found = paired_difference(&a, &[5.0; 400]).unwrap();
        assert_eq!(found.mean, 1.0);
        let half = 1.96 / 20.0;
        assert!(
            (found.low - (1.0 - half)).abs() < 0.015 && (found.high - (1.0 + half)).abs() < 0.015,
            "{found:?}"
        );
        assert!(paired_difference(&[], &[]).is_none());
    }
}
