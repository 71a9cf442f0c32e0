//! The entities of a scanned scene against its truth.

use super::MaterializeOptions;
use super::overlap::{collision_solids, parts_overlap};
use super::placed::placed_figures;
use super::trained::{SAMPLES, Trained, train};
use crate::BenchError;
use crate::prepare::Timer;
use crate::scenes::BenchScene;
use crate::surface::{F1_M, UNMATCHED};
use crate::truth::{SurfacePoint, TrueSurface, observed_surface_at_most};
use rayon::prelude::*;
use sms_core::metrics::Metrics;
use sms_core::{Cancel, CoreError, Entity, EntityKind, EntityShape, Mesh, Progress, Seed, Warnings};
use sms_entities::{EntitySet, build_entities};
use sms_report::sample_surface;
use std::path::Path;

/// The entities stage's seed; `sms materialize` has the same default.
const SEED: Seed = Seed(0);

/// Makes the entities of a scene (from a kept scan where there is one) and measures them; keys are
/// `bench.materialize.{scene}.…` (see `docs/metrics.md`). The meshes come to `keep/meshes/{scene}/` as OBJ in the truth's
/// world. `None` where there is nothing to measure: a model that is not there, or a real recording.
///
/// # Errors
/// [`BenchError`] of the stage that failed.
pub fn run_materialize(
    scene: &BenchScene,
    options: &MaterializeOptions,
    progress: &dyn Progress,
    cancel: &Cancel,
    warnings: &Warnings,
) -> Result<Option<Metrics>, BenchError> {
    let Some(trained) = train(scene, options, progress, cancel, warnings)? else { return Ok(None) };
    let config = &options.bench.entities;
    let timer = Timer::start();
    let set = build_entities(
        &trained.model,
        &trained.sequence,
        &trained.labels,
        config,
        SEED,
        progress,
        cancel,
        warnings,
    )?;
    let (seconds, cpu_seconds) = timer.seconds();

    let measured = measure(&trained, &set);
    let prefix = format!("bench.materialize.{scene}.");
    let mut metrics = Metrics::new();
    metrics.set(format!("{prefix}seconds"), seconds);
    metrics.set(format!("{prefix}cpu_seconds"), cpu_seconds);
    let dynamic = set.entities.iter().filter(|e| e.kind == EntityKind::Dynamic).count();
    metrics.set(format!("{prefix}masks"), if trained.true_masks { "truth" } else { "geometry" });
    let found = measured.iter().filter(|m| m.entity.is_some()).count();
    metrics.set(format!("{prefix}objects"), measured.len());
    metrics.set(format!("{prefix}found"), found);
    metrics.set(format!("{prefix}strays"), dynamic - found);
    for (key, value) in [
        ("scan_seconds", trained.inputs.scan_seconds),
        ("masks_iou", trained.inputs.masks_iou),
        ("gaussians_median_m", trained.inputs.gaussians_median_m.unwrap_or(f64::NAN)),
        ("gaussians_f1_2p5mm", trained.inputs.gaussians_f1_2p5mm),
    ] {
        metrics.set(format!("{prefix}{key}"), value);
    }
    let folder = options.keep.join("meshes").join(scene.to_string());
    for object in &measured {
        object.write(&trained, &set, &folder)?;
    }
    match (&measured[..], scene) {
        ([one], BenchScene::Model(_)) => {
            if let Some(entity) = one.entity.map(|i| &set.entities[i]) {
                metrics.set(format!("{prefix}shape"), shape_name(&entity.shape));
            }
            for (key, value) in &one.figures {
                metrics.set(format!("{prefix}{key}"), *value);
            }
        }
        _ => {
            // Of scenes with several objects each, and the mean over them.
            for object in &measured {
                if let Some(entity) = object.entity.map(|i| &set.entities[i]) {
                    metrics.set(format!("{prefix}{}.shape", object.name), shape_name(&entity.shape));
                }
                for (key, value) in &object.figures {
                    metrics.set(format!("{prefix}{}.{key}", object.name), *value);
                }
            }
            for (key, mean) in means(&measured) {
                metrics.set(format!("{prefix}{key}"), mean);
            }
        }
    }
    Ok(Some(metrics))
}

/// A true object and what became of it.
struct Measured {
    name: String,
    /// Index of the entity that stands for it.
    entity: Option<usize>,
    figures: Vec<(&'static str, f64)>,
}

impl Measured {
    /// Writes mesh and collision solids in the truth's world.
    fn write(&self, trained: &Trained, set: &EntitySet, folder: &Path) -> Result<(), CoreError> {
        let Some(entity) = self.entity.map(|i| &set.entities[i]) else { return Ok(()) };
        let x_tw = trained.sequence.x_world_recording.inverse();
        entity.mesh.transformed(&x_tw).write_obj(&folder.join(format!("{}.obj", self.name)))?;
        let mut parts = Mesh::default();
        for part in collision_solids(entity) {
            let first = parts.vertices.len() as u32;
            parts.vertices.extend(part.vertices);
            parts.triangles.extend(part.triangles.iter().map(|t| t.map(|i| i + first)));
        }
        parts.transformed(&x_tw).write_obj(&folder.join(format!("{}_parts.obj", self.name)))?;
        if let Some(truth) = trained.surfaces.iter().find(|s| s.name == self.name) {
            truth.mesh.write_obj(&folder.join(format!("{}_truth.obj", self.name)))?;
        }
        Ok(())
    }
}

/// The mean of each figure over the objects that have it.
fn means(measured: &[Measured]) -> Vec<(&'static str, f64)> {
    let mut keys: Vec<&'static str> = Vec::new();
    for (key, _) in measured.iter().flat_map(|m| &m.figures) {
        if !keys.contains(key) {
            keys.push(key);
        }
    }
    keys.into_iter()
        .map(|key| {
            let values = measured.iter().flat_map(|m| &m.figures).filter(|(k, _)| *k == key);
            let values: Vec<f64> = values.map(|(_, v)| *v).collect();
            (key, values.iter().sum::<f64>() / values.len() as f64)
        })
        .collect()
}

fn shape_name(shape: &EntityShape) -> &'static str {
    match shape {
        EntityShape::Sphere { .. } => "sphere",
        EntityShape::Box { .. } => "box",
        EntityShape::Cylinder { .. } => "cylinder",
        EntityShape::Convex => "convex",
        EntityShape::TriMesh => "trimesh",
    }
}

fn measure(trained: &Trained, set: &EntitySet) -> Vec<Measured> {
    let x_tw = trained.sequence.x_world_recording.inverse();
    // Everything that was made hides: also what stands for no object.
    let mut found: Vec<(usize, TrueSurface)> = Vec::new();
    for (i, entity) in set.entities.iter().enumerate() {
        if entity.kind == EntityKind::Dynamic {
            let mesh = entity.mesh.transformed(&x_tw);
            found.extend(TrueSurface::new(entity.name.clone(), mesh, None).map(|s| (i, s)));
        }
    }
    let (indices, found): (Vec<usize>, Vec<TrueSurface>) = found.into_iter().unzip();
    let seen = observed_surface_at_most(&found, &trained.cameras_t, SAMPLES);
    let label_of = |k: usize| usize::from(set.entities[indices[k]].label);
    trained
        .surfaces
        .iter()
        .enumerate()
        .map(|(t, truth)| {
            let stands = |k: &usize| {
                trained
                    .truth_of
                    .get(label_of(*k))
                    .is_some_and(|&of| of != UNMATCHED && usize::from(of) == t + 1)
            };
            let Some(k) = (0..found.len()).find(stands) else {
                let figures = vec![("f1_2p5mm", 0.0), ("f1_5mm", 0.0)];
                return Measured { name: truth.name.clone(), entity: None, figures };
            };
            let entity = &set.entities[indices[k]];
            let mut figures = surface_figures(&found[k], &seen[k], truth, &trained.observed[t]);
            figures.extend(solid_figures(entity, truth));
            figures.extend(placed_figures(entity, &x_tw, truth));
            Measured { name: truth.name.clone(), entity: Some(indices[k]), figures }
        })
        .collect()
}

/// How far the surface that the cameras would see of the reconstruction is from the truth, and the surface that they saw of
/// the truth from the reconstruction. What no camera sees is not judged, in neither direction.
fn surface_figures(
    found: &TrueSurface,
    seen: &[SurfacePoint],
    truth: &TrueSurface,
    observed: &[SurfacePoint],
) -> Vec<(&'static str, f64)> {
    let distances = |points: &[SurfacePoint], to: &TrueSurface| -> Vec<f64> {
        let mut d: Vec<f64> = points.par_iter().map(|s| to.distance(s.point)).collect();
        d.sort_by(f64::total_cmp);
        d
    };
    let (off, missing) = (distances(seen, truth), distances(observed, found));
    let all = sample_surface(&found.mesh, ((found.mesh.area() * 1e6) as usize).clamp(1000, SAMPLES), SEED);
    let mut off_all: Vec<f64> = all.par_iter().map(|&p| truth.distance(p)).collect();
    off_all.sort_by(f64::total_cmp);
    let quantile = |d: &[f64], q: f64| match d.len() {
        0 => f64::NAN,
        n => d[((n - 1) as f64 * q).round() as usize],
    };
    let mean = |d: &[f64]| d.iter().sum::<f64>() / d.len().max(1) as f64;
    let within = |d: &[f64], at: f64| d.partition_point(|v| *v <= at) as f64 / d.len().max(1) as f64;
    let f1 = |off: &[f64], at: f64| {
        let (p, r) = (within(off, at), within(&missing, at));
        if p + r > 0.0 { 2.0 * p * r / (p + r) } else { 0.0 }
    };
    vec![
        ("f1_2p5mm", f1(&off, F1_M)),
        ("f1_5mm", f1(&off, 0.005)),
        ("precision_2p5mm", within(&off, F1_M)),
        ("recall_2p5mm", within(&missing, F1_M)),
        ("surface_median_m", quantile(&off, 0.5)),
        ("surface_p90_m", quantile(&off, 0.9)),
        ("completion_m", quantile(&missing, 0.5)),
        ("chamfer_m", 0.5 * (mean(&off) + mean(&missing))),
        ("f1_2p5mm_all", f1(&off_all, F1_M)),
        ("observed_truth_share", observed.len() as f64 / sample_count(truth)),
    ]
}

/// Samples of a surface before the unseen ones were left out.
fn sample_count(truth: &TrueSurface) -> f64 {
    let spacing = crate::truth::OBSERVED_SPACING_M.max((truth.mesh.area() / SAMPLES as f64).sqrt());
    (truth.mesh.area() / (spacing * spacing)).round().max(1.0)
}

fn solid_figures(entity: &Entity, truth: &TrueSurface) -> Vec<(&'static str, f64)> {
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
    if truth.sphere.is_some() || truth.mesh.is_closed_oriented() {
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
    use glamx::{DPose3, DVec3};
    use sms_core::{Camera, Intrinsics};

    #[test]
    fn what_no_camera_sees_is_not_judged_and_what_they_see_is() {
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
                observed_surface_at_most(std::slice::from_ref(s), &cameras, SAMPLES).remove(0)
            };
            let figures = surface_figures(&found, &see(&found), &truth, &see(&truth));
            move |key: &str| figures.iter().find(|f| f.0 == key).unwrap().1
        };
        let half = DVec3::splat(0.03);
        // 1 cm deeper below, where no camera looks: of what is seen, only the foot of the walls is wrong.
        let deeper = || cuboid(DVec3::new(0.03, 0.03, 0.035), -0.005);
        let f = figures(deeper(), cuboid(half, 0.0));
        assert!(f("recall_2p5mm") == 1.0 && f("surface_median_m") < 1e-12);
        // Walls of 7 cm instead of 6, of which the lowest 7.5 mm are wrong, beside the top.
        let expected = 1.0 - 4.0 * 0.06 * 0.0075 / (4.0 * 0.06 * 0.07 + 0.0036);
        assert!((f("precision_2p5mm") - expected).abs() < 2e-3, "{}", f("precision_2p5mm"));
        assert!(f("f1_2p5mm_all") < f("f1_2p5mm") - 0.05);
        assert!(f("f1_5mm") > f("f1_2p5mm"));
        // 4 mm too high, where they look.
        let f = figures(cuboid(DVec3::new(0.03, 0.03, 0.032), 0.002), cuboid(half, 0.0));
        assert!(f("precision_2p5mm") < 0.85 && f("recall_2p5mm") < 0.85 && f("f1_5mm") == 1.0);
        assert!(f("observed_truth_share") > 0.8 && f("observed_truth_share") < 0.85);
    }
}
