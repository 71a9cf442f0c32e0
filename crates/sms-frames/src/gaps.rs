//! Gaps between the samples of a depth sensor that is coarser than the image.
//!
//! Depth that was registered to a colour camera with more pixels lacks every few rows and columns: neighbouring samples land two
//! pixels apart. Inside of measured surfaces, a third of the pixels of two real recordings of 640 × 480 are such gaps.

use crate::DepthNoise;
use crate::normals::MAX_SLOPE;
use rayon::prelude::*;
use sms_core::{DepthImage, Image, Intrinsics};

/// Fewest columns of a depth sensor: neighbouring samples are `width / SENSOR_COLUMNS` pixels apart at most, rounded up.
const SENSOR_COLUMNS: usize = 320;
/// Lines through a pixel.
const LINES: [(i64, i64); 4] = [(1, 0), (0, 1), (1, 1), (1, -1)];
/// Standard deviations between two samples of one surface.
const SIGMAS: f64 = 3.0;

/// Fills pixels that lie between two samples of one surface, as far apart as those of a coarse sensor, with the depth on the
/// straight line between them (the mean over all such lines). Other pixels do not change, nor do images of at most 320 columns.
pub(crate) fn fill_gaps(depth: DepthImage, k: &Intrinsics, noise: &DepthNoise) -> DepthImage {
    let most = depth.width.div_ceil(SENSOR_COLUMNS) as i64;
    if most < 2 {
        return depth;
    }
    let gaps = Gaps { depth: &depth, k, noise, most };
    let fill = |i: usize| match depth.data[i] {
        z if z > 0.0 => z,
        _ => gaps.depth_between((i % depth.width) as i64, (i / depth.width) as i64).unwrap_or(0.0) as f32,
    };
    Image::from_vec(depth.width, depth.height, (0..depth.data.len()).into_par_iter().map(fill).collect())
}

struct Gaps<'a> {
    depth: &'a DepthImage,
    k: &'a Intrinsics,
    noise: &'a DepthNoise,
    /// Greatest distance between two samples, in rows or columns.
    most: i64,
}

impl Gaps<'_> {
    /// Returns the depth at a pixel without a sample, in metres; `None` where it does not lie between samples of one surface.
    fn depth_between(&self, x: i64, y: i64) -> Option<f64> {
        let lines = LINES.iter().filter_map(|line| self.on_line(x, y, *line));
        let (sum, weights) = lines
            .fold((0.0, 0.0), |(sum, weights), (inverse, weight)| (sum + weight * inverse, weights + weight));
        (weights > 0.0).then(|| weights / sum)
    }

    /// Returns the inverse depth (1/m) between the nearest samples on a line, and its weight: the inverse of their distance.
    fn on_line(&self, x: i64, y: i64, (dx, dy): (i64, i64)) -> Option<(f64, f64)> {
        let nearest = |sign: i64| {
            let at =
                |n: i64| self.depth.get(x + sign * n * dx, y + sign * n * dy).map_or(0.0, |&z| f64::from(z));
            (1..self.most).map(|n| (n, at(n))).find(|(_, z)| *z > 0.0)
        };
        let ((before, z0), (after, z1)) = (nearest(-1)?, nearest(1)?);
        let steps = before + after;
        let length = steps as f64 * (dx as f64).hypot(dy as f64);
        let near = z0.min(z1);
        let rise = MAX_SLOPE * self.k.pixel_footprint(near) * length;
        let noise = SIGMAS * std::f64::consts::SQRT_2 * self.noise.sigma_m(near);
        // Inverse depth is affine in the pixel on a plane.
        let inverse = (after as f64 / z0 + before as f64 / z1) / steps as f64;
        (steps <= self.most && (z0 - z1).abs() <= noise + rise).then_some((inverse, 1.0 / length))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (960, 60);

    fn image(depth: impl Fn(usize, usize) -> f32) -> DepthImage {
        let pixels = (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y)));
        Image::from_vec(SIZE.0, SIZE.1, pixels.map(|(x, y)| depth(x, y)).collect())
    }

    fn filled(depth: &DepthImage) -> DepthImage {
        fill_gaps(
            depth.clone(),
            &Intrinsics::from_fov(depth.width, depth.height, 1.0),
            &DepthNoise::default(),
        )
    }

    #[test]
    fn lines_without_depth_on_a_plane_get_its_depth() {
        let plane =
            |x: usize, y: usize| 1.0 / (1.0 + 0.001 * (x as f32 - 480.0) + 0.0005 * (y as f32 - 30.0));
        // Gaps of one row or column, and of two columns.
        let is_gap = |x: usize, y: usize| x % 5 == 2 || x % 35 == 3 || y % 5 == 3;
        let recorded = image(|x, y| if is_gap(x, y) { 0.0 } else { plane(x, y) });
        let result = filled(&recorded);
        for (x, y) in (5..SIZE.1 - 5).flat_map(|y| (5..SIZE.0 - 5).map(move |x| (x, y))) {
            let (found, truth) = (result[(x, y)], plane(x, y));
            assert!((found - truth).abs() < 1e-5, "{:?}: {found} for {truth}", (x, y));
            assert!(is_gap(x, y) || found == recorded[(x, y)]);
        }
    }

    #[test]
    fn nothing_is_filled_between_two_surfaces_in_holes_or_at_borders() {
        // A step of 3 cm; a hole of 9 × 9 pixels; the first columns.
        let recorded = image(|x, y| match (x, y) {
            (300, _) | (0..2, _) | (100..109, 10..19) => 0.0,
            (..300, _) => 1.0,
            _ => 1.03,
        });
        let result = filled(&recorded);
        let is_filled = |x: usize, y: usize| result[(x, y)] > 0.0;
        assert!((0..SIZE.1).all(|y| !is_filled(300, y) && !is_filled(0, y) && !is_filled(1, y)));
        assert!((100..109).all(|x| !is_filled(x, 14)));
    }

    #[test]
    fn gaps_are_as_wide_as_the_image_is_finer_than_a_coarse_sensor() {
        let most = |width: usize| {
            let widest = |gap: &usize| {
                let line = |x: usize| if (5..5 + gap).contains(&x) { 0.0 } else { 1.0 };
                let depth = Image::from_vec(width, 1, (0..width).map(line).collect());
                filled(&depth).data.iter().all(|z| *z > 0.0)
            };
            (0..9).take_while(widest).last()
        };
        assert_eq!([320, 640, 960, 1920].map(most), [0, 1, 2, 5].map(Some));
    }
}
