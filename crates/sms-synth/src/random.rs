//! Uniform draws.

use rand::RngExt;
use sms_core::StageRng;

/// Draws from `[low, high)`.
pub(crate) fn uniform(rng: &mut StageRng, [low, high]: [f64; 2]) -> f64 {
    low + (high - low) * rng.random::<f64>()
}

/// Picks one of several values with equal probability.
pub(crate) fn pick<T: Copy>(rng: &mut StageRng, of: &[T]) -> T {
    of[rng.random_range(0..of.len())]
}
