//! EWA projection of Gaussians into one camera (Zwicker et al. 2002; Kerbl et al. 2023), sixteen at a time.

use super::bands::Span;
use super::lanes::{Chunk, Lanes, NONE, WIDTH, array, by_simd};
use super::tile::{BAND_ROWS, FLAT, LOG2_ALPHA_MIN, NORMAL_CHANNEL, Splat};
use crate::AFFINITY_DIM;
use crate::harmonics::{BASIS, CONSTANT, basis, difference};
use crate::parameters::{AFFINITY, COLOR, HARMONICS, LOG_SCALE, LOGIT_OPACITY, POSITION, ROTATION, Row};
use glamx::Mat3;
use sms_core::Camera;
use std::f32::consts::{LN_2, LOG2_E};

/// Variance in pixels² added to both axes of a splat, so that few fall between pixels (the 2-D low-pass filter): less than
/// that of a pixel's square, 1/12; Mip-Splatting uses 0.1 (Yu et al., CVPR 2024).
///
/// The splat's opacity is lowered by √(det Σ / det(Σ + filter)), so that the filter spreads a splat without adding to
/// it (Mip-Splatting). Otherwise small discs would bleed over silhouettes. With a filter of 0.3 px², on four noisy
/// billiards scans held-out mIoU rose from 0.906–0.925 to 0.961–0.968, PSNR by 0.4 to 1.0 dB, and depth errors fell by
/// 0.3 to 0.5 mm.
///
/// A wider filter still moves silhouettes outwards, because many discs seen edge-on overlap there and their opacities do not
/// simply add up. With 0.3, 0.1 and 0.05 px², ten billiards scans have depth errors of 1.67, 1.27 and 1.13 mm at 29.7, 30.0 and
/// 30.0 dB; with discs that stay on the surface, 0.05 and 0.02 give 0.94 and 0.89 mm at 34.2 and 34.1 dB on two of them
/// (experiments/studies/scan/fused.md).
pub const LOW_PASS: f64 = 0.02;
/// Constant added to det Σ, pixels⁴, so that it has a gradient for discs seen edge-on.
pub const AREA_FLOOR: f64 = 1e-6;
/// Low-pass filter of the slope of a splat's depth, in place of [`LOW_PASS`], pixels²: small enough to preserve the
/// slope of discs of few pixels, and large enough to bound the slope of discs seen edge-on, to 1/(2√ε) standard
/// deviations per pixel.
///
/// On a noisy billiards scan the mean error of depth on surfaces at 53° to 66° to the ray was 2.5 mm with the depth of
/// the centre. With a slope it was 1.19 mm for ε = 0.3 (the low-pass filter of the time), 0.68 with 0.1, 0.50 with 0.05, 0.39 with
/// 0.02, 0.35 with 0.01 and 0.31 with 0.003.
pub const SLOPE_LOW_PASS: f64 = 0.01;
/// Least depth of visible Gaussians, metres.
pub const NEAR: f64 = 0.02;
/// Largest depth of visible Gaussians, metres. Only damaged data is farther, and would overflow sums.
pub const FAR: f64 = 1e6;
/// The linearisation clamps directions to the image, enlarged by this share of its size.
pub const MARGIN: f64 = 0.15;

/// A camera in single precision.
#[derive(Debug, Clone, Copy)]
pub(super) struct CameraView {
    /// Rotation from the world to the camera, row by row.
    pub(super) r_cw: [[f32; 3]; 3],
    pub(super) t_cw: [f32; 3],
    /// Centre of projection in the world.
    eye_w: [f32; 3],
    /// Focal lengths.
    pub(super) focal: [f32; 2],
    /// Principal point.
    center: [f32; 2],
    /// Limits of x/z and y/z in the linearisation.
    limit: [(f32, f32); 2],
    pub(super) width: usize,
    pub(super) height: usize,
}

impl CameraView {
    pub(super) fn new(camera: &Camera) -> Self {
        let k = &camera.intrinsics;
        let x_cw = camera.x_wc.inverse();
        let limits = |c: f64, f: f64, size: f64| {
            ((-(c + MARGIN * size) / f) as f32, ((size - c + MARGIN * size) / f) as f32)
        };
        Self {
            r_cw: Mat3::from_quat(x_cw.rotation.as_quat()).transpose().to_cols_array_2d(),
            t_cw: x_cw.translation.as_vec3().to_array(),
            eye_w: camera.center_w().as_vec3().to_array(),
            focal: [k.fx as f32, k.fy as f32],
            center: [k.cx as f32, k.cy as f32],
            limit: [limits(k.cx, k.fx, k.width as f64), limits(k.cy, k.fy, k.height as f64)],
            width: k.width,
            height: k.height,
        }
    }

    /// Returns the vector from the camera to a Gaussian, metres in the world.
    #[inline(always)]
    pub(super) fn direction_w(&self, Row(row): &Row) -> [f32; 3] {
        array!(3, |i| row[POSITION + i] - self.eye_w[i])
    }

    /// Returns the colour of a Gaussian in this view.
    #[inline(always)]
    fn color_of(&self, row: &Row) -> [f32; 3] {
        let coefficients = row.0[HARMONICS..].first_chunk::<{ 3 * BASIS }>().expect("a row is longer");
        let color = array!(3, |c| row.0[COLOR + c]);
        if *coefficients == CONSTANT {
            return color;
        }
        let difference = difference(coefficients, &basis(self.direction_w(row)));
        array!(3, |c| color[c] + difference[c])
    }
}

/// A vector, or a point, of each of sixteen Gaussians.
pub(super) type Vectors<L> = [L; 3];

#[inline(always)]
pub(super) fn dot<L: Lanes>(a: Vectors<L>, b: Vectors<L>) -> L {
    a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]))
}

/// Matrix times vector.
#[inline(always)]
pub(super) fn rotated<L: Lanes>(rows: &[[f32; 3]; 3], v: Vectors<L>) -> Vectors<L> {
    array!(3, |i| dot(array!(3, |j| L::splat(rows[i][j])), v))
}

/// Intermediate results shared by projection and its gradient.
pub(super) struct Linearized<L: Lanes> {
    pub(super) p_c: Vectors<L>,
    /// 1/z.
    pub(super) inverse_z: L,
    pub(super) quaternion: [L; 4],
    pub(super) scale: [L; 3],
    pub(super) opacity: L,
    /// Clamped x/z and y/z, and where they were not clamped.
    pub(super) slope: [L; 2],
    pub(super) unclamped: [L::Mask; 2],
    /// Axes times scale, in the camera.
    pub(super) axes_c: [Vectors<L>; 3],
    /// The same in the image, pixels.
    pub(super) axes_i: [[L; 2]; 3],
    /// 2-D covariance with the low-pass filter: xx, xy, yy.
    pub(super) covariance: [L; 3],
    /// Determinants of the covariance without the filter, plus [`AREA_FLOOR`], and with the filter.
    pub(super) determinants: [L; 2],
    /// Change of depth per pixel, see [`depth_slope`].
    pub(super) depth_slope: [L; 2],
    /// One for the shortest axis (the first of equals), zero for the others.
    pub(super) shortest: [L; 3],
    /// −1 if the shortest axis must be flipped to face the camera, else 1.
    pub(super) facing: L,
    /// The shortest axis in the world, facing the camera.
    pub(super) normal_w: Vectors<L>,
    /// Lanes with a finite Gaussian in front of the camera.
    pub(super) valid: L::Mask,
}

/// The first sixteen parameters of up to sixteen Gaussians.
#[inline(always)]
pub(super) fn columns<L: Lanes>(rows: &[Row]) -> [L; WIDTH] {
    let mut of_rows = [L::splat(0.0); WIDTH];
    for (to, row) in of_rows.iter_mut().zip(rows) {
        *to = L::load(row.0.first_chunk().expect("a row is longer"));
    }
    L::transpose(of_rows)
}

#[inline(always)]
pub(super) fn linearize<L: Lanes>(columns: &[L; WIDTH], view: &CameraView) -> Linearized<L> {
    let one = L::splat(1.0);
    let p_w = [columns[POSITION], columns[POSITION + 1], columns[POSITION + 2]];
    let r_p = rotated(&view.r_cw, p_w);
    let p_c = array!(3, |i| r_p[i] + L::splat(view.t_cw[i]));
    let largest = L::splat(f32::MAX);
    let finite = L::both(largest.ge(p_c[0].abs()), largest.ge(p_c[1].abs()));
    let depth = L::both(p_c[2].ge(L::splat(NEAR as f32)), L::splat(FAR as f32).ge(p_c[2]));
    let inverse_z = one / p_c[2];

    let quaternion @ [x, y, z, w] =
        [columns[ROTATION], columns[ROTATION + 1], columns[ROTATION + 2], columns[ROTATION + 3]];
    let (x2, y2, z2) = (x + x, y + y, z + z);
    let (xx, yy, zz, xy, xz, yz) = (x * x2, y * y2, z * z2, x * y2, x * z2, y * z2);
    let (wx, wy, wz) = (w * x2, w * y2, w * z2);
    let axes_w = [
        [one - (yy + zz), xy + wz, xz - wy],
        [xy - wz, one - (xx + zz), yz + wx],
        [xz + wy, yz - wx, one - (xx + yy)],
    ];
    let log_scale = [columns[LOG_SCALE], columns[LOG_SCALE + 1], columns[LOG_SCALE + 2]];
    let scale = array!(3, |k| log_scale[k].exp());

    let mut slope = [inverse_z; 2];
    let mut unclamped = [depth; 2];
    for i in 0..2 {
        let ratio = p_c[i] * inverse_z;
        let (low, high) = (L::splat(view.limit[i].0), L::splat(view.limit[i].1));
        slope[i] = ratio.max(low).min(high);
        unclamped[i] = L::both(ratio.ge(low), high.ge(ratio));
    }
    let focal = array!(2, |i| L::splat(view.focal[i]) * inverse_z);
    let mut axes_c = axes_w;
    let mut axes_i = [[one; 2]; 3];
    let low_pass = L::splat(LOW_PASS as f32);
    let mut covariance = [low_pass, L::splat(0.0), low_pass];
    for k in 0..3 {
        axes_c[k] = rotated(&view.r_cw, array!(3, |i| axes_w[k][i] * scale[k]));
        let v = axes_c[k];
        let u = array!(2, |i| focal[i] * slope[i].neg_mul_add(v[2], v[i]));
        axes_i[k] = u;
        covariance[0] = u[0].mul_add(u[0], covariance[0]);
        covariance[1] = u[0].mul_add(u[1], covariance[1]);
        covariance[2] = u[1].mul_add(u[1], covariance[2]);
    }

    let crossed = crossed(&axes_i);
    let filtered = low_pass.mul_add(covariance[0] + covariance[2] - low_pass, crossed);
    let determinants = [crossed + L::splat(AREA_FLOOR as f32), filtered];
    let [s0, s1, s2] = log_scale;
    let first = one.keep(L::both(s1.ge(s0), s2.ge(s0)));
    let second = one.keep(s2.ge(s1)) * (one - first);
    let shortest = [first, second, one - first - second];
    let axis_c = array!(3, |i| dot(shortest, array!(3, |k| axes_c[k][i])));
    let facing = one - L::splat(2.0).keep(dot(axis_c, p_c).gt(L::splat(0.0)));
    let normal_w = array!(3, |i| dot(shortest, array!(3, |k| axes_w[k][i])) * facing);
    let opacity = one / (one + columns[LOGIT_OPACITY].negated().exp());
    let valid = L::both(finite, depth);
    Linearized {
        p_c,
        inverse_z,
        quaternion,
        scale,
        opacity,
        slope,
        unclamped,
        axes_c,
        axes_i,
        covariance,
        determinants,
        depth_slope: depth_slope(&axes_c, &axes_i, crossed),
        shortest,
        facing,
        normal_w,
        valid,
    }
}

/// u × v.
#[inline(always)]
pub(super) fn cross<L: Lanes>(u: [L; 2], v: [L; 2]) -> L {
    u[0] * v[1] - u[1] * v[0]
}

/// det Σ_k u_k u_kᵀ by Cauchy and Binet. A sum of squares keeps the digits that xx·yy − xy² would lose.
#[inline(always)]
fn crossed<L: Lanes>(axes: &[[L; 2]; 3]) -> L {
    let [a, b, c] = [cross(axes[0], axes[1]), cross(axes[0], axes[2]), cross(axes[1], axes[2])];
    a.mul_add(a, b.mul_add(b, c * c))
}

/// Returns the change of depth per pixel within a splat, from its axes in the camera and in the image: given a pixel,
/// the mean depth of the linearised Gaussian is z + slope · (pixel − mean), with slope = Cov(pixel)⁻¹ Cov(pixel, z).
/// For a disc, this is its plane.
#[inline(always)]
fn depth_slope<L: Lanes>(axes_c: &[Vectors<L>; 3], axes_i: &[[L; 2]; 3], crossed: L) -> [L; 2] {
    let epsilon = L::splat(SLOPE_LOW_PASS as f32);
    let (mut xx, mut xy, mut yy) = (epsilon, L::splat(0.0), epsilon);
    let mut with_z = [L::splat(0.0); 2];
    for k in 0..3 {
        let ([x, y], z) = (axes_i[k], axes_c[k][2]);
        xx = x.mul_add(x, xx);
        xy = x.mul_add(y, xy);
        yy = y.mul_add(y, yy);
        with_z = [x.mul_add(z, with_z[0]), y.mul_add(z, with_z[1])];
    }
    let determinant = epsilon.mul_add(xx + yy - epsilon, crossed);
    let inverse = L::splat(1.0) / determinant;
    [(yy * with_z[0] - xy * with_z[1]) * inverse, (xx * with_z[1] - xy * with_z[0]) * inverse]
}

/// Inverse of the 2-D covariance: xx, xy, yy.
#[inline(always)]
pub(super) fn conic<L: Lanes>([xx, xy, yy]: [L; 3]) -> [L; 3] {
    let inverse = L::splat(1.0) / (xx * yy - xy * xy);
    [yy * inverse, (xy * inverse).negated(), xx * inverse]
}

/// A projected Gaussian: the view-dependent part of its [`Splat`], and its outline.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct Projected(Chunk);

/// The ellipse in which alpha reaches [`super::tile::ALPHA_MIN`].
#[derive(Debug, Clone, Copy)]
pub(super) struct Outline {
    /// Centre, pixels.
    pub(super) mean: [f32; 2],
    /// Half width and half height, pixels.
    pub(super) half: [f32; 2],
    /// Half width of the row through the centre.
    pub(super) half_row: f32,
    /// Horizontal shift of the middle of a row, per row.
    pub(super) slant: f32,
}

const MEAN: usize = 0;
const POWER: usize = 2;
const LOG2_OPACITY: usize = 5;
const DEPTH: usize = 6;
const NORMAL: usize = 7;
const HALF: usize = 10;
const HALF_ROW: usize = 12;
const SLANT: usize = 13;
const DEPTH_SLOPE: usize = 14;

impl Projected {
    pub(super) const UNSEEN: Self = Self(NONE);

    /// Returns the splat in `view` of the Gaussian with parameters `row`.
    #[inline(always)]
    pub(super) fn splat(&self, row: &Row, view: &CameraView) -> Splat {
        let p = &self.0;
        let mut splat = Splat {
            mean: [p[MEAN], p[MEAN + 1]],
            power: [p[POWER], p[POWER + 1], p[POWER + 2]],
            log2_opacity: p[LOG2_OPACITY],
            depth: p[DEPTH],
            depth_slope: [p[DEPTH_SLOPE], p[DEPTH_SLOPE + 1]],
            ..Splat::ZERO
        };
        splat.features[..3].copy_from_slice(&view.color_of(row));
        splat.features[NORMAL_CHANNEL..NORMAL_CHANNEL + 3].copy_from_slice(&p[NORMAL..NORMAL + 3]);
        splat.features[FLAT - AFFINITY_DIM..].copy_from_slice(&row.0[AFFINITY..AFFINITY + AFFINITY_DIM]);
        splat
    }

    #[inline(always)]
    pub(super) fn outline(&self) -> Outline {
        let p = &self.0;
        Outline {
            mean: [p[MEAN], p[MEAN + 1]],
            half: [p[HALF], p[HALF + 1]],
            half_row: p[HALF_ROW],
            slant: p[SLANT],
        }
    }

    /// Bits of the depth. Depths are positive, so their bits have the same order.
    #[inline(always)]
    pub(super) fn depth_bits(&self) -> u32 {
        self.0[DEPTH].to_bits()
    }
}

/// Projects `rows` and returns the bands that each touches. A Gaussian touches none if it is invisible (behind or at
/// the camera, outside the image, too faint, or degenerate).
#[inline(always)]
fn project<L: Lanes>(
    rows: &[Row],
    view: &CameraView,
    bands: usize,
    projected: &mut [Projected],
    spans: &mut [Span],
) {
    let of_rows = rows.chunks(WIDTH).zip(spans.chunks_mut(WIDTH));
    for ((rows, spans), projected) in of_rows.zip(projected.chunks_mut(WIDTH)) {
        let columns = columns::<L>(rows);
        let m = linearize(&columns, view);
        let (zero, half) = (L::splat(0.0), L::splat(-0.5 * LOG2_E));
        let [xx, xy, yy] = m.covariance;
        let conic = conic(m.covariance);
        let determinant = xx * yy - xy * xy;
        let mean = array!(2, |i| {
            (L::splat(view.focal[i]) * m.p_c[i]).mul_add(m.inverse_z, L::splat(view.center[i]))
        });
        let spread = m.determinants[0] / m.determinants[1];
        let log2_opacity = spread.log2().mul_add(L::splat(0.5), m.opacity.log2());
        // Squared Mahalanobis distance at which alpha reaches its minimum.
        let reach = (log2_opacity - L::splat(LOG2_ALPHA_MIN)) * L::splat(2.0 * LN_2);
        let (half_x, half_y) = ((reach * xx).sqrt(), (reach * yy).sqrt());
        let size = [L::splat(view.width as f32), L::splat(view.height as f32)];
        let right = L::both((mean[0] + half_x).gt(zero), size[0].gt(mean[0] - half_x));
        let below = L::both((mean[1] + half_y).gt(zero), size[1].gt(mean[1] - half_y));
        // In single precision, a splat thousands of pixels across loses its determinant. Dropping such splats does no
        // harm.
        let product = xx * yy;
        let sound = L::both(determinant.gt(product * L::splat(1e-6)), L::splat(f32::MAX).ge(product));
        let seen = L::both(L::both(right, below), L::both(sound, L::both(m.valid, reach.gt(zero))));

        let mut out = [zero; WIDTH];
        out[MEAN..MEAN + 2].copy_from_slice(&mean);
        out[POWER] = conic[0] * half;
        out[POWER + 1] = conic[1] * L::splat(-LOG2_E);
        out[POWER + 2] = conic[2] * half;
        out[LOG2_OPACITY] = log2_opacity;
        out[DEPTH] = m.p_c[2];
        out[NORMAL..NORMAL + 3].copy_from_slice(&m.normal_w);
        out[HALF] = half_x;
        out[HALF + 1] = half_y;
        out[HALF_ROW] = (reach * determinant / yy).sqrt();
        out[SLANT] = xy / yy;
        out[DEPTH_SLOPE..DEPTH_SLOPE + 2].copy_from_slice(&m.depth_slope);
        let out = L::transpose(out);
        for (i, to) in projected.iter_mut().enumerate() {
            out[i].store(&mut to.0);
        }
        let ends = [mean[1] - half_y, mean[1] + half_y + L::splat(BAND_ROWS as f32)];
        let [first, end] = array!(2, |i| {
            let band = ends[i] * L::splat(1.0 / BAND_ROWS as f32);
            band.max(zero).min(L::splat(bands as f32)).keep(seen)
        });
        let packed = L::pack(first, end);
        for (span, packed) in spans.iter_mut().zip(packed) {
            *span = Span::unpack(packed);
        }
    }
}

by_simd! {
    /// Projects Gaussians.
    fn project_rows = project(
        rows: &[Row], view: &CameraView, bands: usize, projected: &mut [Projected], spans: &mut [Span],
    )
}
