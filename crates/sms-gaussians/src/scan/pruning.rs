//! Removal of Gaussians: transparent ones, and floaters in front of the measured surface.

use super::config::ScanConfig;
use super::nearby::map_nearby;
use crate::Trainer;
use glamx::Vec3;
use rayon::prelude::*;
use sms_frames::Frame;

/// Removes Gaussians below the opacity threshold.
pub(crate) fn prune_transparent(trainer: &mut dyn Trainer, config: &ScanConfig) {
    let keep: Vec<bool> = trainer.opacities().iter().map(|&o| o >= config.pruning.opacity_below).collect();
    if keep.contains(&false) {
        trainer.retain(&keep);
    }
}

/// Removes Gaussians below the opacity threshold and, if enabled, floaters. A floater has more `frames` that see
/// through it than frames that measure a surface near it, or fewer than `least` of the latter. Returns the centres of
/// the remaining Gaussians.
pub(crate) fn prune_all(
    trainer: &mut dyn Trainer,
    frames: &[&Frame],
    least: usize,
    config: &ScanConfig,
) -> Vec<Vec3> {
    let (positions_w, opacities) = trainer.places();
    let stands =
        if config.pruning.floaters { standing(&positions_w, frames, least, config) } else { Vec::new() };
    let stands = |i: usize| stands.get(i).is_none_or(|stands| *stands);
    let opaque = |o: f32| o >= config.pruning.opacity_below;
    let keep: Vec<bool> = opacities.iter().enumerate().map(|(i, o)| opaque(*o) && stands(i)).collect();
    if keep.contains(&false) {
        trainer.retain(&keep);
    }
    positions_w.into_iter().zip(keep).filter_map(|(p, keep)| keep.then_some(p)).collect()
}

/// Marks the points with at least `least` frames that measure a surface near them, and not more frames that see through
/// them.
fn standing(positions_w: &[Vec3], frames: &[&Frame], least: usize, config: &ScanConfig) -> Vec<bool> {
    // Counts frames that see through a point, and frames that measure a surface near it.
    let add = |(through, surface): &mut (usize, usize), frame: &Frame, p_w: Vec3| {
        let sight = sight(frame, p_w, config);
        *through += usize::from(sight == PointVisibility::Through);
        *surface += usize::from(sight == PointVisibility::Surface);
    };
    let stands = |(through, surface): (usize, usize)| surface >= through.max(least);
    if let [frame] = frames {
        // Frame by frame, so that the depth image stays in the caches.
        let of_point = |p_w: &Vec3| {
            let mut counts = (0, 0);
            add(&mut counts, frame, *p_w);
            stands(counts)
        };
        return positions_w.par_iter().with_min_len(1024).map(of_point).collect();
    }
    map_nearby(positions_w, |group| {
        let mut counts = vec![(0, 0); group.len()];
        for frame in frames {
            for (&i, counts) in group.iter().zip(&mut counts) {
                add(counts, frame, positions_w[i as usize]);
            }
        }
        counts.into_iter().map(stands).collect()
    })
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum PointVisibility {
    /// Every measured neighbour is behind the point.
    Through,
    /// A measured neighbour is at the point.
    Surface,
    /// Hidden, outside the image, or with too few measurements.
    Unknown,
}

/// Classifies a point by all of the 3 × 3 pixels around it in one frame: next to a silhouette, a single pixel may show
/// the background.
fn sight(frame: &Frame, p_w: Vec3, config: &ScanConfig) -> PointVisibility {
    let Some((u, v, z)) = frame.camera.project(p_w.as_dvec3()) else { return PointVisibility::Unknown };
    let Some((x, y)) = frame.camera.pixel_at(u, v) else { return PointVisibility::Unknown };
    let (mut measured, mut behind) = (0, 0);
    for dy in -1..=1 {
        for dx in -1..=1 {
            let Some(&depth) = frame.depth.get(x as i64 + dx, y as i64 + dy) else { continue };
            if depth <= 0.0 {
                continue;
            }
            measured += 1;
            let (depth, tolerance) =
                (f64::from(depth), config.tolerance_m(&frame.depth_noise, f64::from(depth)));
            if (depth - z).abs() <= tolerance {
                return PointVisibility::Surface;
            }
            behind += usize::from(depth - z > tolerance);
        }
    }
    if measured >= 5 && behind == measured { PointVisibility::Through } else { PointVisibility::Unknown }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DPose3;
    use sms_core::{Camera, Image, Intrinsics};

    /// A camera at the origin before a wall at 1 m with a step to 0.5 m in the left half.
    fn frame() -> Frame {
        let k = Intrinsics::from_fov(32, 20, 1.0);
        let mut depth = Image::filled(32, 20, 1.0f32);
        for y in 0..20 {
            for x in 0..16 {
                depth[(x, y)] = 0.5;
            }
        }
        Frame {
            depth_noise: sms_frames::DepthNoise::default(),
            index: 0,
            time_s: None,
            camera: Camera::new(k, DPose3::identity()),
            color: Image::filled(32, 20, [0; 3]),
            depth,
            normal_c: Image::filled(32, 20, [0.0, 0.0, -1.0]),
            color_path: "".into(),
            mask_path: None,
        }
    }

    #[test]
    fn a_point_is_seen_through_only_when_all_that_is_measured_round_it_lies_behind() {
        let (frame, config) = (frame(), ScanConfig::default());
        let at = |x: usize, z: f64| sight(&frame, frame.camera.unproject_pixel(x, 10, z).as_vec3(), &config);
        assert_eq!(at(24, 0.5), PointVisibility::Through);
        assert_eq!(at(24, 1.002), PointVisibility::Surface);
        assert_eq!(at(24, 1.1), PointVisibility::Unknown, "hidden by the wall");
        assert_eq!(at(16, 0.5), PointVisibility::Surface, "one pixel beside the step");
        let mut sparse = frame.clone();
        sparse.depth.data.iter_mut().enumerate().filter(|(i, _)| i % 2 == 0).for_each(|(_, z)| *z = 0.0);
        let p_w = sparse.camera.unproject_pixel(24, 10, 0.5).as_vec3();
        assert_ne!(sight(&sparse, p_w, &config), PointVisibility::Surface);
        assert_eq!(sight(&sparse, Vec3::new(0.0, 0.0, -1.0), &config), PointVisibility::Unknown);
    }
}
