//! Multipath of time-of-flight cameras: light that reaches a surface by way of another one.

use super::depth_camera::DepthView;
use super::edges::RELATIVE_JUMP;
use glamx::DVec3;
use rayon::prelude::*;
use sms_core::{DepthImage, Image};

/// Samples of the image per row, between which the error is interpolated.
const SAMPLES: usize = 72;
/// Brightest diffuse surface. `echo` also contains highlights, which send their light to few places.
const MAX_ALBEDO: f64 = 0.9;

/// A small piece of surface in the camera's frame.
struct Patch {
    p_c: DVec3,
    normal_c: DVec3,
    /// Distance from the camera, metres.
    distance: f64,
    /// Irradiance of a light at the camera, relative to 1 m and face on.
    irradiance: f64,
    albedo: f64,
    area_m2: f64,
}

/// Returns depth with the error of light that was reflected twice, `gain` times as strong as one diffuse reflection between the
/// visible surfaces makes it.
///
/// Light that reaches a point by way of another surface travels farther, so that concave corners appear rounded and too
/// far (Fuchs 2010, "Multipath Interference Compensation in Time-of-Flight Camera Images", whose model this is). With m_j the light
/// at point i by way of patch j, relative to the direct light, and δ_j = (d_j + |p_i − p_j| − d_i) / 2 the excess of the measured
/// distance, the error is Σ m_j δ_j / (1 + Σ m_j): phases as small angles, which holds for excesses of centimetres. Surfaces between i
/// and j are not considered. A plane does not see itself and is unchanged.
pub(super) fn with_multipath(view: &DepthView<'_>, gain: f64) -> DepthImage {
    let (width, height) = view.depth.size();
    let step = width.div_ceil(SAMPLES).max(1);
    let (columns, rows) = (width.div_ceil(step), height.div_ceil(step));
    let at = |i: usize, size: usize| (i * step + step / 2).min(size - 1);
    let patches: Vec<Option<Patch>> = (0..columns * rows)
        .into_par_iter()
        .map(|i| patch(view, at(i % columns, width), at(i / columns, height), step))
        .collect();
    let errors: Vec<f64> =
        patches.par_iter().map(|own| own.as_ref().map_or(0.0, |own| excess(own, &patches, gain))).collect();
    let mut out = Image::filled(width, height, 0.0f32);
    out.data.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.iter_mut().enumerate() {
            let z = view.depth[(x, y)];
            *pixel = z;
            let Some(normal) = normal_c(view, x, y) else { continue };
            // Bilinear between the samples on the same surface.
            let (u, v) = (x as f64 / step as f64 - 0.5, y as f64 / step as f64 - 0.5);
            let (mut sum, mut weights) = (0.0, 0.0);
            for (i, j) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
                let (i, j) = (u.floor() + i, v.floor() + j);
                if i < 0.0 || j < 0.0 || i >= columns as f64 || j >= rows as f64 {
                    continue;
                }
                let sample = j as usize * columns + i as usize;
                let Some(patch) = &patches[sample] else { continue };
                // The sample's plane must pass near the pixel.
                let off = (point_c(view, x, y) - patch.p_c).dot(patch.normal_c).abs();
                if off < RELATIVE_JUMP * f64::from(z) && normal.dot(patch.normal_c) > 0.8 {
                    let weight = (1.0 - (u - i).abs()) * (1.0 - (v - j).abs()) + 1e-6;
                    sum += weight * errors[sample];
                    weights += weight;
                }
            }
            if weights > 0.0 {
                // The error is along the ray, depth along the optical axis.
                let ray = point_c(view, x, y);
                *pixel += (sum / weights * ray.z / ray.length()) as f32;
            }
        }
    });
    out
}

/// Returns the error of the distance of a patch, metres.
fn excess(own: &Patch, patches: &[Option<Patch>], gain: f64) -> f64 {
    let (mut sum, mut light) = (0.0, 0.0);
    for other in patches.iter().flatten() {
        let between = other.p_c - own.p_c;
        let squared = between.length_squared();
        let (up, down) = (between.dot(own.normal_c), -between.dot(other.normal_c));
        if up <= 0.0 || down <= 0.0 {
            continue;
        }
        // cos cos / (π r²); the other patch's area keeps neighbours at a crease finite.
        let form = up * down
            / (squared.max(1e-12) * std::f64::consts::PI * (squared + other.area_m2 / std::f64::consts::PI));
        let share = gain * other.albedo * other.irradiance * form * other.area_m2 / own.irradiance.max(1e-9);
        light += share;
        sum += share * 0.5 * (other.distance + squared.sqrt() - own.distance);
    }
    sum / (1.0 + light)
}

fn patch(view: &DepthView<'_>, x: usize, y: usize, step: usize) -> Option<Patch> {
    let normal_c = normal_c(view, x, y)?;
    let p_c = point_c(view, x, y);
    let distance = p_c.length();
    let k = view.intrinsics;
    let cos = -normal_c.dot(p_c) / distance;
    // Area on the surface that the sample's step × step pixels see.
    let area_m2 = (step * step) as f64 * p_c.z.powi(3) / (k.fx * k.fy * (cos * distance).max(0.05 * p_c.z));
    Some(Patch {
        p_c,
        normal_c,
        distance,
        irradiance: cos.max(0.0) / (distance * distance),
        albedo: f64::from(view.echo[(x, y)]).clamp(0.0, MAX_ALBEDO),
        area_m2,
    })
}

fn point_c(view: &DepthView<'_>, x: usize, y: usize) -> DVec3 {
    let k = view.intrinsics;
    let z = f64::from(view.depth[(x, y)]);
    DVec3::new((x as f64 + 0.5 - k.cx) / k.fx, (y as f64 + 0.5 - k.cy) / k.fy, 1.0) * z
}

/// Returns the normal towards the camera from the neighbours on the same surface; `None` at edges.
fn normal_c(view: &DepthView<'_>, x: usize, y: usize) -> Option<DVec3> {
    let (width, height) = view.depth.size();
    let p_c = point_c(view, x, y);
    let joined = |u: usize, v: usize| {
        let q_c = point_c(view, u, v);
        (q_c.z > 0.0 && (q_c.z - p_c.z).abs() < RELATIVE_JUMP * p_c.z).then_some(q_c)
    };
    if p_c.z <= 0.0 {
        return None;
    }
    let along = |before: Option<DVec3>, after: Option<DVec3>| match (before, after) {
        (Some(before), Some(after)) => Some(after - before),
        (Some(before), None) => Some(p_c - before),
        (None, Some(after)) => Some(after - p_c),
        (None, None) => None,
    };
    let right = along(
        x.checked_sub(1).and_then(|u| joined(u, y)),
        (x + 1 < width).then(|| joined(x + 1, y)).flatten(),
    )?;
    let down = along(
        y.checked_sub(1).and_then(|v| joined(x, v)),
        (y + 1 < height).then(|| joined(x, y + 1)).flatten(),
    )?;
    let normal = right.cross(down).try_normalize()?;
    Some(if normal.dot(p_c) > 0.0 { -normal } else { normal })
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::Intrinsics;

    /// Depth of the nearest of planes n·p = d in front of a camera, and |cos| of the incidence.
    fn planes(k: &Intrinsics, planes: &[(DVec3, f64)]) -> (DepthImage, Image<f32>) {
        let (mut depth, mut cos) =
            (Image::filled(k.width, k.height, 0.0f32), Image::filled(k.width, k.height, 1.0f32));
        for y in 0..k.height {
            for x in 0..k.width {
                let ray = DVec3::new((x as f64 + 0.5 - k.cx) / k.fx, (y as f64 + 0.5 - k.cy) / k.fy, 1.0);
                let (z, n) = planes
                    .iter()
                    .map(|&(n, d)| (d / n.dot(ray), n))
                    .filter(|(z, _)| *z > 0.0)
                    .min_by(|a, b| a.0.total_cmp(&b.0))
                    .unwrap();
                depth[(x, y)] = z as f32;
                cos[(x, y)] = (n.dot(ray) / ray.length()).abs() as f32;
            }
        }
        (depth, cos)
    }

    fn errors(k: &Intrinsics, scene: &[(DVec3, f64)], albedo: f32) -> Vec<f64> {
        let (depth, cos) = planes(k, scene);
        let echo = Image::filled(k.width, k.height, albedo);
        let view = DepthView { depth: &depth, cos_incidence: &cos, echo: &echo, intrinsics: k, guide: None };
        let seen = with_multipath(&view, 1.0);
        seen.data.iter().zip(&depth.data).map(|(a, b)| f64::from(a - b)).collect()
    }

    #[test]
    fn a_plane_keeps_its_depth_and_a_concave_corner_moves_away() {
        let k = Intrinsics::from_fov(144, 96, 1.0);
        for plane in [(DVec3::Z, 1.0), (DVec3::new(0.6, 0.0, 0.8), 0.9)] {
            let plane = errors(&k, &[plane], 0.8);
            assert!(plane.iter().all(|e| e.abs() < 1e-6), "{:?}", plane.iter().copied().fold(0.0, f64::max));
        }
        // Two walls at a right angle whose edge is 1 m away on the optical axis.
        let half = 0.5f64.sqrt();
        let walls = [(DVec3::new(half, 0.0, half), half), (DVec3::new(-half, 0.0, half), half)];
        let corner = errors(&k, &walls, 0.8);
        let row = |x: usize| corner[48 * 144 + x];
        assert!(corner.iter().all(|&e| e >= 0.0), "nothing comes nearer");
        assert!(row(60) > 0.005 && row(60) < 0.10, "{}", row(60));
        assert!(row(60) > 1.3 * row(4), "the error is largest at the edge: {} {}", row(60), row(4));
        let mirrored = row(143 - 60);
        assert!((mirrored / row(60) - 1.0).abs() < 0.1, "both walls are alike: {mirrored} {}", row(60));
        // Walls that reflect a quarter send about a quarter of the light.
        let dark = errors(&k, &walls, 0.2)[48 * 144 + 60];
        assert!(dark < 0.5 * row(60) && dark > 0.15 * row(60), "{dark} {}", row(60));
    }

    #[test]
    fn a_convex_edge_keeps_its_depth() {
        let k = Intrinsics::from_fov(144, 96, 1.0);
        // The nearest of planes is concave; the farthest of the same two is convex.
        let half = 0.5f64.sqrt();
        let (mut depth, cos) = planes(&k, &[(DVec3::Z, 1.0)]);
        for y in 0..96 {
            for x in 0..144 {
                let ray = (x as f64 + 0.5 - k.cx) / k.fx;
                depth[(x, y)] = (half / (half - half * ray.abs())) as f32;
            }
        }
        let echo = Image::filled(144, 96, 0.8f32);
        let view = DepthView { depth: &depth, cos_incidence: &cos, echo: &echo, intrinsics: &k, guide: None };
        let seen = with_multipath(&view, 1.0);
        let largest = seen.data.iter().zip(&depth.data).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(largest < 1e-4, "{largest}");
    }
}
