//! The entities of a scanned scene against its truth.

use super::MaterializeOptions;
use super::trained::{Trained, train};
use crate::BenchError;
use crate::scenes::BenchScene;
use crate::timer::Timer;
use sms_core::metrics::Metrics;
use sms_core::{CoreError, EntityKind, EntityShape, Mesh, Seed, StageContext};
use sms_entities::EntitySet;
use sms_eval::{
    SURFACE_SAMPLES, TrueSurface, UNMATCHED, collision_solids, observed_surface_at_most, placed_figures,
    solid_figures, surface_figures,
};
use sms_pipeline::stages;
use std::path::Path;

/// The entities stage's seed; `sms materialize` has the same default.
const SEED: Seed = Seed(0);

/// Makes the entities of a scene (from a kept scan where there is one) and measures them; keys are
/// `bench.materialize.{scene}.…` (see `experiments/metrics.md`). The meshes come to `keep/meshes/{scene}/` as OBJ in the truth's
/// world. `None` where there is nothing to measure: a model that is not there, or a real recording.
///
/// # Errors
/// [`BenchError`] of the stage that failed.
pub fn run_materialize(
    scene: &BenchScene,
    options: &MaterializeOptions,
    context: StageContext<'_>,
) -> Result<Option<Metrics>, BenchError> {
    let Some(trained) = train(scene, options, context)? else { return Ok(None) };
    let config = &options.bench.entities;
    let timer = Timer::start();
    let set = stages::entities(
        trained.model.clone(),
        &trained.sequence,
        &trained.labels,
        config,
        &options.bench.read,
        context.with_seed(SEED),
    )?
    .set;
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
            // Figures of each object in the scene, and the mean over them.
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

/// A true object and its reconstruction.
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
    // Every entity occludes, also one that matches no object.
    let mut found: Vec<(usize, TrueSurface)> = Vec::new();
    for (i, entity) in set.entities.iter().enumerate() {
        if entity.kind == EntityKind::Dynamic {
            let mesh = entity.mesh.transformed(&x_tw);
            found.extend(TrueSurface::new(entity.name.clone(), mesh, None).map(|s| (i, s)));
        }
    }
    let (indices, found): (Vec<usize>, Vec<TrueSurface>) = found.into_iter().unzip();
    let seen = observed_surface_at_most(&found, &trained.cameras_t, SURFACE_SAMPLES);
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
