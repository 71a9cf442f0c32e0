//! Compares the reconstruction with known models, or with the ground truth of a generated recording.

use crate::Error;
use glamx::{DPose3, DVec3};
use sms_core::metrics::Metrics;
use sms_core::{BACKGROUND, Entity, EntityShape, InputError, MassProperties, Mesh, PointCloud, Warnings};
use sms_eval::{
    EvaluateSettings, KnownSurface, ObjectScores, SolidScores, compare_sphere, entity_solid, evaluate_object,
    known_solid, match_objects, read_known_objects,
};
use sms_sim::RestingDrift;
use sms_synth::TruthScene;
use std::path::Path;

/// Mean distance between surfaces beyond which a reconstruction does not match a scanned model, metres.
const REACH_M: f64 = 0.1;

/// A known object in the scene's world.
#[derive(Debug, Clone)]
pub struct KnownBody {
    /// Name in metrics of models.
    pub name: String,
    /// Name in messages.
    pub description: String,
    /// Name of its label, if the masks are from the recording.
    label_name: Option<String>,
    cloud: PointCloud,
    mesh: Option<Mesh>,
    /// Centre and radius of a sphere.
    sphere: Option<(DVec3, f64)>,
    reach_m: f64,
}

impl KnownBody {
    fn surface(&self) -> KnownSurface<'_> {
        self.mesh.as_ref().map_or(KnownSurface::Cloud(&self.cloud), KnownSurface::Mesh)
    }

    fn solid(&self) -> Option<MassProperties> {
        known_solid(self.mesh.as_ref()?, self.sphere)
    }
}

/// The comparison of a known object with its reconstruction.
#[derive(Debug, Clone)]
pub struct Comparison {
    /// Name of the known object.
    pub known: String,
    /// Name of the known object for messages.
    pub description: String,
    /// Name of the entity.
    pub entity: String,
    /// Whether its body is fixed in the scene.
    pub is_fixed: bool,
    /// Distances between the surfaces.
    pub scores: ObjectScores,
    /// Errors of volume, mass centre and inertia, if both are solids.
    pub solid: Option<SolidScores>,
    /// Errors of centre and radius in metres, if both are spheres.
    pub sphere: Option<(f64, f64)>,
}

/// Naming of the metrics of a comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MetricNames {
    /// Names of the known objects.
    Known,
    /// Names of the reconstruction.
    Entity,
}

/// Reads scanned models with poses. `x_wr` maps the recording's world to the scene's. With `by_label`, an object is
/// matched with the entity of its label before shapes are compared.
///
/// # Errors
/// [`Error::Input`] if the file is missing or has no model with a pose.
pub fn known_models(path: &Path, x_wr: &DPose3, by_label: bool) -> Result<Vec<KnownBody>, Error> {
    if !path.is_file() {
        let cure = "use the recording's objects.json";
        return Err(InputError::new("this file does not exist", path, cure).into());
    }
    let known = read_known_objects(path)?;
    if known.is_empty() {
        let what = "no object in this file has a model with a pose";
        return Err(InputError::new(what, path, "add `model` and `model_to_world` to an object").into());
    }
    let carried = |object: sms_eval::KnownObject| KnownBody {
        cloud: PointCloud {
            points_w: object.model_r.points_w.iter().map(|&p| x_wr.transform_point(p)).collect(),
            ..PointCloud::default()
        },
        mesh: object.mesh_r.map(|m| m.transformed(x_wr)),
        description: object.name.clone(),
        label_name: by_label.then(|| object.name.clone()),
        name: object.name,
        sphere: None,
        reach_m: REACH_M,
    };
    Ok(known.into_iter().map(carried).collect())
}

/// Returns the objects of a generated scene, transformed by `x_wr`.
pub fn known_truth(truth: &TruthScene, x_wr: &DPose3) -> Vec<KnownBody> {
    let carried = |object: &sms_synth::TruthObject| KnownBody {
        name: object.name.clone(),
        description: format!("{} ({})", object.name, object.class),
        label_name: None,
        cloud: PointCloud::default(),
        mesh: Some(object.mesh_w().transformed(x_wr)),
        sphere: object.sphere_radius.map(|r| (x_wr.transform_point(object.x_wb.translation), r)),
        reach_m: 0.5 * object.aabb_w().extents().length(),
    };
    truth.objects.iter().map(carried).collect()
}

/// Matches the entities of objects, moving and fixed, with the known objects and measures each pair. `fixed` are the names
/// of the fixed bodies of the scene. Objects without a match become warnings; metrics are added to `metrics`.
///
/// # Errors
/// As [`evaluate_object`].
pub fn evaluate(
    known: &[KnownBody],
    entities: &[Entity],
    fixed: &[&str],
    settings: &EvaluateSettings,
    names: MetricNames,
    metrics: &mut Metrics,
    warnings: &Warnings,
) -> Result<Vec<Comparison>, Error> {
    let objects: Vec<&Entity> = entities.iter().filter(|e| e.label != BACKGROUND).collect();
    let mut comparisons = Vec::new();
    for (object, entity) in known.iter().zip(pairs(known, &objects)) {
        let Some(entity) = entity else {
            let message = format!("`{}` was not reconstructed", object.description);
            warnings.add("evaluate", "not_found", message, "check the masks in the report");
            continue;
        };
        let name = if names == MetricNames::Known { &object.name } else { &entity.name };
        let mut comparison = compare(name, entity, object, settings, metrics)?;
        comparison.is_fixed = fixed.contains(&entity.name.as_str());
        comparisons.push(comparison);
    }
    Ok(comparisons)
}

/// Adds the drift of each compared entity to the metrics.
pub(crate) fn add_drifts(
    comparisons: &[Comparison],
    names: MetricNames,
    drifts: &[RestingDrift],
    metrics: &mut Metrics,
) {
    for c in comparisons {
        let name = if names == MetricNames::Known { &c.known } else { &c.entity };
        if let Some(drift) = drifts.iter().find(|d| d.body == c.entity) {
            metrics.set(format!("evaluate.{name}.drift_m"), drift.moved_m);
            metrics.set(format!("evaluate.{name}.turn_rad"), drift.turned_rad);
        }
    }
}

/// Matches each known object with an entity, each at most once: first by the name of the label, then by the distances
/// between the surfaces.
///
/// Labels match by name, not by value: masks of the recording are renumbered from 1 when they are read, and labels have
/// the names of the values in `objects.json`.
fn pairs<'a>(known: &[KnownBody], objects: &[&'a Entity]) -> Vec<Option<&'a Entity>> {
    let plain = |name: &str| -> String {
        name.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
    };
    let mut given = Vec::new();
    for (k, object) in known.iter().enumerate() {
        let Some(label) = object.label_name.as_deref().map(plain) else { continue };
        given.extend(objects.iter().position(|e| plain(&e.name) == label).map(|f| (k, f)));
    }
    let surfaces: Vec<KnownSurface<'_>> = known.iter().map(KnownBody::surface).collect();
    let found: Vec<KnownSurface<'_>> = objects.iter().map(|e| KnownSurface::Mesh(&e.mesh)).collect();
    let reach: Vec<f64> = known.iter().map(|k| k.reach_m).collect();
    let matched = match_objects(&surfaces, &found, &given, &reach);
    matched.into_iter().map(|m| m.map(|f| objects[f])).collect()
}

/// Measures one pair; the keys of the metrics contain `name`.
fn compare(
    name: &str,
    entity: &Entity,
    known: &KnownBody,
    settings: &EvaluateSettings,
    metrics: &mut Metrics,
) -> Result<Comparison, Error> {
    let scores = evaluate_object(&entity.mesh, known.surface(), settings)?;
    metrics.merge(scores.metrics(name));
    let solid = known.solid().zip(entity_solid(entity).ok());
    let solid = solid.map(|(truth, found)| SolidScores::new(&found, &truth));
    if let Some(solid) = &solid {
        metrics.merge(solid.metrics(name));
    }
    let mut sphere = None;
    if let (EntityShape::Sphere { center_w, radius }, Some((center, true_radius))) =
        (&entity.shape, known.sphere)
    {
        metrics.merge(compare_sphere(name, (*center_w, *radius), (center, true_radius)));
        sphere = Some(((*center_w - center).length(), (radius - true_radius).abs()));
    }
    Ok(Comparison {
        known: known.name.clone(),
        description: known.description.clone(),
        entity: entity.name.clone(),
        is_fixed: false,
        scores,
        solid,
        sphere,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::EntityKind;

    fn ball(x: f64) -> Mesh {
        Mesh::icosphere(0.03, 2).transformed(&DPose3::from_translation(DVec3::X * x))
    }

    fn known(name: &str, x: f64, by_label: bool) -> KnownBody {
        KnownBody {
            name: name.into(),
            description: name.into(),
            label_name: by_label.then(|| name.into()),
            cloud: PointCloud::default(),
            mesh: Some(ball(x)),
            sphere: None,
            reach_m: REACH_M,
        }
    }

    fn entity(label: u16, name: &str, x: f64) -> Entity {
        Entity {
            label,
            name: name.into(),
            description: String::new(),
            kind: EntityKind::Dynamic,
            shape: EntityShape::Convex,
            cloud: PointCloud::default(),
            mesh: ball(x),
            texture: None,
            parts: Vec::new(),
            observed_share: 1.0,
            residual_m: 0.0,
            mean_color: [0; 3],
        }
    }

    #[test]
    fn labels_go_by_name_whatever_they_were_numbered() {
        // The recording has values 3 (tray) and 7 (glue bottle), which become 1 and 2.
        let (tray, glue) = (entity(1, "tray", 0.05), entity(2, "glue_bottle", 0.0));
        let found = [&tray, &glue];
        let names = |known: &[KnownBody]| -> Vec<Option<String>> {
            pairs(known, &found).into_iter().map(|e| e.map(|e| e.name.clone())).collect()
        };
        // The bottle's model is at the place of the reconstructed tray, but the labels decide.
        let labelled = [known("Glue bottle", 0.05, true), known("tray", 0.0, true)];
        assert_eq!(names(&labelled), [Some("glue_bottle".into()), Some("tray".into())]);
        // Without labels, the nearest entity, each once.
        let unlabelled = [known("a", 0.03, false), known("b", 0.06, false)];
        assert_eq!(names(&unlabelled), [Some("glue_bottle".into()), Some("tray".into())]);
        assert_eq!(names(&[known("far", 1.0, false)]), [None]);
    }

    #[test]
    fn fixed_objects_are_compared_too_and_the_environment_is_not() {
        // Next to the fixed bottle stands a duck that moves; the environment is at the bottle's place.
        let fixed = |e: Entity| Entity { kind: EntityKind::Static, ..e };
        let entities = [
            entity(1, "duck", 0.05),
            fixed(entity(2, "bottle", 0.001)),
            fixed(entity(BACKGROUND, "environment", 0.0)),
        ];
        let (mut metrics, warnings) = (Metrics::new(), Warnings::new());
        let found = evaluate(
            &[known("glue", 0.0, false)],
            &entities,
            &["bottle", "environment", "floor"],
            &EvaluateSettings::default(),
            MetricNames::Known,
            &mut metrics,
            &warnings,
        )
        .unwrap();
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].entity.as_str(), found[0].is_fixed), ("bottle", true));
        let median = metrics.number("evaluate.glue.accuracy_median_m").unwrap();
        assert!(median > 1e-4 && median < 1.1e-3, "{median}");
        assert!((found[0].solid.unwrap().mass_center_error_m - 0.001).abs() < 1e-6);
        // A body that only the scene fixed, and one that moves.
        for (fixed, expected) in [(&["duck"][..], true), (&[], false)] {
            let settings = EvaluateSettings::default();
            let known = [known("duck", 0.05, false)];
            let names = MetricNames::Known;
            let found =
                evaluate(&known, &entities[..1], fixed, &settings, names, &mut metrics, &warnings).unwrap();
            assert_eq!((found[0].entity.as_str(), found[0].is_fixed), ("duck", expected));
        }
        assert!(warnings.snapshot().is_empty());
    }
}
