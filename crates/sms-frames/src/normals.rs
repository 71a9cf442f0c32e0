//! Normals from depth: a weighted plane through each pixel's neighbourhood.

use crate::DepthNoise;
use crate::plane_fit::{InverseDepthFit, InverseDepthPlane};
use sms_core::{DepthImage, Image, Intrinsics, NormalImage};

/// Minimum number of valid pixels in the window.
const MIN_VALID: usize = 6;
/// Steepest slope that passes the first, wide gate: metres of depth per metre across.
const MAX_SLOPE: f64 = 3.0;
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
    let window = Window::new(radius);
    let mut normals = Image::filled(depth.width, depth.height, [0.0f32; 3]);
    for y in 0..depth.height {
        for x in 0..depth.width {
            if depth[(x, y)] > 0.0
                && let Some(plane) = window.fit(depth, intrinsics, noise, x, y)
                && let Some(n) = plane_normal_c(&plane, intrinsics, x as f64 + 0.5, y as f64 + 0.5)
            {
                normals[(x, y)] = n;
            }
        }
    }
    normals
}

/// The offsets of the window's pixels, with their distance and weight.
struct Window(Vec<(i64, i64, f64, f64)>);

impl Window {
    fn new(radius: usize) -> Self {
        let r = radius as i64;
        let falloff = 1.0 / (2.0 * (0.8 * radius.max(1) as f64).powi(2));
        let offsets = (-r..=r).flat_map(|dy| (-r..=r).map(move |dx| (dx, dy)));
        Self(
            offsets
                .map(|(dx, dy)| {
                    let d2 = (dx * dx + dy * dy) as f64;
                    (dx, dy, d2.sqrt(), (-d2 * falloff).exp())
                })
                .collect(),
        )
    }

    fn fit(
        &self,
        depth: &DepthImage,
        k: &Intrinsics,
        noise: &DepthNoise,
        x: usize,
        y: usize,
    ) -> Option<InverseDepthPlane> {
        let z0 = f64::from(depth[(x, y)]);
        let gate = 3.0 * noise.sigma_m(z0);
        let rise = MAX_SLOPE * k.pixel_footprint(z0);
        let mut plane: Option<InverseDepthPlane> = None;
        // First a wide gate around the centre pixel, then twice 3σ around the current plane.
        for _ in 0..3 {
            let mut fit = InverseDepthFit::default();
            for &(dx, dy, distance, weight) in &self.0 {
                let Some(&z) = depth.get(x as i64 + dx, y as i64 + dy) else { continue };
                if z <= 0.0 {
                    continue;
                }
                let (z, dx, dy) = (f64::from(z), dx as f64, dy as f64);
                let off = match &plane {
                    None => (z - z0).abs() - rise * distance,
                    Some(p) => (z - p.depth_at(dx, dy)).abs(),
                };
                if off <= gate {
                    fit.add(dx, dy, 1.0 / z, weight);
                }
            }
            if fit.count < MIN_VALID {
                return None;
            }
            plane = Some(fit.solve()?);
        }
        plane
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
