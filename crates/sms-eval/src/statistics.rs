//! Statistics of distances and shares.

use sms_core::{QuantileRule, quantile};

/// Returns the mean; NaN for an empty slice.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Returns the value nearest to the quantile `q`; NaN for an empty slice. Reorders `values`.
pub(crate) fn rank(values: &mut [f64], q: f64) -> f64 {
    quantile(values, q, QuantileRule::Nearest).unwrap_or(f64::NAN)
}

/// Returns F1, the harmonic mean of precision and recall; 0 if both are 0.
pub(crate) fn f1(precision: f64, recall: f64) -> f64 {
    let sum = precision + recall;
    if sum > 0.0 { 2.0 * precision * recall / sum } else { 0.0 }
}
