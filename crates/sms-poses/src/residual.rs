//! Residuals of one pair of frames and their normal equations.
//!
//! A point of frame i is mapped into camera j by `X_ji`. Two residuals compare it with the measurement of frame j at
//! its projection:
//! - depth: the distance of the point to the plane through the measured point (point to plane, projective association);
//! - colour: the brightness in frame j minus the brightness in frame i, after the pair's gain and offset.
//!
//! Both depend on the pose only through the mapped point p. Let a = ∂r/∂p and q = p − c. The derivative with respect to
//! a rotation ω and a shift v of frame i about the centre c is (q × a, a). The derivative for frame j is its negative.

use crate::PosesConfig;
use crate::align::lever;
use crate::linear::{Block, Six};
use crate::luma::sample;
use crate::views::{Point, PreparedFrame, sigma_along_normal};
use glamx::{DMat3, DPose3, DVec3, Vec3};
use sms_core::Intrinsics;

/// A residual and its gradient with respect to the mapped point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LinearResidual {
    pub(crate) residual: f64,
    pub(crate) by_point: DVec3,
}

impl LinearResidual {
    /// Derivative with respect to (rotation, shift) of the mapped frame about `center`.
    pub(crate) fn jacobian(&self, p: DVec3, center: DVec3) -> Six {
        lever(p - center, self.by_point)
    }
}

/// Distance of `p` to the plane through `q` with normal `n`.
pub(crate) fn depth_residual(p: DVec3, q: DVec3, n: DVec3) -> LinearResidual {
    LinearResidual { residual: n.dot(p - q), by_point: n }
}

/// Brightness of `view` at the projection of `p` minus `expected`, at a level; `None` outside.
///
/// `shift` is the shift of the colour against the depth, pixels at loaded size. Also returns the slope along the image.
pub(crate) fn color_residual(
    p: DVec3,
    view: &PreparedFrame,
    level: usize,
    shift: [f64; 2],
    expected: f64,
) -> Option<(LinearResidual, [f64; 2])> {
    let k = &view.intrinsics;
    let scale = 1.0 / view.scale(level);
    let (x, y) = (p.x / p.z, p.y / p.z);
    let (value, du, dv) = sample(
        &view.luma[level],
        (k.fx * x + k.cx + shift[0]) * scale,
        (k.fy * y + k.cy + shift[1]) * scale,
    )?;
    let (ax, ay) = (du * k.fx * scale / p.z, dv * k.fy * scale / p.z);
    let by_point = DVec3::new(ax, ay, -(ax * x + ay * y));
    Some((LinearResidual { residual: value - expected, by_point }, [du, dv]))
}

/// Gain and offset of a pair's brightness, in levels: the brightness I of frame i is converted to I + gain · (I − 128)
/// / 64 + offset.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Brightness {
    pub(crate) gain: f64,
    pub(crate) offset: f64,
}

impl Brightness {
    /// Standard deviations of gain and offset among the frames of a recording, levels.
    const PRIOR: [f64; 2] = [20.0, 30.0];

    fn columns(luma: f64) -> [f64; 2] {
        [-(luma - 128.0) / 64.0, -1.0]
    }

    fn expected(&self, luma: f64) -> f64 {
        let [gain, offset] = Self::columns(luma);
        luma - self.gain * gain - self.offset * offset
    }
}

/// Bins of [`Histogram`] and their width.
const BINS: usize = 160;
const BIN: f64 = 0.1;

/// Counts of absolute values up to 16. Their medians do not depend on the order of threads.
#[derive(Debug, Clone)]
pub(crate) struct Histogram {
    counts: Vec<u32>,
    total: u32,
}

impl Default for Histogram {
    fn default() -> Self {
        Self { counts: vec![0; BINS], total: 0 }
    }
}

impl Histogram {
    fn add(&mut self, e: f64) {
        self.counts[((e / BIN) as usize).min(BINS - 1)] += 1;
        self.total += 1;
    }

    pub(crate) fn merge(&mut self, other: &Self) {
        self.counts.iter_mut().zip(&other.counts).for_each(|(a, b)| *a += b);
        self.total += other.total;
    }

    pub(crate) fn total(&self) -> u32 {
        self.total
    }

    /// Returns the median, interpolated within its bin; `None` without values.
    pub(crate) fn median(&self) -> Option<f64> {
        let mut before = 0u32;
        let half = 0.5 * f64::from(self.total);
        self.counts.iter().enumerate().find_map(|(i, &c)| {
            let reached = f64::from(before + c) >= half && c > 0;
            let at = (i as f64 + (half - f64::from(before)) / f64::from(c.max(1))) * BIN;
            before += c;
            reached.then_some(at)
        })
    }

    /// Returns the mean of min(value, `most`); `None` without values.
    pub(crate) fn mean_up_to(&self, most: f64) -> Option<f64> {
        let sum: f64 = self
            .counts
            .iter()
            .enumerate()
            .map(|(i, &c)| f64::from(c) * ((i as f64 + 0.5) * BIN).min(most))
            .sum();
        (self.total > 0).then(|| sum / f64::from(self.total))
    }
}

/// Residuals of a pair.
#[derive(Debug, Clone, Default)]
pub(crate) struct ResidualStats {
    /// Depth residuals in standard deviations of the noise.
    pub(crate) depth: Histogram,
    /// Depth residuals in millimetres.
    pub(crate) depth_mm: Histogram,
    /// Colour residuals in their standard deviations.
    pub(crate) color: Histogram,
    /// Colour residuals in levels.
    pub(crate) color_levels: Histogram,
}

impl ResidualStats {
    pub(crate) fn merge(&mut self, other: &Self) {
        self.depth.merge(&other.depth);
        self.depth_mm.merge(&other.depth_mm);
        self.color.merge(&other.color);
        self.color_levels.merge(&other.color_levels);
    }
}

/// Robust scales of the residuals in one iteration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Weighing {
    /// Depth residuals of this many σ are typical.
    pub(crate) depth_scale: f64,
    /// Colour residuals of this many σ are typical.
    pub(crate) color_scale: f64,
    /// Mapped points farther than this from the measured surface count as occluded, metres.
    pub(crate) gate_m: f64,
}

/// The quadratic form of a pair: ½ δᵀ H δ + gᵀ δ with δ = δᵢ − δⱼ about the world's `center`, in world axes.
#[derive(Debug, Clone)]
pub(crate) struct PairSums {
    pub(crate) h: Block,
    pub(crate) g: Six,
    /// Coupling with gain, offset and colour shift, and the block of these four.
    by_extra: [Six; EXTRA],
    extra_h: [[f64; EXTRA]; EXTRA],
    extra_g: [f64; EXTRA],
    pub(crate) seen: ResidualStats,
}

/// Tukey's weight of a residual of `e` σ, if `scale` σ are typical.
fn tukey(e: f64, scale: f64) -> f64 {
    let t = e / (4.685 * scale);
    if t.abs() < 1.0 { (1.0 - t * t).powi(2) } else { 0.0 }
}

/// Unknowns besides the poses: the pair's gain and offset, then the colour shift of all frames (x, y).
const EXTRA: usize = 4;

/// Contribution of a pair to the colour shift, with gain and offset eliminated: the coupling with δ, and the block of
/// the shift.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct ShiftSums {
    pub(crate) by: [Six; 2],
    pub(crate) h: [[f64; 2]; 2],
    pub(crate) g: [f64; 2],
}

/// Sums in the axes of camera j, upper triangle of H.
#[derive(Default)]
struct Sums {
    h: [f64; 21],
    g: Six,
    b: [Six; EXTRA],
    bh: [[f64; EXTRA]; EXTRA],
    bg: [f64; EXTRA],
}

impl Sums {
    fn add(&mut self, jacobian: &Six, residual: f64, weight: f64) {
        let mut at = 0;
        for a in 0..6 {
            let wj = weight * jacobian[a];
            self.g[a] += wj * residual;
            for b in a..6 {
                self.h[at] += wj * jacobian[b];
                at += 1;
            }
        }
    }

    fn add_extra(&mut self, jacobian: &Six, residual: f64, columns: [f64; EXTRA], weight: f64) {
        for k in 0..EXTRA {
            let wc = weight * columns[k];
            self.bg[k] += wc * residual;
            for l in 0..EXTRA {
                self.bh[k][l] += wc * columns[l];
            }
            for a in 0..6 {
                self.b[k][a] += wc * jacobian[a];
            }
        }
    }
}

/// The point at which all residuals are linearised.
#[derive(Clone, Copy)]
pub(crate) struct LinearisationPoint<'a> {
    /// Level of the brightness images.
    pub(crate) level: usize,
    pub(crate) poses: &'a [DPose3],
    /// Shift of the colour against the depth, pixels at loaded size.
    pub(crate) color_shift: [f64; 2],
}

/// One direction of a pair: points of `from` are projected into `to`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Arc {
    pub(crate) from: usize,
    pub(crate) to: usize,
    pub(crate) brightness: Brightness,
}

/// Maps points of frame i (`arc.from`) into frame j (`arc.to`, which is `view_j`) and sums up their linearised residuals.
pub(crate) fn linearise(
    points: &[Point],
    view_j: &PreparedFrame,
    arc: &Arc,
    at: LinearisationPoint<'_>,
    center_w: DVec3,
    weighing: &Weighing,
    config: &PosesConfig,
) -> PairSums {
    let LinearisationPoint { level, poses, color_shift } = at;
    let (x_wi, x_wj, brightness) = (&poses[arc.from], &poses[arc.to], arc.brightness);
    let x_ji = x_wj.inverse() * *x_wi;
    let center = x_wj.inverse_transform_point(center_w);
    let turn = DMat3::from_quat(x_ji.rotation);
    let k: &Intrinsics = &view_j.intrinsics;
    let mut sums = Sums::default();
    let mut seen = ResidualStats::default();
    // Normals that differ by more than 60° belong to different surfaces.
    const LEAST_COSINE: f64 = 0.5;
    let per_pixel = 1.0 / view_j.scale(level);
    for point in points {
        let p = turn * point.p_c + x_ji.translation;
        if p.z <= 1e-3 {
            continue;
        }
        let (u, v) = (k.fx * p.x / p.z + k.cx, k.fy * p.y / p.z + k.cy);
        let Some((x, y, surface)) = view_j.surface_at(u, v) else { continue };
        let z = f64::from(surface.z);
        let q = DVec3::new((x as f64 + 0.5 - k.cx) / k.fx * z, (y as f64 + 0.5 - k.cy) / k.fy * z, z);
        let n = Vec3::from(surface.n).as_dvec3();
        let has_plane = n != DVec3::ZERO;
        let off = if has_plane { n.dot(p - q) } else { p.z - q.z };
        if off.abs() > weighing.gate_m {
            continue;
        }
        let facing = n.dot(turn * point.n_c);
        if config.use_depth && has_plane && facing > LEAST_COSINE {
            let r = depth_residual(p, q, n);
            let sigma = point.sigma_m.hypot(sigma_along_normal(&config.noise, q, n));
            let e = r.residual / sigma;
            seen.depth.add(e.abs());
            seen.depth_mm.add(1e3 * r.residual.abs());
            let weight = tukey(e, weighing.depth_scale) / (sigma * weighing.depth_scale).powi(2);
            if weight > 0.0 {
                sums.add(&r.jacobian(p, center), r.residual, weight);
            }
        }
        if config.use_color && point.textured {
            let expected = brightness.expected(point.luma);
            let Some((r, slope)) = color_residual(p, view_j, level, color_shift, expected) else { continue };
            let sigma = config.color_sigma.hypot(config.color_slip_px * slope[0].hypot(slope[1]));
            let e = r.residual / sigma;
            seen.color.add(e.abs());
            seen.color_levels.add(r.residual.abs());
            let weight = tukey(e, weighing.color_scale) / (sigma * weighing.color_scale).powi(2);
            if weight > 0.0 {
                let jacobian = r.jacobian(p, center);
                sums.add(&jacobian, r.residual, weight);
                let [gain, offset] = Brightness::columns(point.luma);
                let by_shift = |k: usize| (slope[k] - point.slope[k]) * per_pixel;
                sums.add_extra(&jacobian, r.residual, [gain, offset, by_shift(0), by_shift(1)], weight);
            }
        }
    }
    let values = [brightness.gain, brightness.offset];
    for (k, (value, sigma)) in values.into_iter().zip(Brightness::PRIOR).enumerate() {
        sums.bh[k][k] += sigma.powi(-2);
        sums.bg[k] += value * sigma.powi(-2);
    }
    in_world(sums, &DMat3::from_quat(x_wj.rotation), seen)
}

/// Rotates sums from camera axes to world axes.
fn in_world(sums: Sums, r_wj: &DMat3, seen: ResidualStats) -> PairSums {
    let rotated = |s: &Six| -> Six {
        let (a, b) = (*r_wj * DVec3::new(s[0], s[1], s[2]), *r_wj * DVec3::new(s[3], s[4], s[5]));
        [a.x, a.y, a.z, b.x, b.y, b.z]
    };
    let mut camera = [[0.0; 6]; 6];
    let mut at = 0;
    for a in 0..6 {
        for b in a..6 {
            camera[a][b] = sums.h[at];
            camera[b][a] = sums.h[at];
            at += 1;
        }
    }
    // R H Rᵀ: rows first, then columns.
    let rows: Block = camera.map(|row| rotated(&row));
    let mut h = [[0.0; 6]; 6];
    for b in 0..6 {
        let column = rotated(&std::array::from_fn(|a| rows[a][b]));
        for a in 0..6 {
            h[a][b] = column[a];
        }
    }
    PairSums {
        h,
        g: rotated(&sums.g),
        by_extra: sums.b.map(|b| rotated(&b)),
        extra_h: sums.bh,
        extra_g: sums.bg,
        seen,
    }
}

impl PairSums {
    /// Returns the inverse of the block of gain and offset.
    fn brightness_inverse(&self) -> [[f64; 2]; 2] {
        let ([a, b, ..], d) = (self.extra_h[0], self.extra_h[1][1]);
        let det = (a * d - b * b).max(1e-300);
        [[d / det, -b / det], [-b / det, a / det]]
    }

    /// Returns H, g and the terms of the colour shift with gain and offset eliminated, so that gain and offset stay
    /// optimal for every correction.
    pub(crate) fn reduced(&self) -> (Block, Six, ShiftSums) {
        let inverse = self.brightness_inverse();
        let (mut h, mut g) = (self.h, self.g);
        let mut shift = ShiftSums {
            by: [self.by_extra[2], self.by_extra[3]],
            h: std::array::from_fn(|k| std::array::from_fn(|l| self.extra_h[2 + k][2 + l])),
            g: [self.extra_g[2], self.extra_g[3]],
        };
        for k in 0..2 {
            for l in 0..2 {
                let w = inverse[k][l];
                for a in 0..6 {
                    let left = self.by_extra[k][a] * w;
                    g[a] -= left * self.extra_g[l];
                    for b in 0..6 {
                        h[a][b] -= left * self.by_extra[l][b];
                    }
                }
                for m in 0..2 {
                    let left = self.extra_h[2 + m][k] * w;
                    shift.g[m] -= left * self.extra_g[l];
                    for n in 0..2 {
                        shift.h[m][n] -= left * self.extra_h[l][2 + n];
                    }
                    for a in 0..6 {
                        shift.by[m][a] -= left * self.by_extra[l][a];
                    }
                }
            }
        }
        (h, g, shift)
    }

    /// Returns the optimal gain and offset for a correction δ = δᵢ − δⱼ and a change of the colour shift.
    pub(crate) fn brightness_after(&self, delta: &Six, shift: [f64; 2], before: Brightness) -> Brightness {
        let inverse = self.brightness_inverse();
        let right: [f64; 2] = std::array::from_fn(|k| {
            self.extra_g[k]
                + (0..6).map(|a| self.by_extra[k][a] * delta[a]).sum::<f64>()
                + (0..2).map(|l| self.extra_h[k][2 + l] * shift[l]).sum::<f64>()
        });
        Brightness {
            gain: before.gain - inverse[0][0] * right[0] - inverse[0][1] * right[1],
            offset: before.offset - inverse[1][0] * right[0] - inverse[1][1] * right[1],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::moved_about;
    use crate::views::SurfaceSample;
    use proptest::prelude::*;
    use sms_core::Image;

    const CENTER_W: DVec3 = DVec3::new(0.3, -0.1, 0.2);

    fn view() -> PreparedFrame {
        let intrinsics = Intrinsics { width: 48, height: 32, fx: 41.0, fy: 43.0, cx: 23.4, cy: 16.7 };
        let wave = |i: usize| {
            let (x, y) = ((i % 48) as f32, (i / 48) as f32);
            120.0 + 60.0 * (0.21 * x + 0.1 * y).sin() * (0.3 * y - 0.05 * x).cos()
        };
        let luma = vec![Image::from_vec(48, 32, (0..48 * 32).map(wave).collect())];
        PreparedFrame {
            intrinsics,
            surface: vec![SurfaceSample::default(); 48 * 32],
            luma,
            finest_scale: 1.0,
        }
    }

    fn pose(v: [f64; 6]) -> DPose3 {
        moved_about(DVec3::ZERO, &v)
    }

    /// Derivatives of `f` with respect to the corrections of frame i's and frame j's pose, by central differences.
    fn by_differences(x_wi: DPose3, x_wj: DPose3, f: impl Fn(DPose3, DPose3) -> f64) -> (Six, Six) {
        let e = 1e-6;
        let along = |a: usize, s: f64| {
            let mut step = [0.0; 6];
            step[a] = s;
            moved_about(CENTER_W, &step)
        };
        let of_i =
            std::array::from_fn(|a| (f(along(a, e) * x_wi, x_wj) - f(along(a, -e) * x_wi, x_wj)) / (2.0 * e));
        let of_j =
            std::array::from_fn(|a| (f(x_wi, along(a, e) * x_wj) - f(x_wi, along(a, -e) * x_wj)) / (2.0 * e));
        (of_i, of_j)
    }

    fn in_world_axes(r_wj: DMat3, j: Six) -> Six {
        let (a, b) = (r_wj * DVec3::new(j[0], j[1], j[2]), r_wj * DVec3::new(j[3], j[4], j[5]));
        [a.x, a.y, a.z, b.x, b.y, b.z]
    }

    fn agree(found: Six, expected: Six, sign: f64) -> Result<(), TestCaseError> {
        let size = expected.iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-3);
        for a in 0..6 {
            let off = (sign * found[a] - expected[a]).abs();
            prop_assert!(off <= 1e-6 * size, "{found:?} {expected:?}");
        }
        Ok(())
    }

    proptest! {
        #[test]
        fn jacobians_are_those_of_finite_differences(
            a in prop::array::uniform6(-0.08..0.08f64), b in prop::array::uniform6(-0.08..0.08f64),
            u in -0.3..0.3f64, v in -0.2..0.2f64, z in 0.5..1.5f64, tilt in prop::array::uniform3(-0.5..0.5f64),
        ) {
            let view = view();
            let (x_wi, x_wj) = (pose(a), pose(b));
            let p_i = DVec3::new(u, v, 1.0) * z;
            let carried = |x_wi: DPose3, x_wj: DPose3| (x_wj.inverse() * x_wi).transform_point(p_i);
            let p = carried(x_wi, x_wj);
            let center = x_wj.inverse_transform_point(CENTER_W);
            let r_wj = DMat3::from_quat(x_wj.rotation);

            let (q, n) = (p + DVec3::new(0.01, -0.02, 0.005), (DVec3::from_array(tilt) - DVec3::Z).normalize());
            let found = in_world_axes(r_wj, depth_residual(p, q, n).jacobian(p, center));
            let (of_i, of_j) = by_differences(x_wi, x_wj, |i, j| depth_residual(carried(i, j), q, n).residual);
            agree(found, of_i, 1.0)?;
            agree(found, of_j, -1.0)?;

            // Bilinear interpolation is smooth only within a cell.
            let k = view.intrinsics;
            let inside = |x: f64| (x - 0.5).rem_euclid(1.0) > 1e-3 && (x - 0.5).rem_euclid(1.0) < 1.0 - 1e-3;
            prop_assume!(inside(k.fx * p.x / p.z + k.cx + 0.3) && inside(k.fy * p.y / p.z + k.cy - 0.2));
            let color = |p| color_residual(p, &view, 0, [0.3, -0.2], 100.0);
            prop_assume!(color(p).is_some());
            let found = in_world_axes(r_wj, color(p).unwrap().0.jacobian(p, center));
            let (of_i, of_j) =
                by_differences(x_wi, x_wj, |i, j| color(carried(i, j)).map_or(f64::NAN, |r| r.0.residual));
            agree(found, of_i, 1.0)?;
            agree(found, of_j, -1.0)?;
        }

        #[test]
        fn sums_in_world_axes_are_those_of_world_jacobians(
            turn in prop::array::uniform3(-2.0..2.0f64), rows in prop::collection::vec(prop::array::uniform6(-1.0..1.0f64), 3)
        ) {
            let r_wj = DMat3::from_quat(glamx::DQuat::from_scaled_axis(DVec3::from_array(turn)));
            let mut sums = Sums::default();
            let (mut h, mut g) = ([[0.0; 6]; 6], [0.0; 6]);
            for (k, row) in rows.iter().enumerate() {
                let (r, w) = (0.3 + k as f64, 1.0 / (1.0 + k as f64));
                sums.add(row, r, w);
                let world = in_world_axes(r_wj, *row);
                for a in 0..6 {
                    g[a] += w * r * world[a];
                    for b in 0..6 {
                        h[a][b] += w * world[a] * world[b];
                    }
                }
            }
            let found = in_world(sums, &r_wj, ResidualStats::default());
            for a in 0..6 {
                prop_assert!((found.g[a] - g[a]).abs() < 1e-9);
                for b in 0..6 {
                    prop_assert!((found.h[a][b] - h[a][b]).abs() < 1e-9);
                }
            }
        }
    }

    #[test]
    fn brightness_is_eliminated_exactly() {
        // Residuals r + J δ + C (gain, offset, shift) of twelve measurements.
        let mut sums = Sums::default();
        let pseudo = |k: usize, a: usize| ((k * k * 7 + a * a * 3 + k * a * 5) as f64).sin();
        let rows: [(Six, f64, [f64; EXTRA]); 14] = std::array::from_fn(|k| {
            let extra = [pseudo(k, 9), -1.0, pseudo(k, 11), pseudo(k, 13)];
            (std::array::from_fn(|a| pseudo(k, a)), 0.1 * k as f64 - 0.3, extra)
        });
        for (j, r, c) in &rows {
            sums.add(j, *r, 1.0);
            sums.add_extra(j, *r, *c, 1.0);
        }
        let pair = in_world(sums, &DMat3::IDENTITY, ResidualStats::default());
        let (h, g, shift) = pair.reduced();
        // Frame 0 and a frame that a very strong prior holds fixed.
        let mut system = crate::linear::System::new(2);
        system.add_pair(0, 1, &h, &g, &shift);
        let held: Block = std::array::from_fn(|a| std::array::from_fn(|b| if a == b { 1e9 } else { 0.0 }));
        system.add_own(1, &held, &[0.0; 6]);
        let (steps, step) = system.solve().unwrap();
        let delta: Six = std::array::from_fn(|a| steps[0][a] - steps[1][a]);
        let after = pair.brightness_after(&delta, step, Brightness::default());
        // At the joint minimum the residual is orthogonal to every column.
        let all = [after.gain, after.offset, step[0], step[1]];
        let residual = |(j, r, c): &(Six, f64, [f64; EXTRA])| {
            r + (0..6).map(|a| j[a] * delta[a]).sum::<f64>() + (0..EXTRA).map(|k| c[k] * all[k]).sum::<f64>()
        };
        for a in 0..6 {
            let off = rows.iter().map(|row| row.0[a] * residual(row)).sum::<f64>();
            assert!(off.abs() < 1e-6, "{off}");
        }
        for k in 0..EXTRA {
            let off = rows.iter().map(|row| row.2[k] * residual(row)).sum::<f64>();
            assert!(off.abs() < 1e-6, "{off}");
        }
    }

    #[test]
    fn medians_of_histograms() {
        let mut h = Histogram::default();
        assert_eq!(h.median(), None);
        (0..1000).for_each(|i| h.add(f64::from(i) * 0.004));
        assert!((h.median().unwrap() - 2.0).abs() < 0.02);
        assert!((h.mean_up_to(100.0).unwrap() - 2.0).abs() < 0.02);
        assert!(h.mean_up_to(1.0).unwrap() < 1.0);
    }
}
