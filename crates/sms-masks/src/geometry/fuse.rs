//! One cloud of oriented surface elements (surfels) from all frames.

use super::GeometryConfig;
use super::linalg::{mean_and_covariance, symmetric_eigen};
use crate::voxels::{RowWalk, key_of};
use glamx::DVec3;
use rayon::prelude::*;
use sms_core::{Cancel, CoreError, DepthImage};
use sms_frames::{Frame, Sequence};

/// Surface element: one occupied cell of the fused cloud.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Surfel {
    /// Position in the world.
    pub(crate) p_w: DVec3,
    /// Unit normal towards the cameras.
    pub(crate) n_w: DVec3,
    /// Sum of the weights of its samples.
    pub(crate) weight: f64,
    /// Mean sRGB colour.
    pub(crate) color: [f32; 3],
    /// Spread of the cloud along the normal, metres.
    pub(crate) sigma_m: f64,
}

/// Sums over the samples of one cell, in one frame or several.
#[derive(Debug, Clone, Copy)]
struct FusedCell {
    key: u64,
    p_w: DVec3,
    to_camera: DVec3,
    color: [f32; 3],
    weight: f64,
    count: u32,
}

/// Fuses the frames; also returns which surfels are within `gap_m` of each other.
pub(crate) fn fuse(
    sequence: &Sequence,
    config: &GeometryConfig,
    cancel: &Cancel,
) -> Result<(Vec<Surfel>, Neighbors), CoreError> {
    let fused: Vec<&Frame> =
        spread(sequence.len(), config.max_fused_frames).map(|i| &sequence.frames[i]).collect();
    let limit = depth_limit(&fused, config);
    let parts: Vec<Vec<FusedCell>> = fused
        .par_iter()
        .map(|f| {
            if cancel.is_cancelled() {
                return vec![];
            }
            merge(samples(f, limit, config))
        })
        .collect();
    cancel.check()?;
    let mut cells = merge(parts.into_iter().flatten().collect());
    // Cells with a small fraction of the usual number of samples are noise.
    let mut counts: Vec<u32> = cells.iter().map(|c| c.count).collect();
    let middle = counts.len() / 2;
    let usual = if counts.is_empty() { 0 } else { *counts.select_nth_unstable(middle).1 };
    cells.retain(|c| c.count >= usual.div_ceil(8));
    let consistent: Vec<bool> = cells.par_iter().map(|c| is_consistent(c, &fused)).collect();
    let mut keep = consistent.iter();
    cells.retain(|_| *keep.next().unwrap_or(&false));
    cancel.check()?;
    let positions: Vec<DVec3> = cells.iter().map(|c| c.p_w / c.weight).collect();
    let keys: Vec<u64> = cells.iter().map(|c| c.key).collect();
    let graph = Neighbors::new(&keys, &positions, config.gap_m, config.voxel_m);
    cancel.check()?;
    let surfels = orient(&cells, &positions, &graph, config.gap_m);
    Ok((surfels, graph))
}

/// Returns at most `most` indices below `count`, evenly spread.
fn spread(count: usize, most: usize) -> impl Iterator<Item = usize> {
    let n = count.min(most.max(1));
    (0..n).map(move |k| k * count / n)
}

/// Returns the depth limit of fusion: a multiple of the median depth in the central ninth of the images.
fn depth_limit(frames: &[&Frame], config: &GeometryConfig) -> f64 {
    let mut depths: Vec<f32> = Vec::new();
    for frame in frames {
        let (w, h) = frame.depth.size();
        for y in (h / 3..2 * h / 3).step_by(3) {
            depths.extend((w / 3..2 * w / 3).step_by(3).map(|x| frame.depth[(x, y)]).filter(|&z| z > 0.0));
        }
    }
    if depths.is_empty() {
        return config.max_depth_m;
    }
    let middle = depths.len() / 2;
    let usual = f64::from(*depths.select_nth_unstable_by(middle, f32::total_cmp).1);
    config.max_depth_m.min(config.depth_spread * usual)
}

/// Returns the back-projected pixels of one frame. Isolated depths are skipped: fewer than 4 of the 5×5 pixels around
/// them agree within 3 %. The weight of a sample is the inverse of z², times the cosine of its viewing angle if the
/// normal is known: samples near silhouettes are off by up to a pixel.
fn samples(frame: &Frame, limit_m: f64, config: &GeometryConfig) -> Vec<FusedCell> {
    let (w, h) = frame.depth.size();
    let center_w = frame.camera.center_w();
    let mut cells = Vec::new();
    for y in 0..h {
        for x in 0..w {
            let z = frame.depth[(x, y)];
            if z <= 0.0 || f64::from(z) > limit_m || !z.is_finite() {
                continue;
            }
            let mut agree = 0;
            for j in y.saturating_sub(2)..(y + 3).min(h) {
                for i in x.saturating_sub(2)..(x + 3).min(w) {
                    agree += usize::from((frame.depth[(i, j)] - z).abs() < 0.03 * z);
                }
            }
            if agree < 5 {
                continue;
            }
            let p_w = frame.camera.unproject_pixel(x, y, f64::from(z));
            let Some(key) = key_of(p_w, config.voxel_m) else { continue };
            let to_camera = (center_w - p_w).normalize_or(DVec3::Z);
            let n = frame.normal_c[(x, y)];
            let n_w =
                frame.camera.x_wc.rotation * DVec3::new(f64::from(n[0]), f64::from(n[1]), f64::from(n[2]));
            let facing = if n == [0.0; 3] { 0.3 } else { n_w.dot(to_camera).max(0.1).powi(2) };
            let weight = facing / f64::from(z * z);
            let color = frame.color[(x, y)].map(|c| f32::from(c) * weight as f32);
            cells.push(FusedCell {
                key,
                p_w: p_w * weight,
                to_camera: to_camera * weight,
                color,
                weight,
                count: 1,
            });
        }
    }
    cells
}

/// Returns the same surface in cells of size `cell_m`, their neighbours (within 2.5 cells), and the coarse surfel of
/// each fine one. Coarse normals come from a wider neighbourhood and are reliable even where noise tilts fine ones.
pub(crate) fn coarsen(surfels: &[Surfel], cell_m: f64) -> (Vec<Surfel>, Neighbors, Vec<u32>) {
    let key = |s: &Surfel| key_of(s.p_w, cell_m).unwrap_or(u64::MAX);
    let cells = merge(
        surfels
            .iter()
            .map(|s| FusedCell {
                key: key(s),
                p_w: s.p_w * s.weight,
                to_camera: s.n_w * s.weight,
                color: s.color.map(|c| c * s.weight as f32),
                weight: s.weight,
                count: 1,
            })
            .collect(),
    );
    let positions: Vec<DVec3> = cells.iter().map(|c| c.p_w / c.weight).collect();
    let keys: Vec<u64> = cells.iter().map(|c| c.key).collect();
    let graph = Neighbors::new(&keys, &positions, 2.5 * cell_m, cell_m);
    let coarse = orient(&cells, &positions, &graph, 2.5 * cell_m);
    // The cells were made from these surfels, so every key exists.
    let parent = surfels.par_iter().map(|s| keys.partition_point(|&k| k < key(s)) as u32).collect();
    (coarse, graph, parent)
}

/// Adds up cells with equal keys. The sort is stable, so sums run in the order of the frames.
fn merge(mut cells: Vec<FusedCell>) -> Vec<FusedCell> {
    cells.par_sort_by_key(|c| c.key);
    cells
        .chunk_by(|a, b| a.key == b.key)
        .map(|same| {
            let mut sum = same[0];
            for c in &same[1..] {
                sum.p_w += c.p_w;
                sum.to_camera += c.to_camera;
                sum.weight += c.weight;
                sum.count += c.count;
                for k in 0..3 {
                    sum.color[k] += c.color[k];
                }
            }
            sum
        })
        .collect()
}

/// Returns whether more frames see a surface at the cell than see through it.
fn is_consistent(cell: &FusedCell, frames: &[&Frame]) -> bool {
    let p_w = cell.p_w / cell.weight;
    let (mut seen, mut through) = (0usize, 0usize);
    for frame in frames {
        let Some((u, v, z)) = frame.camera.project(p_w) else { continue };
        let Some((x, y)) = frame.camera.pixel_at(u, v) else { continue };
        let tolerance = 0.012f64.max(0.015 * z);
        match around(&frame.depth, x, y) {
            Some((near, _)) if near > z + tolerance => through += 1,
            Some((near, far)) if near < z + tolerance && far > z - tolerance => seen += 1,
            _ => {}
        }
    }
    seen > through
}

/// Returns the smallest and largest depth of the 3×3 pixels around one; `None` if fewer than 3 are measured.
fn around(depth: &DepthImage, x: usize, y: usize) -> Option<(f64, f64)> {
    let (mut near, mut far, mut count) = (f32::INFINITY, 0.0f32, 0);
    for j in y.saturating_sub(1)..(y + 2).min(depth.height) {
        for i in x.saturating_sub(1)..(x + 2).min(depth.width) {
            let z = depth[(i, j)];
            if z > 0.0 {
                near = near.min(z);
                far = far.max(z);
                count += 1;
            }
        }
    }
    (count >= 3).then_some((f64::from(near), f64::from(far)))
}

/// Computes normals from the weighted neighbourhood of each cell. Then moves each position along its normal onto the
/// mean of the neighbours that face the same way, which turns the thick skin of noise into a surface.
fn orient(cells: &[FusedCell], positions: &[DVec3], graph: &Neighbors, reach_m: f64) -> Vec<Surfel> {
    // Gaussian of half the reach, truncated at the reach.
    let near = |i: usize| {
        graph.of(i).chain(std::iter::once(i)).map(move |j| {
            let d2 = positions[i].distance_squared(positions[j]) / (reach_m * reach_m);
            (j, cells[j].weight * (-2.0 * d2).exp())
        })
    };
    let frames: Vec<(DVec3, f64)> = (0..cells.len())
        .into_par_iter()
        .map(|i| {
            let towards = cells[i].to_camera.normalize_or(DVec3::Z);
            let around = near(i).map(|(j, w)| (positions[j], w));
            match mean_and_covariance(around) {
                Some((_, covariance, _)) if graph.degree(i) >= 4 => {
                    let (values, vectors) = symmetric_eigen(covariance);
                    let n = vectors[0];
                    (if n.dot(towards) < 0.0 { -n } else { n }, values[0].max(0.0).sqrt())
                }
                // Too few neighbours for a normal.
                _ => (towards, 0.4 * reach_m),
            }
        })
        .collect();
    (0..cells.len())
        .into_par_iter()
        .map(|i| {
            let (n_w, sigma_m) = frames[i];
            let (mut shift, mut total) = (0.0, 0.0);
            for (j, w) in near(i) {
                let alike = frames[j].0.dot(n_w);
                if alike > 0.7 {
                    shift += w * alike * n_w.dot(positions[j] - positions[i]);
                    total += w * alike;
                }
            }
            let cell = &cells[i];
            let shift = if total > 0.0 { shift / total } else { 0.0 };
            Surfel {
                p_w: positions[i] + n_w * shift,
                n_w,
                weight: cell.weight,
                color: cell.color.map(|c| c / cell.weight as f32),
                sigma_m,
            }
        })
        .collect()
}

/// The neighbours of each surfel within a radius, ordered by key.
#[derive(Debug)]
pub(crate) struct Neighbors {
    start: Vec<u32>,
    list: Vec<u32>,
}

impl Neighbors {
    /// Builds the neighbours of cells of size `voxel_m` with sorted keys.
    pub(crate) fn new(keys: &[u64], positions: &[DVec3], radius_m: f64, voxel_m: f64) -> Self {
        const CHUNK: usize = 8192;
        let radius2 = radius_m * radius_m;
        let parts: Vec<(Vec<u32>, Vec<u32>)> = (0..keys.len().div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| {
                let range = chunk * CHUNK..keys.len().min((chunk + 1) * CHUNK);
                let mut walk = RowWalk::new(keys, radius_m / voxel_m, range.start);
                let (mut counts, mut list) = (Vec::with_capacity(CHUNK), Vec::with_capacity(32 * CHUNK));
                for i in range {
                    let before = list.len();
                    walk.visit(i, |j| {
                        if j != i && positions[j].distance_squared(positions[i]) < radius2 {
                            list.push(j as u32);
                        }
                    });
                    counts.push((list.len() - before) as u32);
                }
                (counts, list)
            })
            .collect();
        let mut start = Vec::with_capacity(keys.len() + 1);
        start.push(0);
        let mut list = Vec::with_capacity(parts.iter().map(|p| p.1.len()).sum());
        for (counts, part) in parts {
            for count in counts {
                start.push(start[start.len() - 1] + count);
            }
            list.extend(part);
        }
        Self { start, list }
    }

    fn degree(&self, i: usize) -> usize {
        (self.start[i + 1] - self.start[i]) as usize
    }

    pub(crate) fn of(&self, i: usize) -> impl Iterator<Item = usize> + '_ {
        self.list[self.start[i] as usize..self.start[i + 1] as usize].iter().map(|&j| j as usize)
    }

    /// Returns the connected pieces of the surfels accepted by `holds`, each sorted, in the order of their first
    /// surfel.
    pub(crate) fn components(&self, holds: impl Fn(usize) -> bool) -> Vec<Vec<usize>> {
        let mut taken = vec![false; self.start.len() - 1];
        let mut pieces = Vec::new();
        for first in 0..taken.len() {
            if taken[first] || !holds(first) {
                continue;
            }
            taken[first] = true;
            let mut piece = vec![first];
            let mut next = 0;
            while next < piece.len() {
                for j in self.of(piece[next]) {
                    if !taken[j] && holds(j) {
                        taken[j] = true;
                        piece.push(j);
                    }
                }
                next += 1;
            }
            piece.sort_unstable();
            pieces.push(piece);
        }
        pieces
    }
}
