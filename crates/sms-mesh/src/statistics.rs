//! Order statistics that are 0 for an empty list.

use sms_core::{QuantileRule, quantile as core_quantile};

/// Returns the upper median of values; 0 for none.
pub fn median(mut values: Vec<f64>) -> f64 {
    core_quantile(&mut values, 0.5, QuantileRule::Nearest).unwrap_or(0.0)
}

/// Returns the order statistic nearest to the share `q` of `values`; 0 for none.
pub fn quantile(mut values: Vec<f64>, q: f64) -> f64 {
    core_quantile(&mut values, q, QuantileRule::Nearest).unwrap_or(0.0)
}
