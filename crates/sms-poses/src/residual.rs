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
use crate::histogram::{Histogram, ResidualStats};
use crate::linear::Six;
use crate::luma::sample;
use crate::pair::{ColorRow, PairSums, Sums};
use crate::views::{DirectedFrame, Point, Surface, by_focal_of, pixel_point, sigma_along_normal};
use glamx::{DMat3, DPose3, DVec3};
use sms_core::Intrinsics;

/// Least cosine between a ray and a normal. Points that are seen more obliquely are hidden, or as good as.
const LEAST_INCIDENCE: f64 = 0.2;

/// Least cosine between the normals of two points that are compared near the solution. At edges, points are compared with another
/// surface. The mean of both normals is off by half of their angle; of its information, the share (1 − cos) / 2 then
/// falls on directions that no surface resists: at most a twentieth.
const LEAST_ALIGNED: f64 = 0.9;

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
    view: DirectedFrame<'_>,
    level: usize,
    shift: [f64; 2],
    expected: f64,
) -> Option<(LinearResidual, [f64; 2])> {
    let k = &view.intrinsics;
    let scale = 1.0 / view.frame.scale(level);
    let (x, y) = (p.x / p.z, p.y / p.z);
    let (value, du, dv) = sample(
        &view.frame.luma[level],
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
    pub(crate) const PRIOR: [f64; 2] = [20.0, 30.0];

    fn columns(luma: f64) -> [f64; 2] {
        [-(luma - 128.0) / 64.0, -1.0]
    }

    fn expected(&self, luma: f64) -> f64 {
        let [gain, offset] = Self::columns(luma);
        luma - self.gain * gain - self.offset * offset
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

impl Weighing {
    /// Returns the weights from which an alignment begins: residuals of badly aligned frames are many σ.
    pub(crate) fn first(gate_m: f64) -> Self {
        Self { depth_scale: 10.0, color_scale: 4.0, gate_m }
    }

    /// Returns the robust scales after residuals were seen: the typical ones, but at least the noise. `sigma_z_m` is the noise of
    /// depth where it is largest.
    pub(crate) fn after(&self, seen: &ResidualStats, sigma_z_m: f64) -> Self {
        let scale = |h: &Histogram| h.median().map_or(1.0, |m| (1.4826 * m).max(1.0));
        let depth_scale = scale(&seen.depth);
        let gate_m = 8.0 * depth_scale * std::f64::consts::SQRT_2 * sigma_z_m;
        Self { depth_scale, color_scale: scale(&seen.color), gate_m: gate_m.max(0.01).min(self.gate_m) }
    }
}

/// Tukey's weight of a residual of `e` σ, if `scale` σ are typical.
fn tukey(e: f64, scale: f64) -> f64 {
    let t = e / (4.685 * scale);
    if t.abs() < 1.0 { (1.0 - t * t).powi(2) } else { 0.0 }
}

/// The point at which all residuals are linearised.
#[derive(Clone, Copy)]
pub(crate) struct LinearisationPoint<'a> {
    /// Level of the brightness images.
    pub(crate) level: usize,
    pub(crate) poses: &'a [DPose3],
    /// Shift of the colour against the depth, pixels at loaded size.
    pub(crate) color_shift: [f64; 2],
    pub(crate) phase: Phase,
}

/// The two parts of the refinement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Phase {
    /// From afar, every measurement helps, and steps that are too small are safe.
    Approach,
    /// Near the solution, derivatives that are wrong by noise or by smoothing are left out ([`crate::pair`]).
    Estimate,
}

/// One direction of a pair: points of `from` are projected into `to`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Arc {
    pub(crate) from: usize,
    pub(crate) to: usize,
    pub(crate) brightness: Brightness,
}

/// The surface of a frame at the projection of a point.
pub(crate) struct Meeting {
    /// The measured point.
    pub(crate) q: DVec3,
    pub(crate) n: DVec3,
    pub(crate) sigma_z_m: f64,
    /// Whether both surfaces have a direction, and look to the same side.
    pub(crate) faces: bool,
    /// See [`crate::views::Direction`].
    pub(crate) is_flat: bool,
}

/// Returns the meeting of the point `p`, whose normal is `n_p`, with the surface at its projection; `None` if that is not within
/// the gate.
pub(crate) fn meeting(
    p: DVec3,
    n_p: DVec3,
    surface: &Surface,
    k: &Intrinsics,
    gate_m: f64,
) -> Option<Meeting> {
    // Normals that differ by more than 60° belong to different surfaces.
    const LEAST_COSINE: f64 = 0.5;
    let (x, y) = surface.pixel.filter(|_| surface.depth.z > 0.0)?;
    let q = pixel_point(k, x as i64, y as i64, surface.depth.z.into());
    let n = surface.direction.n_c();
    let has_plane = n != DVec3::ZERO;
    let off = if has_plane { n.dot(p - q) } else { p.z - q.z };
    // A point whose surface looks away from the camera is hidden from it: it met the surface in front of it.
    let is_hidden = n_p != DVec3::ZERO && -n_p.dot(p) < LEAST_INCIDENCE * p.length();
    (off.abs() <= gate_m && !is_hidden).then_some(Meeting {
        q,
        n,
        sigma_z_m: surface.depth.sigma_z_m.into(),
        faces: has_plane && n.dot(n_p) > LEAST_COSINE,
        is_flat: surface.direction.is_flat,
    })
}

/// Calls `f` with each point, its position and normal in the axes of another camera, and the surface there.
pub(crate) fn for_each_landing(
    points: &[Point],
    x_ji: &DPose3,
    view_j: DirectedFrame<'_>,
    mut f: impl FnMut(&Point, DVec3, DVec3, &Surface),
) {
    const BATCH: usize = 64;
    let turn = DMat3::from_quat(x_ji.rotation);
    for batch in points.chunks(BATCH) {
        // The places that a last batch leaves empty are behind the camera.
        let mut mapped = [DVec3::ZERO; BATCH];
        for (p, point) in mapped.iter_mut().zip(batch) {
            *p = turn * point.p_c + x_ji.translation;
        }
        let surfaces = view_j.surfaces(&mapped);
        for ((point, p), surface) in batch.iter().zip(mapped).zip(&surfaces) {
            f(point, p, turn * point.n_c, surface);
        }
    }
}

/// Returns √(a² + b²) without the care for overflow of `hypot`, which takes longer than the rest of a weight.
fn length(a: f64, b: f64) -> f64 {
    (a * a + b * b).sqrt()
}

/// Maps points of frame i (`arc.from`) into frame j (`arc.to`, which is `view_j`) and sums up their linearised residuals.
pub(crate) fn linearise(
    points: &[Point],
    view_j: DirectedFrame<'_>,
    arc: &Arc,
    at: LinearisationPoint<'_>,
    center_w: DVec3,
    weighing: &Weighing,
    config: &PosesConfig,
) -> PairSums {
    let LinearisationPoint { level, poses, color_shift, phase } = at;
    let (x_wi, x_wj, brightness) = (&poses[arc.from], &poses[arc.to], arc.brightness);
    let x_ji = x_wj.inverse() * *x_wi;
    let center = x_wj.inverse_transform_point(center_w);
    let k_j = &view_j.intrinsics;
    let turn = DMat3::from_quat(x_ji.rotation);
    let mut sums = Sums::new(phase);
    let mut seen = ResidualStats::default();
    for_each_landing(points, &x_ji, view_j, |point, p, n_i, surface| {
        let Some(met) = meeting(p, n_i, surface, k_j, weighing.gate_m) else { return };
        let is_one_surface = phase == Phase::Approach || met.n.dot(n_i) >= LEAST_ALIGNED;
        if config.use_depth && met.faces && is_one_surface {
            // The mean of both normals: two points of a curved surface then have no residual (Rusinkiewicz 2019).
            let n = (met.n + n_i).normalize();
            let q = met.q;
            let r = depth_residual(p, q, n);
            let sigma = length(point.sigma_m, sigma_along_normal(met.sigma_z_m, q, n));
            let e = r.residual / sigma;
            seen.depth.add(e.abs());
            seen.depth_mm.add(1e3 * r.residual.abs());
            let weight = tukey(e, weighing.depth_scale) / (sigma * weighing.depth_scale).powi(2);
            if weight > 0.0 {
                let by_focal = n.dot(turn * by_focal_of(point.p_c) - by_focal_of(q));
                sums.add_depth(&r.jacobian(p, center), by_focal, r.residual, weight);
            }
        }
        // Without a direction of the surface, the derivatives of both images cannot be compared.
        if config.use_color && point.textured && met.faces {
            let expected = brightness.expected(point.luma);
            let Some((r, slope)) = color_residual(p, view_j, level, color_shift, expected) else {
                return;
            };
            let sigma = length(config.color_sigma, config.color_slip_px * length(slope[0], slope[1]));
            let e = r.residual / sigma;
            seen.color.add(e.abs());
            seen.color_levels.add(r.residual.abs());
            let weight = tukey(e, weighing.color_scale) / (sigma * weighing.color_scale).powi(2);
            let gain = 1.0 + brightness.gain / 64.0;
            let gradients = Gradients { p, n: n_i, turn: &turn, point, k_j };
            if let Some((by_i, by_j)) = gradients.rows(gain, &r, center).filter(|_| weight > 0.0) {
                sums.add_color(&by_i, &by_j, r.residual, weight);
            }
        }
    });
    sums.in_world(&DMat3::from_quat(x_wj.rotation), seen).with_prior(brightness)
}

/// A point of a plane that both frames see, with its texture.
struct Gradients<'a> {
    /// The point in camera j.
    p: DVec3,
    /// The normal of its plane in camera j.
    n: DVec3,
    /// Rotation from camera i to camera j.
    turn: &'a DMat3,
    point: &'a Point,
    k_j: &'a Intrinsics,
}

impl Gradients<'_> {
    /// Returns the derivatives of a colour residual with respect to all unknowns, by the image of frame i and by that of
    /// frame j. `None` if a camera sees the plane too obliquely.
    ///
    /// The texture of a plane has a gradient t within it. An image has the gradient a = t + λ n that is orthogonal to its
    /// ray, so that the image of one camera follows from that of the other.
    fn rows(&self, gain: f64, by_j: &LinearResidual, center: DVec3) -> Option<(ColorRow, ColorRow)> {
        let (p, n, point) = (self.p, self.n, self.point);
        let ray_i = *self.turn * point.p_c;
        let converted = |a: DVec3, ray: DVec3| {
            let along = n.dot(ray);
            (along.abs() >= LEAST_INCIDENCE * ray.length()).then(|| a - n * (a.dot(ray) / along))
        };
        let of_i = *self.turn * point.luma_by_p * gain;
        let pixel_j = [p.z / self.k_j.fx, p.z / self.k_j.fy];
        let [gain_column, offset_column] = Brightness::columns(point.luma);
        // The point moves with the focal length, and so does the one that frame j sees at a pixel.
        let parted = *self.turn * by_focal_of(point.p_c) - by_focal_of(p);
        let row = |in_j: DVec3, in_i: DVec3| -> ColorRow {
            let in_i = self.turn.transpose() * in_i;
            let by_shift = |k: usize| in_j[k] * pixel_j[k] - in_i[k] * point.pixel_m[k];
            let [a, b, c, d, e, f] = lever(p - center, in_j);
            let by_focal = in_j.dot(parted);
            [a, b, c, d, e, f, gain_column, offset_column, by_shift(0), by_shift(1), by_focal]
        };
        let of_j = by_j.by_point;
        Some((row(converted(of_i, p)?, of_i), row(of_j, converted(of_j, ray_i)?)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::moved_about;
    use crate::views::{Blocks, DepthSample, Direction, PreparedFrame};
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
            depth_noise: sms_frames::DepthNoise::default(),
            depth: vec![DepthSample::default(); 48 * 32],
            blocks: Blocks::default(),
            directions: vec![Direction::default(); 48 * 32],
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

            // A longer focal length moves the point of frame i, and what frame j sees at a pixel.
            let (e, k_i) = (1e-6, view.intrinsics);
            let turn = DMat3::from_quat((x_wj.inverse() * x_wi).rotation);
            let with_focal = |p: DVec3, log: f64| DVec3::new(p.x * f64::exp(-log), p.y * f64::exp(-log), p.z);
            let of_focal = |log: f64| {
                let p = (x_wj.inverse() * x_wi).transform_point(with_focal(p_i, log));
                depth_residual(p, with_focal(q, log), n).residual
            };
            let found = n.dot(turn * by_focal_of(p_i) - by_focal_of(q));
            let expected = (of_focal(e) - of_focal(-e)) / (2.0 * e);
            prop_assert!((found - expected).abs() < 1e-6, "{found} {expected}");

            // The interpolation is a polynomial only within a cell.
            let k = k_i;
            let inside = |x: f64| (x - 0.5).rem_euclid(1.0) > 1e-3 && (x - 0.5).rem_euclid(1.0) < 1.0 - 1e-3;
            prop_assume!(inside(k.fx * p.x / p.z + k.cx + 0.3) && inside(k.fy * p.y / p.z + k.cy - 0.2));
            let color = |p| color_residual(p, view.alone(), 0, [0.3, -0.2], 100.0);
            prop_assume!(color(p).is_some());
            let found = in_world_axes(r_wj, color(p).unwrap().0.jacobian(p, center));
            let (of_i, of_j) =
                by_differences(x_wi, x_wj, |i, j| color(carried(i, j)).map_or(f64::NAN, |r| r.0.residual));
            agree(found, of_i, 1.0)?;
            agree(found, of_j, -1.0)?;
            let of_focal = |log: f64| {
                let p = (x_wj.inverse() * x_wi).transform_point(with_focal(p_i, log));
                let view = view.alone().with_focal(log);
                color_residual(p, view, 0, [0.3, -0.2], 100.0).map_or(f64::NAN, |r| r.0.residual)
            };
            let found = color(p).unwrap().0.by_point.dot(turn * by_focal_of(p_i) - by_focal_of(p));
            let expected = (of_focal(e) - of_focal(-e)) / (2.0 * e);
            prop_assert!((found - expected).abs() < 1e-5 * (1.0 + expected.abs()), "{found} {expected}");
        }
    }
}
