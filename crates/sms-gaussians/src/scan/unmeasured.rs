//! Gaussians where colour was recorded but no depth: dark, shiny and distant surfaces, and the shadows of the depth sensor beside
//! silhouettes. They fill the picture and are no surface of a body ([`GaussianModel::measured`](crate::GaussianModel::measured)).
//!
//! The depth of a pixel without measurement is interpolated from those around it, from the farther ones where they are of two
//! surfaces: what is missing beside a silhouette is the background. The point then moves back along its ray until no frame
//! sees through it.

use super::config::ScanConfig;
use super::seeding::{AffinityCodes, disc};
use crate::{RenderedMaps, Seedling};
use glamx::DVec3;
use rand::seq::SliceRandom;
use rayon::prelude::*;
use sms_core::{DepthImage, Image, LabelMap, Seed};
use sms_frames::Frame;
use sms_surface::{PointVisibility, Surfel, visibility};

/// Distance of these Gaussians as a multiple of that of measured ones.
const COARSER: f64 = 2.0;
/// Factor by which the depth grows until no frame sees through a point.
const STEP: f64 = 1.05;
/// Number of such steps, after which a point is left out.
const STEPS: usize = 24;
/// Least difference of a colour channel (0 to 1) that needs a Gaussian: about ten times the noise of a camera.
const LEAST_DIFFERENCE: f32 = 0.05;
/// The fused surface covers a pixel if it is as opaque there as one disc, not trained yet and seen face-on, is at this number of standard
/// deviations.
const COVERED_SIGMAS: f32 = 1.5;
/// Depths within this ratio belong to one surface.
const SAME_SURFACE: f32 = 1.1;

/// Returns the pixels of `frame` without depth that the fused surface does not cover (`rendered`): where other frames measured
/// a surface, nothing is missing.
pub(crate) fn uncovered(frame: &Frame, rendered: &RenderedMaps, config: &ScanConfig) -> Vec<u32> {
    let covered = config.seeding.opacity * (-0.5 * COVERED_SIGMAS * COVERED_SIGMAS).exp();
    let is_open = |i: &u32| {
        let i = *i as usize;
        frame.depth.data[i] <= 0.0
            && frame.shows_scene(i)
            && rendered.alpha[i] < covered
            && differs(rendered.color[i], frame.color.data[i])
    };
    (0..frame.depth.data.len() as u32).filter(is_open).collect()
}

/// Returns Gaussians for the `uncovered` pixels of `frame` that the Gaussians so far leave open (`rendered`). `frames` are
/// all frames that are trained on.
pub(crate) fn seed_unmeasured(
    (frame, uncovered): (&Frame, &[u32]),
    (labels, codes): (&LabelMap, &AffinityCodes),
    rendered: &RenderedMaps,
    frames: &[&Frame],
    config: &ScanConfig,
    seed: Seed,
) -> Vec<Seedling> {
    let settings = &config.seeding;
    let (width, height) = frame.depth.size();
    let Some(filled) = fill(&frame.depth) else { return Vec::new() };
    let mut rng = seed.derive("order").rng();
    let is_open = |i: &usize| {
        rendered.alpha[*i] < settings.alpha_below && differs(rendered.color[*i], frame.color.data[*i])
    };
    let mut order: Vec<usize> = uncovered.iter().map(|&i| i as usize).filter(is_open).collect();
    order.shuffle(&mut rng);
    let spacing_px = COARSER * settings.spacing_px;
    let mut taken = Image::filled(width, height, false);
    let reach = spacing_px.ceil() as i64;
    let mut chosen = Vec::new();
    for i in order {
        let (x, y) = ((i % width) as i64, (i / width) as i64);
        if taken.data[i] {
            continue;
        }
        chosen.push(i);
        for (dx, dy) in (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy))) {
            let near = ((dx * dx + dy * dy) as f64) < spacing_px * spacing_px;
            let (px, py) = (x + dx, y + dy);
            if near && px >= 0 && py >= 0 && (px as usize) < width && (py as usize) < height {
                taken[(px as usize, py as usize)] = true;
            }
        }
    }
    let tolerance = config.surface().tolerance;
    let clear =
        |p_w: DVec3| !frames.iter().any(|f| visibility(f, p_w, &tolerance) == PointVisibility::Through);
    let depths: Vec<Option<f64>> = chosen
        .par_iter()
        .map(|&i| {
            let first = f64::from(filled.data[i]);
            let depths = (0..STEPS).map(|k| first * STEP.powi(k as i32));
            depths.into_iter().find(|&z| clear(frame.camera.unproject_pixel(i % width, i / width, z)))
        })
        .collect();
    let mut affinity_rng = seed.derive("affinity").rng();
    let k = &frame.camera.intrinsics;
    let mut seedlings = Vec::new();
    for (i, z) in chosen.into_iter().zip(depths) {
        let Some(z) = z else { continue };
        let p_w = frame.camera.unproject_pixel(i % width, i / width, z);
        let to_camera_w = (frame.camera.center_w() - p_w).normalize();
        let footprint_m = k.pixel_footprint(z);
        let element = Surfel {
            p_w,
            n_w: to_camera_w,
            spacing_m: spacing_px * footprint_m,
            to_camera_w,
            pitch_m: footprint_m,
            ..Surfel::default()
        };
        let color = frame.color.data[i].map(|c| f32::from(c) / 255.0);
        seedlings.push(disc(
            &element,
            element.spacing_m,
            color,
            codes.draw(labels.data[i], &mut affinity_rng),
            config,
        ));
    }
    seedlings
}

/// Whether a rendered colour is not the recorded one: where the background has the right colour, no Gaussian is needed.
fn differs(rendered: [f32; 3], recorded: [u8; 3]) -> bool {
    (0..3).any(|c| (rendered[c] - f32::from(recorded[c]) / 255.0).abs() > LEAST_DIFFERENCE)
}

/// Returns the depth image with the pixels without measurement filled from those around them (pull and push over a pyramid of
/// halved images); `None` without any measurement.
fn fill(depth: &DepthImage) -> Option<DepthImage> {
    if !depth.data.iter().any(|&z| z > 0.0) {
        return None;
    }
    let (width, height) = depth.size();
    if depth.data.iter().all(|&z| z > 0.0) || (width == 1 && height == 1) {
        return Some(depth.clone());
    }
    let (w, h) = (width.div_ceil(2), height.div_ceil(2));
    let mut half = Image::filled(w, h, 0.0f32);
    for y in 0..h {
        for x in 0..w {
            let of = |dx: usize, dy: usize| depth.get((2 * x + dx) as i64, (2 * y + dy) as i64).copied();
            let four = [of(0, 0), of(1, 0), of(0, 1), of(1, 1)].map(|z| z.unwrap_or(0.0));
            half[(x, y)] = farther_mean(&four);
        }
    }
    let coarse = fill(&half)?;
    let mut filled = depth.clone();
    for y in 0..height {
        for x in 0..width {
            if depth[(x, y)] <= 0.0 {
                filled[(x, y)] = interpolated(&coarse, x, y);
            }
        }
    }
    Some(filled)
}

/// Returns the mean of the depths that belong to the farthest surface; 0 without any.
fn farther_mean(depths: &[f32]) -> f32 {
    let farthest = depths.iter().copied().fold(0.0, f32::max);
    let (mut sum, mut count) = (0.0, 0.0f32);
    for &z in depths.iter().filter(|z| **z * SAME_SURFACE >= farthest && **z > 0.0) {
        sum += z;
        count += 1.0;
    }
    if count > 0.0 { sum / count } else { 0.0 }
}

/// Returns the value of a halved image at pixel (x, y) of the whole one: bilinear over those of the four values that belong to
/// the farthest surface.
fn interpolated(half: &DepthImage, x: usize, y: usize) -> f32 {
    let (u, v) = ((x as f32 + 0.5) / 2.0 - 0.5, (y as f32 + 0.5) / 2.0 - 0.5);
    let (fx, fy) = (u - u.floor(), v - v.floor());
    let at = |dx: i64, dy: i64| {
        let column = (u.floor() as i64 + dx).clamp(0, half.width as i64 - 1) as usize;
        let row = (v.floor() as i64 + dy).clamp(0, half.height as i64 - 1) as usize;
        half[(column, row)]
    };
    let four = [
        (at(0, 0), (1.0 - fx) * (1.0 - fy)),
        (at(1, 0), fx * (1.0 - fy)),
        (at(0, 1), (1.0 - fx) * fy),
        (at(1, 1), fx * fy),
    ];
    let farthest = four.iter().map(|(z, _)| *z).fold(0.0, f32::max);
    let same = four.iter().filter(|(z, _)| z * SAME_SURFACE >= farthest);
    let (sum, weight) = same.fold((0.0, 0.0), |(sum, weight), (z, w)| (sum + z * w, weight + w));
    sum / weight
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_depth_is_that_of_the_farther_surface_around_it() {
        // A near object on the left, a wall on the right, and a band without depth between them.
        let mut depth = Image::filled(32, 16, 2.0f32);
        for y in 0..16 {
            for x in 0..20 {
                depth[(x, y)] = if x < 12 { 1.0 } else { 0.0 };
            }
        }
        let filled = fill(&depth).unwrap();
        assert!(depth.data.iter().zip(&filled.data).all(|(a, b)| *a == 0.0 || a == b));
        // Beside the wall it is the wall's.
        assert!((0..16).all(|y| (filled[(19, y)] - 2.0).abs() < 1e-6));
        assert!(filled.data.iter().all(|z| (1.0..=2.0).contains(z)));
        assert!(fill(&Image::filled(3, 2, 0.0)).is_none());
    }

    #[test]
    fn a_plane_with_a_hole_is_filled_by_its_own_depth() {
        let mut depth = Image::filled(33, 21, 1.5f32);
        (8..14).for_each(|y| (10..20).for_each(|x| depth[(x, y)] = 0.0));
        assert!(fill(&depth).unwrap().data.iter().all(|z| (z - 1.5).abs() < 1e-6));
    }
}
