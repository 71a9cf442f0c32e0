//! Error model of a structured-light stereo camera such as Orbbec's or RealSense's.

use crate::texture::{hash, smoothstep};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sms_core::{DepthImage, Image, Seed};

/// Errors of the depth camera. Lengths in pixels refer to an image 1280 wide and scale with the width.
///
/// Stereo measures disparity, the inverse of depth, with an error of a fixed fraction of a pixel, so the error of
/// depth grows with z²: σ_z = z² σ_d / (f b), where f is the focal length in pixels, b the baseline and σ_d the error of
/// disparity (Khoshelham & Elberink 2012, "Accuracy and Resolution of Kinect Depth Data"). With f = 881 and b = 0.05 m the
/// defaults are σ_d = 0.053 and steps of 0.044 pixels; they follow the size of published figures for such cameras (about
/// 1 mm at 0.7 m, 1.6 mm at 1 m; Orbbec state ≤ 2 % at 2 m for the Gemini 2).
///
/// The second imager stands `baseline_m` to the right. Surfaces occluded for it have no depth: a shadow of
/// f b (1/z₁ − 1/z₂) pixels at the left of every object. Both imagers are assumed to see farther to the sides than the
/// image. A pixel also needs returned light of the projector: dark surfaces and slanted metal return too little, a polished
/// surface that faces the camera too much.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DepthCamera {
    /// Standard deviation at zero distance, metres.
    pub sigma_m: f64,
    /// Growth of the standard deviation with z², 1/m.
    pub sigma_per_m: f64,
    /// Size of the patches with correlated errors (the matching window), pixels at width 1280.
    pub correlation_px: f64,
    /// Step of the inverse depth, 1/m: the depth step at 1 m is this many metres. 0 for none.
    pub disparity_step_per_m: f64,
    /// Width of the band around depth edges with lost measurements, pixels at width 1280.
    pub edge_px: f64,
    /// Share of that band without a measurement.
    pub edge_dropout: f64,
    /// Share of that band whose depth lies between foreground and background.
    pub flying_share: f64,
    /// Cosine of the angle of incidence below which measurements begin to be lost; all are below a quarter of it.
    pub grazing_cos: f64,
    /// Distance of the second imager, to the right along the image's rows, metres; 0 for none, and no shadows.
    pub baseline_m: f64,
    /// Returned light (see [`DepthView::echo`]) below which measurements begin to be lost; all are below a quarter of it.
    pub dark_echo: f64,
    /// Returned light above which the pattern is washed out; 0 for never.
    pub glare_echo: f64,
    /// Share of patches without a measurement at random.
    pub hole_share: f64,
    /// Shortest and longest measurable depth, metres.
    pub range_m: [f64; 2],
}

/// The true scene, pixel by pixel; images of one size.
#[derive(Debug, Clone, Copy)]
pub struct DepthView<'a> {
    /// Depth along the optical axis in metres, 0 without a surface.
    pub depth: &'a DepthImage,
    /// |cos| of the angle between ray and surface normal.
    pub cos_incidence: &'a Image<f32>,
    /// Light of a projector beside the camera that comes back, relative to a white diffuse surface at the same slant.
    pub echo: &'a Image<f32>,
    /// Focal length along the rows, pixels.
    pub fx: f64,
}

impl Default for DepthCamera {
    fn default() -> Self {
        Self {
            sigma_m: 0.0004,
            sigma_per_m: 0.0012,
            correlation_px: 2.5,
            disparity_step_per_m: 0.001,
            edge_px: 2.0,
            edge_dropout: 0.6,
            flying_share: 0.04,
            grazing_cos: 0.18,
            baseline_m: 0.05,
            dark_echo: 0.03,
            glare_echo: 8.0,
            hole_share: 0.003,
            range_m: [0.15, 3.0],
        }
    }
}

/// Disparities with a larger difference belong to different surfaces, pixels.
const JUMP_PX: f64 = 1.5;

impl DepthCamera {
    /// A camera without errors and limits of range.
    pub fn perfect() -> Self {
        Self {
            sigma_m: 0.0,
            sigma_per_m: 0.0,
            correlation_px: 0.0,
            disparity_step_per_m: 0.0,
            edge_px: 0.0,
            edge_dropout: 0.0,
            flying_share: 0.0,
            grazing_cos: 0.0,
            baseline_m: 0.0,
            dark_echo: 0.0,
            glare_echo: 0.0,
            hole_share: 0.0,
            range_m: [0.0, f64::INFINITY],
        }
    }

    /// Returns the standard deviation of a measurement at depth `z`, metres, before quantisation.
    pub fn sigma_at(&self, z: f64) -> f64 {
        self.sigma_m + self.sigma_per_m * z * z
    }

    /// Simulates a measurement.
    pub fn measure(&self, view: &DepthView, seed: Seed) -> DepthImage {
        let depth = view.depth;
        let (width, height) = depth.size();
        let scale = width as f64 / 1280.0;
        let band = if self.edge_px > 0.0 { (self.edge_px * scale).round().max(1.0) as usize } else { 0 };
        let edges = if band > 0 { edge_band(depth, band) } else { vec![false; width * height] };
        let noise = Noise::new(seed, self.correlation_px * scale);
        let patch = (6.0 * scale).max(1.0);
        let [near, far] = self.range_m;
        let mut out = Image::filled(width, height, 0.0f32);
        out.data.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            let shadowed = self.shadowed(&depth.data[y * width..(y + 1) * width], view.fx);
            for (x, pixel) in row.iter_mut().enumerate() {
                let at = y * width + x;
                let mut z = f64::from(depth.data[at]);
                if z <= 0.0 || z < near || z > far || shadowed.get(x) == Some(&true) {
                    continue;
                }
                let cell = ((x as f64 / patch) as i32, (y as f64 / patch) as i32);
                if noise.uniform(cell.0, cell.1, 11) < self.hole_share {
                    continue;
                }
                // Measurements are lost below a limit, all of them below a quarter of it.
                let lost = |value: f32, limit: f64, channel: i32| {
                    let seen = smoothstep((0.25 * limit) as f32, limit as f32, value);
                    limit > 0.0 && noise.uniform(x as i32, y as i32, channel) >= f64::from(seen)
                };
                let (cos, echo) = (view.cos_incidence.data[at], view.echo.data[at]);
                if lost(cos, self.grazing_cos, 12) || lost(echo, self.dark_echo, 16) {
                    continue;
                }
                if self.glare_echo > 0.0 && f64::from(echo) > self.glare_echo {
                    continue;
                }
                if edges[at] {
                    // Dropouts come in small clumps, not as salt and pepper.
                    let clump = ((x as f64 / scale / 2.0) as i32, (y as f64 / scale / 2.0) as i32);
                    if noise.uniform(clump.0, clump.1, 13) < self.edge_dropout {
                        continue;
                    }
                    if noise.uniform(x as i32, y as i32, 14)
                        < self.flying_share / (1.0 - self.edge_dropout).max(0.05)
                        && let Some(other) = across_edge(depth, x, y, band)
                    {
                        z += (f64::from(other) - z) * noise.uniform(x as i32, y as i32, 15);
                    }
                }
                z += self.sigma_at(z) * noise.normal(x, y);
                if self.disparity_step_per_m > 0.0 {
                    let step = self.disparity_step_per_m;
                    z = 1.0 / ((1.0 / z.max(1e-3) / step).round().max(1.0) * step);
                }
                *pixel = z.max(0.0) as f32;
            }
        });
        out
    }

    /// Returns which pixels of a row are occluded for the second imager; empty without one.
    fn shadowed(&self, row: &[f32], fx: f64) -> Vec<bool> {
        if self.baseline_m <= 0.0 {
            return Vec::new();
        }
        // Disparities, and the largest disparity in each column of the second imager.
        let disparity = |z: f32| if z > 0.0 { fx * self.baseline_m / f64::from(z) } else { 0.0 };
        let disparities: Vec<f64> = row.iter().map(|&z| disparity(z)).collect();
        let column = |x: usize| (x as f64 + 0.5 - disparities[x]).floor();
        let mut nearest = vec![0.0f64; row.len()];
        for x in 0..row.len() {
            // A slanted surface is wider in the second image, without gaps between its pixels.
            let joined = x + 1 < row.len() && (disparities[x + 1] - disparities[x]).abs() < JUMP_PX;
            let (low, high) = if joined { (column(x), column(x + 1)) } else { (column(x), column(x)) };
            for c in low.min(high) as i64..=low.max(high) as i64 {
                if let Some(slot) = usize::try_from(c).ok().and_then(|c| nearest.get_mut(c)) {
                    *slot = slot.max(disparities[x]);
                }
            }
        }
        let is_shadowed = |x: usize| {
            let c = column(x);
            c >= 0.0 && nearest.get(c as usize).is_some_and(|&d| d > disparities[x] + JUMP_PX)
        };
        (0..row.len()).map(is_shadowed).collect()
    }
}

/// Marks pixels within `band` of a depth discontinuity. Inverse depth is linear over the image of a plane, so its second
/// difference distinguishes an edge from a slanted surface at any resolution.
fn edge_band(depth: &DepthImage, band: usize) -> Vec<bool> {
    const RELATIVE_JUMP: f32 = 0.02;
    let (width, height) = depth.size();
    let inverse = |x: usize, y: usize| {
        let z = depth.data[y * width + x];
        if z > 0.0 { 1.0 / z } else { 0.0 }
    };
    let jumps = |a: f32, b: f32, c: f32| (a - 2.0 * b + c).abs() > RELATIVE_JUMP * b.max(1e-3);
    let mut edge = vec![false; width * height];
    edge.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for x in 0..width {
            let b = inverse(x, y);
            row[x] = (x > 0 && x + 1 < width && jumps(inverse(x - 1, y), b, inverse(x + 1, y)))
                || (y > 0 && y + 1 < height && jumps(inverse(x, y - 1), b, inverse(x, y + 1)));
        }
    });
    if band <= 1 {
        return edge;
    }
    let reach = band - 1;
    let mut wide = vec![false; width * height];
    wide.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for x in 0..width {
            row[x] = (y.saturating_sub(reach)..=(y + reach).min(height - 1))
                .any(|v| (x.saturating_sub(reach)..=(x + reach).min(width - 1)).any(|u| edge[v * width + u]));
        }
    });
    wide
}

/// Returns a depth from the other side of the nearest edge along the row.
fn across_edge(depth: &DepthImage, x: usize, y: usize, band: usize) -> Option<f32> {
    let z = depth[(x, y)];
    (1..=band + 1).find_map(|d| {
        [x.checked_sub(d), Some(x + d)].into_iter().flatten().filter(|&u| u < depth.width).find_map(|u| {
            let other = depth[(u, y)];
            (other > 0.0 && (other - z).abs() > 0.02 * z).then_some(other)
        })
    })
}

/// Repeatable noise that depends on the pixel and the seed only.
struct Noise {
    seed: u32,
    /// Lattice spacing in pixels; 0 for white noise.
    step: f64,
}

/// Share of the variance that is correlated within a patch.
const CORRELATED: f64 = 0.7;

impl Noise {
    fn new(seed: Seed, correlation: f64) -> Self {
        Self {
            seed: (seed.0 ^ (seed.0 >> 32)) as u32,
            step: if correlation > 1.0 { correlation } else { 0.0 },
        }
    }

    fn uniform(&self, x: i32, y: i32, channel: i32) -> f64 {
        f64::from(hash(x, y, channel, self.seed)) / 4_294_967_296.0
    }

    /// Returns a standard normal value at a pixel.
    fn normal(&self, x: usize, y: usize) -> f64 {
        let white = irwin_hall(self.seed, x as i32, y as i32, 1);
        if self.step == 0.0 {
            return white;
        }
        let (u, v) = (x as f64 / self.step, y as f64 / self.step);
        let (i, j) = (u.floor(), v.floor());
        let (fu, fv) = (u - i, v - j);
        let (mut sum, mut square) = (0.0, 0.0);
        for (di, dj, w) in [
            (0, 0, (1.0 - fu) * (1.0 - fv)),
            (1, 0, fu * (1.0 - fv)),
            (0, 1, (1.0 - fu) * fv),
            (1, 1, fu * fv),
        ] {
            sum += w * irwin_hall(self.seed, i as i32 + di, j as i32 + dj, 3);
            square += w * w;
        }
        // Dividing by the weights' norm keeps the variance the same between lattice points.
        CORRELATED.sqrt() * sum / square.sqrt() + (1.0 - CORRELATED).sqrt() * white
    }
}

/// Zero mean, unit variance, near normal up to 4.9 σ: the sum of eight bytes of two hashes.
pub(crate) fn irwin_hall(seed: u32, x: i32, y: i32, channel: i32) -> f64 {
    let sum: u32 = [hash(x, y, channel, seed), hash(x, y, channel + 1, seed)]
        .iter()
        .flat_map(|h| h.to_le_bytes())
        .map(u32::from)
        .sum();
    // Variance of one byte: (256² − 1) / 12.
    (f64::from(sum) - 8.0 * 127.5) / (8.0f64 * 65535.0 / 12.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(z: f32) -> (DepthImage, Image<f32>) {
        (Image::filled(320, 200, z), Image::filled(320, 200, 1.0))
    }

    /// Measures white surfaces with the default field of view.
    fn measure(camera: &DepthCamera, depth: &DepthImage, cos: &Image<f32>, seed: u64) -> DepthImage {
        let echo = Image::filled(320, 200, 0.8);
        camera.measure(&DepthView { depth, cos_incidence: cos, echo: &echo, fx: 220.0 }, Seed(seed))
    }

    fn mean_and_sigma(values: &[f32]) -> (f64, f64) {
        let n = values.len() as f64;
        let mean = values.iter().map(|&v| f64::from(v)).sum::<f64>() / n;
        (mean, (values.iter().map(|&v| (f64::from(v) - mean).powi(2)).sum::<f64>() / n).sqrt())
    }

    #[test]
    fn the_error_grows_with_the_square_of_the_distance_and_has_no_bias() {
        let camera = DepthCamera { hole_share: 0.0, disparity_step_per_m: 0.0, ..DepthCamera::default() };
        for correlation_px in [0.0, 10.0] {
            let camera = DepthCamera { correlation_px, ..camera.clone() };
            for z in [0.4f32, 0.8, 1.6] {
                let (depth, cos) = flat(z);
                let (mean, sigma) = mean_and_sigma(&measure(&camera, &depth, &cos, 1).data);
                let expected = 0.0004 + 0.0012 * f64::from(z).powi(2);
                assert!((sigma / expected - 1.0).abs() < 0.05, "{z}: {sigma} {expected}");
                assert!((mean - f64::from(z)).abs() < 0.05 * expected);
            }
        }
    }

    #[test]
    fn quantisation_steps_grow_with_the_square_of_the_distance() {
        let camera = DepthCamera { sigma_m: 1e-3, sigma_per_m: 0.0, ..DepthCamera::default() };
        for z in [0.5f32, 1.0] {
            let (depth, cos) = flat(z);
            let mut levels: Vec<f32> =
                measure(&camera, &depth, &cos, 2).data.into_iter().filter(|&v| v > 0.0).collect();
            levels.sort_by(f32::total_cmp);
            levels.dedup();
            let step = levels.windows(2).map(|w| w[1] - w[0]).fold(f32::INFINITY, f32::min);
            let expected = 0.001 * z * z;
            assert!((step / expected - 1.0).abs() < 0.05, "{step} {expected}");
        }
    }

    #[test]
    fn edges_and_grazing_surfaces_lose_measurements_and_slanted_planes_do_not() {
        let camera = DepthCamera { hole_share: 0.0, baseline_m: 0.0, ..DepthCamera::default() };
        let (mut depth, mut cos) = flat(1.0);
        for y in 0..200 {
            for x in 160..320 {
                depth[(x, y)] = 0.6;
            }
            for x in 0..40 {
                cos[(x, y)] = 0.04;
            }
        }
        let measured = measure(&camera, &depth, &cos, 3);
        let valid = |x0: usize, x1: usize| {
            let n: usize = (0..200).map(|y| (x0..x1).filter(|&x| measured[(x, y)] > 0.0).count()).sum();
            n as f64 / (200 * (x1 - x0)) as f64
        };
        assert_eq!(valid(0, 40), 0.0);
        assert_eq!(valid(60, 150), 1.0);
        assert!((valid(159, 161) - 0.4).abs() < 0.12, "{}", valid(159, 161));
        let mut slanted = Image::filled(320, 200, 0.0f32);
        for y in 0..200 {
            for x in 0..320 {
                slanted[(x, y)] = 1.0 / (0.5 + 0.008 * x as f32 + 0.01 * y as f32);
            }
        }
        assert!(edge_band(&slanted, 2).iter().all(|e| !e));
    }

    #[test]
    fn a_perfect_camera_changes_nothing_and_seeds_differ() {
        let (depth, cos) = flat(0.7);
        assert_eq!(measure(&DepthCamera::perfect(), &depth, &cos, 1), depth);
        let camera = DepthCamera::default();
        let a = measure(&camera, &depth, &cos, 1);
        assert_eq!(a, measure(&camera, &depth, &cos, 1));
        assert_ne!(a, measure(&camera, &depth, &cos, 2));
    }

    #[test]
    fn the_shadow_of_a_near_thing_is_as_wide_as_the_difference_of_disparities() {
        let camera = DepthCamera { baseline_m: 0.05, ..DepthCamera::perfect() };
        for (near, far) in [(0.5f32, 0.7f32), (0.4, 1.6)] {
            let (mut depth, cos) = flat(far);
            for y in 0..200 {
                (150..200).for_each(|x| depth[(x, y)] = near);
            }
            let echo = Image::filled(320, 200, 0.8);
            let view = DepthView { depth: &depth, cos_incidence: &cos, echo: &echo, fx: 881.0 };
            let measured = camera.measure(&view, Seed(1));
            let lost: Vec<usize> = (0..320).filter(|&x| measured[(x, 100)] == 0.0).collect();
            let width = 881.0 * 0.05 * (1.0 / f64::from(near) - 1.0 / f64::from(far));
            // The shadow is at most as wide as the object.
            let expected = width.min(50.0);
            assert!((lost.len() as f64 - expected).abs() <= 1.0, "{} {expected}", lost.len());
            assert!(
                (lost[0] as f64 - (150.0 - width)).abs() <= 1.0,
                "it begins so far to the left: {lost:?}"
            );
            assert!(lost.windows(2).all(|w| w[1] == w[0] + 1));
        }
        // A slanted plane that both see loses nothing.
        let slanted =
            Image::from_vec(320, 200, (0..64_000).map(|i| 1.0 / (0.5 + 0.004 * (i % 320) as f32)).collect());
        let (_, cos) = flat(1.0);
        assert_eq!(measure(&camera, &slanted, &cos, 1), slanted);
    }

    #[test]
    fn dark_and_glaring_surfaces_have_holes() {
        let camera = DepthCamera { dark_echo: 0.03, glare_echo: 8.0, ..DepthCamera::perfect() };
        let (depth, cos) = flat(0.7);
        let echo = Image::from_vec(
            320,
            200,
            (0..64_000).map(|i| [0.005, 0.01875, 0.04, 9.0][(i % 320) / 80]).collect(),
        );
        let view = DepthView { depth: &depth, cos_incidence: &cos, echo: &echo, fx: 220.0 };
        let measured = camera.measure(&view, Seed(3));
        let share = |band: usize| {
            let pixels = (0..200).flat_map(|y| (80 * band..80 * band + 80).map(move |x| (x, y)));
            pixels.filter(|&p| measured[p] > 0.0).count() as f64 / 16_000.0
        };
        assert_eq!((share(0), share(2), share(3)), (0.0, 1.0, 0.0));
        assert!((share(1) - 0.5).abs() < 0.02, "half is seen in the middle of the ramp: {}", share(1));
    }
}
