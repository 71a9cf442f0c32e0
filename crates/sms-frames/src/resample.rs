//! Undistortion and resampling of recorded images.

use crate::plane_fit::InverseDepthFit;
use crate::{DepthNoise, Lens};
use sms_core::{ColorImage, DepthImage, Image, Intrinsics};

/// Returns the pinhole that a recorded lens is resampled to: its long side `long_side` pixels (0 or larger than recorded keeps
/// the size), no distortion.
pub fn target_intrinsics(lens: &Lens, long_side: usize) -> Intrinsics {
    let k = &lens.intrinsics;
    let long = k.width.max(k.height);
    if long_side == 0 || long_side >= long {
        return *k;
    }
    let side = |n: usize| ((n * long_side) as f64 / long as f64).round().max(1.0) as usize;
    k.scaled_to(side(k.width), side(k.height))
}

/// Catmull-Rom cubic.
fn cubic(t: f32) -> f32 {
    let t = t.abs();
    if t < 1.0 {
        (1.5 * t - 2.5) * t * t + 1.0
    } else if t < 2.0 {
        ((-0.5 * t + 2.5) * t - 4.0) * t + 2.0
    } else {
        0.0
    }
}

/// Returns, for each output position, the first source index and the weights of its neighbours, which sum to 1. The kernel
/// is widened by the shrink factor, so that finer detail is averaged and not aliased.
fn kernel_rows(source: usize, target: usize) -> Vec<(usize, Vec<f32>)> {
    let scale = source as f64 / target as f64;
    let width = scale.max(1.0);
    (0..target)
        .map(|i| {
            let center = (i as f64 + 0.5) * scale;
            let from = (center - 2.0 * width).floor().max(0.0) as usize;
            let to = ((center + 2.0 * width).ceil() as usize).min(source);
            let raw: Vec<f32> =
                (from..to).map(|j| cubic(((j as f64 + 0.5 - center) / width) as f32)).collect();
            let sum: f32 = raw.iter().sum();
            (from, raw.iter().map(|w| w / sum).collect())
        })
        .collect()
}

fn to_byte(v: f32) -> u8 {
    v.round().clamp(0.0, 255.0) as u8
}

/// Resizes colour by a separable Catmull-Rom filter, widened when shrinking. Values are filtered as stored (sRGB).
pub fn resize_color(image: &ColorImage, width: usize, height: usize) -> ColorImage {
    if image.size() == (width, height) {
        return image.clone();
    }
    let columns = kernel_rows(image.width, width);
    let rows = kernel_rows(image.height, height);
    let mut narrow = vec![[0.0f32; 3]; width * image.height];
    for y in 0..image.height {
        let line = &image.data[y * image.width..(y + 1) * image.width];
        for (x, (from, weights)) in columns.iter().enumerate() {
            let mut sum = [0.0f32; 3];
            for (pixel, w) in line[*from..].iter().zip(weights) {
                for c in 0..3 {
                    sum[c] += w * f32::from(pixel[c]);
                }
            }
            narrow[y * width + x] = sum;
        }
    }
    let mut data = Vec::with_capacity(width * height);
    let mut line = vec![[0.0f32; 3]; width];
    for (from, weights) in &rows {
        line.fill([0.0; 3]);
        for (j, w) in weights.iter().enumerate() {
            let source = &narrow[(from + j) * width..(from + j + 1) * width];
            for (sum, pixel) in line.iter_mut().zip(source) {
                for c in 0..3 {
                    sum[c] += w * pixel[c];
                }
            }
        }
        data.extend(line.iter().map(|p| p.map(to_byte)));
    }
    Image::from_vec(width, height, data)
}

/// Undoes lens distortion at the recorded size by Catmull-Rom interpolation; beyond the recorded image its border is
/// repeated (depth is absent there).
pub fn undistort_color(image: &ColorImage, lens: &Lens) -> ColorImage {
    if lens.distortion.is_none() {
        return image.clone();
    }
    let k = lens.intrinsics;
    let clamp = |v: i64, n: usize| v.clamp(0, n as i64 - 1) as usize;
    let mut data = Vec::with_capacity(image.data.len());
    for y in 0..k.height {
        for x in 0..k.width {
            let (u, v) = lens.from_ideal(&k, x as f64 + 0.5, y as f64 + 0.5);
            let (u, v) =
                (u.clamp(-4.0, k.width as f64 + 4.0) - 0.5, v.clamp(-4.0, k.height as f64 + 4.0) - 0.5);
            let (i, j) = (u.floor(), v.floor());
            let mut sum = [0.0f32; 3];
            for dy in -1..=2i64 {
                let wy = cubic((j + dy as f64 - v) as f32);
                let row = clamp(j as i64 + dy, image.height) * image.width;
                for dx in -1..=2i64 {
                    let w = wy * cubic((i + dx as f64 - u) as f32);
                    let pixel = image.data[row + clamp(i as i64 + dx, image.width)];
                    for c in 0..3 {
                        sum[c] += w * f32::from(pixel[c]);
                    }
                }
            }
            data.push(sum.map(to_byte));
        }
    }
    Image::from_vec(k.width, k.height, data)
}

/// A depth sample on the target's image plane.
#[derive(Debug, Clone, Copy)]
struct DepthSample {
    u: f32,
    v: f32,
    z: f32,
}

/// The recorded depth samples that fall into each target pixel.
struct Blocks {
    start: Vec<u32>,
    samples: Vec<DepthSample>,
    width: usize,
    height: usize,
}

impl Blocks {
    fn new(depth: &DepthImage, lens: &Lens, target: &Intrinsics) -> Self {
        let mut placed: Vec<(u32, DepthSample)> = Vec::new();
        for y in 0..depth.height {
            for x in 0..depth.width {
                let z = depth[(x, y)];
                if z <= 0.0 {
                    continue;
                }
                let Some((u, v)) = lens.to_ideal(target, x as f64 + 0.5, y as f64 + 0.5) else { continue };
                if u < 0.0 || v < 0.0 || u >= target.width as f64 || v >= target.height as f64 {
                    continue;
                }
                let pixel = v as usize * target.width + u as usize;
                placed.push((pixel as u32, DepthSample { u: u as f32, v: v as f32, z }));
            }
        }
        let mut start = vec![0u32; target.width * target.height + 1];
        placed.iter().for_each(|(pixel, _)| start[*pixel as usize + 1] += 1);
        for i in 1..start.len() {
            start[i] += start[i - 1];
        }
        let mut next = start.clone();
        let mut samples = vec![DepthSample { u: 0.0, v: 0.0, z: 0.0 }; placed.len()];
        for (pixel, sample) in placed {
            let slot = &mut next[pixel as usize];
            samples[*slot as usize] = sample;
            *slot += 1;
        }
        Self { start, samples, width: target.width, height: target.height }
    }

    fn of(&self, x: usize, y: usize) -> &[DepthSample] {
        let pixel = y * self.width + x;
        &self.samples[self.start[pixel] as usize..self.start[pixel + 1] as usize]
    }
}

/// Largest difference in depth between samples of one surface within a block: 5 mm, and 1.5 % of the depth.
fn cluster_gap(z: f32) -> f32 {
    (0.015 * z).max(0.005)
}

/// Returns the sample nearest to the block's centre among those of its front surface: the nearest cluster in depth that
/// holds at least a quarter of the block's samples, so that a single stray value in front is not a surface.
fn front_sample(block: &[DepthSample], cu: f32, cv: f32, sorted: &mut Vec<f32>) -> Option<DepthSample> {
    if block.is_empty() {
        return None;
    }
    sorted.clear();
    sorted.extend(block.iter().map(|s| s.z));
    sorted.sort_unstable_by(f32::total_cmp);
    let enough = block.len().div_ceil(4);
    let mut from = 0;
    let mut front = sorted[0];
    for i in 1..=sorted.len() {
        if i == sorted.len() || sorted[i] - sorted[i - 1] > cluster_gap(sorted[i - 1]) {
            front = sorted[from];
            if i - from >= enough {
                break;
            }
            from = i;
        }
    }
    let limit = front + cluster_gap(front);
    let distance = |s: &DepthSample| (s.u - cu).powi(2) + (s.v - cv).powi(2);
    block
        .iter()
        .filter(|s| s.z >= front && s.z <= limit)
        .min_by(|a, b| distance(a).total_cmp(&distance(b)).then(a.z.total_cmp(&b.z)))
        .copied()
}

/// Moves the depth of the chosen sample to the block's centre along the surface, averaging the block's samples of
/// that surface. The surface is the plane through the samples of the 3 × 3 blocks around; without one, or if
/// it deviates from the sample, the sample's own depth is kept.
fn depth_at_center(
    blocks: &Blocks,
    x: usize,
    y: usize,
    chosen: DepthSample,
    noise: &DepthNoise,
    pitch: f64,
) -> f32 {
    let (cu, cv) = (x as f64 + 0.5, y as f64 + 0.5);
    let z0 = f64::from(chosen.z);
    let sigma = noise.sigma_m(z0);
    let gap = f64::from(cluster_gap(chosen.z));
    let around = (y.saturating_sub(1)..=(y + 1).min(blocks.height - 1))
        .flat_map(|j| (x.saturating_sub(1)..=(x + 1).min(blocks.width - 1)).map(move |i| (i, j)));
    let mut plane: Option<crate::plane_fit::InverseDepthPlane> = None;
    for _ in 0..2 {
        let mut fit = InverseDepthFit::default();
        for (i, j) in around.clone() {
            for s in blocks.of(i, j) {
                let (du, dv, z) = (f64::from(s.u) - cu, f64::from(s.v) - cv, f64::from(s.z));
                let off = match &plane {
                    None => (z - z0).abs() - gap.max(3.0 * pitch),
                    Some(p) => (z - p.depth_at(du, dv)).abs() - 3.0 * sigma,
                };
                if off <= 0.0 {
                    fit.add(du, dv, 1.0 / z, 1.0);
                }
            }
        }
        plane = if fit.count >= 6 { fit.solve() } else { None };
        if plane.is_none() {
            return chosen.z;
        }
    }
    let Some(plane) = plane else { return chosen.z };
    let (mut sum, mut count) = (0.0, 0.0);
    for s in blocks.of(x, y) {
        let (du, dv, z) = (f64::from(s.u) - cu, f64::from(s.v) - cv, f64::from(s.z));
        if (z - plane.depth_at(du, dv)).abs() <= 3.0 * sigma {
            sum += 1.0 / z - plane.gx * du - plane.gy * dv;
            count += 1.0;
        }
    }
    let z = count / sum;
    if count > 0.0 && (z - z0).abs() <= gap { z as f32 } else { chosen.z }
}

/// Resamples depth to the pinhole `target`: the front surface of each target pixel's block of recorded samples, at the
/// pixel's centre. A recorded image that is hardly larger than the target is resampled by nearest neighbour.
pub fn resample_depth(
    depth: &DepthImage,
    lens: &Lens,
    target: &Intrinsics,
    noise: &DepthNoise,
) -> DepthImage {
    let k = &lens.intrinsics;
    if lens.distortion.is_none() && k == target {
        return depth.clone();
    }
    let mut out = Image::filled(target.width, target.height, 0.0f32);
    let shrink = (k.fx * k.fy / (target.fx * target.fy)).sqrt();
    if shrink < 1.25 {
        for y in 0..target.height {
            for x in 0..target.width {
                let (u, v) = lens.from_ideal(target, x as f64 + 0.5, y as f64 + 0.5);
                if let Some(&z) = depth.get(u.floor() as i64, v.floor() as i64) {
                    out[(x, y)] = z;
                }
            }
        }
        return out;
    }
    let blocks = Blocks::new(depth, lens, target);
    let mut sorted = Vec::new();
    for y in 0..target.height {
        for x in 0..target.width {
            if let Some(chosen) = front_sample(blocks.of(x, y), x as f32 + 0.5, y as f32 + 0.5, &mut sorted) {
                let pitch = target.pixel_footprint(f64::from(chosen.z));
                out[(x, y)] = depth_at_center(&blocks, x, y, chosen, noise, pitch);
            }
        }
    }
    out
}
