//! One surface from all frames of a posed RGB-D sequence, as oriented surface elements (surfels).
//!
//! [`fuse`] adds elements frame after frame, moves every element onto the weighted mean of the measurements of
//! all frames ([`settle`]), as in projective fusion of depth (Curless and Levoy, SIGGRAPH 1996), and removes those that more frames contradict than
//! measure. Elements have a side: the two faces of a thin wall are fused apart.

mod config;
mod grow;
mod measure;
mod nearby;
mod point;
mod running;
mod surfel;

#[cfg(test)]
mod fixture;

pub use config::{SurfaceConfig, SurfaceTolerance};
pub use grow::grow;
pub use measure::{PointVisibility, SAME_SURFACE_COSINE, WallSide, settle, standing, visibility};
pub use nearby::map_nearby;
pub use point::{MeasuredPoint, measured_point};
pub use running::{RunningMean, add_measurements};
pub use surfel::{SeedPixel, Surfel};

use measure::supported;
use sms_core::{Cancel, CoreError, Seed};
use sms_frames::Frame;

/// Fuses frames into one surface. The same frames and seed give the same surface, for any number of threads.
///
/// # Errors
/// [`CoreError::Interrupted`] when cancelled.
pub fn fuse(
    frames: &[&Frame],
    config: &SurfaceConfig,
    seed: Seed,
    cancel: &Cancel,
) -> Result<Vec<Surfel>, CoreError> {
    let mut surfels = Vec::new();
    for (slot, frame) in frames.iter().enumerate() {
        cancel.check()?;
        grow(&mut surfels, frame, slot, config, seed.derive_index("frame", slot as u64));
    }
    settle(&mut surfels, frames, config, WallSide::Normal, cancel)?;
    let mut kept = supported(&surfels, frames, &config.tolerance).into_iter();
    cancel.check()?;
    surfels.retain(|_| kept.next().unwrap_or(true));
    Ok(surfels)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{config, facing_plane};
    use rand::RngExt;

    /// Frames from several heights above the plane z = 0, with noise of the stated standard deviation.
    fn noisy_frames(count: usize) -> Vec<Frame> {
        let mut rng = Seed(7).rng();
        let frame = |i: usize| {
            let mut frame = facing_plane(0.5 + 0.01 * i as f64, 0.0);
            let sigma = frame.depth_noise.sigma_m(0.5);
            for z in &mut frame.depth.data {
                // The sum of twelve uniform numbers has a variance of one.
                let normal: f64 = (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
                *z += (sigma * normal) as f32;
            }
            frame
        };
        (0..count).map(frame).collect()
    }

    fn rms_height_m(surfels: &[Surfel]) -> f64 {
        (surfels.iter().map(|s| s.p_w.z * s.p_w.z).sum::<f64>() / surfels.len() as f64).sqrt()
    }

    #[test]
    fn noise_falls_with_the_number_of_frames_and_threads_do_not_matter() {
        let frames = noisy_frames(16);
        let sigma = frames[0].depth_noise.sigma_m(0.5);
        let of = |count: usize| {
            let frames: Vec<&Frame> = frames[..count].iter().collect();
            fuse(&frames, &config(), Seed(3), &Cancel::new()).unwrap()
        };
        // Each frame contributes one pixel if the element lies at its centre, and 2.25 independent ones in the mean over all places.
        for count in [4, 16] {
            let surfels = of(count);
            let (rms_m, stated_m) = (rms_height_m(&surfels), surfels.iter().map(|s| s.sigma_m));
            let stated_m = stated_m.sum::<f64>() / surfels.len() as f64;
            assert!((1.0..1.7).contains(&(stated_m / rms_m)), "{count} frames: {stated_m} {rms_m}");
            let gain = sigma / rms_m / (count as f64).sqrt();
            assert!((0.95..1.55).contains(&gain), "{count} frames: {gain}");
        }
        let single = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        assert_eq!(single.install(|| of(16)), of(16));
    }

    #[test]
    fn both_faces_of_a_thin_wall_stay_however_often_each_is_seen() {
        // A wall of 3 mm, seen three times from above and once from below.
        let above = facing_plane(0.5, 0.0);
        let below = facing_plane(-0.5, -0.003);
        let surfels = fuse(&[&above, &above, &below, &above], &config(), Seed(3), &Cancel::new()).unwrap();
        let (upper, lower): (Vec<&Surfel>, Vec<&Surfel>) = surfels.iter().partition(|s| s.n_w.z > 0.0);
        assert!(lower.len() > upper.len() / 2, "{} {}", upper.len(), lower.len());
        assert!(upper.iter().all(|s| s.p_w.z.abs() < 1e-6));
        assert!(lower.iter().all(|s| (s.p_w.z + 0.003).abs() < 1e-6));
    }

    #[test]
    fn points_in_the_air_of_one_frame_are_removed() {
        let mut frames = noisy_frames(4);
        for y in 10..14 {
            (20..24).for_each(|x| frames[0].depth[(x, y)] = 0.3);
        }
        let frames: Vec<&Frame> = frames.iter().collect();
        let surfels = fuse(&frames, &config(), Seed(3), &Cancel::new()).unwrap();
        assert!(!surfels.is_empty() && surfels.iter().all(|s| s.p_w.z.abs() < 0.02));
    }

    #[test]
    fn frames_without_usable_depth_have_no_surface() {
        let of = |frames: &[&Frame]| fuse(frames, &config(), Seed(3), &Cancel::new()).unwrap();
        assert!(of(&[]).is_empty());
        for z in [0.0, f32::NAN, f32::INFINITY, -1.0] {
            let mut frame = facing_plane(0.5, 0.0);
            frame.depth.data.fill(z);
            assert!(of(&[&frame, &frame]).is_empty(), "{z}");
        }
        let mut bare = facing_plane(0.5, 0.0);
        bare.normal_c.data.fill([0.0; 3]);
        assert!(of(&[&bare]).is_empty());
    }

    #[test]
    fn a_cancelled_fusion_is_interrupted() {
        let (frames, cancel) = (noisy_frames(2), Cancel::new());
        cancel.cancel();
        let result = fuse(&frames.iter().collect::<Vec<_>>(), &config(), Seed(3), &cancel);
        assert!(matches!(result, Err(CoreError::Interrupted)));
    }
}
