//! Frames prepared for comparison: points to project into other frames, and images to compare them with.

use crate::PosesConfig;
use crate::luma::{Luma, half, luma, sample};
use glamx::{DVec3, Vec3};
use rayon::prelude::*;
use sms_core::Intrinsics;
use sms_frames::{DepthNoise, Frame, Sequence, normals_at};

/// Depth at one pixel; `z` is 0 without a measurement.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct DepthSample {
    pub(crate) z: f32,
    /// Standard deviation of the depth, metres, at the mean depth of the neighbourhood. A weight that followed the measured
    /// depth would prefer points that seem near: by 4σ²/z.
    pub(crate) sigma_z_m: f32,
}

/// Surface direction in the camera, in eight bytes: lookups of scattered pixels wait for memory.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Direction {
    /// Components of the normal in units of 1/32767, which turns it by less than 3e-5 rad; zero without a direction.
    n: [i16; 3],
    /// Whether the surroundings are flat within their noise.
    pub(crate) is_flat: bool,
}

impl Direction {
    const GRID: f64 = 32767.0;

    /// Rounds a normal; one that is not finite counts as none.
    pub(crate) fn new(n_c: DVec3, is_flat: bool) -> Self {
        let n = if n_c.is_finite() { n_c } else { DVec3::ZERO };
        Self { n: n.to_array().map(|v| (v * Self::GRID).round() as i16), is_flat }
    }

    /// Returns the same direction in surroundings that are not flat.
    pub(crate) fn not_flat(self) -> Self {
        Self { is_flat: false, ..self }
    }

    /// Returns the normal; zero without a direction.
    pub(crate) fn n_c(&self) -> DVec3 {
        DVec3::from_array(self.n.map(|v| f64::from(v) / Self::GRID))
    }
}

/// The surface that a frame measured at one pixel.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Surface {
    /// The pixel; `None` outside the image.
    pub(crate) pixel: Option<(usize, usize)>,
    /// Its `z` is 0 without a measurement, and outside the image.
    pub(crate) depth: DepthSample,
    pub(crate) direction: Direction,
}

/// Depths of neighbouring pixels that differ by more than this share belong to different surfaces.
const EDGE_SHARE: f32 = 0.03;

/// Squares of pixels, each the size of a pixel of the finest brightness image, that share a surface direction.
#[derive(Debug, Clone, Default)]
pub(crate) struct Blocks {
    /// Side of a block, pixels, as a power of two.
    bits: u32,
    /// Blocks in a row.
    width: usize,
    /// Index of the first measured pixel of each block, at which its direction is determined. A block across a depth edge has none:
    /// its pixels belong to different surfaces.
    pub(crate) measured: Vec<Option<usize>>,
}

impl Blocks {
    pub(crate) fn new(depth: &[DepthSample], k: &Intrinsics, bits: u32) -> Self {
        let side = 1usize << bits;
        let width = k.width.div_ceil(side);
        let mut measured = vec![None; width * k.height.div_ceil(side)];
        let mut is_edge = vec![false; measured.len()];
        for (pixel, s) in depth.iter().enumerate().filter(|(_, s)| s.z > 0.0) {
            let block = ((pixel / k.width) >> bits) * width + ((pixel % k.width) >> bits);
            let first: &mut Option<usize> = &mut measured[block];
            let z = depth[*first.get_or_insert(pixel)].z;
            is_edge[block] |= (s.z - z).abs() > EDGE_SHARE * z;
        }
        measured.iter_mut().zip(is_edge).filter(|(_, is_edge)| *is_edge).for_each(|(m, _)| *m = None);
        Self { bits, width, measured }
    }

    /// Returns the block of a pixel.
    pub(crate) fn of(&self, x: usize, y: usize) -> usize {
        (y >> self.bits) * self.width + (x >> self.bits)
    }
}

/// One frame prepared for comparison.
#[derive(Debug)]
pub(crate) struct PreparedFrame {
    pub(crate) intrinsics: Intrinsics,
    /// It determines the weight of depth relative to colour, and of both relative to the given poses.
    pub(crate) depth_noise: DepthNoise,
    /// Depth at each pixel of the loaded size.
    pub(crate) depth: Vec<DepthSample>,
    pub(crate) blocks: Blocks,
    /// Surface direction of each block that the frame alone shows.
    pub(crate) directions: Vec<Direction>,
    /// Brightness, the finest level first.
    pub(crate) luma: Vec<Luma>,
    /// Pixels of the loaded size per pixel of the finest level.
    pub(crate) finest_scale: f64,
}

/// A frame with present intrinsics and surface directions, or with its own.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DirectedFrame<'a> {
    pub(crate) frame: &'a PreparedFrame,
    pub(crate) intrinsics: Intrinsics,
    pub(crate) directions: &'a [Direction],
}

/// A measured point of a frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Point {
    /// Position in the frame's camera, metres.
    pub(crate) p_c: DVec3,
    /// Surface normal in the frame's camera; zero where unknown.
    pub(crate) n_c: DVec3,
    /// Whether the surroundings are flat within their noise.
    pub(crate) is_flat: bool,
    /// Standard deviation of the position along the normal, metres.
    pub(crate) sigma_m: f64,
    /// Brightness at the level.
    pub(crate) luma: f64,
    /// Derivative of the brightness with respect to the position in the frame's camera, levels per metre.
    pub(crate) luma_by_p: DVec3,
    /// Size of a pixel at the point, metres.
    pub(crate) pixel_m: [f64; 2],
    /// Whether the neighbourhood has enough gradient for comparison by colour.
    pub(crate) textured: bool,
}

impl PreparedFrame {
    fn new(frame: &Frame, levels: usize, halvings: usize, config: &PosesConfig) -> Self {
        // Values that are not finite count as not measured.
        let sample = |&z: &f32| DepthSample {
            z: if z.is_finite() { z.max(0.0) } else { 0.0 },
            ..DepthSample::default()
        };
        let direction = |&n: &[f32; 3]| Direction::new(Vec3::from(n).as_dvec3(), true);
        let k = &frame.camera.intrinsics;
        let mut depth: Vec<DepthSample> = frame.depth.data.iter().map(sample).collect();
        let blocks = Blocks::new(&depth, k, halvings as u32);
        let measured = blocks.measured.iter().copied();
        let normals = normals_at(measured, &frame.depth, k, &frame.depth_noise, config.normal_radius_px);
        let directions = normals.iter().map(direction).collect();
        set_sigmas(&mut depth, k, &frame.depth_noise, config.normal_radius_px);
        let mut finest = luma(&frame.color);
        for _ in 0..halvings {
            finest = half(&finest);
        }
        let mut luma = vec![finest];
        while luma.len() < levels {
            luma.push(half(&luma[luma.len() - 1]));
        }
        let finest_scale = 2f64.powi(halvings as i32);
        Self {
            intrinsics: frame.camera.intrinsics,
            depth_noise: frame.depth_noise,
            depth,
            blocks,
            directions,
            luma,
            finest_scale,
        }
    }

    /// Returns the pixels of the loaded size per pixel of a level.
    pub(crate) fn scale(&self, level: usize) -> f64 {
        self.finest_scale * 2f64.powi(level as i32)
    }

    /// Returns the frame with the directions that it shows alone.
    pub(crate) fn alone(&self) -> DirectedFrame<'_> {
        DirectedFrame { frame: self, intrinsics: self.intrinsics, directions: &self.directions }
    }
}

impl DirectedFrame<'_> {
    /// Returns the frame with a focal length that is changed by the factor exp(`log`).
    pub(crate) fn with_focal(mut self, log: f64) -> Self {
        self.intrinsics.fx *= log.exp();
        self.intrinsics.fy *= log.exp();
        self
    }

    /// Returns the surfaces at the projections of points.
    ///
    /// Each of the three loops is short, so that the processor waits for many places in memory at once.
    pub(crate) fn surfaces<const N: usize>(&self, points_c: &[DVec3; N]) -> [Surface; N] {
        let width = self.frame.intrinsics.width;
        let mut surfaces =
            points_c.map(|p_c| Surface { pixel: pixel_of(&self.intrinsics, p_c), ..Surface::default() });
        for surface in &mut surfaces {
            let depth = surface.pixel.map(|(x, y)| self.frame.depth[y * width + x]);
            surface.depth = depth.unwrap_or_default();
        }
        for surface in surfaces.iter_mut().filter(|s| s.depth.z > 0.0) {
            let direction = surface.pixel.map(|(x, y)| self.directions[self.frame.blocks.of(x, y)]);
            surface.direction = direction.unwrap_or_default();
        }
        surfaces
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
        let (k, luma) = (&self.intrinsics, &self.frame.luma[level]);
        let scale = self.frame.scale(level);
        let step = (stride * scale).max(1.0);
        let at = |n: usize, o: f64| {
            (0..).map(move |i| ((i as f64 + o) * step) as usize).take_while(move |&x| x < n)
        };
        let mut points = Vec::new();
        for y in at(k.height, offset[1]) {
            for x in at(k.width, offset[0]) {
                let s = self.frame.depth[y * k.width + x];
                if s.z <= 0.0 {
                    continue;
                }
                let (u, v, z) = (x as f64 + 0.5, y as f64 + 0.5, f64::from(s.z));
                let p_c = pixel_point(k, x as i64, y as i64, z);
                let direction = self.directions[self.frame.blocks.of(x, y)];
                let n_c = direction.n_c();
                let sampled = sample(luma, (u + color_shift[0]) / scale, (v + color_shift[1]) / scale);
                let pixel_m = [z / k.fx, z / k.fy];
                let slope =
                    sampled.map_or([0.0; 2], |s| [s.1 / scale / pixel_m[0], s.2 / scale / pixel_m[1]]);
                points.push(Point {
                    p_c,
                    n_c,
                    is_flat: direction.is_flat,
                    sigma_m: sigma_along_normal(s.sigma_z_m.into(), p_c, n_c),
                    luma: sampled.map_or(0.0, |s| s.0),
                    luma_by_p: DVec3::new(slope[0], slope[1], -(slope[0] * p_c.x + slope[1] * p_c.y) / z),
                    pixel_m,
                    textured: sampled.is_some_and(|s| s.1.hypot(s.2) >= config.min_gradient),
                });
            }
        }
        points
    }
}

/// Sets the noise of each measurement from the mean inverse depth of its neighbourhood on the same surface, which is exact
/// for planes.
fn set_sigmas(all: &mut [DepthSample], k: &Intrinsics, noise: &DepthNoise, reach: usize) {
    let (w, h, reach) = (k.width as i64, k.height as i64, reach as i64);
    let inverse: Vec<f64> = all.iter().map(|s| if s.z > 0.0 { 1.0 / f64::from(s.z) } else { 0.0 }).collect();
    let sigma = |i: usize| {
        let (x, y) = ((i % k.width) as i64, (i / k.width) as i64);
        let own = inverse[i];
        // Neighbours in opposite pairs, so that a slope cancels.
        let (mut sum, mut count) = (own, 1.0);
        for dy in -reach..=reach {
            for dx in 0..=reach {
                if dx == 0 && dy <= 0 {
                    continue;
                }
                let at = |u: i64, v: i64| {
                    if u < 0 || v < 0 || u >= w || v >= h { 0.0 } else { inverse[(v * w + u) as usize] }
                };
                let (a, b) = (at(x + dx, y + dy), at(x - dx, y - dy));
                // A pair across an edge has another mean.
                if a > 0.0 && b > 0.0 && (0.5 * (a + b) - own).abs() < f64::from(EDGE_SHARE) * own {
                    sum += a + b;
                    count += 2.0;
                }
            }
        }
        noise.sigma_m(count / sum) as f32
    };
    let sigmas: Vec<f32> = (0..all.len()).map(|i| if all[i].z > 0.0 { sigma(i) } else { 0.0 }).collect();
    all.iter_mut().zip(sigmas).for_each(|(s, sigma)| s.sigma_z_m = sigma);
}

/// Returns the pixel at the projection of a point in the camera; `None` outside the image.
pub(crate) fn pixel_of(k: &Intrinsics, p_c: DVec3) -> Option<(usize, usize)> {
    let (u, v) = (k.fx * p_c.x / p_c.z + k.cx, k.fy * p_c.y / p_c.z + k.cy);
    let is_inside = p_c.z > 1e-3 && u >= 0.0 && v >= 0.0 && u < k.width as f64 && v < k.height as f64;
    is_inside.then_some((u as usize, v as usize))
}

/// Returns the derivative of the point that a pixel with depth shows with respect to the logarithm of the focal length.
pub(crate) fn by_focal_of(p_c: DVec3) -> DVec3 {
    DVec3::new(-p_c.x, -p_c.y, 0.0)
}

/// Returns the point at the centre of a pixel with depth `z`, in the camera.
pub(crate) fn pixel_point(k: &Intrinsics, x: i64, y: i64, z: f64) -> DVec3 {
    DVec3::new((x as f64 + 0.5 - k.cx) / k.fx * z, (y as f64 + 0.5 - k.cy) / k.fy * z, z)
}

/// Returns the standard deviation of a point along its normal, from depth noise along the ray. Viewing angles below
/// about 12° count as 12°, because other errors than noise dominate there.
pub(crate) fn sigma_along_normal(sigma_z_m: f64, p_c: DVec3, n_c: DVec3) -> f64 {
    sigma_z_m * (n_c.dot(p_c) / p_c.z).abs().max(0.2)
}

/// Prepares all frames, with as many levels as their size allows, up to the configured number.
pub(crate) fn views(sequence: &Sequence, config: &PosesConfig) -> Vec<PreparedFrame> {
    let long = sequence.frames.iter().map(|f| f.color.width.max(f.color.height)).max().unwrap_or(1);
    let short = sequence.frames.iter().map(|f| f.color.width.min(f.color.height)).min().unwrap_or(1);
    let (levels, halvings) = levels_and_halvings(long, short, config);
    sequence.frames.par_iter().map(|f| PreparedFrame::new(f, levels, halvings, config)).collect()
}

/// Prepares one frame.
pub(crate) fn prepared(frame: &Frame, config: &PosesConfig) -> PreparedFrame {
    let (w, h) = frame.color.size();
    let (levels, halvings) = levels_and_halvings(w.max(h), w.min(h), config);
    PreparedFrame::new(frame, levels, halvings, config)
}

/// Returns the number of levels, and the number of halvings of the loaded size for the finest one.
fn levels_and_halvings(long: usize, short: usize, config: &PosesConfig) -> (usize, usize) {
    const LEAST_SIDE: usize = 12;
    let halvings = (0..8usize).find(|h| long >> h <= config.finest_long_side.max(16)).unwrap_or(8);
    let fitting =
        (1..config.iterations.len().max(1)).take_while(|l| short >> (halvings + l) >= LEAST_SIDE).count();
    (1 + fitting, halvings)
}
