//! The depth noise of a recording, from the differences between its frames.
//!
//! Two frames measure the same flat surface independently of each other. The distance of a point of one to the surface of the
//! other, divided by the cosine of the incidence, is the difference of two errors of depth: its standard deviation is √2 σ(z).
//! Within a frame, noise in patches would look like a surface.

use crate::residual::{for_each_landing, meeting};
use crate::views::{DirectedFrame, Point};
use glamx::DPose3;
use rayon::prelude::*;
use sms_core::NORMAL_90;
use sms_frames::DepthNoise;
use std::collections::BTreeMap;

/// Ratio between the limits of two neighbouring ranges of depth.
const RATIO: f64 = 1.15;
/// Fewest differences in a range of depth.
const LEAST: usize = 500;
/// Differences above this share of the depth belong to different surfaces.
const SAME_SURFACE: f64 = 0.03;
/// Least cosine of the incidence: more oblique surfaces have other errors than noise.
const LEAST_COSINE: f64 = 0.4;
/// The standard deviation is that of the normal distribution with the same quantile: later stages tell surfaces apart by it, so
/// that it must hold the tails of a sensor's errors, and not only their middle.
const QUANTILE: f64 = 0.9;

/// Returns the noise that explains the differences between pairs of frames; `None` if too few are comparable.
pub(crate) fn depth_noise(
    views: &[DirectedFrame<'_>],
    points: &[Vec<Point>],
    poses: &[DPose3],
    pairs: &[(usize, usize)],
) -> Option<DepthNoise> {
    let of_pair =
        |&(i, j): &(usize, usize)| differences(&points[i], views[j], &(poses[j].inverse() * poses[i]));
    let all: Vec<Vec<(f64, f64)>> = pairs.par_iter().map(of_pair).collect();
    let mut ranges: BTreeMap<i32, Vec<f64>> = std::collections::BTreeMap::new();
    for (z, difference) in all.into_iter().flatten() {
        ranges.entry((z.ln() / RATIO.ln()).floor() as i32).or_default().push(difference);
    }
    let sigmas: Vec<(f64, f64)> = ranges
        .into_iter()
        .filter(|(_, differences)| differences.len() >= LEAST)
        .map(|(range, mut differences)| {
            let rank = (QUANTILE * differences.len() as f64) as usize;
            let quantile = *differences.select_nth_unstable_by(rank, f64::total_cmp).1;
            (RATIO.powf(f64::from(range) + 0.5), quantile / NORMAL_90 / std::f64::consts::SQRT_2)
        })
        .collect();
    fitted(&sigmas)
}

/// Returns depth and absolute difference of depth of the points of a frame that another frame sees, too.
fn differences(points: &[Point], into: DirectedFrame<'_>, x_ji: &DPose3) -> Vec<(f64, f64)> {
    let mut found = Vec::new();
    for_each_landing(points, x_ji, into, |point, p, n_i, surface| {
        let gate_m = SAME_SURFACE * point.p_c.z;
        let Some(met) = meeting(p, n_i, surface, &into.intrinsics, gate_m) else { return };
        let Some(n) = (met.n + n_i).try_normalize() else { return };
        let cosine = -n.dot(p) / p.z;
        if met.faces && point.is_flat && met.is_flat && cosine >= LEAST_COSINE {
            // Depths of a pair of views differ; the noise is that of their root mean square to first order.
            let z = (0.5 * (point.p_c.z.powi(2) + p.z * p.z)).sqrt();
            found.push((z, n.dot(p - met.q).abs() / cosine));
        }
    });
    found
}

/// Fits σ(z) = a + b z² with a, b ≥ 0 to standard deviations at some depths, by least squares of the relative errors.
fn fitted(sigmas: &[(f64, f64)]) -> Option<DepthNoise> {
    // Rows (1, z²) / σ with the right side 1.
    let (mut aa, mut ab, mut bb, mut a1, mut b1) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for &(z, sigma) in sigmas.iter().filter(|(_, sigma)| *sigma > 0.0) {
        let (a, b) = (sigma.recip(), z * z / sigma);
        aa += a * a;
        ab += a * b;
        bb += b * b;
        a1 += a;
        b1 += b;
    }
    if aa <= 0.0 {
        return None;
    }
    let det = aa * bb - ab * ab;
    let free = (det > 1e-9 * aa * bb).then(|| ((a1 * bb - b1 * ab) / det, (b1 * aa - a1 * ab) / det));
    let (a_m, b_per_m) = match free {
        Some((a, b)) if a >= 0.0 && b >= 0.0 => (a, b),
        Some((a, _)) if a < 0.0 => (0.0, b1 / bb),
        Some(_) => (a1 / aa, 0.0),
        // One range of depth cannot tell the parts apart; triangulating sensors have the second.
        None => (0.0, b1 / bb),
    };
    Some(DepthNoise { a_m, b_per_m })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn laws_are_recovered_and_have_no_negative_part() {
        let depths = [0.5, 0.7, 1.0, 1.4, 2.0];
        let of = |law: &dyn Fn(f64) -> f64| fitted(&depths.map(|z| (z, law(z)))).unwrap();
        let both = of(&|z| 0.0004 + 0.0012 * z * z);
        assert!((both.a_m - 0.0004).abs() < 1e-9 && (both.b_per_m - 0.0012).abs() < 1e-9, "{both:?}");
        let cubic = of(&|z| 0.001 * z * z * z);
        assert!(cubic.a_m == 0.0 && cubic.b_per_m > 0.0, "{cubic:?}");
        let falling = of(&|z| 0.001 / z);
        assert!(falling.b_per_m == 0.0 && falling.a_m > 0.0, "{falling:?}");
        assert_eq!(fitted(&[(2.0, 0.004)]), Some(DepthNoise { a_m: 0.0, b_per_m: 0.001 }));
        assert_eq!(fitted(&[]), None);
    }
}
