//! Patterns that stay at their place in the image while the camera moves: parts of a gripper too near for the depth sensor.
//!
//! Patches of two images at the same place are compared by their normalised correlation, which does not depend on exposure. A pattern
//! with edges in one direction only may slide along itself, so patches need gradients in two directions.

use crate::resample::resize_color;
use glamx::DVec2;
use rayon::prelude::*;
use sms_core::{Camera, Cancel, ColorImage, Image};

/// Longest side of the compared images, pixels.
const LONG_SIDE: usize = 320;
/// Half width of a patch, pixels of the compared images.
const RADIUS: usize = 4;
/// Least correlation of patches that show the same.
const ALIKE: f32 = 0.6;
/// Least share of the pairs of images whose patches are alike.
const LEAST_SHARE: f32 = 0.5;
/// Least number of pairs.
const LEAST_PAIRS: u16 = 4;
/// Least mean square of brightness changes per pixel, in the direction with the smallest (0 to 255).
const LEAST_TEXTURE: f32 = 2.0;
/// Standard deviation of the noise of brightness (0 to 255).
const NOISE: f32 = 2.0;
/// Depth of what is too far to be measured, metres.
const FAR_M: f64 = 1e4;
/// Distance between pixels at which the motion of the scene is computed, pixels of the compared images.
const CELL: usize = 8;

/// A picture with its camera, and the least depth of the scene, metres.
pub(crate) struct Picture<'a> {
    pub(crate) camera: &'a Camera,
    pub(crate) color: &'a ColorImage,
    pub(crate) nearest_m: f64,
}

/// Brightness (0 to 255) with the mean and the standard deviation of every patch.
struct Patches {
    brightness: Image<f32>,
    mean: Vec<f32>,
    /// With the noise's.
    deviation: Vec<f32>,
    is_textured: Vec<bool>,
}

impl Patches {
    fn of(color: &ColorImage, (width, height): (usize, usize)) -> Self {
        let small = resize_color(color, width, height);
        let brightness = small.map(|c| c.iter().map(|&v| f32::from(v)).sum::<f32>() / 3.0);
        let mean = box_mean(&brightness.data, (width, height));
        let square = box_mean(&brightness.data.iter().map(|v| v * v).collect::<Vec<_>>(), (width, height));
        let deviation = mean
            .iter()
            .zip(&square)
            .map(|(mean, square)| ((square - mean * mean).max(0.0) + NOISE * NOISE).sqrt())
            .collect();
        let is_textured = textured(&brightness);
        Self { brightness, mean, deviation, is_textured }
    }
}

/// Returns the pixels, at the size of the pictures, whose pattern stays in place while the scene moves there; `None` without pictures
/// or when cancelled. A patch that holds pixels of `scene` may stay for these: its pixel counts only within a patch of one whose patch
/// holds none.
pub(crate) fn patterns_in_place(
    pictures: &[Picture<'_>],
    scene: &Image<bool>,
    cancel: &Cancel,
) -> Option<Image<bool>> {
    let (width, height) = pictures.first()?.color.size();
    let shrink = width.max(height).div_ceil(LONG_SIDE).max(1);
    let size = (width.div_ceil(shrink), height.div_ceil(shrink));
    let patches: Vec<Patches> = pictures.par_iter().map(|p| Patches::of(p.color, size)).collect();
    let pairs: Vec<(usize, usize)> = (0..pictures.len()).flat_map(|j| (0..j).map(move |i| (i, j))).collect();
    let none = || vec![(0u16, 0u16); size.0 * size.1];
    // Numbers of pairs that are alike, and of all; their order does not matter.
    let counts = pairs
        .par_iter()
        .fold(none, |mut counts, &(i, j)| {
            if !cancel.is_cancelled() {
                compare((&pictures[i], &patches[i]), (&pictures[j], &patches[j]), shrink, &mut counts);
            }
            counts
        })
        .reduce(none, |mut a, b| {
            a.iter_mut().zip(b).for_each(|(a, b)| *a = (a.0 + b.0, a.1 + b.1));
            a
        });
    if cancel.is_cancelled() {
        return None;
    }
    let stays =
        |(alike, all): (u16, u16)| all >= LEAST_PAIRS && f32::from(alike) >= LEAST_SHARE * f32::from(all);
    let stays = Image::from_vec(size.0, size.1, counts.into_iter().map(stays).collect());
    let mut shows_scene = Image::filled(size.0, size.1, false);
    for i in (0..scene.data.len()).filter(|&i| scene.data[i]) {
        shows_scene[(i % width / shrink, i / width / shrink)] = true;
    }
    let near_scene = dilated(&shows_scene);
    let sure = stays.data.iter().zip(&near_scene.data).map(|(stays, near)| *stays && !near).collect();
    let beside = dilated(&Image::from_vec(size.0, size.1, sure));
    let found = |i: usize| {
        let pixel = (i % width / shrink, i / width / shrink);
        stays[pixel] && beside[pixel]
    };
    Some(Image::from_vec(width, height, (0..width * height).map(found).collect()))
}

/// Marks all pixels whose patches hold a marked one.
fn dilated(marked: &Image<bool>) -> Image<bool> {
    let (width, height) = marked.size();
    let values: Vec<f32> = marked.data.iter().map(|m| f32::from(u8::from(*m))).collect();
    let mean = box_mean(&values, (width, height));
    Image::from_vec(width, height, mean.into_iter().map(|m| m > 0.0).collect())
}

/// Counts the pixels at which the scene moves from one picture to the other, and those of which the patches are alike and textured.
fn compare(
    (a, pa): (&Picture<'_>, &Patches),
    (b, pb): (&Picture<'_>, &Patches),
    shrink: usize,
    counts: &mut [(u16, u16)],
) {
    let (width, height) = pa.brightness.size();
    let has_moved = moved(a, b, shrink, (width, height));
    if !has_moved.data.contains(&true) {
        return;
    }
    let product: Vec<f32> = pa.brightness.data.iter().zip(&pb.brightness.data).map(|(a, b)| a * b).collect();
    let product = box_mean(&product, (width, height));
    let correlation = |i: usize| (product[i] - pa.mean[i] * pb.mean[i]) / (pa.deviation[i] * pb.deviation[i]);
    for (i, count) in counts.iter_mut().enumerate() {
        if has_moved[(i % width / CELL, i / width / CELL)] {
            // A part has its texture in all pictures; the scene has it in some.
            count.0 += u16::from(pa.is_textured[i] && pb.is_textured[i] && correlation(i) >= ALIKE);
            count.1 += 1;
        }
    }
}

/// Returns, for cells of the image, whether every point of the scene there moves by more than a patch from `a` to `b` and back,
/// however far it is.
fn moved(a: &Picture<'_>, b: &Picture<'_>, shrink: usize, (width, height): (usize, usize)) -> Image<bool> {
    let least = ((2 * RADIUS + 1) * shrink) as f64;
    let cells = (width.div_ceil(CELL), height.div_ceil(CELL));
    let by = |from: &Picture<'_>, to: &Picture<'_>, pixel: DVec2| {
        let at = |depth_m: f64| {
            let p_w = from.camera.unproject(pixel.x, pixel.y, depth_m);
            to.camera.project(p_w).map(|(u, v, _)| DVec2::new(u, v))
        };
        // Its places for all depths lie on a line.
        match (at(from.nearest_m), at(FAR_M)) {
            (Some(near), Some(far)) => distance_to_segment(pixel, near, far) >= least,
            // Part of the ray is behind the other camera; the rest may cross the pixel.
            _ => false,
        }
    };
    let has_moved = |i: usize| {
        let at = |k: usize| ((k * CELL + CELL / 2) * shrink) as f64;
        let pixel = DVec2::new(at(i % cells.0), at(i / cells.0));
        by(a, b, pixel) && by(b, a, pixel)
    };
    Image::from_vec(cells.0, cells.1, (0..cells.0 * cells.1).map(has_moved).collect())
}

fn distance_to_segment(p: DVec2, from: DVec2, to: DVec2) -> f64 {
    let along = to - from;
    let t = ((p - from).dot(along) / along.length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
    p.distance(from + t * along)
}

/// Returns whether the brightness of every patch changes in all directions.
fn textured(brightness: &Image<f32>) -> Vec<bool> {
    let (width, height) = brightness.size();
    let at = |x: i64, y: i64| {
        let clamp = |v: i64, n: usize| v.clamp(0, n as i64 - 1) as usize;
        brightness[(clamp(x, width), clamp(y, height))]
    };
    let mut products = [(); 3].map(|()| Vec::with_capacity(width * height));
    for (x, y) in (0..height as i64).flat_map(|y| (0..width as i64).map(move |x| (x, y))) {
        let smooth = |f: &dyn Fn(i64) -> f32| (f(-1) + 2.0 * f(0) + f(1)) / 8.0;
        let gx = smooth(&|d| at(x + 1, y + d) - at(x - 1, y + d));
        let gy = smooth(&|d| at(x + d, y + 1) - at(x + d, y - 1));
        for (sum, value) in products.iter_mut().zip([gx * gx, gx * gy, gy * gy]) {
            sum.push(value);
        }
    }
    let [xx, xy, yy] = products.map(|p| box_mean(&p, (width, height)));
    let least = |i: usize| 0.5 * (xx[i] + yy[i]) - (0.25 * (xx[i] - yy[i]).powi(2) + xy[i] * xy[i]).sqrt();
    (0..width * height).map(|i| least(i) >= LEAST_TEXTURE).collect()
}

/// Mean over the patch around every pixel, as far as it lies in the image.
fn box_mean(values: &[f32], (width, height): (usize, usize)) -> Vec<f32> {
    let rows: Vec<f32> =
        values.chunks(width).flat_map(|row| window_mean(row.iter().copied(), width)).collect();
    let mut result = vec![0.0; values.len()];
    for x in 0..width {
        let column = window_mean((0..height).map(|y| rows[y * width + x]), height);
        column.into_iter().enumerate().for_each(|(y, v)| result[y * width + x] = v);
    }
    result
}

/// Mean over a window along a line of `n` values.
fn window_mean(line: impl Iterator<Item = f32>, n: usize) -> Vec<f32> {
    let sums: Vec<f64> = std::iter::once(0.0)
        .chain(line.scan(0.0, |sum, v| {
            *sum += f64::from(v);
            Some(*sum)
        }))
        .collect();
    (0..n)
        .map(|i| {
            let (from, to) = (i.saturating_sub(RADIUS), (i + RADIUS + 1).min(n));
            ((sums[to] - sums[from]) / (to - from) as f64) as f32
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::{DPose3, DQuat, DVec3};
    use rand::RngExt;
    use sms_core::{Intrinsics, Seed};

    const SIZE: (usize, usize) = (96, 64);
    /// First column of the part.
    const PART: usize = 60;

    fn noise(seed: u64) -> ColorImage {
        let mut rng = Seed(seed).rng();
        Image::from_vec(SIZE.0, SIZE.1, (0..SIZE.0 * SIZE.1).map(|_| [rng.random(); 3]).collect())
    }

    fn turning(i: usize) -> DPose3 {
        let x = 0.05 * i as f64;
        DPose3::from_parts(DVec3::X * x, DQuat::from_rotation_y(0.2 * i as f64))
    }

    fn sliding(i: usize) -> DPose3 {
        DPose3::from_translation(DVec3::X * 0.2 * i as f64)
    }

    /// Six pictures of noise that differs everywhere but in the columns from `PART` on; `scene` marks pixels with depth.
    fn found(pose: impl Fn(usize) -> DPose3, scene: impl Fn(usize) -> bool) -> Image<bool> {
        let part = noise(100);
        let pictures: Vec<(Camera, ColorImage)> = (0..6)
            .map(|i| {
                let mut color = noise(i as u64);
                (0..color.data.len())
                    .filter(|j| j % SIZE.0 >= PART)
                    .for_each(|j| color.data[j] = part.data[j]);
                (Camera::new(Intrinsics::from_fov(SIZE.0, SIZE.1, 1.0), pose(i)), color)
            })
            .collect();
        let pictures: Vec<Picture<'_>> =
            pictures.iter().map(|(camera, color)| Picture { camera, color, nearest_m: 0.5 }).collect();
        let scene =
            Image::from_vec(SIZE.0, SIZE.1, (0..SIZE.0 * SIZE.1).map(|i| scene(i % SIZE.0)).collect());
        patterns_in_place(&pictures, &scene, &Cancel::new()).unwrap()
    }

    #[test]
    fn a_pattern_that_stays_while_the_scene_moves_is_found() {
        let found = found(turning, |_| false);
        for (i, found) in found.data.iter().enumerate() {
            let inside = (i % SIZE.0) as i64 - PART as i64;
            // Patches across its border may be alike.
            assert!(*found == (inside >= 0) || inside.abs() <= RADIUS as i64, "column {}", i % SIZE.0);
        }
    }

    #[test]
    fn a_pattern_beside_surfaces_with_depth_is_believed_only_near_one_that_is_not() {
        // All patches of the part hold pixels with depth.
        let stripes = |x: usize| x.is_multiple_of(RADIUS + 1);
        assert!(found(turning, stripes).data.iter().all(|found| !found));
        // The scene has depth up to the part, and patches of the columns beside it hold some of it.
        let beside = found(turning, |x| x < PART);
        assert!((0..SIZE.1).all(|y| beside[(PART + 3, y)] && !beside[(PART - RADIUS - 1, y)]));
    }

    #[test]
    fn what_a_far_scene_would_show_is_not_found() {
        // Points at infinity stay in place before a camera that does not turn, and all do before one at rest.
        assert!(found(sliding, |_| false).data.iter().all(|found| !found));
        assert!(found(|_| DPose3::identity(), |_| false).data.iter().all(|found| !found));
    }

    #[test]
    fn even_surfaces_and_edges_in_one_direction_are_not_textured() {
        let of = |value: &dyn Fn(usize, usize) -> f32| {
            let pixels = (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y)));
            textured(&Image::from_vec(SIZE.0, SIZE.1, pixels.map(|(x, y)| value(x, y)).collect()))
        };
        assert!(of(&|_, _| 120.0).iter().all(|t| !t));
        assert!(of(&|x, _| if x < 40 { 0.0 } else { 200.0 }).iter().all(|t| !t));
        assert!(of(&|x, y| if x < 40 && y < 30 { 0.0 } else { 200.0 })[30 * SIZE.0 + 40]);
    }
}
