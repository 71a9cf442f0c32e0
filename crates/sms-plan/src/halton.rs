//! Low-discrepancy points for screening.

use rand::RngExt;
use sms_core::Seed;

const PRIMES: [u64; 12] = [2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37];

/// The Halton sequence (Halton 1960) in [0, 1)ⁿ, shifted by a seeded random vector modulo 1 (Cranley and Patterson
/// 1976) so that different seeds try different points.
#[derive(Debug, Clone)]
pub struct Halton {
    shift: Vec<f64>,
}

impl Halton {
    /// A sequence of up to 12 dimensions.
    ///
    /// # Panics
    /// With more than 12 dimensions, where the plain sequence is no longer evenly spread.
    pub fn new(dimensions: usize, seed: Seed) -> Self {
        assert!(dimensions <= PRIMES.len(), "Halton points of {dimensions} dimensions are not evenly spread");
        let mut rng = seed.derive("halton").rng();
        Self { shift: (0..dimensions).map(|_| rng.random()).collect() }
    }

    /// The point at an index.
    pub fn point(&self, index: u64) -> Vec<f64> {
        self.shift
            .iter()
            .zip(PRIMES)
            // Index 0 gives 0 in all bases, so it is skipped.
            .map(|(shift, base)| (radical_inverse(index + 1, base) + shift).fract())
            .collect()
    }
}

/// The digits of `index` in `base`, mirrored at the radix point.
fn radical_inverse(mut index: u64, base: u64) -> f64 {
    let (mut value, mut digit) = (0.0, 1.0 / base as f64);
    while index > 0 {
        value += (index % base) as f64 * digit;
        index /= base;
        digit /= base as f64;
    }
    value
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Squared L2-star discrepancy (Warnock 1972).
    fn discrepancy_squared(points: &[Vec<f64>]) -> f64 {
        let (n, d) = (points.len() as f64, points[0].len() as i32);
        let single: f64 = points.iter().map(|p| p.iter().map(|x| (1.0 - x * x) / 2.0).product::<f64>()).sum();
        let pairs: f64 = points
            .iter()
            .flat_map(|p| {
                points.iter().map(|q| p.iter().zip(q).map(|(a, b)| 1.0 - a.max(*b)).product::<f64>())
            })
            .sum();
        3f64.powi(-d) - 2.0 / n * single + pairs / (n * n)
    }

    #[test]
    fn the_radical_inverse_mirrors_the_digits() {
        let base2: Vec<f64> = (1..8).map(|i| radical_inverse(i, 2)).collect();
        assert_eq!(base2, [0.5, 0.25, 0.75, 0.125, 0.625, 0.375, 0.875]);
        assert!((radical_inverse(5, 3) - (2.0 / 3.0 + 1.0 / 9.0)).abs() < 1e-15);
    }

    #[test]
    fn points_are_spread_far_better_than_random_ones() {
        let (n, d) = (256, 4);
        // The average of n independent uniform points.
        let random = (2f64.powi(-d) - 3f64.powi(-d)) / f64::from(n);
        let seeds = 8;
        let mut mean = 0.0;
        for seed in 0..seeds {
            let halton = Halton::new(d as usize, Seed(seed));
            let points: Vec<Vec<f64>> = (0..n as u64).map(|i| halton.point(i)).collect();
            assert!(points.iter().flatten().all(|v| (0.0..1.0).contains(v)));
            mean += discrepancy_squared(&points) / seeds as f64;
        }
        assert!(mean < 0.3 * random, "{:.3} of random", mean / random);
    }

    #[test]
    fn seeds_shift_the_points() {
        assert_ne!(Halton::new(2, Seed(1)).point(3), Halton::new(2, Seed(2)).point(3));
        assert_eq!(Halton::new(2, Seed(1)).point(3), Halton::new(2, Seed(1)).point(3));
    }
}
