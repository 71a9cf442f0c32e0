//! Quantiles of unsorted values and of the normal distribution.

/// Interpolation between the two order statistics that enclose a quantile. The names are NumPy's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum QuantileRule {
    /// Linear (type 7 of Hyndman and Fan 1996).
    Linear,
    /// The nearer one; halfway between them, the greater one. At 0.5 this is the upper median.
    Nearest,
    /// The smaller one.
    Lower,
}

/// Half width of the interval that holds 90 % of a normal distribution, in standard deviations: the 90 % quantile of the
/// absolute value of a standard normal number.
pub const NORMAL_90: f64 = 1.644_853_626_951_472;

/// Returns the quantile `q` of `values`, or `None` if there are none. `q` is clamped to [0, 1]. Takes linear time and
/// reorders `values`. Values are ordered by [`f64::total_cmp`], so NaN counts as the greatest (or, with its sign set, the
/// smallest).
///
/// ```
/// use sms_core::{QuantileRule, quantile};
/// let mut ladder = [4.0, 1.0, 3.0, 2.0];
/// assert_eq!(quantile(&mut ladder, 0.5, QuantileRule::Linear), Some(2.5));
/// assert_eq!(quantile(&mut ladder, 0.5, QuantileRule::Nearest), Some(3.0));
/// assert_eq!(quantile(&mut ladder, 0.5, QuantileRule::Lower), Some(2.0));
/// ```
pub fn quantile(values: &mut [f64], q: f64, rule: QuantileRule) -> Option<f64> {
    let last = values.len().checked_sub(1)?;
    let position = q.clamp(0.0, 1.0) * last as f64;
    let rank = match rule {
        QuantileRule::Linear | QuantileRule::Lower => position.floor(),
        QuantileRule::Nearest => position.round(),
    } as usize;
    let (_, &mut low, above) = values.select_nth_unstable_by(rank, f64::total_cmp);
    if rule != QuantileRule::Linear {
        return Some(low);
    }
    let high = above.iter().copied().min_by(f64::total_cmp).unwrap_or(low);
    Some(low + (position - rank as f64) * (high - low))
}

#[cfg(test)]
mod tests {
    use super::QuantileRule::{Linear, Lower, Nearest};
    use super::*;
    use crate::Seed;
    use rand::RngExt;

    #[test]
    fn nine_tenths_of_a_normal_distribution_are_in_the_interval() {
        // Simpson's rule over the density.
        let (count, density) = (1000, |x: f64| (-0.5 * x * x).exp() / std::f64::consts::TAU.sqrt());
        let step = 2.0 * NORMAL_90 / f64::from(count);
        let weight = |i: i32| if i % count == 0 { 1.0 } else { f64::from(2 + 2 * (i % 2)) };
        let sum: f64 = (0..=count).map(|i| weight(i) * density(f64::from(i) * step - NORMAL_90)).sum();
        assert!((sum * step / 3.0 - 0.9).abs() < 1e-12);
    }

    #[test]
    fn quantiles_of_a_uniform_ladder() {
        // The values are their ranks: the linear quantile is q · 10.
        let mut ladder: Vec<f64> = (0..=10).rev().map(f64::from).collect();
        assert_eq!(quantile(&mut ladder, 0.9, Linear), Some(9.0));
        assert_eq!(quantile(&mut ladder, 0.95, Linear), Some(9.5));
        assert_eq!(quantile(&mut ladder, 0.95, Nearest), Some(10.0));
        assert_eq!(quantile(&mut ladder, 0.95, Lower), Some(9.0));
        assert_eq!(quantile(&mut ladder, 0.94, Nearest), Some(9.0));
        for rule in [Linear, Nearest, Lower] {
            assert_eq!(quantile(&mut ladder, 0.0, rule), Some(0.0));
            assert_eq!(quantile(&mut ladder, 1.0, rule), Some(10.0));
            assert_eq!(quantile(&mut ladder, -1.0, rule), Some(0.0));
            assert_eq!(quantile(&mut ladder, 2.0, rule), Some(10.0));
            assert_eq!(quantile(&mut [3.0], 0.9, rule), Some(3.0));
            assert_eq!(quantile(&mut [], 0.5, rule), None);
        }
    }

    #[test]
    fn medians_of_odd_and_even_counts() {
        assert_eq!(quantile(&mut [3.0, 1.0, 8.0], 0.5, Linear), Some(3.0));
        assert_eq!(quantile(&mut [4.0, 1.0, 8.0, 2.0], 0.5, Linear), Some(3.0));
        for n in 1..9_u32 {
            let mut values: Vec<f64> = (0..n).map(f64::from).collect();
            assert_eq!(quantile(&mut values, 0.5, Nearest), Some(f64::from(n / 2)), "{n} values");
        }
    }

    #[test]
    fn selection_agrees_with_sorting() {
        let mut rng = Seed(7).rng();
        for n in 1..60_usize {
            let values: Vec<f64> = (0..n).map(|_| f64::from(rng.random_range(-9..9))).collect();
            let q: f64 = rng.random_range(0.0..1.0);
            let mut sorted = values.clone();
            sorted.sort_by(f64::total_cmp);
            let at = q * (n - 1) as f64;
            let [below, above] = [at.floor() as usize, at.ceil() as usize];
            let linear = sorted[below] + (at - at.floor()) * (sorted[above] - sorted[below]);
            assert_eq!(quantile(&mut values.clone(), q, Lower), Some(sorted[below]));
            assert_eq!(quantile(&mut values.clone(), q, Nearest), Some(sorted[at.round() as usize]));
            assert_eq!(quantile(&mut values.clone(), q, Linear), Some(linear));
        }
    }
}
