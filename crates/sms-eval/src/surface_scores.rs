//! Reconstructed surfaces, compared with true ones.

use crate::label_matching::UNMATCHED;
use crate::statistics::{f1, mean, rank};
use crate::surface_index::SurfaceIndex;
use crate::truth::{SurfacePoint, TrueSurface};
use glamx::{DPose3, DVec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sms_core::GOLDEN_ANGLE_RAD;
use sms_gaussians::GaussianModel;

/// Largest distance of a correct point, metres.
pub const F1_M: f64 = 0.0025;

/// Settings for sampling points from discs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DiscSampling {
    /// Gaussians less opaque than this are left out (the entities stage's value).
    pub min_opacity: f32,
    /// Gaussians with a less certain label are left out (the entities stage's value).
    pub min_confidence: f32,
    /// Radius of the discs, standard deviations.
    pub sigmas: f64,
    /// Points per square metre of disc.
    pub density_per_m2: f64,
}

impl Default for DiscSampling {
    fn default() -> Self {
        Self { min_opacity: 0.1, min_confidence: 0.5, sigmas: 1.0, density_per_m2: 1e6 }
    }
}

/// A reconstructed surface point with its label.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LabelledPoint {
    /// Position.
    pub point: DVec3,
    /// Label of the masks; 0 for the background.
    pub label: u16,
}

/// Returns points on the discs of the Gaussians, uniform by area (each disc is covered by a sunflower spiral),
/// transformed by `x_tw`.
pub fn disc_points(model: &GaussianModel, x_tw: &DPose3, sampling: &DiscSampling) -> Vec<LabelledPoint> {
    let mut points = Vec::new();
    for i in 0..model.len() {
        let usable = model.is_measured(i)
            && model.opacities[i] >= sampling.min_opacity
            && model.label_confidence[i] >= sampling.min_confidence
            && model.positions_w[i].is_finite()
            && model.scales[i].is_finite();
        if !usable {
            continue;
        }
        let center = model.positions_w[i].as_dvec3();
        let (_, axes) = model.disc(i);
        let [a, b] = axes.map(|(axis, sigma)| axis.as_dvec3() * (f64::from(sigma) * sampling.sigmas));
        let area = std::f64::consts::PI * a.length() * b.length();
        let count = ((area * sampling.density_per_m2).round() as usize).clamp(1, 5000);
        for k in 0..count {
            let radius = ((k as f64 + 0.5) / count as f64).sqrt();
            let (sin, cos) = (GOLDEN_ANGLE_RAD * (k + i) as f64).sin_cos();
            let p_w = center + a * (radius * cos) + b * (radius * sin);
            points.push(LabelledPoint { point: x_tw.transform_point(p_w), label: model.labels[i] });
        }
    }
    points
}

/// Scores of a surface; distances in metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SurfaceScores {
    /// Median distance of the reconstruction's points to the true surface.
    pub median_m: f64,
    /// 90 % quantile of this distance.
    pub p90_m: f64,
    /// Share of the reconstruction's points within [`F1_M`].
    pub precision: f64,
    /// Share of the observed surface's samples within [`F1_M`] of a point of the reconstruction.
    pub recall: f64,
    /// Harmonic mean of the two.
    pub f1: f64,
}

impl SurfaceScores {
    /// Scores of an object that was not found.
    pub fn missing() -> Self {
        Self { median_m: f64::NAN, p90_m: f64::NAN, precision: 0.0, recall: 0.0, f1: 0.0 }
    }
}

/// Scores points against a true surface and the samples of it that were observed.
pub fn score_surface(
    points: &[DVec3],
    distance: impl Fn(DVec3) -> f64 + Sync,
    observed: &[SurfacePoint],
) -> SurfaceScores {
    let Some(index) = SurfaceIndex::of_points(points) else { return SurfaceScores::missing() };
    let mut off: Vec<f64> = points.par_iter().map(|&p| distance(p)).collect();
    let hit: usize = observed.par_iter().filter(|s| index.closest(s.point).distance <= F1_M).count();
    let precision = off.iter().filter(|d| **d <= F1_M).count() as f64 / off.len() as f64;
    let recall = if observed.is_empty() { f64::NAN } else { hit as f64 / observed.len() as f64 };
    let (median_m, p90_m) = (rank(&mut off, 0.5), rank(&mut off, 0.9));
    SurfaceScores { median_m, p90_m, precision, recall, f1: f1(precision, recall) }
}

/// Scores of all objects.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneScores {
    /// Name and scores of each true object, in their order.
    pub objects: Vec<(String, SurfaceScores)>,
    /// Mean over the objects: of medians and quantiles over found objects, of precision, recall and F1 over all
    /// objects.
    pub mean: SurfaceScores,
    /// Number of true objects with points.
    pub found: usize,
}

/// Scores the points of each object against its surface and the samples of it that were observed.
fn scene_scores(
    points_of: &[Vec<DVec3>],
    surfaces: &[TrueSurface],
    observed: &[Vec<SurfacePoint>],
) -> SceneScores {
    let scored = surfaces.iter().zip(points_of).zip(observed).map(|((surface, points), observed)| {
        (surface.name.clone(), score_surface(points, |p| surface.distance(p), observed))
    });
    let objects: Vec<(String, SurfaceScores)> = scored.collect();
    let mean = |value: fn(&SurfaceScores) -> f64| {
        let finite: Vec<f64> = objects.iter().map(|o| value(&o.1)).filter(|v| v.is_finite()).collect();
        mean(&finite)
    };
    let found = objects.iter().filter(|o| o.1.median_m.is_finite()).count();
    let mean = SurfaceScores {
        median_m: mean(|s| s.median_m),
        p90_m: mean(|s| s.p90_m),
        precision: mean(|s| s.precision),
        recall: mean(|s| s.recall),
        f1: mean(|s| s.f1),
    };
    SceneScores { objects, mean, found }
}

/// Scores each true object by the points of its matched label: `truth_of[label]` is the true label (object index + 1;
/// 0: background, [`UNMATCHED`]: none). Distances are to the surface of this object, so that points with a wrong label
/// are errors. Points of unmatched labels are ignored; see [`stray_share`].
pub fn score_labelled(
    points: &[LabelledPoint],
    truth_of: &[u16],
    surfaces: &[TrueSurface],
    observed: &[Vec<SurfacePoint>],
) -> SceneScores {
    let mut of_object = vec![Vec::new(); surfaces.len()];
    for p in points {
        let truth = truth_of.get(usize::from(p.label)).copied().unwrap_or(UNMATCHED);
        if truth != 0 && truth != UNMATCHED && usize::from(truth) <= surfaces.len() {
            of_object[usize::from(truth) - 1].push(p.point);
        }
    }
    scene_scores(&of_object, surfaces, observed)
}

/// Returns the share of the points with an object's label whose label matches no true object.
pub fn stray_share(points: &[LabelledPoint], truth_of: &[u16]) -> f64 {
    let (mut all, mut stray) = (0usize, 0usize);
    for p in points.iter().filter(|p| p.label != 0) {
        all += 1;
        let truth = truth_of.get(usize::from(p.label)).copied().unwrap_or(UNMATCHED);
        stray += usize::from(truth == UNMATCHED || truth == 0);
    }
    stray as f64 / all.max(1) as f64
}

/// Points without labels belong to no object if they are farther than this from every object, metres.
pub const CROP_M: f64 = 0.02;

/// Scores points without labels, such as those of other programs: each point is assigned to the nearest object. It is
/// left out if the floor (z = 0) is closer, or every object is more than [`CROP_M`] away. This uses the truth to
/// separate objects from the floor, so its figures are not comparable with those of [`score_labelled`].
pub fn score_cropped(
    points: &[DVec3],
    surfaces: &[TrueSurface],
    observed: &[Vec<SurfacePoint>],
) -> SceneScores {
    let nearest: Vec<Option<usize>> = points
        .par_iter()
        .map(|&p| {
            let near = surfaces.iter().enumerate().filter(|(_, s)| is_near(s, p));
            let best = near
                .map(|(i, s)| (s.distance(p), i))
                .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))?;
            (best.0 <= CROP_M && best.0 <= p.z.abs()).then_some(best.1)
        })
        .collect();
    let mut of_object = vec![Vec::new(); surfaces.len()];
    for (p, object) in points.iter().zip(nearest) {
        if let Some(object) = object {
            of_object[object].push(*p);
        }
    }
    scene_scores(&of_object, surfaces, observed)
}

/// Returns whether a point could be closer than [`CROP_M`] to a surface, by the bounding box.
pub fn is_near(surface: &TrueSurface, p: DVec3) -> bool {
    let room = DVec3::splat(CROP_M);
    p.cmpge(surface.bounds.min - room).all() && p.cmple(surface.bounds.max + room).all()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::truth::sample_true_surface;
    use glamx::{Quat, Vec3};
    use sms_core::{Mesh, Seed};

    fn wall(name: &str, x: f64) -> TrueSurface {
        let mesh = Mesh::cuboid(DVec3::new(0.01, 0.05, 0.05));
        TrueSurface::new(name, mesh.transformed(&DPose3::from_translation(DVec3::new(x, 0.0, 0.2))), None)
            .unwrap()
    }

    /// Points 1 mm apart on the side of a wall that faces +x, offset from the wall.
    fn facing(surface: &TrueSurface, off: f64) -> (Vec<SurfacePoint>, Vec<DVec3>) {
        let mut samples = sample_true_surface(surface, 0.001, Seed(1));
        samples.retain(|s| s.normal.x > 0.9);
        let points = samples.iter().map(|s| s.point + s.normal * off).collect();
        (samples, points)
    }

    #[test]
    fn a_plane_with_an_offset_is_off_by_exactly_that() {
        let surface = wall("wall", 0.0);
        for (off, f1) in [(0.0012, 1.0), (0.003, 0.0)] {
            let (observed, points) = facing(&surface, off);
            let s = score_surface(&points, |p| surface.distance(p), &observed);
            assert!((s.median_m - off).abs() < 1e-12 && (s.p90_m - off).abs() < 1e-12, "{s:?}");
            assert_eq!(s.f1, f1);
        }
        // Half of the points are missing: precision 1, recall one half.
        let (observed, points) = facing(&surface, 0.0);
        let half: Vec<DVec3> = points.into_iter().filter(|p| p.y > 0.0).collect();
        let s = score_surface(&half, |p| surface.distance(p), &observed);
        assert!(s.precision == 1.0 && (s.recall - 0.525).abs() < 0.01, "{s:?}");
        assert!((s.f1 - 2.0 * s.recall / (1.0 + s.recall)).abs() < 1e-12);
    }

    #[test]
    fn labels_decide_which_object_a_point_is_measured_against() {
        let surfaces = [wall("a", 0.0), wall("b", 0.3)];
        let (observed_a, points_a) = facing(&surfaces[0], 0.001);
        let (observed_b, points_b) = facing(&surfaces[1], 0.002);
        let observed = [observed_a, observed_b];
        let label = |points: &[DVec3], label| {
            points.iter().map(|&point| LabelledPoint { point, label }).collect::<Vec<_>>()
        };
        let mut points = label(&points_a, 2);
        points.extend(label(&points_b, 1));
        points.extend(label(&points_b[..100], 3));
        let s = score_labelled(&points, &[0, 2, 1, UNMATCHED], &surfaces, &observed);
        assert!((s.objects[0].1.median_m - 0.001).abs() < 1e-12);
        assert!((s.mean.median_m - 0.0015).abs() < 1e-12 && s.mean.f1 == 1.0 && s.found == 2);
        let stray = stray_share(&points, &[0, 2, 1, UNMATCHED]);
        assert!((stray - 100.0 / (points_a.len() + points_b.len() + 100) as f64).abs() < 1e-12);
        // With exchanged labels, everything is wrong.
        let s = score_labelled(&points, &[0, 1, 2, UNMATCHED], &surfaces, &observed);
        assert!(s.mean.f1 == 0.0 && s.mean.median_m > 0.2);
        // An object without points is missing: it counts in F1 but not in the median.
        let s = score_labelled(&label(&points_a, 1), &[0, 1], &surfaces, &observed);
        assert!((s.mean.f1 - 0.5).abs() < 1e-12 && (s.mean.median_m - 0.001).abs() < 1e-12 && s.found == 1);
        // Without labels, the floor and points far from every object are left out.
        let mut bare: Vec<DVec3> = points_a.iter().chain(&points_b).copied().collect();
        bare.extend([DVec3::new(0.0, 0.0, 0.001), DVec3::new(5.0, 0.0, 1.0), DVec3::new(0.15, 0.0, 0.2)]);
        let s = score_cropped(&bare, &surfaces, &observed);
        assert!((s.mean.median_m - 0.0015).abs() < 1e-12 && s.mean.precision == 1.0);
    }

    #[test]
    fn points_cover_a_disc_by_area() {
        let model = GaussianModel {
            positions_w: vec![Vec3::new(0.1, 0.0, 0.0); 2],
            rotations_wg: vec![Quat::IDENTITY; 2],
            scales: vec![Vec3::new(0.02, 0.01, 0.001); 2],
            opacities: vec![0.9, 0.05],
            colors: vec![[0.5; 3]; 2],
            affinities: vec![[0.0; 16]; 2],
            labels: vec![3; 2],
            label_confidence: vec![1.0; 2],
            ..GaussianModel::default()
        };
        let x_tw = DPose3::from_translation(DVec3::Z);
        let points = disc_points(&model, &x_tw, &DiscSampling::default());
        let expected = std::f64::consts::PI * 0.02 * 0.01 * 1e6;
        assert!((points.len() as f64 - expected).abs() <= 1.0, "the transparent one is left out");
        let n = points.len() as f64;
        let mean = points.iter().map(|p| p.point).sum::<DVec3>() / n;
        assert!((mean - DVec3::new(0.1, 0.0, 1.0)).length() < 2e-4);
        // A uniform disc has a variance of a quarter of its squared radius.
        let xx = points.iter().map(|p| (p.point.x - 0.1).powi(2)).sum::<f64>() / n;
        assert!((xx / (0.02f64.powi(2) / 4.0) - 1.0).abs() < 0.02, "{xx}");
        assert!(points.iter().all(|p| p.label == 3 && (p.point.z - 1.0).abs() < 1e-9));
    }
}
