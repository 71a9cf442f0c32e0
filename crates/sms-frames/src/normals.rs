//! Normals from depth: a weighted plane through each pixel's neighbourhood.

use crate::DepthNoise;
use crate::plane_fit::{InverseDepthFit, InverseDepthPlane, WeightedOffset};
use sms_core::{DepthImage, Image, Intrinsics, NormalImage};

/// Minimum number of valid pixels in the window.
const MIN_VALID: usize = 6;
/// Steepest slope that passes the first, wide gate: metres of depth per metre across.
pub(crate) const MAX_SLOPE: f64 = 3.0;
/// Grid of stored normals, which a 16-bit cache keeps exactly; rounding turns them by less than 3e-5 rad.
pub(crate) const NORMAL_GRID: f32 = 32767.0;

/// Computes unit normals in the camera frame, facing the camera; zero where fewer than six pixels of the window agree on
/// a plane.
///
/// Inverse depth is fitted as an affine function of the pixel (exact for planes; noise is along the depth axis
/// only), weighted by nearness. Neighbours farther than 3σ(z) from the plane are left out and the plane is fitted
/// again, so that a step in depth does not tilt the normals beside it.
pub fn normals_from_depth(
    depth: &DepthImage,
    intrinsics: &Intrinsics,
    noise: &DepthNoise,
    radius: usize,
) -> NormalImage {
    let pixels = 0..depth.data.len();
    let normals = normals_at(pixels.map(Some), depth, intrinsics, noise, radius);
    Image::from_vec(depth.width, depth.height, normals)
}

/// As [`normals_from_depth`], at the pixels with the given indices only; the normal of `None` is zero.
pub fn normals_at(
    pixels: impl Iterator<Item = Option<usize>>,
    depth: &DepthImage,
    intrinsics: &Intrinsics,
    noise: &DepthNoise,
    radius: usize,
) -> Vec<[f32; 3]> {
    let window = Window::new(radius);
    let fit = Fit { window: &window, depth, inverse: inverse_depths(depth), intrinsics, noise };
    let normal = |pixel: usize| {
        let (x, y) = (pixel % depth.width, pixel / depth.width);
        let plane = (depth.data[pixel] > 0.0).then(|| fit.at(x, y))??;
        plane_normal_c(&plane, intrinsics, x as f64 + 0.5, y as f64 + 0.5)
    };
    pixels.map(|pixel| pixel.and_then(normal).unwrap_or_default()).collect()
}

/// Returns the inverse of each depth; 0 without a measurement.
fn inverse_depths(depth: &DepthImage) -> Vec<f64> {
    depth.data.iter().map(|&z| if z > 0.0 { 1.0 / f64::from(z) } else { 0.0 }).collect()
}

/// The pixels of a window, row by row.
struct Window {
    radius: usize,
    cells: Vec<Cell>,
}

/// A pixel of a window.
struct Cell {
    dx: f64,
    dy: f64,
    /// Distance from the centre, pixels.
    distance: f64,
    weighted: WeightedOffset,
}

impl Window {
    fn new(radius: usize) -> Self {
        let r = radius as i64;
        let falloff = 1.0 / (2.0 * (0.8 * radius.max(1) as f64).powi(2));
        let offsets = (-r..=r).flat_map(|dy| (-r..=r).map(move |dx| (dx as f64, dy as f64)));
        let cell = |(dx, dy): (f64, f64)| {
            let d2 = dx * dx + dy * dy;
            Cell { dx, dy, distance: d2.sqrt(), weighted: WeightedOffset::new(dx, dy, (-d2 * falloff).exp()) }
        };
        Self { radius, cells: offsets.map(cell).collect() }
    }
}

/// Fits planes to windows of a depth image.
struct Fit<'a> {
    window: &'a Window,
    depth: &'a DepthImage,
    inverse: Vec<f64>,
    intrinsics: &'a Intrinsics,
    noise: &'a DepthNoise,
}

impl Fit<'_> {
    fn at(&self, x: usize, y: usize) -> Option<InverseDepthPlane> {
        let z0 = f64::from(self.depth[(x, y)]);
        let gate = 3.0 * self.noise.sigma_m(z0);
        let rise = MAX_SLOPE * self.intrinsics.pixel_footprint(z0);
        // First a wide gate around the centre pixel, then twice 3σ around the current plane.
        let mut fit = self.sums(x, y, |cell, z| (z - z0).abs() - rise * cell.distance <= gate)?;
        for _ in 0..2 {
            let plane = fit.solve()?;
            // With inverse depth w > 0 of the plane, |z − 1/w| ≤ gate; the form without a division is false for w ≤ 0.
            let next = self.sums(x, y, |cell, z| {
                let w = plane.inverse_depth_at(cell.dx, cell.dy);
                (z * w - 1.0).abs() <= gate * w
            })?;
            if next == fit {
                return Some(plane);
            }
            fit = next;
        }
        fit.solve()
    }

    /// Returns the sums over those depths of the window around (x, y) that `is_inlier` accepts; `None` for too few.
    fn sums(&self, x: usize, y: usize, is_inlier: impl Fn(&Cell, f64) -> bool) -> Option<InverseDepthFit> {
        let (w, h, r) = (self.depth.width, self.depth.height, self.window.radius);
        let (left, right) = (x.saturating_sub(r), (x + r + 1).min(w));
        let mut fit = InverseDepthFit::default();
        for v in y.saturating_sub(r)..(y + r + 1).min(h) {
            let first = (v + r - y) * (2 * r + 1) + left + r - x;
            let cells = &self.window.cells[first..first + right - left];
            let row = v * w + left..v * w + right;
            let depths = self.depth.data[row.clone()].iter().zip(&self.inverse[row]);
            for (cell, (&z, &inverse)) in cells.iter().zip(depths) {
                if inverse > 0.0 && is_inlier(cell, f64::from(z)) {
                    fit.add_weighted(&cell.weighted, inverse);
                }
            }
        }
        (fit.count >= MIN_VALID).then_some(fit)
    }
}

/// Returns the normal of a plane with inverse depth `plane.c` at image-plane coordinates (u, v); `None` if it is viewed at
/// less than 5°, where depth does not determine it.
fn plane_normal_c(plane: &InverseDepthPlane, k: &Intrinsics, u: f64, v: f64) -> Option<[f32; 3]> {
    // n·p = -1 on the plane, with p = z (x', y', 1) and 1/z = c + gx (fx x' + cx - u) + gy (fy y' + cy - v).
    let n = [-plane.gx * k.fx, -plane.gy * k.fy, -(plane.c + plane.gx * (k.cx - u) + plane.gy * (k.cy - v))];
    let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
    let ray = [(u - k.cx) / k.fx, (v - k.cy) / k.fy, 1.0f64];
    let ray_length = (ray[0] * ray[0] + ray[1] * ray[1] + 1.0).sqrt();
    let cosine = -(n[0] * ray[0] + n[1] * ray[1] + n[2]) / (length * ray_length);
    (cosine.is_finite() && cosine > 0.087)
        .then(|| n.map(|v| ((v / length) as f32 * NORMAL_GRID).round() / NORMAL_GRID))
}
