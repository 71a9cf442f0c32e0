//! The fused surface of all frames with its labels, and open meshes of parts of it.
//!
//! A surface that does not move needs no volume: the environment and bodies that are kept fixed are exactly the measured surface.

use crate::config::EnvironmentConfig;
use crate::views::Views;
use glamx::DVec3;
use sms_core::{Cancel, CoreError, Mesh, Seed};
use sms_frames::Frame;
use sms_mesh::{cloud::thin, simplify, taubin, triangulate};
use sms_surface::SurfaceConfig;
use std::collections::BTreeMap;

/// Decimation errors, tried in this order until the face budget is met, metres.
const DECIMATION_ERRORS: [f64; 3] = [0.002, 0.004, 0.008];

/// Points of an open surface.
#[derive(Debug, Clone, Default)]
pub(crate) struct SurfacePoints {
    pub(crate) points_w: Vec<DVec3>,
    /// Unit normals towards free space.
    pub(crate) normals_w: Vec<DVec3>,
    /// Largest distances from places of the surface to their nearest point, metres.
    pub(crate) spacings_m: Vec<f64>,
}

impl SurfacePoints {
    pub(crate) fn push(&mut self, p_w: DVec3, normal_w: DVec3, spacing_m: f64) {
        self.points_w.push(p_w);
        self.normals_w.push(normal_w);
        self.spacings_m.push(spacing_m);
    }

    pub(crate) fn extend(&mut self, other: Self) {
        self.points_w.extend(other.points_w);
        self.normals_w.extend(other.normals_w);
        self.spacings_m.extend(other.spacings_m);
    }

    /// Returns the smoothed open mesh through the points.
    pub(crate) fn mesh(&self, settings: &EnvironmentConfig) -> Mesh {
        let mut mesh = triangulate(&self.points_w, &self.normals_w, &self.spacings_m);
        smooth_open(&mut mesh, 0.5 * settings.spacing);
        mesh
    }
}

/// The fused surface, thinned to the voxel of the environment.
pub(crate) struct FusedSurface {
    surface: SurfacePoints,
    /// The label that most frames have for each point.
    labels: Vec<u16>,
}

impl FusedSurface {
    /// Fuses all frames.
    ///
    /// # Errors
    /// [`CoreError::Interrupted`] when cancelled.
    pub(crate) fn of(
        views: &Views<'_>,
        settings: &EnvironmentConfig,
        seed: Seed,
        cancel: &Cancel,
    ) -> Result<Self, CoreError> {
        let frames: Vec<&Frame> = views.sequence.frames.iter().collect();
        let surfels = sms_surface::fuse(&frames, &SurfaceConfig::default(), seed, cancel)?;
        let points_w: Vec<DVec3> = surfels.iter().map(|s| s.p_w).collect();
        let normals_w: Vec<DVec3> = surfels.iter().map(|s| s.n_w).collect();
        let kept = thin(&points_w, &normals_w, settings.spacing);
        let thinned_w: Vec<DVec3> = kept.iter().map(|&i| points_w[i]).collect();
        let mut fused = Self { surface: SurfacePoints::default(), labels: Vec::new() };
        for (i, label) in kept.into_iter().zip(views.labels_of(&thinned_w)) {
            if let Some(label) = label {
                // A removed element is within the spacing of a kept one.
                fused.surface.push(points_w[i], normals_w[i], surfels[i].spacing_m + settings.spacing);
                fused.labels.push(label);
            }
        }
        Ok(fused)
    }

    /// Returns the points that `is_part` accepts by place, normal and label.
    pub(crate) fn part(&self, is_part: impl Fn(DVec3, DVec3, u16) -> bool) -> SurfacePoints {
        let mut part = SurfacePoints::default();
        let all = &self.surface;
        for (i, &label) in self.labels.iter().enumerate() {
            if is_part(all.points_w[i], all.normals_w[i], label) {
                part.push(all.points_w[i], all.normals_w[i], all.spacings_m[i]);
            }
        }
        part
    }
}

/// Returns the open mesh with at most `budget` faces if the surface moves by no more than the largest decimation error.
pub(crate) fn within_faces(mesh: Mesh, budget: usize) -> Mesh {
    DECIMATION_ERRORS.iter().fold(mesh, |mesh, &error_m| {
        if mesh.triangles.len() > budget { simplify(&mesh, budget, error_m) } else { mesh }
    })
}

/// Taubin smoothing that does not move the boundary of an open mesh.
fn smooth_open(mesh: &mut Mesh, limit: f64) {
    let mut edges: BTreeMap<(u32, u32), i32> = BTreeMap::new();
    for &[a, b, c] in &mesh.triangles {
        for (i, j) in [(a, b), (b, c), (c, a)] {
            *edges.entry((i.min(j), i.max(j))).or_default() += if i < j { 1 } else { -1 };
        }
    }
    let mut rim = vec![false; mesh.vertices.len()];
    for ((a, b), count) in edges {
        if count != 0 {
            rim[a as usize] = true;
            rim[b as usize] = true;
        }
    }
    taubin(mesh, &rim, 6, limit);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::over_plate;

    /// The areas of the labelled and of the unlabelled part, square metres.
    fn areas(fused: &FusedSurface) -> [f64; 2] {
        let settings = EnvironmentConfig::default();
        [1, sms_core::BACKGROUND]
            .map(|wanted| fused.part(|_, _, label| label == wanted).mesh(&settings).area())
    }

    fn fused(views: &Views<'_>) -> FusedSurface {
        FusedSurface::of(views, &EnvironmentConfig::default(), Seed(3), &Cancel::new()).unwrap()
    }

    #[test]
    fn every_part_of_a_plate_has_the_surface_of_its_label() {
        let (sequence, labels) = over_plate(3, 100);
        let [labelled, unlabelled] = areas(&fused(&Views::new(&sequence, &labels)));
        assert!((0.46..0.505).contains(&labelled), "{labelled}");
        assert!((0.46..0.505).contains(&unlabelled), "{unlabelled}");
    }

    #[test]
    fn surface_that_more_frames_see_through_than_measure_is_left_out() {
        let (mut sequence, labels) = over_plate(6, 100);
        for frame in &mut sequence.frames[..2] {
            for y in 40..60 {
                (40..60).for_each(|x| frame.depth[(x, y)] *= 0.8);
            }
        }
        let floating = |fused: &FusedSurface| fused.part(|p, _, _| p.z > 0.05).points_w.len();
        assert_eq!(floating(&fused(&Views::new(&sequence, &labels))), 0);
        sequence.frames.truncate(2);
        let labels = sms_core::Labels { maps: labels.maps[..2].to_vec(), ..labels };
        assert!(floating(&fused(&Views::new(&sequence, &labels))) > 50);
    }

    #[test]
    fn decimation_keeps_a_flat_surface_and_meets_the_budget() {
        let (sequence, labels) = over_plate(3, 100);
        let mesh =
            fused(&Views::new(&sequence, &labels)).part(|_, _, _| true).mesh(&EnvironmentConfig::default());
        let few = within_faces(mesh.clone(), 200);
        assert!(few.triangles.len() <= 200 && mesh.triangles.len() > 1000);
        assert!((few.area() / mesh.area() - 1.0).abs() < 0.01);
    }
}
