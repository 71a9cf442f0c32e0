//! Comparison of two sets of poses on pairs of frames and points that no refinement fitted.

use crate::histogram::{Histogram, ResidualStats};
use crate::pair::PairSums;
use crate::refine::{BundleAdjustment, CameraValues, arcs, settle_brightness};
use crate::residual::{LinearisationPoint, Phase, Weighing};
use crate::views::{DirectedFrame, Point};
use glamx::DPose3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Residuals of the held-out pairs under one set of poses.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Consistency {
    /// Median distance of a frame's points to the surface measured by another frame, metres; `None` without pairs.
    pub depth_median_m: Option<f64>,
    /// Median difference of brightness, 8-bit levels.
    pub color_median: Option<f64>,
    /// Points that were compared by depth.
    pub depth_points: u64,
    /// Points that were compared by colour.
    pub color_points: u64,
}

/// Reduction of one kind of residual.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Gain {
    /// Reduction of the mean residual, relative to it.
    pub share: f64,
    /// Mean over standard error of the reduction, over pairs of frames.
    pub t: f64,
}

impl Gain {
    /// Thresholds of significance and of size.
    const LEAST_T: f64 = 4.0;
    const LEAST_SHARE: f64 = 0.03;

    fn better(&self) -> bool {
        self.t > Self::LEAST_T && self.share > Self::LEAST_SHARE
    }

    fn worse(&self) -> bool {
        self.t < -Self::LEAST_T && self.share < -Self::LEAST_SHARE
    }
}

/// The given and the refined poses side by side.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Judgement {
    /// Residuals with the given poses.
    pub before: Consistency,
    /// Residuals with the refined poses.
    pub after: Consistency,
    /// Change of depth residuals.
    pub depth: Gain,
    /// Change of colour residuals.
    pub color: Gain,
    /// Number of compared pairs of frames.
    pub pairs: usize,
}

impl Judgement {
    /// Returns whether the refined poses are significantly better by depth or by colour, and not worse by the other.
    pub fn improved(&self) -> bool {
        (self.depth.better() || self.color.better()) && !self.depth.worse() && !self.color.worse()
    }
}

/// Residuals are clipped at this many σ: larger ones come from another surface.
const MOST_SIGMA: f64 = 6.0;
/// Minimum number of points of a pair.
const LEAST_POINTS: u32 = 100;
/// Minimum number of pairs for a judgement.
const LEAST_PAIRS: usize = 4;

/// Poses, and the values of their cameras.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Posed<'a> {
    pub(crate) poses: &'a [DPose3],
    pub(crate) camera: CameraValues,
}

/// Compares two sets of poses on the held-out pairs, or on the used pairs with other points if too few are held out.
pub(crate) fn judge(problem: &BundleAdjustment<'_>, before: Posed<'_>, after: Posed<'_>) -> Judgement {
    let pairs = &problem.graph.held_out;
    let pairs = if pairs.len() < LEAST_PAIRS { &problem.graph.pairs } else { pairs };
    let before = residuals(problem, pairs, before);
    let after = residuals(problem, pairs, after);
    let gain = |kind: fn(&ResidualStats) -> &Histogram| {
        let differences: Vec<(f64, f64)> = before
            .iter()
            .zip(&after)
            .filter(|(b, a)| kind(b).total() >= LEAST_POINTS && kind(a).total() >= LEAST_POINTS)
            .filter_map(|(b, a)| Some((kind(b).mean_up_to(MOST_SIGMA)?, kind(a).mean_up_to(MOST_SIGMA)?)))
            .collect();
        paired_gain(&differences)
    };
    Judgement {
        depth: gain(|s| &s.depth),
        color: gain(|s| &s.color),
        before: consistency(&before),
        after: consistency(&after),
        pairs: pairs.len(),
    }
}

fn paired_gain(differences: &[(f64, f64)]) -> Gain {
    let n = differences.len() as f64;
    if differences.len() < LEAST_PAIRS {
        return Gain::default();
    }
    let base = differences.iter().map(|d| d.0).sum::<f64>() / n;
    let mean = differences.iter().map(|d| d.0 - d.1).sum::<f64>() / n;
    let variance = differences.iter().map(|d| (d.0 - d.1 - mean).powi(2)).sum::<f64>() / (n - 1.0);
    Gain { share: mean / base.max(1e-12), t: mean / (variance / n).sqrt().max(1e-12) }
}

/// Computes the residuals of each pair, both directions together, with the brightness fitted.
fn residuals(
    problem: &BundleAdjustment<'_>,
    pairs: &[(usize, usize)],
    Posed { poses, camera }: Posed<'_>,
) -> Vec<ResidualStats> {
    let mut arcs = arcs(pairs);
    let weighing = Weighing { depth_scale: 4.0, color_scale: 4.0, gate_m: problem.widest_gate_m() };
    let color_shift = camera.color_shift_px;
    let at = LinearisationPoint { level: 0, poses, color_shift, phase: Phase::Approach };
    let views: Vec<DirectedFrame<'_>> =
        problem.views.iter().map(|v| v.alone().with_focal(camera.focal)).collect();
    // The refinement uses the grid with an offset of half a step.
    let stride = problem.config.point_stride.max(2.0);
    let of = |v: &DirectedFrame<'_>| v.points(0, stride, [0.0, 0.0], color_shift, problem.config);
    let points: Vec<Vec<Point>> = views.par_iter().map(of).collect();
    let mut sums: Vec<PairSums> = Vec::new();
    for _ in 0..3 {
        sums = problem.linearise_all(&views, &arcs, &points, at, &weighing);
        settle_brightness(&mut arcs, &sums);
    }
    sums.chunks_exact(2)
        .map(|both| {
            let mut seen = both[0].seen.clone();
            seen.merge(&both[1].seen);
            seen
        })
        .collect()
}

fn consistency(pairs: &[ResidualStats]) -> Consistency {
    let mut all = ResidualStats::default();
    pairs.iter().for_each(|s| all.merge(s));
    Consistency {
        depth_median_m: all.depth_mm.median().map(|mm| 1e-3 * mm),
        color_median: all.color_levels.median(),
        depth_points: all.depth_mm.total().into(),
        color_points: all.color_levels.total().into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gain_must_be_sure_and_worth_it() {
        let sure = Gain { share: 0.1, t: 9.0 };
        let small = Gain { share: 0.001, t: 9.0 };
        let chance = Gain { share: 0.1, t: 1.0 };
        let worse = Gain { share: -0.1, t: -9.0 };
        let judged = |depth, color| Judgement { depth, color, ..Judgement::default() }.improved();
        assert!(judged(sure, chance) && judged(small, sure));
        assert!(!judged(small, chance) && !judged(sure, worse) && !judged(worse, sure));
    }

    #[test]
    fn a_steady_reduction_is_significant_and_noise_is_not() {
        let steady: Vec<(f64, f64)> = (0..10).map(|i| (1.0 + 0.01 * f64::from(i), 0.8)).collect();
        assert!(paired_gain(&steady).better());
        let noisy: Vec<(f64, f64)> = (0..10).map(|i| (1.0, if i % 2 == 0 { 0.7 } else { 1.2 })).collect();
        assert!(!paired_gain(&noisy).better());
    }
}
