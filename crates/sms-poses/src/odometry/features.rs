//! Corners with binary descriptors and measured positions.
//!
//! Corners pass the segment test (Rosten and Drummond, "Machine learning for high-speed corner detection", ECCV 2006) on
//! several sizes of the image; descriptors compare brightness at 256 pairs of places around a corner, turned into the
//! direction of its brightness centroid (Rublee et al., "ORB: an efficient alternative to SIFT or SURF", ICCV 2011).

use crate::luma::{Luma, smooth};
use crate::views::{PreparedFrame, pixel_point};
use glamx::DVec3;
use sms_core::{Seed, standard_normal};
use std::sync::LazyLock;

/// A corner with depth.
#[derive(Debug, Clone)]
pub(super) struct Feature {
    /// Position in the camera, metres.
    pub(super) p_c: DVec3,
    /// Standard deviation of its position, metres: that of its depth, and of its place in the image.
    pub(super) sigma_m: f64,
    pub(super) descriptor: Descriptor,
}

/// Bits of brightness comparisons.
pub(super) type Descriptor = [u64; 4];

/// Number of image sizes with corners, each half of the one before.
const SIZES: usize = 3;
/// Side of the cells whose strongest corners are kept, pixels, so that corners cover the image.
const CELL: usize = 24;
/// Corners kept in a cell.
const PER_CELL: usize = 6;
/// Radius of the patch that gives the direction of a corner, pixels.
const DIRECTION_RADIUS: i64 = 7;
/// Largest distance of a compared place from the corner, pixels.
const PATCH_RADIUS: f64 = 12.0;
/// Distance of corners from the border, pixels: the turned patch with its rounding, within the image.
const BORDER: usize = PATCH_RADIUS as usize + 2;

/// Offsets of the circle of the segment test in order.
const CIRCLE: [(i64, i64); 16] = [
    (0, -3),
    (1, -3),
    (2, -2),
    (3, -1),
    (3, 0),
    (3, 1),
    (2, 2),
    (1, 3),
    (0, 3),
    (-1, 3),
    (-2, 2),
    (-3, 1),
    (-3, 0),
    (-3, -1),
    (-2, -2),
    (-1, -3),
];
/// Number of pixels in a row on the circle that must all be brighter, or all darker.
const ARC: usize = 9;

/// Pairs of places, drawn from a normal distribution (Calonder et al., "BRIEF", ECCV 2010).
static PAIRS: LazyLock<Vec<[[f64; 2]; 2]>> = LazyLock::new(|| {
    let mut rng = Seed(0).derive("descriptor").rng();
    let mut place = || loop {
        let at = [0, 1].map(|_| 0.4 * PATCH_RADIUS * standard_normal(&mut rng));
        if at[0].hypot(at[1]) <= PATCH_RADIUS {
            return at;
        }
    };
    (0..256).map(|_| [place(), place()]).collect()
});

/// Returns the corners of a frame that have depth. `noise_levels` is the standard deviation of its brightness.
pub(super) fn features(view: &PreparedFrame, noise_levels: f64) -> Vec<Feature> {
    let mut found = Vec::new();
    for level in 0..view.luma.len().min(SIZES) {
        let luma = &view.luma[level];
        if luma.width <= 2 * BORDER || luma.height <= 2 * BORDER {
            break;
        }
        // Comparisons of single pixels would compare noise.
        let blurred = smooth(&smooth(luma));
        let scale = view.scale(level);
        for (x, y) in corners(luma, (3.0 * noise_levels) as f32) {
            let (u, v) = ((x as f64 + 0.5) * scale, (y as f64 + 0.5) * scale);
            let Some((p_c, sigma_z_m)) = measured_near(view, u, v) else { continue };
            let sigma_m = sigma_z_m.hypot(view.intrinsics.pixel_footprint(p_c.z) * scale);
            found.push(Feature { p_c, sigma_m, descriptor: descriptor(&blurred, x, y) });
        }
    }
    found
}

/// Returns the position of the measurement nearest to (u, v), on the ray of (u, v), and the noise of its depth. Depth that was
/// warped into the colour camera has holes.
fn measured_near(view: &PreparedFrame, u: f64, v: f64) -> Option<(DVec3, f64)> {
    const REACH: i64 = 2;
    let k = &view.intrinsics;
    let (x, y) = (u as i64, v as i64);
    let near = |dx: i64, dy: i64| {
        let (x, y) = (x + dx, y + dy);
        let inside = x >= 0 && y >= 0 && x < k.width as i64 && y < k.height as i64;
        let s = inside.then(|| view.depth[y as usize * k.width + x as usize])?;
        (s.z > 0.0).then_some((dx * dx + dy * dy, s.z, s.sigma_z_m))
    };
    let all = (-REACH..=REACH).flat_map(|dy| (-REACH..=REACH).filter_map(move |dx| near(dx, dy)));
    // Of equally near ones the closest to the camera: a corner belongs to the surface in front.
    let (_, z, sigma_z_m) = all.min_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)))?;
    let at_pixel = pixel_point(k, x, y, z.into());
    let off = DVec3::new((u - x as f64 - 0.5) / k.fx, (v - y as f64 - 0.5) / k.fy, 0.0);
    Some((at_pixel + off * f64::from(z), sigma_z_m.into()))
}

/// Returns the corners of an image: the strongest of each cell, row by row of cells.
fn corners(luma: &Luma, threshold: f32) -> Vec<(usize, usize)> {
    let (w, h) = luma.size();
    let mut score = vec![0f32; w * h];
    for y in BORDER..h - BORDER {
        for x in BORDER..w - BORDER {
            score[y * w + x] = segment_score(luma, x, y, threshold);
        }
    }
    let is_peak = |x: usize, y: usize| {
        let own = score[y * w + x];
        own > 0.0
            && (0..9).filter(|k| *k != 4).all(|k| {
                let other = score[(y + k / 3 - 1) * w + x + k % 3 - 1];
                // Of equal neighbours the first one in memory counts.
                other < own || (other == own && k > 4)
            })
    };
    let mut found = Vec::new();
    for top in (BORDER..h - BORDER).step_by(CELL) {
        for left in (BORDER..w - BORDER).step_by(CELL) {
            let rows = top..(top + CELL).min(h - BORDER);
            let columns = left..(left + CELL).min(w - BORDER);
            let mut cell: Vec<(usize, usize)> = rows
                .flat_map(|y| columns.clone().map(move |x| (x, y)))
                .filter(|&(x, y)| is_peak(x, y))
                .collect();
            cell.sort_by(|a, b| score[b.1 * w + b.0].total_cmp(&score[a.1 * w + a.0]));
            found.extend(cell.into_iter().take(PER_CELL));
        }
    }
    found
}

/// Returns the sum of the differences beyond the threshold around the circle if the segment test passes, else 0.
fn segment_score(luma: &Luma, x: usize, y: usize, threshold: f32) -> f32 {
    let w = luma.width as i64;
    let at = y as i64 * w + x as i64;
    let center = luma.data[at as usize];
    let difference = |k: usize| {
        let (dx, dy) = CIRCLE[k];
        luma.data[(at + dy * w + dx) as usize] - center
    };
    // Of four pixels at right angles, an arc of nine contains at least two neighbours.
    let sides = [0, 4, 8, 12].map(difference);
    let has_two =
        |sign: f32| (0..4).any(|k| [sides[k], sides[(k + 1) % 4]].iter().all(|d| sign * d > threshold));
    if !has_two(1.0) && !has_two(-1.0) {
        return 0.0;
    }
    let all: [f32; 16] = std::array::from_fn(difference);
    let passes = |sign: f32| {
        let mut row = 0;
        (0..16 + ARC - 1).any(|k| {
            row = if sign * all[k % 16] > threshold { row + 1 } else { 0 };
            row >= ARC
        })
    };
    let sum = |sign: f32| all.iter().map(|d| (sign * d - threshold).max(0.0)).sum::<f32>();
    [1.0, -1.0].into_iter().filter(|s| passes(*s)).map(sum).fold(0.0, f32::max)
}

/// Returns the comparisons around a pixel, turned by the direction of the brightness centroid.
fn descriptor(luma: &Luma, x: usize, y: usize) -> Descriptor {
    let value = |dx: i64, dy: i64| luma.data[((y as i64 + dy) * luma.width as i64 + x as i64 + dx) as usize];
    let (mut along_x, mut along_y) = (0f32, 0f32);
    for dy in -DIRECTION_RADIUS..=DIRECTION_RADIUS {
        for dx in -DIRECTION_RADIUS..=DIRECTION_RADIUS {
            if dx * dx + dy * dy <= DIRECTION_RADIUS * DIRECTION_RADIUS {
                along_x += dx as f32 * value(dx, dy);
                along_y += dy as f32 * value(dx, dy);
            }
        }
    }
    let (sin, cos) = f64::from(along_y).atan2(f64::from(along_x)).sin_cos();
    let turned =
        |[a, b]: [f64; 2]| value((cos * a - sin * b).round() as i64, (sin * a + cos * b).round() as i64);
    let mut bits = [0u64; 4];
    for (k, [a, b]) in PAIRS.iter().enumerate() {
        bits[k / 64] |= u64::from(turned(*a) < turned(*b)) << (k % 64);
    }
    bits
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::Image;

    fn image(size: usize, value: impl Fn(f64, f64) -> f64) -> Luma {
        let at = |i: usize| value((i % size) as f64 + 0.5, (i / size) as f64 + 0.5) as f32;
        Image::from_vec(size, size, (0..size * size).map(at).collect())
    }

    #[test]
    fn corners_of_a_square_are_found_and_nothing_on_its_sides() {
        let square =
            image(
                96,
                |u, v| if (30.0..66.0).contains(&u) && (30.0..66.0).contains(&v) { 200.0 } else { 50.0 },
            );
        let found = corners(&square, 9.0);
        assert_eq!(found.len(), 4, "{found:?}");
        for (x, y) in found {
            let off = |c: usize| (c as f64 + 0.5 - 30.0).abs().min((c as f64 + 0.5 - 66.0).abs());
            assert!(off(x) < 3.0 && off(y) < 3.0, "{x} {y}");
        }
    }

    #[test]
    fn descriptors_turn_with_the_image_and_tell_places_apart() {
        let pattern = |u: f64, v: f64| {
            120.0 + 60.0 * (0.31 * u + 0.13 * v + 0.002 * u * v).sin() * (0.23 * v - 0.11 * u).cos() + 0.4 * u
        };
        let upright = image(96, pattern);
        // Turned by 0.6 about the middle pixel.
        let turned = image(96, |u, v| {
            let (sin, cos) = 0.6f64.sin_cos();
            let (a, b) = (u - 48.5, v - 48.5);
            pattern(48.5 + cos * a + sin * b, 48.5 - sin * a + cos * b)
        });
        let bits = |a: &Descriptor, b: &Descriptor| (0..4).map(|k| (a[k] ^ b[k]).count_ones()).sum::<u32>();
        let own = descriptor(&upright, 48, 48);
        let same = bits(&own, &descriptor(&turned, 48, 48));
        let other = bits(&own, &descriptor(&upright, 62, 30));
        assert!(same < 40 && other > 2 * same, "{same} {other}");
    }
}
