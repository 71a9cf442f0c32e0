//! Pixels that show something attached to the camera: a gripper, a mount, a part of the robot.
//!
//! What moves with the camera has the same depth at the same pixel in most frames, and the other frames see through its points. A wall
//! along which the camera moves has the same depth at a pixel too, but the other frames measure it where its points project to. Where
//! these frames measure their own pixel's usual depth, both would explain it: such measurements count as seen, and for neither.
//! Pairs of frames between which a point hardly moves in the image tell nothing.
//!
//! Parts too near for the depth sensor are found by their picture ([`crate::pattern`]).

use crate::pattern::{Picture, patterns_in_place};
use crate::{DepthNoise, Frame, evenly_spread};
use rayon::prelude::*;
use sms_core::{Camera, Cancel, ColorImage, DepthImage, Image, QuantileRule, quantile};

/// Number of frames, spread over the sequence, that are examined.
pub(crate) const MOST_VIEWS: usize = 20;
/// Least number of measurements at a pixel, and of pairs of frames of which the second sees the place of a point of the first.
const LEAST: usize = 4;
/// Least share of the frames that measure a pixel.
const LEAST_MEASURED: f64 = 0.3;
/// Least share of a pixel's measurements that have its usual depth.
const LEAST_ALIKE: f64 = 0.6;
/// Depths of one surface differ by at most this share, or by their noise.
const ALIKE: f64 = 0.03;
/// Least distance in the image between a pixel and its point in another frame, pixels: silhouettes flicker by less.
const LEAST_MOVED: f64 = 5.0;
/// Largest share of these pairs, without those that both would explain, in which the second frame confirms a point of the scene. On
/// the pixels of constant depth of a real shelf it is at most 0.01 for 95 % of those of the robot, and in three real recordings at
/// least 0.13 for 95 % of those of the scene (prototype; experiments/studies/materialize.md).
const MOST_CONFIRMED: f64 = 0.05;
/// Least share of these pairs in which the second frame sees through the point: a frame of a wrong pose is in fewer of them.
const LEAST_THROUGH: f64 = 0.2;
/// Half width of the window in which most pixels that are known must be attached, pixels.
const WINDOW: i64 = 2;
/// Quantile of the depths of a view that the scene begins at: wrong measurements are nearer.
const NEAREST: f64 = 0.02;
/// If more of the measured pixels than this share seem attached, the poses are at fault.
const MOST_ATTACHED: f64 = 0.5;

/// Depth of one frame, and its colour if pictures are examined.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DepthView<'a> {
    /// Intrinsics and pose.
    pub(crate) camera: &'a Camera,
    /// Depth in metres, 0 where there is none.
    pub(crate) depth: &'a DepthImage,
    /// Its noise.
    pub(crate) noise: DepthNoise,
    /// Colour, of the same size.
    pub(crate) color: Option<&'a ColorImage>,
}

impl<'a> From<&'a Frame> for DepthView<'a> {
    fn from(frame: &'a Frame) -> Self {
        let color = Some(&frame.color);
        Self { camera: &frame.camera, depth: &frame.depth, noise: frame.depth_noise, color }
    }
}

impl DepthView<'_> {
    fn tolerance_m(&self, z: f64) -> f64 {
        self.noise.tolerance_m(z, ALIKE)
    }
}

/// Pixels that show something attached to the camera.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Attached {
    /// The pixels.
    pub(crate) pixels: Image<bool>,
    /// Their share of all pixels.
    pub(crate) share: f64,
}

impl Attached {
    /// Returns the finding for the user.
    pub(crate) fn message(&self) -> String {
        let percent = 100.0 * self.share;
        format!(
            "{percent:.1} % of the pixels show something that moves with the camera, such as a gripper; \
             a scan leaves them out"
        )
    }
}

/// Finds the pixels that show something attached to the camera. `None` if there are none, if the images differ in size, if
/// the poses do not tell, or when cancelled.
pub(crate) fn attached(views: &[DepthView<'_>], cancel: &Cancel) -> Option<Attached> {
    let size = views.first()?.depth.size();
    if views.iter().any(|v| v.depth.size() != size) {
        return None;
    }
    let views: Vec<DepthView<'_>> =
        evenly_spread(views.len(), MOST_VIEWS).into_iter().map(|i| views[i]).collect();
    let usual = usual_depth(&views, size);
    let measured = measured(&views, size);
    // A pixel without a usual depth shows the scene, if it measures anything.
    let verdict = |i: usize| match (measured.data[i], usual.data[i]) {
        (0, _) => None,
        _ if cancel.is_cancelled() => None,
        (_, 0.0) => Some(false),
        _ => is_refuted(&views, &usual, (i % size.0, i / size.0)),
    };
    let verdicts: Vec<Option<bool>> = (0..usual.data.len()).into_par_iter().map(verdict).collect();
    let mut verdicts = Image::from_vec(size.0, size.1, verdicts);
    follow_surfaces(&mut verdicts, &usual, |z| views[0].tolerance_m(z));
    let mut pixels = majority(&verdicts);
    let all: usize = measured.data.iter().sum();
    let own: usize = measured.data.iter().zip(&pixels.data).filter(|(_, own)| **own).map(|(n, _)| n).sum();
    if own as f64 > MOST_ATTACHED * all as f64 {
        return None;
    }
    if let Some(pictures) = pictures(&views, &pixels) {
        let is_measured = |n: usize| n as f64 >= LEAST_MEASURED * views.len() as f64;
        let scene = measured.data.iter().zip(&pixels.data).map(|(&n, own)| is_measured(n) && !own).collect();
        let scene = Image::from_vec(size.0, size.1, scene);
        let mut found = patterns_in_place(&pictures, &scene, cancel)?;
        for (i, own) in found.data.iter_mut().enumerate() {
            *own = pixels.data[i] || (*own && !is_measured(measured.data[i]));
        }
        let found = majority(&found.map(|own| Some(*own)));
        // If most of the image stays in place, the poses are at fault.
        if share_of(&found) <= MOST_ATTACHED {
            pixels.data.iter_mut().zip(found.data).for_each(|(own, found)| *own |= found);
        }
    }
    let share = share_of(&pixels);
    (share > 0.0).then_some(Attached { pixels, share })
}

/// Returns the share of the pixels that are marked.
fn share_of(pixels: &Image<bool>) -> f64 {
    pixels.data.iter().filter(|own| **own).count() as f64 / pixels.data.len().max(1) as f64
}

/// Returns the pixels in whose window most of the pixels that are known are attached.
fn majority(verdicts: &Image<Option<bool>>) -> Image<bool> {
    let (width, height) = verdicts.size();
    let most = |i: usize| {
        let (x, y) = ((i % width) as i64, (i / width) as i64);
        let window = (-WINDOW..=WINDOW).flat_map(|dy| (-WINDOW..=WINDOW).map(move |dx| (dx, dy)));
        let known: Vec<bool> =
            window.filter_map(|(dx, dy)| verdicts.get(x + dx, y + dy).copied().flatten()).collect();
        2 * known.iter().filter(|attached| **attached).count() > known.len()
    };
    Image::from_vec(width, height, (0..width * height).into_par_iter().map(most).collect())
}

/// Returns the pictures of all views, `pixels` of which are attached; `None` if one has no colour or no depth.
fn pictures<'a>(views: &[DepthView<'a>], pixels: &Image<bool>) -> Option<Vec<Picture<'a>>> {
    let picture = |view: &DepthView<'a>| {
        let depths = view.depth.data.iter().zip(&pixels.data).filter(|(z, own)| **z > 0.0 && !**own);
        let mut depths: Vec<f64> = depths.map(|(z, _)| f64::from(*z)).collect();
        let nearest_m = quantile(&mut depths, NEAREST, QuantileRule::Nearest)?;
        Some(Picture { camera: view.camera, color: view.color?, nearest_m })
    };
    views.iter().map(picture).collect()
}

/// Marks pixels of usual depth whose places no other frame sees if they continue the surface of attached pixels.
fn follow_surfaces(verdicts: &mut Image<Option<bool>>, usual: &DepthImage, tolerance_m: impl Fn(f64) -> f64) {
    let width = verdicts.width;
    let mut open: Vec<usize> = (0..verdicts.data.len()).filter(|&i| verdicts.data[i] == Some(true)).collect();
    while let Some(i) = open.pop() {
        let (x, y, z) = ((i % width) as i64, (i / width) as i64, f64::from(usual.data[i]));
        for (x, y) in [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)] {
            let is_open = verdicts.get(x, y) == Some(&None);
            let beside = usual.get(x, y).map_or(0.0, |&z| f64::from(z));
            if is_open && beside > 0.0 && (beside - z).abs() <= tolerance_m(z) {
                let next = y as usize * width + x as usize;
                verdicts.data[next] = Some(true);
                open.push(next);
            }
        }
    }
}

/// Returns the number of frames that measure each pixel.
fn measured(views: &[DepthView<'_>], (width, height): (usize, usize)) -> Image<usize> {
    let count = |i: usize| views.iter().filter(|v| v.depth.data[i] > 0.0).count();
    Image::from_vec(width, height, (0..width * height).into_par_iter().map(count).collect())
}

/// Returns the depth that most frames have at each pixel, 0 where there is none.
fn usual_depth(views: &[DepthView<'_>], (width, height): (usize, usize)) -> DepthImage {
    let least = LEAST.max((LEAST_MEASURED * views.len() as f64).ceil() as usize);
    let usual = |i: usize| {
        let mut depths: Vec<f32> = views.iter().map(|v| v.depth.data[i]).filter(|&z| z > 0.0).collect();
        if depths.len() < least {
            return 0.0;
        }
        depths.sort_by(f32::total_cmp);
        let middle = f64::from(depths[depths.len() / 2]);
        let tolerance = views[0].tolerance_m(middle);
        let alike = depths.iter().filter(|&&z| (f64::from(z) - middle).abs() <= tolerance).count();
        if alike as f64 >= LEAST_ALIKE * depths.len() as f64 { middle as f32 } else { 0.0 }
    };
    Image::from_vec(width, height, (0..width * height).into_par_iter().map(usual).collect())
}

/// Returns whether the other frames see through the points that a pixel of usual depth measures; `None` if too few see their places.
fn is_refuted(views: &[DepthView<'_>], usual: &DepthImage, (x, y): (usize, usize)) -> Option<bool> {
    let is_usual = |view: &DepthView<'_>, pixel: (usize, usize), z: f64| {
        let usual = f64::from(usual[pixel]);
        usual > 0.0 && (z - usual).abs() <= view.tolerance_m(usual)
    };
    let (mut confirmed, mut explained, mut through) = (0usize, 0usize, 0usize);
    for (i, view) in views.iter().enumerate() {
        let z = f64::from(view.depth[(x, y)]);
        if !(z > 0.0 && is_usual(view, (x, y), z)) {
            continue;
        }
        let p_w = view.camera.unproject_pixel(x, y, z);
        for other in views[..i].iter().chain(&views[i + 1..]) {
            let Some((u, v, z)) = other.camera.project(p_w) else { continue };
            let Some(pixel) = other.camera.pixel_at(u, v) else { continue };
            let moved = (u - x as f64 - 0.5).hypot(v - y as f64 - 0.5);
            let seen = f64::from(other.depth[pixel]);
            if moved < LEAST_MOVED || seen <= 0.0 {
                continue;
            }
            if seen > z + other.tolerance_m(z) {
                through += 1;
            } else if seen >= z - other.tolerance_m(z) {
                let count = if is_usual(other, pixel, seen) { &mut explained } else { &mut confirmed };
                *count += 1;
            }
        }
    }
    let all = confirmed + explained + through;
    (all >= LEAST).then_some(
        through as f64 >= LEAST_THROUGH * all as f64
            && confirmed as f64 <= MOST_CONFIRMED * (confirmed + through) as f64,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::{DPose3, DQuat, DVec3};
    use rand::RngExt;
    use sms_core::Intrinsics;

    const SIZE: (usize, usize) = (64, 48);

    /// Depth of the wall z = 1 m, and of something at 0.15 m before the camera that fills the columns from `part` on.
    fn view(x_wc: DPose3, part: usize) -> (Camera, DepthImage) {
        let camera = Camera::new(Intrinsics::from_fov(SIZE.0, SIZE.1, 1.0), x_wc);
        let mut depth = Image::filled(SIZE.0, SIZE.1, 0.0f32);
        for (x, y) in (0..SIZE.0).flat_map(|x| (0..SIZE.1).map(move |y| (x, y))) {
            let ray_w = camera.unproject_pixel(x, y, 1.0) - camera.center_w();
            let wall = (1.0 - camera.center_w().z) / ray_w.z;
            depth[(x, y)] = if x >= part { 0.15 } else { wall as f32 };
        }
        (camera, depth)
    }

    fn found(views: &[(Camera, DepthImage)]) -> Option<Attached> {
        let of = |(camera, depth)| DepthView { camera, depth, noise: DepthNoise::default(), color: None };
        attached(&views.iter().map(|(camera, depth)| of((camera, depth))).collect::<Vec<_>>(), &Cancel::new())
    }

    fn turning(i: usize) -> DPose3 {
        let turn = DQuat::from_rotation_y(0.1 * (i as f64 - 5.0));
        DPose3::from_parts(DVec3::new(0.05 * (5.0 - i as f64), 0.02 * i as f64, 0.0), turn)
    }

    #[test]
    fn a_part_that_moves_with_the_camera_is_found_and_the_wall_is_not() {
        let views: Vec<_> = (0..10).map(|i| view(turning(i), 50)).collect();
        let found = found(&views).unwrap();
        // Its border is found to within the window.
        for (i, is_attached) in found.pixels.data.iter().enumerate() {
            let beyond = (i % SIZE.0) as i64 - 50;
            let expected = beyond >= 0;
            assert!(
                *is_attached == expected || beyond.abs() <= WINDOW,
                "pixel {:?}",
                (i % SIZE.0, i / SIZE.0)
            );
        }
        assert!((found.share - 14.0 / 64.0).abs() < 1.0 / 64.0);
    }

    #[test]
    fn nothing_is_attached_to_a_camera_that_sees_the_wall_alone() {
        let turns: Vec<_> = (0..10).map(|i| view(turning(i), SIZE.0)).collect();
        assert_eq!(found(&turns), None);
        // Along the wall, every pixel has the same depth in all frames.
        let along = |i: usize| DPose3::from_translation(DVec3::X * 0.05 * i as f64);
        let slides: Vec<_> = (0..10).map(|i| view(along(i), SIZE.0)).collect();
        assert_eq!(found(&slides), None);
    }

    #[test]
    fn noise_and_one_wrong_pose_do_not_attach_a_wall() {
        let along = |i: usize| DPose3::from_translation(DVec3::X * 0.05 * i as f64);
        let mut views: Vec<_> = (0..12).map(|i| view(along(i), SIZE.0)).collect();
        let mut rng = sms_core::Seed(5).rng();
        for (_, depth) in &mut views {
            depth.data.iter_mut().for_each(|z| *z += rng.random_range(-0.004..0.004));
        }
        assert_eq!(found(&views), None);
        // The others would see through its points, and it through theirs.
        views[3].0.x_wc.translation.z -= 0.2;
        assert_eq!(found(&views), None);
    }

    #[test]
    fn something_whose_border_flickers_before_a_camera_at_rest_is_not_attached() {
        let views: Vec<_> = (0..10).map(|i| view(DPose3::identity(), 50 + usize::from(i % 3 == 0))).collect();
        assert_eq!(found(&views), None);
    }

    #[test]
    fn a_camera_at_rest_does_not_tell() {
        let views: Vec<_> = (0..10).map(|_| view(DPose3::identity(), 50)).collect();
        assert_eq!(found(&views), None);
        assert_eq!(found(&views[..2]), None);
        assert_eq!(found(&[]), None);
    }
}
