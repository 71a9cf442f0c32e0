//! Medians and paired comparisons of two methods on the same scenes.

use rand::RngExt;
use sms_core::{QuantileRule, Seed, quantile};
use sms_eval::mean;

/// Number of resamples of the scenes.
const RESAMPLES: usize = 4000;

/// A mean difference with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Paired {
    /// Mean of a − b.
    pub(crate) mean: f64,
    /// 2.5 % quantile of the mean over resampled scenes.
    pub(crate) low: f64,
    /// 97.5 % quantile of the mean over resampled scenes.
    pub(crate) high: f64,
}

impl Paired {
    fn of_resamples(mean: f64, resamples: &mut [f64]) -> Self {
        let mut at = |q: f64| quantile(resamples, q, QuantileRule::Nearest).unwrap_or(f64::NAN);
        Self { mean, low: at(0.025), high: at(0.975) }
    }
}

/// Returns the mean of `a − b` over scenes, with the percentile bootstrap (Efron 1979) over scenes: each resample draws
/// whole pairs. The seed is fixed, so that the same values give the same interval. `None` without pairs.
pub(crate) fn paired_difference(a: &[f64], b: &[f64]) -> Option<Paired> {
    let differences: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - b).collect();
    let n = differences.len();
    if n == 0 {
        return None;
    }
    let mut rng = Seed(1979).rng();
    let mut means: Vec<f64> = (0..RESAMPLES)
        .map(|_| (0..n).map(|_| differences[rng.random_range(0..n)]).sum::<f64>() / n as f64)
        .collect();
    Some(Paired::of_resamples(mean(&differences), &mut means))
}

/// Returns the ratio of means `mean(a) / mean(b) − 1` over scenes, with the percentile bootstrap over scenes. Each
/// resample draws whole pairs and forms the ratio of its own means, so that the interval includes the uncertainty of
/// the base. In [`Paired`], `mean` is the ratio over all scenes. The seed is fixed. `None` without pairs, or if values
/// that should be positive are not.
pub(crate) fn paired_ratio(pairs: &[(f64, f64)]) -> Option<Paired> {
    let n = pairs.len();
    if n == 0 || pairs.iter().any(|p| p.1.is_nan() || p.1 <= 0.0 || p.0.is_nan()) {
        return None;
    }
    let ratio = |sums: (f64, f64)| sums.0 / sums.1 - 1.0;
    let add = |s: (f64, f64), p: &(f64, f64)| (s.0 + p.0, s.1 + p.1);
    let mut rng = Seed(1979).rng();
    let mut ratios: Vec<f64> = (0..RESAMPLES)
        .map(|_| ratio((0..n).map(|_| &pairs[rng.random_range(0..n)]).fold((0.0, 0.0), add)))
        .collect();
    Some(Paired::of_resamples(ratio(pairs.iter().fold((0.0, 0.0), add)), &mut ratios))
}

/// Returns the median (the mean of the middle two for an even number of values); NaN for an empty slice.
pub(crate) fn median(values: &[f64]) -> f64 {
    quantile(&mut values.to_vec(), 0.5, QuantileRule::Linear).unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_and_medians() {
        assert_eq!((mean(&[3.0, 1.0, 8.0]), median(&[3.0, 1.0, 8.0])), (4.0, 3.0));
        assert_eq!(median(&[4.0, 1.0, 8.0, 2.0]), 3.0);
        assert!(mean(&[]).is_nan() && median(&[]).is_nan());
    }

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

    #[test]
    fn the_interval_of_a_ratio_is_that_of_its_linearisation_for_many_scenes() {
        // b is 1 or 3, and a is 2 or 3 independently of b: R = 2.5/2. By the delta method the standard error of R is
        // √((σ_a² + R² σ_b²) / n) / mean(b). For the difference over a fixed mean, R is replaced by 1.
        let n = 1600;
        let pairs: Vec<(f64, f64)> =
            (0..n).map(|i| (2.0 + f64::from(i % 2), 1.0 + 2.0 * f64::from(i / 2 % 2))).collect();
        let found = paired_ratio(&pairs).unwrap();
        assert!((found.mean - 0.25).abs() < 1e-12, "{found:?}");
        let half = 1.96 * ((0.25f64 + 1.25 * 1.25) / f64::from(n)).sqrt() / 2.0;
        let of_difference = 1.96 * ((0.25f64 + 1.0) / f64::from(n)).sqrt() / 2.0;
        assert!(half - of_difference > 0.004);
        for end in [found.mean - found.low, found.high - found.mean] {
            assert!((end - half).abs() < 0.002, "{end} instead of {half}");
        }
    }

    #[test]
    fn a_common_factor_has_no_interval_and_nothing_has_no_ratio() {
        // The ratio is the same in every resample; a difference over a fixed mean would vary.
        let pairs: Vec<(f64, f64)> = (1..12).map(|i| (0.5 * f64::from(i), f64::from(i))).collect();
        let found = paired_ratio(&pairs).unwrap();
        assert_eq!((found.mean, found.low, found.high), (-0.5, -0.5, -0.5));
        assert!(paired_ratio(&[]).is_none() && paired_ratio(&[(1.0, 0.0)]).is_none());
    }
}
