//! Frames prepared for comparison: points to project into other frames, and images to compare them with.

use crate::PosesConfig;
use crate::luma::{Luma, half, luma, sample};
use glamx::{DVec3, Vec3};
use rayon::prelude::*;
use sms_core::Intrinsics;
use sms_frames::{DepthNoise, Frame, Sequence};

/// Depth and surface direction at one pixel; `z` is 0 without a measurement, `n` without a direction.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct SurfaceSample {
    pub(crate) z: f32,
    pub(crate) n: [f32; 3],
}

/// One frame prepared for comparison.
#[derive(Debug)]
pub(crate) struct PreparedFrame {
    pub(crate) intrinsics: Intrinsics,
    /// Surface at each pixel of the loaded size.
    pub(crate) surface: Vec<SurfaceSample>,
    /// Brightness, the finest level first.
    pub(crate) luma: Vec<Luma>,
    /// Pixels of the loaded size per pixel of the finest level.
    pub(crate) finest_scale: f64,
}

/// A measured point of a frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Point {
    /// Position in the frame's camera, metres.
    pub(crate) p_c: DVec3,
    /// Surface normal in the frame's camera; zero where unknown.
    pub(crate) n_c: DVec3,
    /// Standard deviation of the position along the normal, metres.
    pub(crate) sigma_m: f64,
    /// Brightness at the level.
    pub(crate) luma: f64,
    /// Derivative of the brightness along the image, levels per pixel of the level.
    pub(crate) slope: [f64; 2],
    /// Whether the neighbourhood has enough gradient for comparison by colour.
    pub(crate) textured: bool,
}

impl PreparedFrame {
    fn new(frame: &Frame, levels: usize, halvings: usize) -> Self {
        // Values that are not finite count as not measured.
        let surface = |(&z, &n): (&f32, &[f32; 3])| SurfaceSample {
            z: if z.is_finite() { z.max(0.0) } else { 0.0 },
            n: if n.iter().all(|v| v.is_finite()) { n } else { [0.0; 3] },
        };
        let surface = frame.depth.data.iter().zip(&frame.normal_c.data).map(surface).collect();
        let mut finest = luma(&frame.color);
        for _ in 0..halvings {
            finest = half(&finest);
        }
        let mut luma = vec![finest];
        while luma.len() < levels {
            luma.push(half(&luma[luma.len() - 1]));
        }
        Self { intrinsics: frame.camera.intrinsics, surface, luma, finest_scale: 2f64.powi(halvings as i32) }
    }

    /// Returns the pixels of the loaded size per pixel of a level.
    pub(crate) fn scale(&self, level: usize) -> f64 {
        self.finest_scale * 2f64.powi(level as i32)
    }

    /// Returns the pixel that contains (u, v) and its surface; `None` outside or without depth.
    pub(crate) fn surface_at(&self, u: f64, v: f64) -> Option<(usize, usize, SurfaceSample)> {
        let (w, h) = (self.intrinsics.width, self.intrinsics.height);
        if !(u >= 0.0 && v >= 0.0 && u < w as f64 && v < h as f64) {
            return None;
        }
        let (x, y) = (u as usize, v as usize);
        let surface = self.surface[y * w + x];
        (surface.z > 0.0).then_some((x, y, surface))
    }

    /// Returns the points with a depth on a grid of `stride` pixels of a level, which begins at `offset` strides. Their
    /// colour is read with an offset of `color_shift` pixels of the loaded size.
    pub(crate) fn points(
        &self,
        level: usize,
        stride: f64,
        offset: [f64; 2],
        color_shift: [f64; 2],
        config: &PosesConfig,
    ) -> Vec<Point> {
        let k = &self.intrinsics;
        let scale = self.scale(level);
        let step = (stride * scale).max(1.0);
        let at = |n: usize, o: f64| {
            (0..).map(move |i| ((i as f64 + o) * step) as usize).take_while(move |&x| x < n)
        };
        let mut points = Vec::new();
        for y in at(k.height, offset[1]) {
            for x in at(k.width, offset[0]) {
                let s = self.surface[y * k.width + x];
                if s.z <= 0.0 {
                    continue;
                }
                let (u, v, z) = (x as f64 + 0.5, y as f64 + 0.5, f64::from(s.z));
                let p_c = DVec3::new((u - k.cx) / k.fx * z, (v - k.cy) / k.fy * z, z);
                let n_c = Vec3::from(s.n).as_dvec3();
                let sampled =
                    sample(&self.luma[level], (u + color_shift[0]) / scale, (v + color_shift[1]) / scale);
                points.push(Point {
                    p_c,
                    n_c,
                    sigma_m: sigma_along_normal(&config.noise, p_c, n_c),
                    luma: sampled.map_or(0.0, |s| s.0),
                    slope: sampled.map_or([0.0; 2], |s| [s.1, s.2]),
                    textured: sampled.is_some_and(|s| s.1.hypot(s.2) >= config.min_gradient),
                });
            }
        }
        points
    }
}

/// Returns the standard deviation of a point along its normal, from depth noise along the ray. Viewing angles below
/// about 12° count as 12°, because other errors than noise dominate there.
pub(crate) fn sigma_along_normal(noise: &DepthNoise, p_c: DVec3, n_c: DVec3) -> f64 {
    noise.sigma_m(p_c.z) * (n_c.dot(p_c) / p_c.z).abs().max(0.2)
}

/// Prepares all frames, with as many levels as their size allows, up to the configured number.
pub(crate) fn views(sequence: &Sequence, config: &PosesConfig) -> Vec<PreparedFrame> {
    const LEAST_SIDE: usize = 12;
    let long = sequence.frames.iter().map(|f| f.color.width.max(f.color.height)).max().unwrap_or(1);
    let short = sequence.frames.iter().map(|f| f.color.width.min(f.color.height)).min().unwrap_or(1);
    let halvings = (0..8usize).find(|h| long >> h <= config.finest_long_side.max(16)).unwrap_or(8);
    let fitting =
        (1..config.iterations.len().max(1)).take_while(|l| short >> (halvings + l) >= LEAST_SIDE).count();
    sequence.frames.par_iter().map(|f| PreparedFrame::new(f, 1 + fitting, halvings)).collect()
}
