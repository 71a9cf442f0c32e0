//! Extents of pieces of the cloud, and quantiles.

use super::fuse::Surfel;
use super::linalg::{mean_and_covariance, symmetric_eigen};
use sms_core::QuantileRule;

/// Returns the extent of a piece along its longest principal axis.
pub(crate) fn length(surfels: &[Surfel], members: &[usize]) -> f64 {
    extents(surfels, members)[2]
}

/// Returns the extents along the principal axes, increasing.
pub(crate) fn extents(surfels: &[Surfel], members: &[usize]) -> [f64; 3] {
    let points = members.iter().map(|&i| (surfels[i].p_w, 1.0));
    let Some((_, covariance, _)) = mean_and_covariance(points) else { return [0.0; 3] };
    let axes = symmetric_eigen(covariance).1;
    axes.map(|axis| {
        let along = members.iter().map(|&i| axis.dot(surfels[i].p_w));
        let (low, high) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
        high - low
    })
}

/// Returns whether a piece fills little of its bounding rectangle, as rims do.
pub(crate) fn is_ragged(area_m2: f64, middle_m: f64, long_m: f64) -> bool {
    area_m2 < 0.35 * middle_m * long_m
}

/// Returns the smaller of the two order statistics around a quantile, or 0 without values.
pub(crate) fn quantile(values: impl Iterator<Item = f64>, share: f64) -> f64 {
    sms_core::quantile(&mut values.collect::<Vec<_>>(), share, QuantileRule::Lower).unwrap_or(0.0)
}
