//! What a structured-light stereo camera of the Orbbec or RealSense kind makes of a perfect depth image.

use crate::texture::{hash, smoothstep};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sms_core::{DepthImage, Image, Seed};

/// Errors of the depth camera. Lengths in pixels refer to an image 1280 wide and scale with the width.
///
/// Stereo measures disparity, the inverse of depth, with an error of a fixed fraction of a pixel, so the error of
/// depth grows with z². Defaults follow the size of published figures for such cameras (about 1 mm at 0.7 m, 1.6 mm at
/// 1 m; Orbbec state ≤ 2 % at 2 m for the Gemini 2).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DepthCamera {
    /// Standard deviation at zero distance, metres.
    pub sigma_m: f64,
    /// Growth of the standard deviation with z², 1/m.
    pub sigma_per_m: f64,
    /// Size of the patches in which the error is alike (the matching window), pixels at width 1280.
    pub correlation_px: f64,
    /// Step of the inverse depth, 1/m: the depth step at 1 m is this many metres. 0 for none.
    pub disparity_step_per_m: f64,
    /// Width of the band around depth edges that loses measurements, pixels at width 1280.
    pub edge_px: f64,
    /// Share of that band without a measurement.
    pub edge_dropout: f64,
    /// Share of that band whose depth lies between foreground and background.
    pub flying_share: f64,
    /// Cosine of the angle of incidence below which measurements begin to be lost; all are below a quarter of it.
    pub grazing_cos: f64,
    /// Share of patches without a measurement for no visible reason.
    pub hole_share: f64,
    /// Shortest and longest measurable depth, metres.
    pub range_m: [f64; 2],
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
            hole_share: 0.003,
            range_m: [0.15, 3.0],
        }
    }
}

impl DepthCamera {
    /// No errors at all, and no limits of range.
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
            hole_share: 0.0,
            range_m: [0.0, f64::INFINITY],
        }
    }

    /// Standard deviation of a measurement at depth `z`, metres, before quantisation.
    pub fn sigma_at(&self, z: f64) -> f64 {
        self.sigma_m + self.sigma_per_m * z * z
    }

    /// A measurement of `depth` (metres along the optical axis, 0 for nothing there); `cos_incidence` is |cos| of the
    /// angle between ray and surface normal at each pixel.
    pub fn measure(&self, depth: &DepthImage, cos_incidence: &Image<f32>, seed: Seed) -> DepthImage {
        let (width, height) = depth.size();
        let scale = width as f64 / 1280.0;
        let band = if self.edge_px > 0.0 { (self.edge_px * scale).round().max(1.0) as usize } else { 0 };
        let edges = if band > 0 { edge_band(depth, band) } else { vec![false; width * height] };
        let noise = Noise::new(seed, self.correlation_px * scale);
        let patch = (6.0 * scale).max(1.0);
        let [near, far] = self.range_m;
        let mut out = Image::filled(width, height, 0.0f32);
        out.data.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            for (x, pixel) in row.iter_mut().enumerate() {
                let at = y * width + x;
                let mut z = f64::from(depth.data[at]);
                if z <= 0.0 || z < near || z > far {
                    continue;
                }
                let cell = ((x as f64 / patch) as i32, (y as f64 / patch) as i32);
                if noise.uniform(cell.0, cell.1, 11) < self.hole_share {
                    continue;
                }
                let cos = f64::from(cos_incidence.data[at]);
                if self.grazing_cos > 0.0 {
                    let seen =
                        smoothstep((0.25 * self.grazing_cos) as f32, self.grazing_cos as f32, cos as f32);
                    if noise.uniform(x as i32, y as i32, 12) >= f64::from(seen) {
                        continue;
                    }
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
}

/// Pixels within `band` of a depth discontinuity. Inverse depth is linear over the image of a plane, so its second
/// difference tells an edge from a slanted surface at any resolution.
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

/// A depth from the other side of the nearest edge along the row.
fn across_edge(depth: &DepthImage, x: usize, y: usize, band: usize) -> Option<f32> {
    let z = depth[(x, y)];
    (1..=band + 1).find_map(|d| {
        [x.checked_sub(d), Some(x + d)].into_iter().flatten().filter(|&u| u < depth.width).find_map(|u| {
            let other = depth[(u, y)];
            (other > 0.0 && (other - z).abs() > 0.02 * z).then_some(other)
        })
    })
}

/// Repeatable noise that depends on the pixel and the seed only, so that threads do not matter.
struct Noise {
    seed: u32,
    /// Lattice spacing in pixels; 0 for white noise.
    step: f64,
}

/// Share of the variance that is common to a patch.
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

    /// A standard normal value at a pixel.
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
                let (mean, sigma) = mean_and_sigma(&camera.measure(&depth, &cos, Seed(1)).data);
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
                camera.measure(&depth, &cos, Seed(2)).data.into_iter().filter(|&v| v > 0.0).collect();
            levels.sort_by(f32::total_cmp);
            levels.dedup();
            let step = levels.windows(2).map(|w| w[1] - w[0]).fold(f32::INFINITY, f32::min);
            let expected = 0.001 * z * z;
            assert!((step / expected - 1.0).abs() < 0.05, "{step} {expected}");
        }
    }

    #[test]
    fn edges_and_grazing_surfaces_lose_measurements_and_slanted_planes_do_not() {
        let camera = DepthCamera { hole_share: 0.0, ..DepthCamera::default() };
        let (mut depth, mut cos) = flat(1.0);
        for y in 0..200 {
            for x in 160..320 {
                depth[(x, y)] = 0.6;
            }
            for x in 0..40 {
                cos[(x, y)] = 0.04;
            }
        }
        let measured = camera.measure(&depth, &cos, Seed(3));
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
        assert_eq!(DepthCamera::perfect().measure(&depth, &cos, Seed(1)), depth);
        let camera = DepthCamera::default();
        let a = camera.measure(&depth, &cos, Seed(1));
        assert_eq!(a, camera.measure(&depth, &cos, Seed(1)));
        assert_ne!(a, camera.measure(&depth, &cos, Seed(2)));
    }
}
