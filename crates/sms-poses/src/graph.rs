//! Selection of the pairs of frames to compare.

use crate::PosesConfig;
use crate::views::{Point, PreparedFrame, pixel_of};
use glamx::DPose3;
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Number of points of a frame that are projected into the others to estimate their overlap.
const SAMPLES: usize = 150;
/// Minimum overlap of a pair.
const LEAST_OVERLAP: f64 = 0.2;
/// Largest difference between the depth of a projected point and the measured depth on the same surface, as a share of
/// the depth: given poses may be wrong by centimetres.
const SAME_SURFACE: f64 = 0.06;
/// Minimum number of projected points on measured pixels.
const LEAST_MEASURED: usize = 8;
/// Largest angle between viewing directions of frames that see the same side of the objects.
const NEAR_ANGLE_RAD: f64 = 0.7;
/// Largest angle between viewing directions of frames that are compared at all.
const FAR_ANGLE_RAD: f64 = 1.4;

/// Pairs of frames (i, j), i < j.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Graph {
    /// Pairs that the refinement uses.
    pub(crate) pairs: Vec<(usize, usize)>,
    /// Pairs held out for the comparison of poses.
    pub(crate) held_out: Vec<(usize, usize)>,
}

impl Graph {
    /// Returns the frames that are part of a used pair.
    pub(crate) fn paired(&self) -> BTreeSet<usize> {
        self.pairs.iter().flat_map(|&(i, j)| [i, j]).collect()
    }
}

/// Overlap of two frames.
#[derive(Debug, Clone, Copy)]
struct FrameOverlap {
    other: usize,
    share: f64,
    angle: f64,
}

/// Chooses pairs by overlap: for each frame the best partners from a similar side, some with a more different
/// direction, and the next best of both kinds as held-out pairs.
pub(crate) fn choose_pairs(views: &[&PreparedFrame], x_wc: &[DPose3], config: &PosesConfig) -> Graph {
    let samples: Vec<Vec<Point>> = views.iter().map(|v| sampled_points(v, config)).collect();
    let overlaps: Vec<Vec<FrameOverlap>> = (0..views.len())
        .into_par_iter()
        .map(|i| {
            (0..views.len())
                .filter(|&j| j != i)
                .filter_map(|j| overlap(i, j, &samples[i], &samples[j], views, x_wc))
                .collect()
        })
        .collect();
    let mut pairs = BTreeSet::new();
    let mut others = BTreeSet::new();
    for (i, all) in overlaps.iter().enumerate() {
        let ordered = |near: bool| {
            let mut list: Vec<FrameOverlap> =
                all.iter().copied().filter(|o| (o.angle <= NEAR_ANGLE_RAD) == near).collect();
            let rank = |o: &FrameOverlap| o.share * if near { o.angle.cos() } else { 1.0 };
            list.sort_by(|a, b| rank(b).total_cmp(&rank(a)).then(a.other.cmp(&b.other)));
            list
        };
        for (list, wanted) in [(ordered(true), config.neighbours), (ordered(false), config.far_neighbours)] {
            let held = (wanted / 4).max(usize::from(wanted > 0));
            // If there are few partners, all but one are used.
            let used = wanted.min(list.len().saturating_sub(1).max(1));
            for (rank, o) in list.iter().take(used + held).enumerate() {
                let pair = (i.min(o.other), i.max(o.other));
                if rank < used {
                    pairs.insert(pair)
                } else {
                    others.insert(pair)
                };
            }
        }
    }
    let held_out = others.difference(&pairs).copied().collect();
    Graph { pairs: pairs.into_iter().collect(), held_out }
}

fn sampled_points(view: &PreparedFrame, config: &PosesConfig) -> Vec<Point> {
    let k = &view.intrinsics;
    let stride = ((k.width * k.height) as f64 / (4 * SAMPLES) as f64).sqrt() / view.scale(0);
    let all = view.alone().points(0, stride.max(1.0), [0.5, 0.5], [0.0; 2], config);
    let step = (all.len() / SAMPLES).max(1);
    all.into_iter().step_by(step).collect()
}

/// Computes the overlap of frames i and j: the share of each frame's points that the other frame sees, and of the two
/// shares the smaller.
fn overlap(
    i: usize,
    j: usize,
    points_i: &[Point],
    points_j: &[Point],
    views: &[&PreparedFrame],
    x_wc: &[DPose3],
) -> Option<FrameOverlap> {
    let axis = |k: usize| x_wc[k].rotation * glamx::DVec3::Z;
    let angle = axis(i).dot(axis(j)).clamp(-1.0, 1.0).acos();
    if angle > FAR_ANGLE_RAD {
        return None;
    }
    let seen = |points: &[Point], from: usize, to: usize| {
        let x = x_wc[to].inverse() * x_wc[from];
        // Points in the image, points on a measured pixel, and points on the same surface.
        let (mut landed, mut measured, mut met) = (0usize, 0usize, 0usize);
        for p in points {
            let q = x.transform_point(p.p_c);
            if let Some((x, y)) = pixel_of(&views[to].intrinsics, q) {
                let z = f64::from(views[to].depth[y * views[to].intrinsics.width + x].z);
                landed += 1;
                measured += usize::from(z > 0.0);
                met += usize::from(z > 0.0 && (z - q.z).abs() < SAME_SURFACE * q.z);
            }
        }
        // Holes in the depth do not reduce the overlap, but a handful of measurements is not enough.
        let share = |n: usize, of: usize| n as f64 / of.max(1) as f64;
        if measured < LEAST_MEASURED { 0.0 } else { share(landed, points.len()) * share(met, measured) }
    };
    let share = seen(points_i, i, j).min(seen(points_j, j, i));
    (share >= LEAST_OVERLAP).then_some(FrameOverlap { other: j, share, angle })
}
