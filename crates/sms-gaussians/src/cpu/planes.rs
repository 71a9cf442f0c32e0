//! Images stored row by row with zero margins, for the window of SSIM.

use super::lanes::{Chunk, WIDTH};
use super::tile::TILE;

/// Half width of SSIM's window.
pub const RADIUS: usize = 5;
/// Taps of the window along one axis.
pub(super) const TAPS: usize = 2 * RADIUS + 1;
/// Zeros left and right of every row: a whole vector, so that rows stay aligned.
pub(super) const MARGIN: usize = WIDTH;

/// Memory aligned to a cache line.
#[derive(Default)]
pub(super) struct Aligned {
    start: usize,
    data: Vec<f32>,
}

impl Aligned {
    /// Resizes the buffer; the contents become zero if the length changes, and remain otherwise.
    pub(super) fn resize(&mut self, length: usize) {
        if self.data.len() != length + WIDTH {
            self.data.clear();
            self.data.resize(length + WIDTH, 0.0);
            self.start = self.data.as_ptr().align_offset(WIDTH * size_of::<f32>()).min(WIDTH);
        }
    }

    pub(super) fn get(&self) -> &[f32] {
        &self.data[self.start..self.data.len() - (WIDTH - self.start)]
    }

    pub(super) fn get_mut(&mut self) -> &mut [f32] {
        let end = self.data.len() - (WIDTH - self.start);
        &mut self.data[self.start..end]
    }
}

/// Images of one size, interleaved row by row, with zeros around.
#[derive(Default)]
pub(super) struct PaddedPlanes {
    layout: RowLayout,
    rows: usize,
    data: Aligned,
}

impl PaddedPlanes {
    /// Resizes to `planes` images of `columns × rows` pixels; contents are only cleared when the size changes.
    pub(super) fn resize(&mut self, planes: usize, columns: usize, rows: usize) {
        let layout = RowLayout::new(planes, columns);
        if (layout, rows) != (self.layout, self.rows) {
            (self.layout, self.rows) = (layout, rows);
            // Another shape may have the same length.
            self.data = Aligned::default();
            self.data.resize(layout.row_len() * (rows + 2 * RADIUS));
        }
    }

    /// Returns the layout of the image's rows, the rows, and the length of a band of `rows` of them.
    pub(super) fn inside_mut(&mut self, rows: usize) -> (RowLayout, &mut [f32], usize) {
        let length = self.layout.row_len();
        let inside = RADIUS * length..(RADIUS + self.rows) * length;
        (self.layout, &mut self.data.get_mut()[inside], (rows * length).max(1))
    }

    /// Length of a row of one image with its margins.
    pub(super) fn stride(&self) -> usize {
        self.layout.stride
    }

    /// Row `y − RADIUS` of one image with its margins; rows beyond the image are zero.
    #[inline(always)]
    pub(super) fn row_above(&self, y: usize, plane: usize) -> &[f32] {
        let first = y * self.layout.row_len() + plane * self.layout.stride;
        &self.data.get()[first..first + self.layout.stride]
    }

    /// Row `y` of one image with its margins.
    #[inline(always)]
    pub(super) fn row(&self, y: usize, plane: usize) -> &[f32] {
        self.row_above(y + RADIUS, plane)
    }

    /// Row `y` of one image from its first pixel on.
    pub(super) fn row_mut(&mut self, y: usize, plane: usize) -> &mut [f32] {
        let first = (y + RADIUS) * self.layout.row_len() + plane * self.layout.stride;
        &mut self.data.get_mut()[first + MARGIN..first + self.layout.stride]
    }

    /// A patch of one image: two rows of eight pixels from pixel (x, y) on.
    #[inline(always)]
    pub(super) fn patch(&self, (x, y): (usize, usize), plane: usize) -> Chunk {
        let eight = |y: usize| &self.row(y, plane)[MARGIN + x..MARGIN + x + TILE];
        join(eight(y), eight(y + 1))
    }
}

#[inline(always)]
fn join(first: &[f32], second: &[f32]) -> Chunk {
    let mut chunk = [0.0; WIDTH];
    chunk[..TILE].copy_from_slice(first);
    chunk[TILE..].copy_from_slice(second);
    chunk
}

/// Layout of the rows of several images.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct RowLayout {
    planes: usize,
    stride: usize,
}

impl RowLayout {
    /// Rows of `columns` pixels and margins.
    pub(super) fn new(planes: usize, columns: usize) -> Self {
        Self { planes, stride: columns.next_multiple_of(WIDTH) + 2 * MARGIN }
    }

    /// From one row of pixels to the next.
    pub(super) fn row_len(self) -> usize {
        self.planes * self.stride
    }

    #[inline(always)]
    fn at(self, y: usize, plane: usize, x: usize) -> usize {
        (y * self.planes + plane) * self.stride + MARGIN + x
    }

    /// Returns sixteen pixels from column `x` (a multiple of sixteen) of row `y` of a band.
    #[inline(always)]
    pub(super) fn chunk_mut(self, band: &mut [f32], y: usize, plane: usize, x: usize) -> &mut Chunk {
        band[self.at(y, plane, x)..].first_chunk_mut().expect("margins are whole chunks")
    }

    /// A patch: two rows of eight pixels from pixel (x, y) of a band on.
    #[inline(always)]
    pub(super) fn patch(self, band: &[f32], (x, y): (usize, usize), plane: usize) -> Chunk {
        let eight = |y: usize| &band[self.at(y, plane, x)..][..TILE];
        join(eight(y), eight(y + 1))
    }

    /// Writes a patch.
    #[inline(always)]
    pub(super) fn set_patch(self, band: &mut [f32], (x, y): (usize, usize), plane: usize, patch: &Chunk) {
        band[self.at(y, plane, x)..][..TILE].copy_from_slice(&patch[..TILE]);
        band[self.at(y + 1, plane, x)..][..TILE].copy_from_slice(&patch[TILE..]);
    }
}
