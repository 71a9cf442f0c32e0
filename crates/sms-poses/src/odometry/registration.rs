//! Dense registration of two frames: depth and brightness, coarse to fine, with the quality of the result.

use super::features::{Feature, features};
use crate::PosesConfig;
use crate::align::{lever, moved_about};
use crate::floor::PairForm;
use crate::linear::{Block, CAMERA, Six};
use crate::residual::{
    Arc, Brightness, LinearisationPoint, Phase, Weighing, for_each_landing, linearise, meeting,
};
use crate::views::{Point, PreparedFrame, sigma_along_normal};
use glamx::{DPose3, DVec3};
use sms_core::{Cholesky, symmetric_eigen};

/// The finest level that is compared: the loaded images' own pixels cost four times as much, for little.
const FINEST: usize = 1;
/// Most iterations of a level.
const ITERATIONS: usize = 12;

/// A frame prepared for registration.
pub(super) struct TrackedView {
    pub(super) frame: PreparedFrame,
    pub(super) features: Vec<Feature>,
    /// Compared points of each level from [`FINEST`] on; empty below.
    points: Vec<Vec<Point>>,
    /// Mean of the points, and their root mean square distance from it, metres.
    center_c: DVec3,
    arm_m: f64,
    /// Noise of depth at the mean depth, metres.
    sigma_z_m: f64,
}

impl TrackedView {
    pub(super) fn new(frame: PreparedFrame, config: &PosesConfig) -> Self {
        let view = frame.alone();
        let of = |level: usize| {
            if level < FINEST.min(frame.luma.len() - 1) {
                return Vec::new();
            }
            view.points(level, config.point_stride, [0.5; 2], [0.0; 2], config)
        };
        let points: Vec<Vec<Point>> = (0..frame.luma.len()).map(of).collect();
        let coarse = points.last().map_or(&[][..], Vec::as_slice);
        let n = coarse.len().max(1) as f64;
        let center_c = coarse.iter().map(|p| p.p_c).sum::<DVec3>() / n;
        let square = coarse.iter().map(|p| (p.p_c - center_c).length_squared()).sum::<f64>() / n;
        let sigma_z_m = frame.depth_noise.sigma_m(center_c.z);
        let features = features(&frame, config.color_sigma);
        Self { features, points, center_c, arm_m: square.sqrt(), sigma_z_m, frame }
    }

    pub(super) fn mean_depth_m(&self) -> f64 {
        self.center_c.z
    }

    /// Returns whether there is enough depth to compare.
    pub(super) fn has_depth(&self) -> bool {
        const LEAST_POINTS: usize = 30;
        self.points.last().is_some_and(|p| p.len() >= LEAST_POINTS)
    }
}

/// The measured motion between two frames.
#[derive(Debug, Clone, Copy)]
pub(super) struct Registration {
    /// Carries points of camera b to camera a.
    pub(super) x_ab: DPose3,
    /// Information about the motion of camera b (turn about [`Self::center_a`], shift), in the axes of camera a.
    pub(super) information: Block,
    /// Where motions turn about, in camera a: the middle of the points.
    pub(super) center_a: DVec3,
    /// Distance of the points from it, metres.
    pub(super) arm_m: f64,
    /// Share of the points of each frame that the other one measured on the same surface; the smaller of both.
    pub(super) overlap: f64,
    quality: Quality,
}

/// Signs of a wrong motion.
#[derive(Debug, Clone, Copy)]
struct Quality {
    /// Share of the points that the other frame looks through, among those that it measured or looks through.
    looked_through: f64,
    /// Typical residuals, in standard deviations of the noise.
    depth_scale: f64,
    color_scale: f64,
    /// Standard deviation of the motion in its least certain direction, as a share of the depth.
    weakest: f64,
}

impl Registration {
    /// Returns whether nothing speaks against the motion.
    pub(super) fn is_trusted(&self) -> bool {
        // Noise at edges makes up to a tenth of the points seem looked through. Residuals of three times the assumed noise are
        // those of a sensor that is worse than assumed; more are another place. A motion along which nothing resists is no
        // measurement.
        let q = &self.quality;
        self.overlap >= 0.15
            && q.looked_through <= 0.2
            && q.depth_scale <= 3.0
            && q.color_scale <= 3.0
            && q.weakest <= 0.01
    }
}

/// Registers frame b to frame a from a first motion. Points farther than `gate_m` from the measured surface count as hidden at
/// first. `None` if the images do not determine the motion.
pub(super) fn register(
    a: &TrackedView,
    b: &TrackedView,
    start_ab: &DPose3,
    gate_m: f64,
    config: &PosesConfig,
) -> Option<Registration> {
    let views = [a.frame.alone(), b.frame.alone()];
    let levels = a.points.len().min(b.points.len());
    let finest = FINEST.min(levels - 1);
    let center_a = a.center_c;
    let sigma_z_m = a.sigma_z_m.max(b.sigma_z_m);
    let mut x_ab = *start_ab;
    let mut brightness = [Brightness::default(); 2];
    let mut weighing = Weighing::first(gate_m);
    let form_at =
        |level: usize, x_ab: &DPose3, brightness: &mut [Brightness; 2], weighing: &mut Weighing, phase| {
            let poses = [DPose3::identity(), *x_ab];
            let at = LinearisationPoint { level, poses: &poses, color_shift: [0.0; 2], phase };
            let sums = [0, 1].map(|k| {
                let arc = Arc { from: k, to: 1 - k, brightness: brightness[k] };
                let points = if k == 0 { &a.points[level] } else { &b.points[level] };
                linearise(points, views[1 - k], &arc, at, center_a, weighing, config)
            });
            let mut seen = sums[0].seen.clone();
            seen.merge(&sums[1].seen);
            *weighing = weighing.after(&seen, sigma_z_m);
            let of = |k: usize| {
                let (h, g, camera) = sums[k].reduced();
                PairForm { h, g, camera }
            };
            (of(0).with_reverse(&of(1)), sums)
        };
    for level in (finest..levels).rev() {
        let pixel_m = a.frame.intrinsics.pixel_footprint(a.center_c.z) * a.frame.scale(level);
        for _ in 0..ITERATIONS {
            let (form, sums) = form_at(level, &x_ab, &mut brightness, &mut weighing, Phase::Approach);
            // The motion of a against b.
            let mut step = form.g.map(|v| -v);
            damped(&form.h, a.arm_m)?.solve(&mut step);
            for (k, sign) in [1.0, -1.0].into_iter().enumerate() {
                brightness[k] =
                    sums[k].brightness_after(&step.map(|v| sign * v), &[0.0; CAMERA], brightness[k]);
            }
            let moved = moved_about(center_a, &step.map(|v| -v)) * x_ab;
            x_ab = DPose3::from_parts(moved.translation, moved.rotation.normalize());
            let turn = DVec3::new(step[0], step[1], step[2]).length() * a.arm_m;
            let largest = DVec3::new(step[3], step[4], step[5]).length().max(turn);
            if !largest.is_finite() {
                return None;
            }
            if largest < 0.02 * pixel_m {
                break;
            }
        }
    }
    let (form, _) = form_at(finest, &x_ab, &mut brightness, &mut weighing, Phase::Estimate);
    let information = form.h.map(|row| row.map(|v| config.independent_share * v));
    let of_b = comparison(&b.points[finest], a, &x_ab, &weighing);
    let of_a = comparison(&a.points[finest], b, &x_ab.inverse(), &weighing);
    let share = |part: usize, of: usize| part as f64 / of.max(1) as f64;
    let front = of_a.in_front + of_b.in_front;
    let quality = Quality {
        looked_through: share(front, front + of_a.same + of_b.same),
        depth_scale: weighing.depth_scale,
        color_scale: weighing.color_scale,
        weakest: weakest_m(&information, a.arm_m) / a.center_c.z.max(1e-3),
    };
    let overlap = of_a.overlap().min(of_b.overlap());
    Some(Registration { x_ab, information, center_a, arm_m: a.arm_m, overlap, quality })
}

/// Factors H with a little resistance in all directions, so that those without information do not move.
fn damped(h: &Block, arm_m: f64) -> Option<Cholesky<6>> {
    const SHARE: f64 = 1e-6;
    let scale = |k: usize| if k < 3 { arm_m.max(1e-6) } else { 1.0 };
    let most = (0..6).map(|k| h[k][k] / (scale(k) * scale(k))).fold(0.0, f64::max);
    let mut damped = *h;
    (0..6).for_each(|k| damped[k][k] += SHARE * most * scale(k) * scale(k));
    Cholesky::new(&damped, 6)
}

/// Returns the standard deviation of the least certain motion, metres; turns count at the distance `arm_m`.
fn weakest_m(information: &Block, arm_m: f64) -> f64 {
    let scale = |k: usize| if k < 3 { 1.0 / arm_m.max(1e-6) } else { 1.0 };
    let scaled = std::array::from_fn(|a| std::array::from_fn(|b| scale(a) * information[a][b] * scale(b)));
    let (values, _) = symmetric_eigen::<6>(scaled, 30, 1e-24);
    values.into_iter().fold(f64::INFINITY, f64::min).max(1e-12).sqrt().recip()
}

/// Points of one frame against the depth of another.
#[derive(Debug, Clone, Copy, Default)]
struct Comparison {
    points: usize,
    /// Points in the other image.
    landed: usize,
    /// Points with depth at their place in the other image.
    measured: usize,
    /// … on the same surface.
    same: usize,
    /// … in front of it: the other frame looks through them.
    in_front: usize,
}

impl Comparison {
    /// Share of the points that the other frame sees; holes in the depth do not reduce it.
    fn overlap(&self) -> f64 {
        let share = |part: usize, of: usize| part as f64 / of.max(1) as f64;
        share(self.landed, self.points) * share(self.same, self.measured)
    }
}

fn comparison(points: &[Point], into: &TrackedView, x: &DPose3, weighing: &Weighing) -> Comparison {
    /// Points within this many typical deviations of a surface lie on it.
    const SAME: f64 = 4.0;
    let k = &into.frame.intrinsics;
    let mut sum = Comparison { points: points.len(), ..Comparison::default() };
    for_each_landing(points, x, into.frame.alone(), |point, p, n, surface| {
        sum.landed += usize::from(surface.pixel.is_some());
        sum.measured += usize::from(surface.depth.z > 0.0);
        let Some(met) = meeting(p, n, surface, k, f64::INFINITY) else { return };
        // Without a direction of the surface, depths are compared along the axis.
        let (plane, sigma_q_m) = if met.n == DVec3::ZERO {
            (DVec3::Z, met.sigma_z_m)
        } else {
            (met.n, sigma_along_normal(met.sigma_z_m, met.q, met.n))
        };
        let sigma = point.sigma_m.hypot(sigma_q_m).max(1e-9);
        if plane.dot(p - met.q).abs() <= SAME * weighing.depth_scale * sigma {
            sum.same += 1;
        } else if p.z < met.q.z {
            sum.in_front += 1;
        }
    });
    sum
}

/// Returns the matrix that takes a motion about `to` (turn, shift) to the same motion about `from`.
pub(super) fn about(from: DVec3, to: DVec3) -> [Six; 6] {
    let mut m = [[0.0; 6]; 6];
    (0..6).for_each(|k| m[k][k] = 1.0);
    for (axis, unit) in DVec3::AXES.into_iter().enumerate() {
        // The shift at `from` along an axis: v + (ω × (from − to)) along it.
        let row = lever(from - to, unit);
        m[3 + axis][..3].copy_from_slice(&row[..3]);
    }
    m
}
