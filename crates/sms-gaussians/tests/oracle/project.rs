//! EWA projection with forward-mode derivatives.

use super::dual::{Dual, INPUTS};
use sms_core::Camera;
use sms_gaussians::limits::{AREA_FLOOR, FAR, LOW_PASS, MARGIN, NEAR, SLOPE_LOW_PASS};
use sms_gaussians::parameters::{LOG_SCALE, PARAMETERS, POSITION, ROTATION};

/// Outputs of projection, in the order of [`OUTPUTS`]: mean x, y; conic xx, xy, yy; depth; world normal; share of
/// the opacity left by the low-pass filter.
pub(super) struct Projection {
    pub(super) outputs: [Dual; OUTPUTS],
    /// Change of depth per pixel in x and y; without derivatives, since training holds it constant.
    pub(super) depth_slope: [f64; 2],
}

pub(super) const OUTPUTS: usize = 10;
pub(super) const MEAN: usize = 0;
pub(super) const CONIC: usize = 2;
pub(super) const DEPTH: usize = 5;
pub(super) const NORMAL: usize = 6;
pub(super) const OPACITY_SHARE: usize = 9;

type Matrix = [[Dual; 3]; 3];

fn rotation(q: [Dual; 4]) -> Matrix {
    let squared = q.iter().fold(Dual::constant(0.0), |sum, &v| sum + v * v);
    let length = squared.sqrt();
    let [x, y, z, w] = q.map(|v| v / length);
    let (one, two) = (Dual::constant(1.0), Dual::constant(2.0));
    [
        [one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)],
        [two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x)],
        [two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y)],
    ]
}

/// Projects one Gaussian; `None` outside the near and far planes.
pub(super) fn project(row: &[f64; PARAMETERS], camera: &Camera) -> Option<Projection> {
    let input = |i: usize| Dual::input(row[i], i);
    let k = &camera.intrinsics;
    let x_cw = camera.x_wc.inverse();
    let r = glamx::DMat3::from_quat(x_cw.rotation);
    let r_cw = |i: usize, j: usize| Dual::constant(r.col(j)[i]);
    let position: [Dual; 3] = std::array::from_fn(|i| input(POSITION + i));
    let p: [Dual; 3] = std::array::from_fn(|i| {
        (0..3).fold(Dual::constant(x_cw.translation[i]), |sum, j| sum + r_cw(i, j) * position[j])
    });
    if p[2].value < NEAR || p[2].value > FAR {
        return None;
    }
    let r_wg = rotation(std::array::from_fn(|i| input(ROTATION + i)));
    let scale: [Dual; 3] = std::array::from_fn(|i| input(LOG_SCALE + i).exp());

    let (fx, fy) = (Dual::constant(k.fx), Dual::constant(k.fy));
    let slope = |x: Dual, center: f64, focal: f64, size: usize| {
        let size = size as f64;
        (x / p[2]).clamp(-(center + MARGIN * size) / focal, (size - center + MARGIN * size) / focal)
    };
    let (sx, sy) = (slope(p[0], k.cx, k.fx, k.width), slope(p[1], k.cy, k.fy, k.height));
    let zero = Dual::constant(0.0);
    let jacobian = [[fx / p[2], zero, -(fx / p[2] * sx)], [zero, fy / p[2], -(fy / p[2] * sy)]];
    // Σ_2D = J R_cw R_wg S S R_wgᵀ R_cwᵀ Jᵀ.
    let mut camera_axes = [[zero; 3]; 3];
    for (c, row) in camera_axes.iter_mut().enumerate() {
        for (axis, value) in row.iter_mut().enumerate() {
            for w in 0..3 {
                *value = *value + r_cw(c, w) * r_wg[w][axis] * scale[axis];
            }
        }
    }
    let mut image_axes = [[zero; 3]; 2];
    for (i, row) in image_axes.iter_mut().enumerate() {
        for (axis, value) in row.iter_mut().enumerate() {
            for c in 0..3 {
                *value = *value + jacobian[i][c] * camera_axes[c][axis];
            }
        }
    }
    let dot = |a: [Dual; 3], b: [Dual; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let low_pass = Dual::constant(LOW_PASS);
    let xx = dot(image_axes[0], image_axes[0]) + low_pass;
    let xy = dot(image_axes[0], image_axes[1]);
    let yy = dot(image_axes[1], image_axes[1]) + low_pass;
    let determinant = xx * yy - xy * xy;
    let area = (xx - low_pass) * (yy - low_pass) - xy * xy + Dual::constant(AREA_FLOOR);
    let shortest = (0..3).min_by(|&a, &b| scale[a].value.total_cmp(&scale[b].value)).unwrap_or(0);
    let normal: [Dual; 3] = std::array::from_fn(|i| r_wg[i][shortest]);
    let eye = camera.center_w();
    let away = (0..3).map(|i| normal[i].value * (position[i].value - eye[i])).sum::<f64>() > 0.0;
    let normal = normal.map(|n| if away { -n } else { n });
    // Mean depth at a pixel: Cov(pixel)⁻¹ Cov(pixel, z), with a separate low-pass filter.
    let [sxx, syy] = [xx, yy].map(|v| v.value - LOW_PASS + SLOPE_LOW_PASS);
    let [kx, ky] = [0, 1].map(|i| dot(image_axes[i], camera_axes[2]).value);
    let covariance = xy;
    let (xy, determinant_of_slope) = (xy.value, sxx * syy - xy.value * xy.value);
    Some(Projection {
        outputs: [
            fx * p[0] / p[2] + Dual::constant(k.cx),
            fy * p[1] / p[2] + Dual::constant(k.cy),
            yy / determinant,
            -(covariance / determinant),
            xx / determinant,
            p[2],
            normal[0],
            normal[1],
            normal[2],
            (area / determinant).sqrt(),
        ],
        depth_slope: [syy * kx - xy * ky, sxx * ky - xy * kx].map(|v| v / determinant_of_slope),
    })
}

impl Projection {
    pub(super) fn value(&self, output: usize) -> f64 {
        self.outputs[output].value
    }

    /// Converts ∂L/∂outputs to ∂L/∂inputs.
    pub(super) fn gradient(&self, d_outputs: &[f64; OUTPUTS]) -> [f64; INPUTS] {
        std::array::from_fn(|i| {
            self.outputs.iter().zip(d_outputs).map(|(output, d)| output.derivative[i] * d).sum()
        })
    }
}
