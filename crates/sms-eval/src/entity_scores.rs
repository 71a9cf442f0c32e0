//! Metrics of one reconstructed entity, compared with its true object.

use crate::overlap::{collision_solids, parts_overlap};
use crate::statistics::{f1, rank};
use crate::surface_index::sample_surface;
use crate::surface_scores::F1_M;
use crate::truth::{OBSERVED_SPACING_M, SurfacePoint, TrueSurface};
use rayon::prelude::*;
use sms_core::{Entity, EntityShape, Seed};

/// Number of samples of a surface before the unobserved ones are removed.
pub const SURFACE_SAMPLES: usize = 100_000;

/// Returns key and value of each surface metric. The reconstructed surface visible to the cameras is compared with the
/// truth, and the observed part of the true surface with the reconstruction. Surfaces that no camera sees do not count.
pub fn surface_figures(
    found: &TrueSurface,
    seen: &[SurfacePoint],
    truth: &TrueSurface,
    observed: &[SurfacePoint],
) -> Vec<(&'static str, f64)> {
    let distances = |points: &[SurfacePoint], to: &TrueSurface| -> Vec<f64> {
        points.par_iter().map(|s| to.distance(s.point)).collect()
    };
    let (mut off, mut missing) = (distances(seen, truth), distances(observed, found));
    let all = sample_surface(
        &found.mesh,
        ((found.mesh.area() * 1e6) as usize).clamp(1000, SURFACE_SAMPLES),
        Seed(0),
    );
    let off_all: Vec<f64> = all.par_iter().map(|&p| truth.distance(p)).collect();
    // Sorted, so that the means of the distances are summed in a fixed order.
    off.sort_by(f64::total_cmp);
    missing.sort_by(f64::total_cmp);
    let mean = |d: &[f64]| d.iter().sum::<f64>() / d.len().max(1) as f64;
    let within = |d: &[f64], at: f64| d.iter().filter(|v| **v <= at).count() as f64 / d.len().max(1) as f64;
    let f1 = |off: &[f64], at: f64| f1(within(off, at), within(&missing, at));
    let [median_m, p90_m, completion_m] =
        [rank(&mut off.clone(), 0.5), rank(&mut off.clone(), 0.9), rank(&mut missing.clone(), 0.5)];
    let chamfer_m = 0.5 * (mean(&off) + mean(&missing));
    vec![
        ("f1_2p5mm", f1(&off, F1_M)),
        ("f1_5mm", f1(&off, 0.005)),
        ("precision_2p5mm", within(&off, F1_M)),
        ("recall_2p5mm", within(&missing, F1_M)),
        ("surface_median_m", median_m),
        ("surface_p90_m", p90_m),
        ("completion_m", completion_m),
        ("chamfer_m", chamfer_m),
        ("f1_2p5mm_all", f1(&off_all, F1_M)),
        ("observed_truth_share", observed.len() as f64 / sample_count(truth)),
    ]
}

/// Returns the number of samples of a surface, including unobserved ones.
fn sample_count(truth: &TrueSurface) -> f64 {
    let spacing = OBSERVED_SPACING_M.max((truth.mesh.area() / SURFACE_SAMPLES as f64).sqrt());
    (truth.mesh.area() / (spacing * spacing)).round().max(1.0)
}

/// Returns key and value of each figure of an entity's solid: mesh, collision parts and volume.
pub fn solid_figures(entity: &Entity, truth: &TrueSurface) -> Vec<(&'static str, f64)> {
    let parts = collision_solids(entity);
    let mut figures = vec![
        ("parts", parts.len() as f64),
        ("faces", entity.mesh.triangles.len() as f64),
        ("closed", f64::from(u8::from(entity.mesh.is_closed_oriented()))),
        ("residual_m", entity.residual_m),
        ("observed_share", entity.observed_share),
    ];
    if let Some(iou) = parts_overlap(&entity.mesh, &parts) {
        figures.push(("parts_iou", iou));
    }
    let is_solid = entity.shape != EntityShape::TriMesh || entity.mesh.is_closed_oriented();
    if is_solid && (truth.sphere.is_some() || truth.mesh.is_closed_oriented()) {
        let true_volume = match truth.sphere {
            Some((_, r)) => 4.0 / 3.0 * std::f64::consts::PI * r.powi(3),
            None => truth.mesh.volume(),
        };
        let ratio = entity.mesh.volume() / true_volume;
        figures.push(("volume_ratio", ratio));
        figures.push(("volume_error", (ratio - 1.0).abs()));
    }
    figures
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::truth::observed_surface_at_most;
    use glamx::{DPose3, DVec3};
    use sms_core::{Camera, Intrinsics, Mesh};

    #[test]
    fn only_observed_surfaces_are_judged() {
        let cameras: Vec<Camera> = (0..12)
            .map(|i| {
                let angle = std::f64::consts::TAU * f64::from(i) / 12.0;
                let eye = DVec3::new(0.5 * angle.cos(), 0.5 * angle.sin(), 0.5);
                Camera::look_at(Intrinsics::from_fov(64, 48, 0.8), eye, DVec3::ZERO, DVec3::Z)
            })
            .collect();
        let cuboid = |half: DVec3, lift: f64| {
            let mesh = Mesh::cuboid(half).transformed(&DPose3::from_translation(DVec3::Z * lift));
            TrueSurface::new("box", mesh, None).unwrap()
        };
        let figures = |found: TrueSurface, truth: TrueSurface| {
            let see = |s: &TrueSurface| {
                observed_surface_at_most(std::slice::from_ref(s), &cameras, SURFACE_SAMPLES).remove(0)
            };
            let figures = surface_figures(&found, &see(&found), &truth, &see(&truth));
            move |key: &str| figures.iter().find(|f| f.0 == key).unwrap().1
        };
        let half = DVec3::splat(0.03);
        // 1 cm deeper below, where no camera looks: only the visible foot of the walls is wrong.
        let deeper = || cuboid(DVec3::new(0.03, 0.03, 0.035), -0.005);
        let f = figures(deeper(), cuboid(half, 0.0));
        assert!(f("recall_2p5mm") == 1.0 && f("surface_median_m") < 1e-12);
        // Walls of 7 cm instead of 6; their lowest 7.5 mm are wrong. The top is also visible.
        let expected = 1.0 - 4.0 * 0.06 * 0.0075 / (4.0 * 0.06 * 0.07 + 0.0036);
        assert!((f("precision_2p5mm") - expected).abs() < 2e-3, "{}", f("precision_2p5mm"));
        assert!(f("f1_2p5mm_all") < f("f1_2p5mm") - 0.05);
        assert!(f("f1_5mm") > f("f1_2p5mm"));
        // 4 mm too high, on the visible side.
        let f = figures(cuboid(DVec3::new(0.03, 0.03, 0.032), 0.002), cuboid(half, 0.0));
        assert!(f("precision_2p5mm") < 0.85 && f("recall_2p5mm") < 0.85 && f("f1_5mm") == 1.0);
        assert!(f("observed_truth_share") > 0.8 && f("observed_truth_share") < 0.85);
    }
}
