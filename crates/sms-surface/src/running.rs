//! Running means of the measurements of surface elements while frames arrive.
//!
//! [`crate::settle`] measures every element in all frames at its final place, which takes a pass over all of them. While a surface grows,
//! each frame moves the elements that it measures to the mean of what was measured so far (Newcombe et al. 2011, "KinectFusion").

use crate::config::SurfaceConfig;
use crate::measure::{SAME_SURFACE_COSINE, SideMeasurement, add_frame};
use crate::surfel::Surfel;
use glamx::DVec3;
use rayon::prelude::*;
use sms_frames::Frame;

/// The measurements of an element by the frames so far.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct RunningMean {
    /// Sum of the inverse variances, m⁻².
    weight: f64,
    /// Weighted sum of the unit normals.
    normal_w: DVec3,
}

/// Adds the measurements of `frame` to the means, one for each element, and moves and turns the elements to them.
pub fn add_measurements(
    surfels: &mut [Surfel],
    means: &mut [RunningMean],
    frame: &Frame,
    config: &SurfaceConfig,
) {
    surfels.par_iter_mut().zip(means).with_min_len(512).for_each(|(surfel, mean)| {
        // An element that was not measured before has the normal of one noisy pixel.
        let least_alike = if mean.weight == 0.0 { config.first_alike } else { SAME_SURFACE_COSINE };
        let mut sides: [SideMeasurement; 2] = Default::default();
        add_frame(&mut sides, frame, surfel, least_alike, config);
        let [front, _] = sides;
        if front.weight == 0.0 {
            return;
        }
        mean.weight += front.weight;
        mean.normal_w += front.normal_w;
        surfel.p_w += surfel.n_w * (front.offset / mean.weight);
        surfel.sigma_m = mean.weight.sqrt().recip();
        surfel.n_w = mean.normal_w.try_normalize().unwrap_or(surfel.n_w);
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{config, facing_plane};
    use crate::{WallSide, grow, settle};
    use sms_core::{Cancel, Seed, standard_normal};

    #[test]
    fn means_of_frame_after_frame_are_those_of_all_frames_at_once() {
        let (config, mut rng) = (config(), Seed(7).rng());
        let mut noisy = |i: usize| {
            let mut frame = facing_plane(0.5 + 0.01 * i as f64, 0.0);
            let sigma_m = frame.depth_noise.sigma_m(0.5);
            frame.depth.data.iter_mut().for_each(|z| *z += (sigma_m * standard_normal(&mut rng)) as f32);
            frame
        };
        let frames: Vec<Frame> = (0..12).map(&mut noisy).collect();
        let (mut running, mut means) = (Vec::new(), Vec::new());
        for (slot, frame) in frames.iter().enumerate() {
            grow(&mut running, frame, slot, &config, Seed(3).derive_index("frame", slot as u64));
            means.resize(running.len(), RunningMean::default());
            add_measurements(&mut running, &mut means, frame, &config);
        }
        let mut settled = running.clone();
        let views: Vec<&Frame> = frames.iter().collect();
        settle(&mut settled, &views, &config, WallSide::Normal, &Cancel::new()).unwrap();
        let first = running.iter().zip(&settled).filter(|(a, _)| a.seed.slot == 0);
        let (mut apart, mut height, mut count) = (0.0, 0.0, 0.0);
        for (a, b) in first {
            apart += (a.p_w.z - b.p_w.z).powi(2);
            height += b.p_w.z.powi(2);
            count += 1.0;
            assert!((a.sigma_m / b.sigma_m - 1.0).abs() < 0.1, "{} {}", a.sigma_m, b.sigma_m);
        }
        // What remains of the noise of one frame, and the difference of the two, which comes from gates and normals.
        let (apart, height) = (f64::sqrt(apart / count), f64::sqrt(height / count));
        assert!(count > 100.0 && apart < 0.3 * height, "{apart} {height} {count}");
    }

    #[test]
    fn what_a_frame_does_not_measure_stays() {
        let config = config();
        let (mut surfels, frame) = (Vec::new(), facing_plane(0.5, 0.0));
        grow(&mut surfels, &frame, 0, &config, Seed(1));
        let before = surfels.clone();
        let mut means = vec![RunningMean::default(); surfels.len()];
        add_measurements(&mut surfels, &mut means, &facing_plane(-0.5, -0.003), &config);
        assert_eq!(surfels, before, "the other face of a wall");
        assert!(means.iter().all(|m| *m == RunningMean::default()));
    }
}
