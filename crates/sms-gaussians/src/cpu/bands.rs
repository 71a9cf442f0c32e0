//! Bands of tile rows. Each band has its own splats, lists per patch, and gradient buffer. Bands run in parallel
//! without sharing data and are added up in a fixed order, independent of the number of threads.
//!
//! The splats of a band are in the order of their Gaussians, so that Gaussians and gradients are accessed sequentially.
//! Only the lists are in depth order.

use super::lanes::{Lanes, NONE, WIDTH, array, by_simd};
use super::perceptron;
use super::planes::Aligned;
use super::prefetch::prefetch;
use super::project::{CameraView, Outline, Projected};
use super::ssim::SsimScratch;
use super::target::TileGrid;
use super::tile::{BAND_ROWS, BAND_TILES, PATCH_ROWS, PATCHES, PatchGradient, Splat, SplatGradient, TILE};
use super::times::StepTimes;
use crate::parameters::Row;

/// Rows of patches in a band.
const BAND_PATCHES: usize = BAND_TILES * PATCHES;

/// Bands that a Gaussian may touch, `first..end`; empty if it is invisible.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Span {
    pub(super) first: u16,
    pub(super) end: u16,
}

impl Span {
    /// `first + 2¹⁶·end`.
    pub(super) fn unpack(packed: u32) -> Self {
        Self { first: packed as u16, end: (packed >> 16) as u16 }
    }

    fn bands(self) -> std::ops::Range<usize> {
        usize::from(self.first)..usize::from(self.end)
    }
}

/// Positions of each Gaussian's splats in the bands that it touches.
#[derive(Default)]
pub(super) struct Slots {
    pub(super) spans: Vec<Span>,
    /// Index of each Gaussian's first entry in `positions`, and the total number of entries.
    first: Vec<u32>,
    /// Position in the band.
    positions: Vec<u32>,
    /// Gaussians of each band in order.
    members: Vec<Vec<u32>>,
}

impl Slots {
    /// Assigns every Gaussian its positions in the bands of its span.
    pub(super) fn assign(&mut self, bands: usize) {
        self.members.resize_with(bands, Vec::new);
        self.members.iter_mut().for_each(Vec::clear);
        self.first.clear();
        self.positions.clear();
        for (gaussian, span) in self.spans.iter().enumerate() {
            self.first.push(self.positions.len() as u32);
            for band in span.bands() {
                let members = &mut self.members[band];
                self.positions.push(members.len() as u32);
                members.push(gaussian as u32);
            }
        }
    }

    /// Gaussians that may touch a band, in order.
    pub(super) fn members(&self, band: usize) -> &[u32] {
        &self.members[band]
    }

    /// `(band, position)` of each splat of a Gaussian, in the order of bands.
    #[inline(always)]
    pub(super) fn of(&self, gaussian: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        let bands = self.spans[gaussian].bands();
        let positions = &self.positions[self.first[gaussian] as usize..];
        bands.zip(positions).map(|(band, position)| (band, *position as usize))
    }
}

/// A band's part of the loss: sums over its pixels.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct BandSums {
    pub(super) color: f64,
    pub(super) ssim: f64,
    pub(super) depth: f64,
    pub(super) normal: f64,
    pub(super) segmentation: f64,
}

pub(super) struct Band {
    /// Splats that may touch the band, in the order of their Gaussians.
    pub(super) splats: Vec<Splat>,
    /// Whether each splat reached a pixel.
    pub(super) reached: Vec<bool>,
    pub(super) gradients: Vec<SplatGradient>,
    pub(super) perceptron: perceptron::PerceptronScratch,
    pub(super) ssim: SsimScratch,
    pub(super) color_gradient: Aligned,
    pub(super) tile_gradient: [PatchGradient; PATCHES],
    pub(super) sums: BandSums,
    pub(super) times: StepTimes,
    /// Splats of each patch, nearest first.
    pub(super) lists: Lists,
    order: Vec<Key>,
    spare: Vec<Key>,
    /// Columns of tiles in which each splat may reach each row of patches, `first + 2¹⁶·end`.
    columns: Vec<[u32; BAND_PATCHES]>,
}

/// Lists of splats of the patches of a band, row of patches by row.
#[derive(Default)]
pub(super) struct Lists {
    /// Start of each list, and the end of the last.
    starts: Vec<u32>,
    /// Number of splats in each list that reach a pixel, after blending; they come first.
    used: Vec<u32>,
    splats: Vec<u32>,
}

impl Lists {
    /// Returns the candidates of a patch, and the counter of the used ones.
    pub(super) fn candidates(&mut self, patch: usize) -> (&mut [u32], &mut u32) {
        let (first, end) = (self.starts[patch] as usize, self.starts[patch + 1] as usize);
        (&mut self.splats[first..end], &mut self.used[patch])
    }

    /// The splats that reach a pixel of a blended patch.
    pub(super) fn used(&self, patch: usize) -> &[u32] {
        let first = self.starts[patch] as usize;
        &self.splats[first..first + self.used[patch] as usize]
    }
}

impl Band {
    pub(super) fn new(classes: usize) -> Self {
        Self {
            splats: Vec::new(),
            reached: Vec::new(),
            gradients: Vec::new(),
            perceptron: perceptron::PerceptronScratch::new(classes),
            ssim: SsimScratch::default(),
            color_gradient: Aligned::default(),
            tile_gradient: [PatchGradient::ZERO; PATCHES],
            sums: BandSums::default(),
            times: StepTimes::default(),
            lists: Lists::default(),
            order: Vec::new(),
            spare: Vec::new(),
            columns: Vec::new(),
        }
    }
}

/// Collects the splats of the band whose first row of pixels is `y` and lists them by patch in order of depth.
#[inline(always)]
fn bin<L: Lanes>(
    band: &mut Band,
    members: &[u32],
    projected: &[Projected],
    rows: &[Row],
    view: &CameraView,
    grid: &TileGrid,
    y: usize,
) {
    band.order.clear();
    band.splats.clear();
    band.columns.clear();
    band.reached.clear();
    band.reached.resize(members.len(), false);
    for (position, &gaussian) in members.iter().enumerate() {
        if let Some(&next) = members.get(position + AHEAD) {
            prefetch(&projected[next as usize]);
            prefetch(&rows[next as usize]);
        }
        let projected = &projected[gaussian as usize];
        band.splats.push(projected.splat(&rows[gaussian as usize], view));
        band.order.push(Key { depth: projected.depth_bits(), position: position as u32 });
    }
    for two in members.chunks(2) {
        let pair = [projected[two[0] as usize].outline(), projected[two[two.len() - 1] as usize].outline()];
        let columns = patch_columns::<L>(pair, y as f32, grid.columns as f32);
        let (columns, _) = columns.as_chunks::<BAND_PATCHES>();
        band.columns.extend_from_slice(&columns[..two.len()]);
    }
    sort(&mut band.order, &mut band.spare);

    // Count: +1 where a splat's columns start, −1 where they end, summed up along each row of patches.
    let patch_rows = (grid.rows * TILE).saturating_sub(y).min(BAND_ROWS) / PATCH_ROWS;
    let Lists { starts, used, splats } = &mut band.lists;
    let stride = grid.columns + 1;
    starts.clear();
    starts.resize(BAND_PATCHES * stride + 1, 0);
    for columns in &band.columns {
        for (row, packed) in columns.iter().enumerate() {
            let (first, end) = (*packed as u16, packed >> 16);
            let starts = &mut starts[row * stride..(row + 1) * stride];
            starts[usize::from(first)] = starts[usize::from(first)].wrapping_add(1);
            starts[end as usize] = starts[end as usize].wrapping_sub(1);
        }
    }
    let mut total = 0;
    for row in 0..patch_rows {
        let mut here = 0u32;
        for column in 0..grid.columns {
            here = here.wrapping_add(starts[row * stride + column]);
            // Closes the gaps of the longer rows in place: overwritten entries have been read.
            starts[row * grid.columns + column] = total;
            total += here;
        }
    }
    let patches = patch_rows * grid.columns;
    starts.truncate(patches);
    starts.push(total);
    // While the lists are filled, each end grows from the start of its list. Afterwards it is the start of the next
    // list.
    used.clear();
    used.extend_from_slice(&starts[..patches]);
    splats.clear();
    splats.resize(total as usize, 0);
    for key in &band.order {
        let columns = &band.columns[key.position as usize];
        for (row, packed) in columns[..patch_rows].iter().enumerate() {
            let (first, end) = ((packed & 0xFFFF) as usize, (packed >> 16) as usize);
            for end in &mut used[row * grid.columns..(row + 1) * grid.columns][first..end] {
                splats[*end as usize] = key.position;
                *end += 1;
            }
        }
    }
}

/// Distance of prefetching, in splats.
const AHEAD: usize = 8;

/// Returns the tile columns in which the ellipses of two splats meet the pixel centres of each row of patches, as
/// `first + 2¹⁶·end`, for the first splat and then for the second. The band starts at pixel row `y`. The range is
/// slightly too large.
#[inline(always)]
fn patch_columns<L: Lanes>(two: [Outline; 2], y: f32, columns: f32) -> [u32; WIDTH] {
    let [a, b] = two;
    let [mean_x, mean_y] = array!(2, |i| L::halves(a.mean[i], b.mean[i]));
    let [half_x, half_y] = array!(2, |i| L::halves(a.half[i], b.half[i]));
    let (slant, half_row) = (L::halves(a.slant, b.slant), L::halves(a.half_row, b.half_row));
    let by_half_y = L::splat(1.0) / half_y;
    // Vertical offset of the rightmost point.
    let row_of_right = slant * half_y * half_y / half_x;
    let (zero, one) = (L::splat(0.0), L::splat(1.0));
    // First and last row of pixel centres of each patch relative to the splat's centre.
    let low = L::load(&FIRST_ROWS) + L::splat(y) - mean_y;
    let high = low + L::splat(PATCH_ROWS as f32 - 1.0);
    let touched = L::both(half_y.ge(low), high.ge(half_y.negated()));
    // x = slant·dy ± half_row·√(1 − (dy/half_y)²) over the rows [low, high] is extreme at the extreme row of the
    // ellipse, or at the nearest end of the interval.
    let (low, high) = (low.max(half_y.negated()), high.min(half_y));
    let rows = [row_of_right.negated().max(low).min(high), row_of_right.max(low).min(high)];
    let widths = array!(2, |i| {
        let part = rows[i] * by_half_y;
        half_row * part.neg_mul_add(part, one).max(zero).sqrt()
    });
    let left = (slant * rows[0] - widths[0]).max(half_x.negated());
    let right = slant.mul_add(rows[1], widths[1]).min(half_x);
    let slack = half_x.mul_add(L::splat(1e-4), L::splat(0.01));
    // Column k holds the pixel centres from 8k + ½ to 8k + 7½.
    let ends = [mean_x + left - slack - L::splat(TILE as f32 - 0.5), mean_x + right + slack - L::splat(0.5)];
    let [first, end] = array!(2, |i| {
        let column = ends[i].mul_add(L::splat(1.0 / TILE as f32), one);
        column.max(zero).min(L::splat(columns)).truncate()
    });
    let some = L::both(touched, end.gt(first));
    L::pack(first.keep(some), end.keep(some))
}

/// First row of pixel centres of the patches of a band, for two splats.
const FIRST_ROWS: [f32; WIDTH] = {
    let mut rows = NONE;
    let mut i = 0;
    while i < WIDTH {
        rows[i] = (i % BAND_PATCHES * PATCH_ROWS) as f32 + 0.5;
        i += 1;
    }
    rows
};

const _: () = assert!(WIDTH == 2 * BAND_PATCHES);

by_simd! {
    /// Collects a band's splats and lists them by patch.
    fn bin_band = bin(
        band: &mut Band, members: &[u32], projected: &[Projected], rows: &[Row], view: &CameraView,
        grid: &TileGrid, y: usize,
    )
}

/// A splat to be sorted.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Key {
    depth: u32,
    position: u32,
}

/// Sorts by depth, ties in the order given: counting sort byte by byte.
fn sort(keys: &mut Vec<Key>, spare: &mut Vec<Key>) {
    let mut counts = [[0u32; 256]; 4];
    for key in &*keys {
        for (byte, counts) in key.depth.to_le_bytes().into_iter().zip(&mut counts) {
            counts[usize::from(byte)] += 1;
        }
    }
    spare.resize(keys.len(), Key::default());
    for (digit, counts) in counts.iter_mut().enumerate() {
        let byte = |key: &Key| usize::from(key.depth.to_le_bytes()[digit]);
        // All bytes are equal, as usual for the highest byte: nothing to do.
        if keys.first().is_none_or(|key| counts[byte(key)] as usize == keys.len()) {
            continue;
        }
        let mut start = 0;
        for count in counts.iter_mut() {
            start += *count;
            *count = start - *count;
        }
        for key in &*keys {
            let place = &mut counts[byte(key)];
            spare[*place as usize] = *key;
            *place += 1;
        }
        std::mem::swap(keys, spare);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn sorting_is_that_of_the_standard_library(depths in prop::collection::vec(0.02f32..50.0, 0..500)) {
            let mut keys: Vec<Key> = depths.iter().enumerate()
                .map(|(i, z)| Key { depth: (z * 8.0).round().to_bits(), position: i as u32 })
                .collect();
            let mut expected = keys.clone();
            expected.sort_by_key(|key| key.depth);
            sort(&mut keys, &mut Vec::new());
            prop_assert_eq!(keys, expected);
        }
    }
}
