//! Structural similarity (Wang et al. 2004) and its gradient. The window is an 11×11 Gaussian with σ = 1.5, with zeros
//! beyond the image as in Kerbl et al. 2023. Convolutions are separable: first down the columns of four rows at a time,
//! so that each pixel read serves four rows, then along each row. Squares and products are formed on the way.

use super::lanes::{Chunk, Lanes, WIDTH, by_simd};
use super::planes::{Aligned, MARGIN, PaddedPlanes, RADIUS, RowLayout, TAPS};
use super::tile::BAND_ROWS;

/// Stabiliser of SSIM's means for values in 0..1.
pub const C1: f64 = 0.01 * 0.01;
/// Stabiliser of SSIM's variances for values in 0..1.
pub const C2: f64 = 0.03 * 0.03;

/// Rows that are convolved together.
const ROWS: usize = 4;

/// The window's weights along one axis.
pub fn window() -> [f64; TAPS] {
    let weight = |i: usize| (-((i as f64 - RADIUS as f64) / 1.5).powi(2) / 2.0).exp();
    let sum: f64 = (0..TAPS).map(weight).sum();
    std::array::from_fn(|i| weight(i) / sum)
}

/// Working rows of one thread: [`ROWS`] rows of up to four images.
#[derive(Default)]
pub(super) struct SsimScratch {
    images: [Aligned; 4],
}

#[inline(always)]
fn chunk(row: &[f32], x: usize) -> &Chunk {
    row[x..].first_chunk().expect("rows are whole chunks")
}

#[inline(always)]
fn row_of(image: &Aligned, row: usize, stride: usize) -> &[f32] {
    &image.get()[row * stride..][..stride]
}

/// Operand of a convolution.
#[derive(Clone, Copy)]
enum SsimOperand {
    /// The first image.
    First,
    /// The second image.
    Second,
    /// The sum of their squares.
    Squares,
    /// Their product.
    Product,
}

/// Applies the window down the columns, for [`ROWS`] rows from row `first` on. Rows beyond `planes` are zero.
#[inline(always)]
fn down<L: Lanes>(
    image: SsimOperand,
    (a, a_plane): (&PaddedPlanes, usize),
    (b, b_plane): (&PaddedPlanes, usize),
    first: usize,
    weights: &[f32; TAPS],
    out: &mut Aligned,
) {
    let stride = a.stride();
    out.resize(ROWS * stride);
    let out = out.get_mut();
    let a: [&[f32]; ROWS + TAPS - 1] = std::array::from_fn(|j| a.row_above(first + j, a_plane));
    let b: [&[f32]; ROWS + TAPS - 1] = std::array::from_fn(|j| b.row_above(first + j, b_plane));
    for x in (0..stride).step_by(WIDTH) {
        let mut sums = [L::splat(0.0); ROWS];
        for j in 0..ROWS + TAPS - 1 {
            let value = match image {
                SsimOperand::First => L::load(chunk(a[j], x)),
                SsimOperand::Second => L::load(chunk(b[j], x)),
                SsimOperand::Squares => {
                    let (a, b) = (L::load(chunk(a[j], x)), L::load(chunk(b[j], x)));
                    a.mul_add(a, b * b)
                }
                SsimOperand::Product => L::load(chunk(a[j], x)) * L::load(chunk(b[j], x)),
            };
            for (k, sum) in sums.iter_mut().enumerate() {
                if j >= k && j - k < TAPS {
                    *sum = value.mul_add(L::splat(weights[j - k]), *sum);
                }
            }
        }
        for (k, sum) in sums.into_iter().enumerate() {
            sum.store(out[k * stride + x..].first_chunk_mut().expect("rows are whole chunks"));
        }
    }
}

/// Applies the window along a row, for the sixteen pixels from column `x` of the image.
#[inline(always)]
fn along<L: Lanes>(row: &[f32], weights: &[f32; TAPS], x: usize) -> L {
    let near = &row[MARGIN + x - RADIUS..][..WIDTH + 2 * RADIUS];
    // Two dependency chains run in parallel.
    let mut even = L::load(chunk(near, 0)) * L::splat(weights[0]);
    let mut odd = L::load(chunk(near, 1)) * L::splat(weights[1]);
    for j in (2..TAPS - 1).step_by(2) {
        even = L::load(chunk(near, j)).mul_add(L::splat(weights[j]), even);
        odd = L::load(chunk(near, j + 1)).mul_add(L::splat(weights[j + 1]), odd);
    }
    even = L::load(chunk(near, TAPS - 1)).mul_add(L::splat(weights[TAPS - 1]), even);
    even + odd
}

/// Planes of each colour in the derivatives buffer: of the mean of x, of the mean of x², of the mean of x·y.
pub(super) const DERIVATIVES: usize = 3;

/// Σ SSIM over the rows of a band from row `first` on and its derivatives, scaled by `scale`, into `band`.
#[inline(always)]
fn similarity<L: Lanes>(
    rendered: &PaddedPlanes,
    observed: &PaddedPlanes,
    first: usize,
    size: (usize, usize),
    scale: f32,
    layout: RowLayout,
    band: &mut [f32],
    scratch: &mut SsimScratch,
) -> f64 {
    let weights = window().map(|w| w as f32);
    let (one, two) = (L::splat(1.0), L::splat(2.0));
    let (c1, c2) = (L::splat(C1 as f32), L::splat(C2 as f32));
    let stride = rendered.stride();
    let mut total = 0.0;
    let rows = BAND_ROWS.min(size.1.saturating_sub(first));
    for four in (0..rows).step_by(ROWS) {
        for color in 0..3 {
            let images = (&mut scratch.images, (rendered, color), (observed, color));
            let ([xs, ys, squares, products], a, b) = images;
            down::<L>(SsimOperand::First, a, b, first + four, &weights, xs);
            down::<L>(SsimOperand::Second, a, b, first + four, &weights, ys);
            down::<L>(SsimOperand::Squares, a, b, first + four, &weights, squares);
            down::<L>(SsimOperand::Product, a, b, first + four, &weights, products);
            for row in four..rows.min(four + ROWS) {
                let of = |image| row_of(image, row - four, stride);
                let (xs, ys, squares, products) = (of(xs), of(ys), of(squares), of(products));
                let mut sum = L::splat(0.0);
                for x in (0..size.0).step_by(WIDTH) {
                    let ux = along::<L>(xs, &weights, x);
                    let uy = along::<L>(ys, &weights, x);
                    let (uxx, uxy, uyy) = (ux * ux, ux * uy, uy * uy);
                    let variance = along::<L>(squares, &weights, x) - uxx - uyy;
                    let covariance = along::<L>(products, &weights, x) - uxy;
                    let (a1, a2) = (two.mul_add(uxy, c1), two.mul_add(covariance, c2));
                    // The sum of variances is never negative, except for rounding.
                    let (b1, b2) = (uxx + uyy + c1, variance.max(L::splat(0.0)) + c2);
                    let (by_b1, by_b2) = (one / b1, one / b2);
                    let inverse = by_b1 * by_b2;
                    // Pixels beyond the image's right edge count neither in the sum nor in the gradient.
                    let inside = inside::<L>(size.0 - x);
                    let s = (a1 * a2 * inverse).keep(inside);
                    sum = sum + s;
                    let scale = L::splat(scale).keep(inside);
                    let d_square = (s * by_b2).negated();
                    let d_product = two * a1 * inverse;
                    let d_mean =
                        two * uy * a2 * inverse - two * ux * s * by_b1 - d_product * uy - two * ux * d_square;
                    (d_mean * scale).store(layout.chunk_mut(band, row, DERIVATIVES * color, x));
                    (d_square * scale).store(layout.chunk_mut(band, row, DERIVATIVES * color + 1, x));
                    (d_product * scale).store(layout.chunk_mut(band, row, DERIVATIVES * color + 2, x));
                }
                total += f64::from(sum.sum());
            }
        }
    }
    total
}

/// Mask of the first `columns` lanes.
#[inline(always)]
fn inside<L: Lanes>(columns: usize) -> L::Mask {
    L::mask(if columns < WIDTH { (1 << columns) - 1 } else { u16::MAX })
}

/// ∂(scaled Σ SSIM)/∂x of the rows of a band from row `first` on, one image per colour, into `band`.
#[inline(always)]
fn similarity_gradient<L: Lanes>(
    rendered: &PaddedPlanes,
    observed: &PaddedPlanes,
    derivatives: &PaddedPlanes,
    first: usize,
    size: (usize, usize),
    layout: RowLayout,
    band: &mut [f32],
    scratch: &mut SsimScratch,
) {
    let weights = window().map(|w| w as f32);
    let two = L::splat(2.0);
    let stride = derivatives.stride();
    let rows = BAND_ROWS.min(size.1.saturating_sub(first));
    for four in (0..rows).step_by(ROWS) {
        for color in 0..3 {
            let [means, squares, products, _] = &mut scratch.images;
            for (k, out) in [&mut *means, &mut *squares, &mut *products].into_iter().enumerate() {
                let plane = (derivatives, DERIVATIVES * color + k);
                down::<L>(SsimOperand::First, plane, plane, first + four, &weights, out);
            }
            for row in four..rows.min(four + ROWS) {
                let of = |image| row_of(image, row - four, stride);
                let (means, squares, products) = (of(means), of(squares), of(products));
                let (xs, ys) = (rendered.row(first + row, color), observed.row(first + row, color));
                for x in (0..size.0).step_by(WIDTH) {
                    let (vx, vy) = (L::load(chunk(xs, MARGIN + x)), L::load(chunk(ys, MARGIN + x)));
                    let square = along::<L>(squares, &weights, x);
                    let product = along::<L>(products, &weights, x);
                    let g = (two * vx).mul_add(square, along::<L>(means, &weights, x));
                    vy.mul_add(product, g).store(layout.chunk_mut(band, row, color, x));
                }
            }
        }
    }
}

by_simd! {
    /// The sum of SSIM over a band of rows and its derivatives with respect to the window's moments.
    fn ssim_band = similarity(
        rendered: &PaddedPlanes, observed: &PaddedPlanes, first: usize, size: (usize, usize), scale: f32,
        layout: RowLayout, band: &mut [f32], scratch: &mut SsimScratch,
    ) -> f64
}

by_simd! {
    /// The gradient of the scaled sum of SSIM over a band of rows.
    fn ssim_gradient_band = similarity_gradient(
        rendered: &PaddedPlanes, observed: &PaddedPlanes, derivatives: &PaddedPlanes, first: usize,
        size: (usize, usize), layout: RowLayout, band: &mut [f32], scratch: &mut SsimScratch,
    )
}
