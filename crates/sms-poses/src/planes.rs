//! Surface directions from all frames together.
//!
//! The normals of one noisy depth image are wrong by ten degrees, and a wrong normal resists motion in the plane of its
//! surface. Here the measured points of all frames are summed up in cells of several sizes. A cell takes its normal from the
//! largest window around it in which the points are as near to a plane as their noise allows.

use crate::views::{DirectedFrame, Direction, Point, pixel_point};
use glamx::{DPose3, DVec3};
use rayon::prelude::*;
use sms_core::symmetric_eigen;

/// Number of window sizes, each twice the one before.
const LEVELS: usize = 4;
/// A window is flat if its thickness is at most this multiple of the noise's.
const FLAT: f64 = 1.3;
/// Minimum number of points of a window.
const LEAST_POINTS: f64 = 12.0;

/// Sums over the points of a cell.
#[derive(Debug, Clone, Copy, Default)]
struct Moments {
    count: f64,
    /// Σ (p − center), and the upper triangle of Σ (p − center)(p − center)ᵀ.
    sum: DVec3,
    products: [f64; 6],
    /// Sum of the normals of the single frames; it tells the outside.
    normals: DVec3,
    /// Sum of the variances along the normal, m².
    variance: f64,
}

impl Moments {
    fn merge(&mut self, o: &Self) {
        self.count += o.count;
        self.sum += o.sum;
        self.normals += o.normals;
        self.variance += o.variance;
        self.products.iter_mut().zip(&o.products).for_each(|(a, b)| *a += b);
    }

    /// Returns the direction of least extent, outwards, and the variance along it relative to that of the noise.
    fn plane(&self) -> Option<(DVec3, f64)> {
        if self.count < LEAST_POINTS || self.normals == DVec3::ZERO {
            return None;
        }
        let m = self.sum / self.count;
        let [xx, xy, xz, yy, yz, zz] = self.products.map(|v| v / self.count);
        let c = [
            [xx - m.x * m.x, xy - m.x * m.y, xz - m.x * m.z],
            [xy - m.x * m.y, yy - m.y * m.y, yz - m.y * m.z],
            [xz - m.x * m.z, yz - m.y * m.z, zz - m.z * m.z],
        ];
        let (values, vectors) = symmetric_eigen::<3>(c, 12, 1e-30);
        let least = (0..3).min_by(|&a, &b| values[a].total_cmp(&values[b]))?;
        let n = DVec3::new(vectors[0][least], vectors[1][least], vectors[2][least]);
        let n = if n.dot(self.normals) < 0.0 { -n } else { n };
        Some((n.normalize(), values[least].max(0.0) / (self.variance / self.count)))
    }
}

/// Cells by their integer coordinates, in a hash table of blocks: neighbouring pixels look up neighbouring cells, which are then
/// near each other in memory, too.
#[derive(Debug, Default)]
struct Cells {
    keys: Vec<[i32; 3]>,
    moments: Vec<Moments>,
    /// Indices of the cells of each block, + 1.
    blocks: Vec<[u32; BLOCK_CELLS]>,
    block_keys: Vec<[i32; 3]>,
    /// Open addressing: indices of blocks, + 1.
    slots: Vec<u32>,
}

/// Side of a block, cells, as a power of two.
const BLOCK_BITS: u32 = 2;
const BLOCK_CELLS: usize = 1 << (3 * BLOCK_BITS);

/// Returns the block of a cell, and its place there.
fn block_of(key: [i32; 3]) -> ([i32; 3], usize) {
    let [x, y, z] = key.map(|k| (k & ((1 << BLOCK_BITS) - 1)) as usize);
    (key.map(|k| k >> BLOCK_BITS), x | y << BLOCK_BITS | z << (2 * BLOCK_BITS))
}

impl Cells {
    /// Returns the slot of a block.
    fn slot(&self, block: [i32; 3]) -> usize {
        let h = block
            .iter()
            .fold(0u64, |h, &k| (h ^ k as u32 as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(29));
        let mask = self.slots.len() - 1;
        let mut at = (h ^ (h >> 32)) as usize & mask;
        loop {
            match self.slots[at] {
                0 => return at,
                i if self.block_keys[i as usize - 1] == block => return at,
                _ => at = (at + 1) & mask,
            }
        }
    }

    fn get(&self, key: [i32; 3]) -> Option<usize> {
        if self.slots.is_empty() {
            return None;
        }
        let (block, place) = block_of(key);
        let block = (self.slots[self.slot(block)] as usize).checked_sub(1)?;
        (self.blocks[block][place] as usize).checked_sub(1)
    }

    fn entry(&mut self, key: [i32; 3]) -> &mut Moments {
        if (self.blocks.len() + 1) * 2 > self.slots.len() {
            self.slots = vec![0; (self.slots.len() * 2).max(1024)];
            for i in 0..self.blocks.len() {
                let at = self.slot(self.block_keys[i]);
                self.slots[at] = i as u32 + 1;
            }
        }
        let (block, place) = block_of(key);
        let at = self.slot(block);
        if self.slots[at] == 0 {
            self.block_keys.push(block);
            self.blocks.push([0; BLOCK_CELLS]);
            self.slots[at] = self.blocks.len() as u32;
        }
        let cell = &mut self.blocks[self.slots[at] as usize - 1][place];
        if *cell == 0 {
            self.keys.push(key);
            self.moments.push(Moments::default());
            *cell = self.keys.len() as u32;
        }
        &mut self.moments[*cell as usize - 1]
    }

    /// Returns the cells of twice the size.
    fn coarser(&self) -> Self {
        let mut coarse = Self::default();
        for (key, m) in self.keys.iter().zip(&self.moments) {
            coarse.entry(key.map(|k| k >> 1)).merge(m);
        }
        coarse
    }

    /// Returns the plane of the window of 3 × 3 × 3 cells around each cell.
    fn planes(&self) -> Vec<Option<(DVec3, f64)>> {
        let window = |key: &[i32; 3]| {
            let mut sum = Moments::default();
            for dz in -1..=1 {
                for dy in -1..=1 {
                    for dx in -1..=1 {
                        if let Some(i) = self.get([
                            key[0].saturating_add(dx),
                            key[1].saturating_add(dy),
                            key[2].saturating_add(dz),
                        ]) {
                            sum.merge(&self.moments[i]);
                        }
                    }
                }
            }
            sum.plane()
        };
        self.keys.par_iter().map(window).collect()
    }
}

/// Normals of the surface that all frames measured.
pub(crate) struct PlaneMap {
    center_w: DVec3,
    cell_m: f64,
    /// From the smallest cells to the largest.
    levels: Vec<Level>,
}

/// The cells of one size.
struct Level {
    cells: Cells,
    /// Normal of each cell in the world, from the largest flat window; `None` where no window is flat.
    flat_w: Vec<Option<DVec3>>,
}

impl PlaneMap {
    pub(crate) fn new(points: &[Vec<Point>], poses: &[DPose3], center_w: DVec3, cell_m: f64) -> Self {
        let mut cells = Cells::default();
        for (points, x) in points.iter().zip(poses) {
            for point in points.iter().filter(|p| p.n_c != DVec3::ZERO) {
                let p_w = x.transform_point(point.p_c);
                let p = p_w - center_w;
                let m = cells.entry(key_of(p, cell_m));
                m.count += 1.0;
                m.sum += p;
                m.normals += x.rotation * point.n_c;
                m.variance += point.sigma_m * point.sigma_m;
                let products = [p.x * p.x, p.x * p.y, p.x * p.z, p.y * p.y, p.y * p.z, p.z * p.z];
                m.products.iter_mut().zip(products).for_each(|(a, b)| *a += b);
            }
        }
        let mut levels = vec![cells];
        while levels.len() < LEVELS {
            levels.push(levels[levels.len() - 1].coarser());
        }
        let planes: Vec<_> = levels.iter().map(Cells::planes).collect();
        // Thickness in units of the noise: misaligned frames thicken all surfaces.
        let mut all: Vec<f64> = planes[0].iter().flatten().map(|p| p.1).collect();
        all.sort_by(f64::total_cmp);
        let typical = all.get(all.len() / 2).copied().unwrap_or(1.0);
        let flat_from = |first: usize, key: &[i32; 3]| {
            let mut found = None;
            for (l, (cells, planes)) in levels.iter().zip(&planes).enumerate().skip(first) {
                match cells.get(key.map(|k| k >> (l - first))).and_then(|i| planes[i]) {
                    Some((n, thickness)) if thickness <= FLAT * typical => found = Some(n),
                    _ => break,
                }
            }
            found
        };
        let flat_w: Vec<Vec<Option<DVec3>>> =
            (0..LEVELS).map(|l| levels[l].keys.par_iter().map(|key| flat_from(l, key)).collect()).collect();
        let levels = levels.into_iter().zip(flat_w).map(|(cells, flat_w)| Level { cells, flat_w });
        Self { center_w, cell_m, levels: levels.collect() }
    }

    /// Returns the normal in a cell of the smallest size, and whether its surroundings are flat. `None` if no cell with points
    /// tells it.
    fn normal_w(&self, key: [i32; 3]) -> Option<(DVec3, bool)> {
        // Points of a frame lie further apart where the surface is near: a larger cell then tells what a small one cannot.
        for (l, level) in self.levels.iter().enumerate() {
            let Some(i) = level.cells.get(key.map(|k| k >> l)) else { continue };
            let mean = || level.cells.moments[i].normals.try_normalize().map(|n| (n, false));
            return level.flat_w[i].map(|n| (n, true)).or_else(|| if l == 0 { mean() } else { None });
        }
        None
    }

    /// Returns the directions of a frame: those of the map, and the frame's own where the map has none.
    pub(crate) fn directions(&self, view: DirectedFrame<'_>, x_wc: &DPose3) -> Vec<Direction> {
        let k = &view.intrinsics;
        let back = x_wc.rotation.inverse();
        let of = |(measured, own): (&Option<usize>, &Direction)| {
            let Some(i) = *measured else { return Direction::default() };
            let z = f64::from(view.frame.depth[i].z);
            let p = pixel_point(k, (i % k.width) as i64, (i / k.width) as i64, z);
            let key = key_of(x_wc.transform_point(p) - self.center_w, self.cell_m);
            let Some((n_w, is_flat)) = self.normal_w(key) else { return own.not_flat() };
            let n = back * n_w;
            Direction::new(if n.dot(p) < 0.0 { n } else { DVec3::ZERO }, is_flat)
        };
        view.frame.blocks.measured.iter().zip(&view.frame.directions).map(of).collect()
    }
}

/// Returns the cell of a point, relative to the centre.
fn key_of(p: DVec3, cell_m: f64) -> [i32; 3] {
    (p / cell_m).floor().to_array().map(|v| v as i32)
}
