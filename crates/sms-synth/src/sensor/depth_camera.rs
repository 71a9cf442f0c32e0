//! Error model of depth cameras: structured light, stereo and time of flight.

use super::depth_grid::{coarse_intrinsics, confidence, enlarged, sampled, smoothed};
use super::dots::from_dots;
use super::edges::{across_edge, edge_band, mixed};
use super::multipath::with_multipath;
use super::noise::Noise;
use crate::texture::smoothstep;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sms_core::{ColorImage, DepthImage, Image, Intrinsics, Seed};

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
///
/// Time of flight measures the phase of returned light. Its noise falls with the amount of light (`light_exponent`), a pixel that
/// sees two surfaces measures a depth between them (`mixed_px`), and light that is reflected twice adds a longer path
/// (`multipath`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DepthCamera {
    /// Standard deviation at zero distance, metres.
    pub sigma_m: f64,
    /// Growth of the standard deviation with z, metres per metre.
    pub sigma_linear: f64,
    /// Growth of the standard deviation with z², 1/m.
    pub sigma_per_m: f64,
    /// The standard deviation grows as (0.8 / r) to this power, where r is the returned light relative to a white diffuse surface that
    /// faces the camera at the same distance; 0.5 for shot noise (Lange & Seitz 2001), 0 for no influence.
    pub light_exponent: f64,
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
    /// Radius of the spot that a pixel sees, pixels at width 1280: at depth edges, depth is the mean over the spot, weighted by the
    /// returned light. 0 for none.
    pub mixed_px: f64,
    /// Share of the light of one diffuse reflection between surfaces that counts as a longer path: 1 for a camera that does not
    /// correct it, 0 for none.
    pub multipath: f64,
    /// Cosine of the angle of incidence below which measurements begin to be lost; all are below a quarter of it.
    pub grazing_cos: f64,
    /// Distance of the second imager, to the right along the image's rows, metres; 0 for none, and no shadows.
    pub baseline_m: f64,
    /// Returned light, relative to a white diffuse surface at the same slant, below which measurements begin to be lost; all are
    /// below a quarter of it.
    pub dark_echo: f64,
    /// Returned light relative to that of a white diffuse surface that faces the camera at 1 m, below which measurements begin to be
    /// lost; all are below a quarter of it. Unlike `dark_echo` it falls with the slant and with the square of the distance. 0 for none.
    pub lost_light: f64,
    /// Returned light above which the pattern is washed out; 0 for never.
    pub glare_echo: f64,
    /// Share of small patches (6 pixels at width 1280) without a measurement at random.
    pub hole_share: f64,
    /// Share of larger or smaller patches without a measurement at random; 0 for none.
    pub missing_share: f64,
    /// Size of those patches, pixels at width 1280; a pixel or less for single pixels.
    pub missing_px: f64,
    /// Columns of the measured depth image across the view; 0, or more than the image has, for those of the image. A property of
    /// the camera: it does not scale with the width.
    pub columns: usize,
    /// Whether depth that is measured on fewer columns is resampled to the colour image's size, as programs do that register depth
    /// to colour; else it is recorded with its own size.
    pub fills_image: bool,
    /// Number of dots that are measured, from which the depth image is interpolated; 0 for a measurement at each pixel.
    pub dots: usize,
    /// Standard deviation of the Gaussian by which measured depth is smoothed, pixels at width 1280; 0 for none.
    pub smoothing_px: f64,
    /// Whether a confidence of 0 (low) to 2 (high) is recorded with each pixel.
    pub has_confidence: bool,
    /// Horizontal and vertical field of view, radians; depth beyond it is missing. 0 for that of the image.
    pub fov_rad: [f64; 2],
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
    /// The camera's intrinsics.
    pub intrinsics: &'a Intrinsics,
    /// The colour image, by which depth between dots is interpolated; without one, by distance only.
    pub guide: Option<&'a ColorImage>,
}

/// A measured depth image.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// Depth along the optical axis in metres, 0 without a measurement. Of the size of the view, or smaller, see
    /// [`DepthCamera::fills_image`].
    pub depth: DepthImage,
    /// Confidence of each pixel of `depth`: 0 low, 1 medium, 2 high; `None` for a camera that states none.
    pub confidence: Option<Image<u16>>,
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
            ..Self::perfect()
        }
    }
}

/// Disparities with a larger difference belong to different surfaces, pixels.
const JUMP_PX: f64 = 1.5;
/// Returned light of the white walls on which noise is measured.
const WHITE: f64 = 0.8;

impl DepthCamera {
    /// A camera without errors and limits of range.
    pub fn perfect() -> Self {
        Self {
            sigma_m: 0.0,
            sigma_linear: 0.0,
            sigma_per_m: 0.0,
            light_exponent: 0.0,
            correlation_px: 0.0,
            disparity_step_per_m: 0.0,
            edge_px: 0.0,
            edge_dropout: 0.0,
            flying_share: 0.0,
            mixed_px: 0.0,
            multipath: 0.0,
            grazing_cos: 0.0,
            baseline_m: 0.0,
            dark_echo: 0.0,
            lost_light: 0.0,
            glare_echo: 0.0,
            hole_share: 0.0,
            missing_share: 0.0,
            missing_px: 0.0,
            columns: 0,
            fills_image: true,
            dots: 0,
            smoothing_px: 0.0,
            has_confidence: false,
            fov_rad: [0.0; 2],
            range_m: [0.0, f64::INFINITY],
        }
    }

    /// Returns the standard deviation of a measurement of a white surface that faces the camera at depth `z`, metres, before
    /// quantisation, interpolation and smoothing.
    pub fn sigma_at(&self, z: f64) -> f64 {
        self.sigma_m + self.sigma_linear * z + self.sigma_per_m * z * z
    }

    /// Returns the intrinsics of the recorded depth image for those of the colour image.
    pub fn intrinsics(&self, color: &Intrinsics) -> Intrinsics {
        if self.fills_image { *color } else { coarse_intrinsics(color, self.columns) }
    }

    /// Simulates a measurement.
    pub fn measure(&self, view: &DepthView, seed: Seed) -> Measured {
        let size = view.depth.size();
        let coarse = coarse_intrinsics(view.intrinsics, self.columns);
        let own = (coarse.width, coarse.height);
        let mut depth = if own == size {
            self.measure_pixels(view, seed)
        } else {
            let (depth, echo) = (sampled(view.depth, own), sampled(view.echo, own));
            let cos_incidence = sampled(view.cos_incidence, own);
            let view = DepthView {
                depth: &depth,
                cos_incidence: &cos_incidence,
                echo: &echo,
                intrinsics: &coarse,
                ..*view
            };
            self.measure_pixels(&view, seed)
        };
        if self.dots > 0 {
            depth = from_dots(&depth, view, self.dots);
        }
        if self.smoothing_px > 0.0 {
            depth = smoothed(&depth, self.smoothing_px * own.0 as f64 / 1280.0);
        }
        if self.missing_share > 0.0 {
            self.lose_patches(&mut depth, seed);
        }
        if self.fills_image && own != size {
            depth = enlarged(&depth, size);
        }
        let confidence = self.has_confidence.then(|| confidence(&depth));
        Measured { depth, confidence }
    }

    /// Simulates the measurement of each pixel of the view.
    fn measure_pixels(&self, view: &DepthView, seed: Seed) -> DepthImage {
        let (width, height) = view.depth.size();
        let scale = width as f64 / 1280.0;
        // Errors that do not change from frame to frame come first: what a pixel sees.
        let bent = (self.multipath > 0.0).then(|| with_multipath(view, self.multipath));
        let seen = bent.as_ref().unwrap_or(view.depth);
        let blended =
            (self.mixed_px > 0.0).then(|| mixed(&DepthView { depth: seen, ..*view }, self.mixed_px * scale));
        let seen = blended.as_ref().unwrap_or(seen);
        let depth = view.depth;
        let band = if self.edge_px > 0.0 { (self.edge_px * scale).round().max(1.0) as usize } else { 0 };
        let edges = if band > 0 { edge_band(depth, band) } else { vec![false; width * height] };
        let noise = Noise::new(seed, self.correlation_px * scale);
        let patch = (6.0 * scale).max(1.0);
        let [near, far] = self.range_m;
        let mut out = Image::filled(width, height, 0.0f32);
        out.data.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            let shadowed = self.shadowed(&depth.data[y * width..(y + 1) * width], view.intrinsics.fx);
            for (x, pixel) in row.iter_mut().enumerate() {
                let at = y * width + x;
                let mut z = f64::from(seen.data[at]);
                if z <= 0.0 || z < near || z > far || shadowed.get(x) == Some(&true) {
                    continue;
                }
                if !self.is_in_view(view.intrinsics, x, y) {
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
                if lost(cos * echo / (z * z) as f32, self.lost_light, 17) {
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
                z += self.sigma_at(z) * self.light_factor(f64::from(cos * echo)) * noise.normal(x, y);
                if self.disparity_step_per_m > 0.0 {
                    let step = self.disparity_step_per_m;
                    z = 1.0 / ((1.0 / z.max(1e-3) / step).round().max(1.0) * step);
                }
                *pixel = z.max(0.0) as f32;
            }
        });
        out
    }

    /// Returns the factor of the noise at this returned light.
    fn light_factor(&self, returned: f64) -> f64 {
        // Polished surfaces return more than white, but no camera's noise falls without limit; tenfold is lost anyway.
        if self.light_exponent > 0.0 {
            (WHITE / returned.max(1e-6)).powf(self.light_exponent).clamp(0.5, 10.0)
        } else {
            1.0
        }
    }

    fn is_in_view(&self, k: &Intrinsics, x: usize, y: usize) -> bool {
        let within = |offset: f64, fov: f64| fov <= 0.0 || offset.abs() <= (0.5 * fov).tan();
        within((x as f64 + 0.5 - k.cx) / k.fx, self.fov_rad[0])
            && within((y as f64 + 0.5 - k.cy) / k.fy, self.fov_rad[1])
    }

    /// Removes patches of a depth image.
    fn lose_patches(&self, depth: &mut DepthImage, seed: Seed) {
        let width = depth.width;
        let noise = Noise::new(seed.derive("missing"), 0.0);
        let size_px = self.missing_px * width as f64 / 1280.0;
        depth.data.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            for (x, z) in row.iter_mut().enumerate() {
                let (i, j) = noise.cell(x, y, size_px);
                if noise.uniform(i, j, 20) < self.missing_share {
                    *z = 0.0;
                }
            }
        });
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

#[cfg(test)]
mod tests;
