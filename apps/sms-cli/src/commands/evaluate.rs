//! `sms evaluate`: the reconstruction against known models, or against the truth of a generated recording.

use super::length_text;
use super::materialize::run_settings;
use crate::cli::Evaluate;
use sms_cli::front::Console;
use sms_core::glamx::{DPose3, DVec3};
use sms_core::metrics::Metrics;
use sms_core::{
    Aabb, Entity, EntityKind, EntityShape, InputError, MassProperties, Mesh, PointCloud, RunFolder, Warnings,
};
use sms_entities::load_entities;
use sms_eval::{
    EvaluateSettings, KnownSurface, MatchSurface, ObjectScores, SolidScores, compare_sphere, entity_solid,
    evaluate_object, known_solid, match_objects, read_known_objects,
};
use sms_frames::Sequence;
use sms_scene::load_scene;
use sms_sim::{RapierFactory, RestingDrift, resting_drift};
use sms_synth::{TruthScene, read_truth};
use std::path::Path;

/// How long the scene is left alone to see whether it rests, seconds.
const REST_S: f64 = 1.0;
/// Mean distance of the surfaces from which on a reconstruction is not that of a scanned model, metres.
const REACH_M: f64 = 0.1;

/// Something known, in the world.
struct Known {
    name: String,
    /// What it is called in messages.
    description: String,
    /// The name of its label where the masks came with the recording.
    label_name: Option<String>,
    cloud: PointCloud,
    mesh: Option<Mesh>,
    sphere: Option<(DVec3, f64)>,
    reach_m: f64,
}

impl Known {
    fn surface(&self) -> KnownSurface<'_> {
        self.mesh.as_ref().map_or(KnownSurface::Cloud(&self.cloud), KnownSurface::Mesh)
    }

    fn match_surface(&self) -> MatchSurface<'_> {
        self.mesh.as_ref().map_or(MatchSurface::Points(&self.cloud.points_w), MatchSurface::Mesh)
    }

    fn solid(&self) -> Option<MassProperties> {
        known_solid(self.mesh.as_ref()?, self.sphere)
    }
}

pub(crate) fn run(console: &Console, a: &Evaluate) -> anyhow::Result<()> {
    let run = RunFolder::open(&a.run)?;
    let set = load_entities(&run.stage_dir("entities", "materialize")?)?;
    let dynamic: Vec<&Entity> = set.entities.iter().filter(|e| e.kind == EntityKind::Dynamic).collect();
    let settings = console.context.settings.section("evaluate", EvaluateSettings::default())?;
    let x_wr = Sequence::load(&run.stage_dir("frames", "scan DIR --out")?)?.x_world_recording;
    let recorded = run_settings(&run)?;
    let warnings = Warnings::new();
    let drifts = contact_drift(&run, &warnings)?;
    let mut metrics = match &a.objects {
        Some(path) => {
            let known = known_models(path, &x_wr, recorded.masks == "files")?;
            let pairs = pairs(&known, &dynamic);
            against_models(console, &known, &pairs, &drifts, &settings, &warnings)?
        }
        None => {
            let recording = Path::new(&recorded.recording);
            if !recording.join("truth").join("truth.json").is_file() {
                return Err(InputError::new(
                    "there is nothing to compare with",
                    recording,
                    "give known models with --objects FILE (see docs/objects.md)",
                )
                .into());
            }
            let truth = read_truth(recording)?;
            let known = known_truth(&truth, &x_wr);
            let pairs = pairs(&known, &dynamic);
            against_truth(console, &truth, &known, &pairs, &drifts, &settings, &warnings)?
        }
    };
    if !drifts.is_empty() {
        let worst = |f: fn(&RestingDrift) -> f64| drifts.iter().map(f).fold(0.0, f64::max);
        let (moved, turned) = (worst(|d| d.moved_m), worst(|d| d.turned_rad));
        metrics.set("evaluate.drift_m", moved).set("evaluate.turn_rad", turned);
        console.say(format!(
            "left alone for {REST_S} s, nothing moves more than {} or turns more than {:.2}°",
            length_text(moved),
            turned.to_degrees()
        ));
    }
    console.finish(&run, "evaluate", &["evaluate."], metrics, &warnings)?;
    console.print_metrics(&run)
}

/// How far each body comes in our own simulator when nothing is done to the scene. A scene that cannot be simulated is
/// reported, and the rest is measured.
fn contact_drift(run: &RunFolder, warnings: &Warnings) -> anyhow::Result<Vec<RestingDrift>> {
    let scene = load_scene(&run.stage_dir("scene", "materialize")?)?;
    Ok(resting_drift(&RapierFactory, &scene, REST_S).unwrap_or_else(|error| {
        warnings.add(
            "evaluate",
            "not_simulated",
            format!("the scene cannot be simulated, so its contact drift is not known: {error}"),
            "look at the objects in the report",
        );
        Vec::new()
    }))
}

fn known_models(path: &Path, x_wr: &DPose3, by_label: bool) -> anyhow::Result<Vec<Known>> {
    if !path.is_file() {
        return Err(
            InputError::new("there is no such file", path, "give the recording's objects.json").into()
        );
    }
    let known = read_known_objects(path)?;
    if known.is_empty() {
        return Err(InputError::new(
            "no object in this file has a model with a pose",
            path,
            "add `model` and `model_to_world` to an object",
        )
        .into());
    }
    let carried = |object: sms_eval::KnownObject| Known {
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

fn known_truth(truth: &TruthScene, x_wr: &DPose3) -> Vec<Known> {
    truth
        .objects
        .iter()
        .map(|object| Known {
            name: object.name.clone(),
            description: format!("{} ({})", object.name, object.class),
            label_name: None,
            cloud: PointCloud::default(),
            mesh: Some(object.mesh_w().transformed(x_wr)),
            sphere: object.sphere_radius.map(|r| (x_wr.transform_point(object.x_wb.translation), r)),
            reach_m: half_diagonal(&object.aabb_w()),
        })
        .collect()
}

fn half_diagonal(bounds: &Aabb) -> f64 {
    0.5 * bounds.extents().length()
}

/// The entity that stands for each known object, each at most once: the one whose label has the object's name, else by the
/// distances between the surfaces.
///
/// Labels go by name, not by value: masks that came with the recording are numbered anew from 1 when they are read, and
/// labels take the names that `objects.json` gives to the values.
fn pairs<'a>(known: &[Known], dynamic: &[&'a Entity]) -> Vec<Option<&'a Entity>> {
    let plain = |name: &str| -> String {
        name.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
    };
    let mut given = Vec::new();
    for (k, object) in known.iter().enumerate() {
        let Some(label) = object.label_name.as_deref().map(plain) else { continue };
        given.extend(dynamic.iter().position(|e| plain(&e.name) == label).map(|f| (k, f)));
    }
    let surfaces: Vec<MatchSurface<'_>> = known.iter().map(Known::match_surface).collect();
    let found: Vec<MatchSurface<'_>> = dynamic.iter().map(|e| MatchSurface::Mesh(&e.mesh)).collect();
    let reach: Vec<f64> = known.iter().map(|k| k.reach_m).collect();
    let matched = match_objects(&surfaces, &found, &given, &reach);
    matched.into_iter().map(|m| m.map(|f| dynamic[f])).collect()
}

/// Everything that is measured of one pair, as metrics of that name.
fn compare(
    name: &str,
    entity: &Entity,
    known: &Known,
    drifts: &[RestingDrift],
    settings: &EvaluateSettings,
    metrics: &mut Metrics,
) -> anyhow::Result<(ObjectScores, Option<SolidScores>)> {
    let scores = evaluate_object(&entity.mesh, known.surface(), settings)?;
    metrics.merge(scores.metrics(name));
    let solid = known.solid().zip(entity_solid(entity).ok());
    let solid = solid.map(|(truth, found)| SolidScores::new(&found, &truth));
    if let Some(solid) = &solid {
        metrics.merge(solid.metrics(name));
    }
    if let (EntityShape::Sphere { center_w, radius }, Some(truth)) = (&entity.shape, known.sphere) {
        metrics.merge(compare_sphere(name, (*center_w, *radius), truth));
    }
    if let Some(drift) = drifts.iter().find(|d| d.body == entity.name) {
        metrics.set(format!("evaluate.{name}.drift_m"), drift.moved_m);
        metrics.set(format!("evaluate.{name}.turn_rad"), drift.turned_rad);
    }
    Ok((scores, solid))
}

/// The figures in words, lengths in millimetres.
fn words(scores: &ObjectScores, solid: Option<&SolidScores>) -> String {
    let mut text = format!(
        "accuracy {} median, {} p90; completion {}; Chamfer {}; F1 {:.3} at 2.5 mm, {:.3} at 5 mm",
        length_text(scores.accuracy_median_m),
        length_text(scores.accuracy_p90_m),
        length_text(scores.completion_median_m),
        length_text(scores.chamfer_m),
        scores.f1_2p5mm,
        scores.f1_5mm
    );
    if let Some(s) = solid {
        text += &format!(
            "; volume × {:.2}, mass centre off by {}, inertia by {:.1} %",
            s.volume_ratio,
            length_text(s.mass_center_error_m),
            100.0 * s.inertia_error
        );
    }
    text
}

/// Scanned models with their poses. Metrics carry the models' names.
fn against_models(
    console: &Console,
    known: &[Known],
    pairs: &[Option<&Entity>],
    drifts: &[RestingDrift],
    settings: &EvaluateSettings,
    warnings: &Warnings,
) -> anyhow::Result<Metrics> {
    let mut metrics = Metrics::new();
    for (object, entity) in known.iter().zip(pairs) {
        let Some(entity) = entity else {
            not_found(&object.description, warnings);
            continue;
        };
        let (scores, solid) = compare(&object.name, entity, object, drifts, settings, &mut metrics)?;
        console.say(format!("{} ({}): {}", object.name, entity.name, words(&scores, solid.as_ref())));
    }
    Ok(metrics)
}

fn not_found(what: &str, warnings: &Warnings) {
    warnings.add(
        "evaluate",
        "not_found",
        format!("`{what}` was not reconstructed"),
        "look at the masks in the report",
    );
}

/// The truth of a generated recording. Metrics carry the reconstruction's names.
fn against_truth(
    console: &Console,
    truth: &TruthScene,
    known: &[Known],
    pairs: &[Option<&Entity>],
    drifts: &[RestingDrift],
    settings: &EvaluateSettings,
    warnings: &Warnings,
) -> anyhow::Result<Metrics> {
    let mut metrics = Metrics::new();
    let mut balls_found = 0;
    for (object, entity) in known.iter().zip(pairs) {
        let Some(entity) = entity else {
            not_found(&object.description, warnings);
            continue;
        };
        let (scores, solid) = compare(&entity.name, entity, object, drifts, settings, &mut metrics)?;
        metrics.set(format!("evaluate.{}.truth", entity.name), object.name.clone());
        let line = match (&entity.shape, object.sphere) {
            (EntityShape::Sphere { center_w, radius }, Some((center, true_radius))) => {
                balls_found += i32::from(object.name == truth.cue || object.name == truth.target);
                format!(
                    "centre off by {}, radius by {}",
                    length_text((*center_w - center).length()),
                    length_text((radius - true_radius).abs())
                )
            }
            _ => words(&scores, solid.as_ref()),
        };
        console.say(format!("{:>12} is {}: {line}", entity.name, object.description));
    }
    let found = pairs.iter().flatten().count();
    metrics.set("evaluate.balls_found", balls_found);
    metrics.set("evaluate.objects_found", found).set("evaluate.objects", known.len());
    Ok(metrics)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::glamx::DPose3;

    fn ball(x: f64) -> Mesh {
        Mesh::icosphere(0.03, 2).transformed(&DPose3::from_translation(DVec3::X * x))
    }

    fn known(name: &str, x: f64, by_label: bool) -> Known {
        Known {
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
        // In the recording the tray has value 3 and the glue bottle 7; read, they are 1 and 2.
        let (tray, glue) = (entity(1, "tray", 0.05), entity(2, "glue_bottle", 0.0));
        let found = [&tray, &glue];
        let names = |known: &[Known]| -> Vec<Option<String>> {
            pairs(known, &found).into_iter().map(|e| e.map(|e| e.name.clone())).collect()
        };
        // The bottle's model stands where the tray was reconstructed: its label says what it is nevertheless.
        let labelled = [known("Glue bottle", 0.05, true), known("tray", 0.0, true)];
        assert_eq!(names(&labelled), [Some("glue_bottle".into()), Some("tray".into())]);
        // Without labels, the nearest, each once.
        let unlabelled = [known("a", 0.03, false), known("b", 0.06, false)];
        assert_eq!(names(&unlabelled), [Some("glue_bottle".into()), Some("tray".into())]);
        assert_eq!(names(&[known("far", 1.0, false)]), [None]);
    }
}
