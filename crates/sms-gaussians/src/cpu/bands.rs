//! Bands of tile rows: each has its own splats in order of depth, lists per tile, and gradient buffer, so that bands
//! run in parallel without sharing and are added up in a fixed order whatever the number of threads.

use super::perceptron;
use super::project::Projected;
use super::raster::{Splat, SplatGradient, TILE};
use super::ssim::SsimScratch;
use super::target::Grid;
use std::sync::atomic::{AtomicU32, Ordering};

/// Rows of tiles in a band. A constant, because it shapes the order of sums.
pub(super) const BAND_TILES: usize = 2;
/// Rows of pixels in a band.
pub(super) const BAND_ROWS: usize = BAND_TILES * TILE;

/// Bands that a Gaussian may touch, `first..end`; empty where it is not seen.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Span {
    pub(super) first: u16,
    pub(super) end: u16,
}

impl Span {
    /// The bands between the top and bottom of a splat's box.
    pub(super) fn of(projected: &Projected, bands: usize) -> Self {
        let (y, half) = (projected.splat.mean[1], projected.splat.extent_y);
        // Conversion to an integer rounds towards zero, which after the clamp is down.
        let band = |y: f32| (y / BAND_ROWS as f32).clamp(0.0, bands as f32) as u16;
        Self { first: band(y - half), end: band(y + half + BAND_ROWS as f32) }
    }

    pub(super) fn len(self) -> usize {
        usize::from(self.end.saturating_sub(self.first))
    }
}

/// Where each Gaussian's splat lies in the bands that it touches.
#[derive(Default)]
pub(super) struct Slots {
    pub(super) spans: Vec<Span>,
    first: Vec<u32>,
    /// Position in the band plus one, 0 for none. Each entry is written by one band only.
    slots: Vec<AtomicU32>,
}

impl Slots {
    /// Makes room for what `spans` asks.
    pub(super) fn prepare(&mut self) {
        self.first.clear();
        let mut total = 0;
        for span in &self.spans {
            self.first.push(total);
            total += span.len() as u32;
        }
        self.slots.resize_with(total as usize, AtomicU32::default);
        self.slots.iter_mut().for_each(|s| *s.get_mut() = 0);
    }

    fn set(&self, gaussian: usize, band: usize, position: usize) {
        let entry = self.first[gaussian] as usize + band - usize::from(self.spans[gaussian].first);
        self.slots[entry].store(position as u32 + 1, Ordering::Relaxed);
    }

    /// `(band, position)` of each splat of a Gaussian, in the order of bands.
    pub(super) fn of(&self, gaussian: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        let (span, first) = (self.spans[gaussian], self.first[gaussian] as usize);
        (0..span.len()).filter_map(move |k| {
            let slot = self.slots[first + k].load(Ordering::Relaxed);
            (slot > 0).then(|| (usize::from(span.first) + k, slot as usize - 1))
        })
    }
}

/// CPU seconds spent in each part of a step, over all threads.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct StepTimes {
    /// Projection of all Gaussians.
    pub project: f64,
    /// Sorting and tile lists.
    pub bin: f64,
    /// Blending.
    pub blend: f64,
    /// SSIM and its gradient.
    pub ssim: f64,
    /// Colour, depth and normal terms.
    pub pixels: f64,
    /// Classifier and cross-entropy.
    pub segmentation: f64,
    /// Gradient of blending.
    pub unblend: f64,
    /// Sums over bands, gradient of projection, regularisers.
    pub unproject: f64,
    /// Optimiser.
    pub adam: f64,
}

impl StepTimes {
    /// Adds another.
    pub fn add(&mut self, other: &Self) {
        self.project += other.project;
        self.bin += other.bin;
        self.blend += other.blend;
        self.ssim += other.ssim;
        self.pixels += other.pixels;
        self.segmentation += other.segmentation;
        self.unblend += other.unblend;
        self.unproject += other.unproject;
        self.adam += other.adam;
    }

    /// What has been added since `earlier`.
    pub fn since(&self, earlier: &Self) -> Self {
        Self {
            project: self.project - earlier.project,
            bin: self.bin - earlier.bin,
            blend: self.blend - earlier.blend,
            ssim: self.ssim - earlier.ssim,
            pixels: self.pixels - earlier.pixels,
            segmentation: self.segmentation - earlier.segmentation,
            unblend: self.unblend - earlier.unblend,
            unproject: self.unproject - earlier.unproject,
            adam: self.adam - earlier.adam,
        }
    }

    /// All parts.
    pub fn total(&self) -> f64 {
        let forward = self.project + self.bin + self.blend;
        forward + self.ssim + self.pixels + self.segmentation + self.unblend + self.unproject + self.adam
    }
}

/// What one band contributes to the loss: sums over its pixels.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct BandSums {
    pub(super) color: f64,
    pub(super) ssim: f64,
    pub(super) depth: f64,
    pub(super) normal: f64,
    pub(super) segmentation: f64,
}

/// One band.
pub(super) struct Band {
    /// Splats that touch the band, nearest first.
    pub(super) splats: Vec<Splat>,
    /// Whether each reached a pixel.
    pub(super) reached: Vec<bool>,
    pub(super) gradients: Vec<SplatGradient>,
    pub(super) perceptron: perceptron::Scratch,
    pub(super) ssim: SsimScratch,
    pub(super) color_gradient: Vec<f32>,
    pub(super) sums: BandSums,
    pub(super) times: StepTimes,
    /// Start of each tile's list, and the end of the last.
    starts: Vec<u32>,
    lists: Vec<u32>,
    order: Vec<u64>,
    candidates: Vec<Projected>,
    hits: Vec<(u32, u32)>,
}

impl Band {
    pub(super) fn new(classes: usize) -> Self {
        Self {
            splats: Vec::new(),
            reached: Vec::new(),
            gradients: Vec::new(),
            perceptron: perceptron::Scratch::new(classes),
            ssim: SsimScratch::default(),
            color_gradient: Vec::new(),
            sums: BandSums::default(),
            times: StepTimes::default(),
            starts: Vec::new(),
            lists: Vec::new(),
            order: Vec::new(),
            candidates: Vec::new(),
            hits: Vec::new(),
        }
    }

    /// The splats of the band's `tile`-th tile, nearest first.
    pub(super) fn list(&self, tile: usize) -> &[u32] {
        &self.lists[self.starts[tile] as usize..self.starts[tile + 1] as usize]
    }

    /// Collects the band's splats in order of depth and lists them by tile.
    pub(super) fn bin(&mut self, index: usize, grid: &Grid, projected: &[Projected], slots: &Slots) {
        self.order.clear();
        self.candidates.clear();
        for (i, span) in slots.spans.iter().enumerate() {
            if usize::from(span.first) <= index && index < usize::from(span.end) {
                // Depths are positive, so their bits sort like the numbers; ties by index. The copies are few enough
                // for the cache, where reading all of `projected` in order of depth would miss it every time.
                let candidate = self.candidates.len() as u64;
                self.order.push(u64::from(projected[i].z.to_bits()) << 32 | candidate);
                self.candidates.push(projected[i]);
            }
        }
        self.order.sort_unstable();

        let first_row = index * BAND_TILES;
        let rows = BAND_TILES.min(grid.rows - first_row);
        self.splats.clear();
        self.hits.clear();
        self.starts.clear();
        self.starts.resize(rows * grid.columns + 1, 0);
        for &key in &self.order {
            let candidate = &self.candidates[key as u32 as usize];
            let position = self.splats.len() as u32;
            let before = self.hits.len();
            for row in 0..rows {
                let y = ((first_row + row) * TILE) as f32;
                let Some((first, end)) = tile_columns(candidate, y, grid.columns) else {
                    continue;
                };
                for column in first..end {
                    let tile = row * grid.columns + column;
                    self.starts[tile + 1] += 1;
                    self.hits.push((tile as u32, position));
                }
            }
            if self.hits.len() > before {
                slots.set(candidate.gaussian as usize, index, self.splats.len());
                self.splats.push(candidate.splat);
            }
        }
        for tile in 1..self.starts.len() {
            self.starts[tile] += self.starts[tile - 1];
        }
        self.lists.clear();
        self.lists.resize(self.hits.len(), 0);
        // Filling from the back leaves `starts` as it was and keeps the order of depth.
        for &(tile, position) in self.hits.iter().rev() {
            let end = &mut self.starts[tile as usize + 1];
            *end -= 1;
            self.lists[*end as usize] = position;
        }
        // Each end has moved to its tile's start: shift back by one tile.
        self.starts.remove(0);
        self.starts.push(self.lists.len() as u32);
        self.reached.clear();
        self.reached.resize(self.splats.len(), false);
    }
}

/// Tile columns in which a splat's ellipse of alpha ≥ 1/255 meets the pixel centres of the tile row that starts at
/// pixel row `y`; slightly generous.
fn tile_columns(candidate: &Projected, y: f32, columns: usize) -> Option<(usize, usize)> {
    let splat = &candidate.splat;
    let ([a, b, c], half_x, half_y) = (splat.conic, candidate.extent_x, splat.extent_y);
    let (low, high) = (y + 0.5 - splat.mean[1], y + TILE as f32 - 0.5 - splat.mean[1]);
    if low > half_y || high < -half_y {
        return None;
    }
    // Over the rows [low, high], x = (−b·dy ± √(a·r − (ac − b²)·dy²))/a with r the reach is extreme at the
    // ellipse's own extreme row −b/c·(±half_x), or at the end of the interval nearest to it.
    let (low, high) = (low.max(-half_y), high.min(half_y));
    let edge = |dy: f32, sign: f32| {
        let root = (a * candidate.reach - candidate.determinant * dy * dy).max(0.0).sqrt();
        (-b * dy + sign * root) / a
    };
    let row_of_right = -b / c * half_x;
    let right = edge(row_of_right.clamp(low, high), 1.0).min(half_x);
    let left = edge((-row_of_right).clamp(low, high), -1.0).max(-half_x);
    let slack = 0.01 + 1e-4 * half_x;
    // Column k holds the pixel centres from 8k + ½ to 8k + 7½; conversion rounds down what the clamp leaves.
    let column = |x: f32| (x * (1.0 / TILE as f32) + 1.0).max(0.0) as usize;
    let first = column(splat.mean[0] + left - slack - (TILE as f32 - 0.5));
    let end = column(splat.mean[0] + right + slack - 0.5);
    let end = end.min(columns);
    (first < end).then_some((first, end))
}
