//! Depth images that are coarser than the colour image, and filters over measured depth.

use rayon::prelude::*;
use sms_core::{DepthImage, Image, Intrinsics};

/// Returns the intrinsics of the measured depth image with this number of columns; those of `view` if it has no more.
pub(super) fn coarse_intrinsics(view: &Intrinsics, columns: usize) -> Intrinsics {
    if columns == 0 || columns >= view.width {
        return *view;
    }
    let rows = (view.height as f64 * columns as f64 / view.width as f64).round().max(1.0) as usize;
    view.scaled_to(columns, rows)
}

/// Samples an image at the centres of the pixels of another size with the same field of view.
pub(super) fn sampled<T: Copy>(image: &Image<T>, (width, height): (usize, usize)) -> Image<T> {
    let at = |i: usize, from: usize, to: usize| ((i as f64 + 0.5) * from as f64 / to as f64) as usize;
    let pixels = (0..width * height).map(|i| {
        let (x, y) = (at(i % width, image.width, width), at(i / width, image.height, height));
        image[(x.min(image.width - 1), y.min(image.height - 1))]
    });
    Image::from_vec(width, height, pixels.collect())
}

/// Resamples measured depth to a larger image with the same field of view, as programs do that register depth to colour:
/// inverse depth is interpolated within a surface, and the nearest pixel is taken at edges and holes.
pub(super) fn enlarged(depth: &DepthImage, (width, height): (usize, usize)) -> DepthImage {
    const RELATIVE_JUMP: f32 = 0.03;
    let (own_width, own_height) = depth.size();
    let mut out = Image::filled(width, height, 0.0f32);
    out.data.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        let v = (y as f64 + 0.5) * own_height as f64 / height as f64 - 0.5;
        for (x, pixel) in row.iter_mut().enumerate() {
            let u = (x as f64 + 0.5) * own_width as f64 / width as f64 - 0.5;
            let (i, j) = (u.floor().max(0.0) as usize, v.floor().max(0.0) as usize);
            let (i1, j1) = ((i + 1).min(own_width - 1), (j + 1).min(own_height - 1));
            let (fu, fv) = ((u - i as f64).clamp(0.0, 1.0) as f32, (v - j as f64).clamp(0.0, 1.0) as f32);
            let corners = [depth[(i, j)], depth[(i1, j)], depth[(i, j1)], depth[(i1, j1)]];
            let low = corners.iter().copied().fold(f32::INFINITY, f32::min);
            let high = corners.iter().copied().fold(0.0, f32::max);
            *pixel = if low > 0.0 && high < (1.0 + RELATIVE_JUMP) * low {
                let weights = [(1.0 - fu) * (1.0 - fv), fu * (1.0 - fv), (1.0 - fu) * fv, fu * fv];
                1.0 / corners.iter().zip(weights).map(|(z, w)| w / z).sum::<f32>()
            } else {
                corners[usize::from(fu >= 0.5) + 2 * usize::from(fv >= 0.5)]
            };
        }
    });
    out
}

/// Smooths measured depth by a Gaussian of this standard deviation; pixels without a measurement do not count and stay empty.
/// Edges are smoothed, too.
pub(super) fn smoothed(depth: &DepthImage, sigma_px: f64) -> DepthImage {
    let reach = (3.0 * sigma_px).ceil() as usize;
    let weights: Vec<f32> =
        (0..=reach).map(|d| (-0.5 * (d as f64 / sigma_px).powi(2)).exp() as f32).collect();
    let (width, height) = depth.size();
    // Weighted sums along the rows, then along the columns.
    let mut rows = Image::filled(width, height, [0.0f32; 2]);
    rows.data.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for (x, sums) in row.iter_mut().enumerate() {
            for u in x.saturating_sub(reach)..=(x + reach).min(width - 1) {
                let (z, w) = (depth[(u, y)], weights[u.abs_diff(x)]);
                if z > 0.0 {
                    *sums = [sums[0] + w * z, sums[1] + w];
                }
            }
        }
    });
    let mut out = Image::filled(width, height, 0.0f32);
    out.data.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.iter_mut().enumerate().filter(|(x, _)| depth[(*x, y)] > 0.0) {
            let (mut sum, mut weight) = (0.0, 0.0);
            for v in y.saturating_sub(reach)..=(y + reach).min(height - 1) {
                let w = weights[v.abs_diff(y)];
                let [z, count] = rows[(x, v)];
                sum += w * z;
                weight += w * count;
            }
            *pixel = sum / weight;
        }
    });
    out
}

/// Returns how far each measurement is to be believed, as ARKit states it: 0 low, 1 medium, 2 high. It is low without a
/// measurement. The rule is assumed (Apple publishes none): the spread of depth in a window of five by five pixels, relative to
/// depth, below 1 % and 3 %.
pub(super) fn confidence(depth: &DepthImage) -> Image<u16> {
    const LIMITS: [f64; 2] = [0.03, 0.01];
    let (width, height) = depth.size();
    let mut out = Image::filled(width, height, 0u16);
    out.data.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.iter_mut().enumerate().filter(|(x, _)| depth[(*x, y)] > 0.0) {
            let (mut n, mut sum, mut squares) = (0.0, 0.0, 0.0);
            for v in y.saturating_sub(2)..=(y + 2).min(height - 1) {
                for u in x.saturating_sub(2)..=(x + 2).min(width - 1) {
                    // About the own depth, so that squares stay small.
                    let off = f64::from(depth[(u, v)] - depth[(x, y)]);
                    if depth[(u, v)] > 0.0 {
                        n += 1.0;
                        sum += off;
                        squares += off * off;
                    }
                }
            }
            let spread = (squares / n - (sum / n).powi(2)).max(0.0).sqrt() / f64::from(depth[(x, y)]);
            *pixel = LIMITS.iter().filter(|limit| spread < **limit).count() as u16;
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slanted_plane_keeps_its_depth_when_it_is_enlarged() {
        let plane = |width: usize, height: usize| {
            let inverse = |i: usize| {
                let (x, y) = ((i % width) as f32 + 0.5, (i / width) as f32 + 0.5);
                1.0 / (1.0 + 0.3 * x / width as f32 + 0.2 * y / height as f32)
            };
            Image::from_vec(width, height, (0..width * height).map(inverse).collect())
        };
        let large = enlarged(&plane(40, 30), (160, 120));
        let truth = plane(160, 120);
        // The border is extended, not extrapolated.
        for (x, y) in (4..156).flat_map(|x| (4..116).map(move |y| (x, y))) {
            assert!((large[(x, y)] - truth[(x, y)]).abs() < 1e-4, "{x} {y}");
        }
        let mut holes = plane(40, 30);
        holes[(20, 15)] = 0.0;
        assert_eq!(enlarged(&holes, (160, 120)).data.iter().filter(|z| **z == 0.0).count(), 16);
    }

    #[test]
    fn smoothing_widens_a_step_to_the_error_function() {
        let sigma = 3.0;
        let step: DepthImage =
            Image::from_vec(60, 40, (0..2400).map(|i| if i % 60 < 30 { 1.0 } else { 1.5 }).collect());
        let row: Vec<f64> = (0..60).map(|x| f64::from(smoothed(&step, sigma)[(x, 20)])).collect();
        // One standard deviation from the edge, the error function has 84 %.
        let at = |x: f64| {
            let (i, f) = ((x - 0.5).floor() as usize, (x - 0.5).fract());
            row[i] * (1.0 - f) + row[i + 1] * f
        };
        assert!((at(30.0) - 1.25).abs() < 0.005, "{}", at(30.0));
        assert!((at(30.0 + sigma) - (1.0 + 0.5 * 0.8413)).abs() < 0.01, "{}", at(33.0));
        assert!((at(30.0 - sigma) - (1.0 + 0.5 * 0.1587)).abs() < 0.01, "{}", at(27.0));
    }

    #[test]
    fn confidence_is_high_on_planes_low_at_edges_and_without_depth() {
        let mut depth: DepthImage =
            Image::from_vec(40, 20, (0..800).map(|i| if i % 40 < 20 { 0.7 } else { 1.0 }).collect());
        depth[(5, 5)] = 0.0;
        let confidence = confidence(&depth);
        assert_eq!((confidence[(5, 5)], confidence[(6, 5)], confidence[(30, 10)]), (0, 2, 2));
        assert_eq!(confidence[(20, 10)], 0);
    }
}
