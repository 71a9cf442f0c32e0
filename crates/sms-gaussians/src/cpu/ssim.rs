//! Structural similarity (Wang et al. 2004) with an 11×11 Gaussian window, σ = 1.5, zeros beyond the image as in
//! Kerbl et al. 2023, and its gradient. Convolutions are separable: down the columns of one row, then along it.

use super::lanes::{Chunk, Lanes, WIDTH, by_simd};

/// Half width of the window.
pub const RADIUS: usize = 5;
const TAPS: usize = 2 * RADIUS + 1;
/// Zeros left and right of every row: a whole vector, so that rows stay aligned.
const MARGIN: usize = WIDTH;
/// Stabiliser of SSIM's means for values in 0..1.
pub const C1: f64 = 0.01 * 0.01;
/// Stabiliser of SSIM's variances for values in 0..1.
pub const C2: f64 = 0.03 * 0.03;

/// The window's weights along one axis.
pub(super) fn window() -> [f64; TAPS] {
    let weight = |i: usize| (-((i as f64 - RADIUS as f64) / 1.5).powi(2) / 2.0).exp();
    let sum: f64 = (0..TAPS).map(weight).sum();
    std::array::from_fn(|i| weight(i) / sum)
}

/// Images of one size, interleaved row by row, with zeros around.
#[derive(Default)]
pub(super) struct Planes {
    planes: usize,
    stride: usize,
    rows: usize,
    data: Vec<f32>,
}

impl Planes {
    /// Makes room for `planes` images of `columns × rows` pixels (`columns` a multiple of eight); contents are only
    /// cleared when the size changes.
    pub(super) fn resize(&mut self, planes: usize, columns: usize, rows: usize) {
        let stride = columns + 2 * MARGIN;
        if (planes, stride, rows) != (self.planes, self.stride, self.rows) {
            (self.planes, self.stride, self.rows) = (planes, stride, rows);
            self.data.clear();
            self.data.resize(planes * stride * (rows + 2 * RADIUS), 0.0);
        }
    }

    fn row_len(&self) -> usize {
        self.planes * self.stride
    }

    /// The rows of the image, how they are laid out, and the length of a band of `rows` of them.
    pub(super) fn inside_mut(&mut self, rows: usize) -> (RowLayout, &mut [f32], usize) {
        let layout = RowLayout { planes: self.planes, stride: self.stride };
        let (first, length) = (RADIUS * self.row_len(), self.rows * self.row_len());
        let band = (rows * self.row_len()).max(1);
        (layout, &mut self.data[first..first + length], band)
    }

    /// The eleven rows around row `y` of one image.
    #[inline(always)]
    fn around(&self, y: usize, plane: usize) -> [&[f32]; TAPS] {
        let at = |j: usize| {
            let first = (y + j) * self.row_len() + plane * self.stride;
            &self.data[first..first + self.stride]
        };
        [at(0), at(1), at(2), at(3), at(4), at(5), at(6), at(7), at(8), at(9), at(10)]
    }

    #[inline(always)]
    fn row(&self, y: usize, plane: usize) -> &[f32] {
        let first = (y + RADIUS) * self.row_len() + plane * self.stride;
        &self.data[first..first + self.stride]
    }
}

/// How a band of [`Planes`] is laid out.
#[derive(Clone, Copy)]
pub(super) struct RowLayout {
    planes: usize,
    stride: usize,
}

impl RowLayout {
    /// Eight pixels from column `x` (a multiple of eight) of row `y` of the band.
    #[inline(always)]
    pub(super) fn chunk_mut(self, band: &mut [f32], y: usize, plane: usize, x: usize) -> &mut Chunk {
        let first = (y * self.planes + plane) * self.stride + MARGIN + x;
        (&mut band[first..first + WIDTH]).try_into().expect("a slice of eight")
    }
}

/// Working rows of one thread.
#[derive(Default)]
pub(super) struct SsimScratch {
    rows: [Vec<f32>; 4],
}

#[inline(always)]
fn chunk(row: &[f32], x: usize) -> &Chunk {
    (&row[x..x + WIDTH]).try_into().expect("a slice of eight")
}

#[inline(always)]
fn down<L: Lanes>(rows: [&[f32]; TAPS], weights: &[f32; TAPS], out: &mut Vec<f32>) {
    out.resize(rows[0].len(), 0.0);
    let (chunks, _) = out.as_chunks_mut::<WIDTH>();
    for (i, to) in chunks.iter_mut().enumerate() {
        let mut sum = L::load(chunk(rows[0], i * WIDTH)) * L::splat(weights[0]);
        for j in 1..TAPS {
            sum = L::load(chunk(rows[j], i * WIDTH)).mul_add(L::splat(weights[j]), sum);
        }
        sum.store(to);
    }
}

/// The window along a row, for the eight pixels from column `x` of the image.
#[inline(always)]
fn along<L: Lanes>(row: &[f32], weights: &[f32; TAPS], x: usize) -> L {
    let first = MARGIN + x - RADIUS;
    let near: &[f32; WIDTH + 2 * RADIUS] =
        (&row[first..first + WIDTH + 2 * RADIUS]).try_into().expect("a slice of that length");
    let mut sum = L::load(chunk(near, 0)) * L::splat(weights[0]);
    for j in 1..TAPS {
        sum = L::load(chunk(near, j)).mul_add(L::splat(weights[j]), sum);
    }
    sum
}

/// Planes of each colour in the statistics buffer: x, y, x² + y², x·y, for rendered x and observed y.
pub(super) const STATISTICS: usize = 4;
/// Planes of each colour in the derivatives buffer: of the mean of x, of the mean of x², of the mean of x·y.
pub(super) const DERIVATIVES: usize = 3;

/// Σ SSIM over the rows `first..first + rows` and its derivatives, scaled by `scale`, into `band`.
#[inline(always)]
fn similarity<L: Lanes>(
    statistics: &Planes,
    first: usize,
    rows: usize,
    size: (usize, usize),
    scale: f32,
    layout: RowLayout,
    band: &mut [f32],
    scratch: &mut SsimScratch,
) -> f64 {
    let weights = window().map(|w| w as f32);
    let (one, two) = (L::splat(1.0), L::splat(2.0));
    let (c1, c2) = (L::splat(C1 as f32), L::splat(C2 as f32));
    let mut total = 0.0;
    for row in 0..rows.min(size.1.saturating_sub(first)) {
        for color in 0..3 {
            for k in 0..STATISTICS {
                down::<L>(
                    statistics.around(first + row, STATISTICS * color + k),
                    &weights,
                    &mut scratch.rows[k],
                );
            }
            let [xs, ys, squares, products] = &scratch.rows;
            let mut sum = L::splat(0.0);
            for x in (0..size.0).step_by(WIDTH) {
                let ux = along::<L>(xs, &weights, x);
                let uy = along::<L>(ys, &weights, x);
                let (uxx, uxy, uyy) = (ux * ux, ux * uy, uy * uy);
                let variance = along::<L>(squares, &weights, x) - uxx - uyy;
                let covariance = along::<L>(products, &weights, x) - uxy;
                let (a1, a2) = (two.mul_add(uxy, c1), two.mul_add(covariance, c2));
                // The sum of variances is never negative; rounding is.
                let (b1, b2) = (uxx + uyy + c1, variance.max(L::splat(0.0)) + c2);
                let inverse = one / (b1 * b2);
                // Pixels beyond the image's right edge count neither in the sum nor in the gradient.
                let inside = inside::<L>(size.0 - x);
                let s = (a1 * a2 * inverse).and(inside);
                sum = sum + s;
                let scale = L::splat(scale).and(inside);
                let d_square = L::splat(0.0) - s / b2;
                let d_product = two * a1 * inverse;
                let d_mean =
                    two * uy * a2 * inverse - two * ux * s / b1 - d_product * uy - two * ux * d_square;
                (d_mean * scale).store(layout.chunk_mut(band, row, DERIVATIVES * color, x));
                (d_square * scale).store(layout.chunk_mut(band, row, DERIVATIVES * color + 1, x));
                (d_product * scale).store(layout.chunk_mut(band, row, DERIVATIVES * color + 2, x));
            }
            total += f64::from(sum.sum());
        }
    }
    total
}

/// Mask of the first `columns` lanes.
#[inline(always)]
fn inside<L: Lanes>(columns: usize) -> L {
    const LANE: Chunk = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];
    L::splat(columns.min(WIDTH) as f32).gt(L::load(&LANE))
}

/// ∂(scaled Σ SSIM)/∂x of the rows `first..first + rows`, one image per colour, into `band`.
#[inline(always)]
fn similarity_gradient<L: Lanes>(
    statistics: &Planes,
    derivatives: &Planes,
    first: usize,
    rows: usize,
    size: (usize, usize),
    layout: RowLayout,
    band: &mut [f32],
    scratch: &mut SsimScratch,
) {
    let weights = window().map(|w| w as f32);
    let two = L::splat(2.0);
    for row in 0..rows.min(size.1.saturating_sub(first)) {
        for color in 0..3 {
            for k in 0..DERIVATIVES {
                down::<L>(
                    derivatives.around(first + row, DERIVATIVES * color + k),
                    &weights,
                    &mut scratch.rows[k],
                );
            }
            let [means, squares, products, _] = &scratch.rows;
            let xs = statistics.row(first + row, STATISTICS * color);
            let ys = statistics.row(first + row, STATISTICS * color + 1);
            for x in (0..size.0).step_by(WIDTH) {
                let (vx, vy) = (L::load(chunk(xs, MARGIN + x)), L::load(chunk(ys, MARGIN + x)));
                let square = along::<L>(squares, &weights, x);
                let product = along::<L>(products, &weights, x);
                let g = along::<L>(means, &weights, x) + two * vx * square + vy * product;
                g.store(layout.chunk_mut(band, row, color, x));
            }
        }
    }
}

by_simd! {
    /// The sum of SSIM over a band of rows and its derivatives with respect to the window's moments.
    fn ssim_band = similarity(
        statistics: &Planes, first: usize, rows: usize, size: (usize, usize), scale: f32, layout: RowLayout,
        band: &mut [f32], scratch: &mut SsimScratch,
    ) -> f64
}

by_simd! {
    /// The gradient of the scaled sum of SSIM over a band of rows.
    fn ssim_gradient_band = similarity_gradient(
        statistics: &Planes, derivatives: &Planes, first: usize, rows: usize, size: (usize, usize),
        layout: RowLayout, band: &mut [f32], scratch: &mut SsimScratch,
    )
}

/// Room for a band's colour gradient, laid out like a band of [`Planes`] with three images.
pub(super) fn gradient_layout(columns: usize) -> (RowLayout, usize) {
    let layout = RowLayout { planes: 3, stride: columns + 2 * MARGIN };
    (layout, layout.planes * layout.stride)
}
