//! The fused surface of all frames with its labels.

use crate::config::EnvironmentConfig;
use crate::views::Views;
use glamx::DVec3;
use sms_core::{Cancel, CoreError, Seed};
use sms_frames::Frame;
use sms_mesh::cloud::thin;
use sms_surface::SurfaceConfig;

/// A point of the surface.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SurfacePoint {
    pub(crate) p_w: DVec3,
    /// Unit normal towards free space.
    pub(crate) n_w: DVec3,
    /// Largest distance from a place of the surface around it to the nearest point, metres.
    pub(crate) spacing_m: f64,
    /// The label that most frames have for it.
    pub(crate) label: u16,
}

/// Fuses all frames, and thins the surface to the spacing of static meshes.
///
/// # Errors
/// [`CoreError::Interrupted`] when cancelled.
pub(crate) fn fused_surface(
    views: &Views<'_>,
    settings: &EnvironmentConfig,
    seed: Seed,
    cancel: &Cancel,
) -> Result<Vec<SurfacePoint>, CoreError> {
    let frames: Vec<&Frame> = views.sequence.frames.iter().collect();
    let surfels = sms_surface::fuse(&frames, &SurfaceConfig::default(), seed, cancel)?;
    let points_w: Vec<DVec3> = surfels.iter().map(|s| s.p_w).collect();
    let normals_w: Vec<DVec3> = surfels.iter().map(|s| s.n_w).collect();
    let kept = thin(&points_w, &normals_w, settings.spacing);
    let thinned_w: Vec<DVec3> = kept.iter().map(|&i| points_w[i]).collect();
    let labels = views.labels_of(&thinned_w);
    let points = kept.into_iter().zip(labels).filter_map(|(i, label)| {
        // A removed element is within the spacing of a kept one.
        let spacing_m = surfels[i].spacing_m + settings.spacing;
        Some(SurfacePoint { p_w: points_w[i], n_w: normals_w[i], spacing_m, label: label? })
    });
    Ok(points.collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::over_plate;

    #[test]
    fn surface_that_more_frames_see_through_than_measure_is_left_out() {
        let (mut sequence, labels) = over_plate(6, 100);
        for frame in &mut sequence.frames[..2] {
            for y in 40..60 {
                (40..60).for_each(|x| frame.depth[(x, y)] *= 0.8);
            }
        }
        let floating = |views: &Views<'_>| {
            let points =
                fused_surface(views, &EnvironmentConfig::default(), Seed(3), &Cancel::new()).unwrap();
            points.iter().filter(|p| p.p_w.z > 0.05).count()
        };
        assert_eq!(floating(&Views::new(&sequence, &labels)), 0);
        sequence.frames.truncate(2);
        let labels = sms_core::Labels { maps: labels.maps[..2].to_vec(), ..labels };
        assert!(floating(&Views::new(&sequence, &labels)) > 50);
    }

    #[test]
    fn surface_that_one_of_six_frames_measures_stays() {
        let (mut sequence, labels) = over_plate(6, 100);
        for frame in &mut sequence.frames[1..] {
            for y in 0..100 {
                (60..100).for_each(|x| frame.depth[(x, y)] = 0.0);
            }
        }
        let views = Views::new(&sequence, &labels);
        let points = fused_surface(&views, &EnvironmentConfig::default(), Seed(3), &Cancel::new()).unwrap();
        let shown =
            |p: &SurfacePoint| sequence.frames[0].camera.project(p.p_w).is_some_and(|(u, ..)| u > 70.0);
        assert!(points.iter().filter(|p| shown(p)).count() > 50);
    }

    #[test]
    fn the_label_of_a_point_is_that_of_most_frames() {
        let (sequence, mut labels) = over_plate(3, 100);
        labels.maps[0].data.fill(1);
        let views = Views::new(&sequence, &labels);
        let points = fused_surface(&views, &EnvironmentConfig::default(), Seed(3), &Cancel::new()).unwrap();
        let left =
            |p: &SurfacePoint| sequence.frames[0].camera.project(p.p_w).is_some_and(|(u, _, _)| u < 49.0);
        let right =
            |p: &SurfacePoint| sequence.frames[0].camera.project(p.p_w).is_some_and(|(u, _, _)| u > 51.0);
        assert!(points.iter().filter(|p| left(p)).all(|p| p.label == 1));
        assert!(points.iter().filter(|p| right(p)).all(|p| p.label == sms_core::BACKGROUND));
        assert!(points.iter().filter(|p| left(p)).count() > 300);
    }
}
