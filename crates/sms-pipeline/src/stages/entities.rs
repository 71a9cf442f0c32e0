//! Labelled Gaussians → entities with meshes, textures and their own Gaussians.

use crate::Error;
use sms_core::metrics::Metrics;
use sms_core::{BACKGROUND, EntityKind, EntityShape, Labels, StageContext};
use sms_entities::{EntitiesConfig, EntitySet, bake_textures, build_entities, object_gaussians};
use sms_frames::{ReadOptions, Sequence, recorded_colors};
use sms_gaussians::GaussianModel;

/// Entities of a scan.
#[derive(Debug, Clone)]
pub struct Entities {
    /// The entities, meshed and textured.
    pub set: EntitySet,
    /// The Gaussians of each object, by the entity's name.
    pub gaussians: Vec<(String, GaussianModel)>,
}

/// Builds the entities of a scan. `sequence` and `labels` are those of the training ([`trained_only`]); `read` are the
/// options for reading the recording's full-size images for textures.
///
/// [`trained_only`]: super::trained_only
///
/// # Errors
/// As [`build_entities`].
pub fn entities(
    mut model: GaussianModel,
    sequence: &Sequence,
    labels: &Labels,
    config: &EntitiesConfig,
    read: &ReadOptions,
    context: StageContext<'_>,
) -> Result<Entities, Error> {
    let mut set = build_entities(&model, sequence, labels, config, context)?;
    set.relabel_model(&mut model);
    let mut labels = labels.clone();
    set.relabel(&mut labels);
    let colors = recorded_colors(sequence, read, config.texture.image_side, context.cancel)?;
    let missing = colors.iter().filter(|c| c.is_none()).count();
    if config.texture.enabled && missing > 0 {
        context.warnings.add(
            "materialize",
            "recorded_colour_missing",
            format!("{missing} of {} recorded colour images are missing", colors.len()),
            "restore the recording at its scanned path; textures now use the smaller frames",
        );
    }
    bake_textures(&mut set, sequence, &labels, &colors, &config.texture);
    let objects = set.entities.iter().filter(|e| e.label != BACKGROUND);
    let gaussians = objects.map(|e| (e.name.clone(), object_gaussians(&model, e, config))).collect();
    Ok(Entities { set, gaussians })
}

/// Returns the metrics `entities.*`.
pub fn entity_metrics(set: &EntitySet) -> Metrics {
    let dynamic: Vec<_> = set.entities.iter().filter(|e| e.kind == EntityKind::Dynamic).collect();
    let count = |is: fn(&EntityShape) -> bool| dynamic.iter().filter(|e| is(&e.shape)).count();
    let mut m = Metrics::new();
    m.set("entities.count", dynamic.len());
    m.set("entities.spheres", count(|s| matches!(s, EntityShape::Sphere { .. })));
    m.set("entities.closed", dynamic.iter().filter(|e| e.mesh.is_closed_oriented()).count());
    m.set("entities.boxes", count(|s| matches!(s, EntityShape::Box { .. })));
    m.set("entities.cylinders", count(|s| matches!(s, EntityShape::Cylinder { .. })));
    m.set("entities.static", set.entities.len() - dynamic.len());
    m
}
