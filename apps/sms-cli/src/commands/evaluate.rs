//! `sms evaluate`: the reconstruction against known models, or against the truth of a generated recording.

use super::length_text;
use super::materialize::run_settings;
use crate::cli::Evaluate;
use crate::context::Context;
use sms_core::glamx::{DPose3, DVec3};
use sms_core::metrics::Metrics;
use sms_core::{Entity, EntityKind, EntityShape, InputError, Mesh, PointCloud, RunFolder, Warnings};
use sms_entities::load_entities;
use sms_frames::Sequence;
use sms_report::{EvaluateSettings, KnownSurface, compare_sphere, evaluate_object, read_known_objects};
use sms_synth::{TruthObject, read_truth};
use std::path::Path;

pub(crate) fn run(context: &Context, a: &Evaluate) -> anyhow::Result<()> {
    let run = RunFolder::open(&a.run)?;
    let set = load_entities(&run.stage_dir("entities", "materialize")?)?;
    let dynamic: Vec<&Entity> = set.entities.iter().filter(|e| e.kind == EntityKind::Dynamic).collect();
    let settings = context.settings.section("evaluate", EvaluateSettings::default())?;
    let x_wr = Sequence::load(&run.stage_dir("frames", "scan DIR --out")?)?.x_world_recording;
    let recorded = run_settings(&run)?;
    let warnings = Warnings::new();
    let metrics = match &a.objects {
        Some(path) => {
            if !path.is_file() {
                return Err(InputError::new(
                    "there is no such file",
                    path,
                    "give the recording's objects.json",
                )
                .into());
            }
            let by_label = recorded.masks == "files";
            against_models(context, path, &dynamic, &x_wr, by_label, &settings, &warnings)?
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
            against_truth(context, recording, &dynamic, &x_wr, &settings, &warnings)?
        }
    };
    context.finish(&run, "evaluate", &["evaluate."], metrics, &warnings)?;
    context.print_metrics(&run)
}

/// Scanned models with their poses. The entity is the one of the same label, else the nearest.
fn against_models(
    context: &Context,
    path: &Path,
    dynamic: &[&Entity],
    x_wr: &DPose3,
    by_label: bool,
    settings: &EvaluateSettings,
    warnings: &Warnings,
) -> anyhow::Result<Metrics> {
    let known = read_known_objects(path)?;
    if known.is_empty() {
        return Err(InputError::new(
            "no object in this file has a model with a pose",
            path,
            "add `model` and `model_to_world` to an object",
        )
        .into());
    }
    let mut metrics = Metrics::new();
    for object in known {
        let model_w = PointCloud {
            points_w: object.model_r.points_w.iter().map(|&p| x_wr.transform_point(p)).collect(),
            ..PointCloud::default()
        };
        let count = model_w.points_w.len().max(1) as f64;
        let center_w = model_w.points_w.iter().copied().sum::<DVec3>() / count;
        let labelled = dynamic.iter().copied().find(|e| by_label && e.label == object.mask_value);
        let Some(entity) = labelled.or_else(|| nearest(dynamic, center_w, 0.1)) else {
            warnings.add(
                "evaluate",
                "not_found",
                format!("`{}` was not reconstructed", object.name),
                "look at the masks in the report",
            );
            continue;
        };
        let scores = evaluate_object(&entity.mesh, KnownSurface::Cloud(&model_w), settings)?;
        context.say(format!(
            "{} ({}): accuracy {} median, {} p90; completion {}; F1 {:.3} at 2.5 mm, {:.3} at 5 mm",
            object.name,
            entity.name,
            length_text(scores.accuracy_median_m),
            length_text(scores.accuracy_p90_m),
            length_text(scores.completion_median_m),
            scores.f1_2p5mm,
            scores.f1_5mm
        ));
        metrics.merge(scores.metrics(&object.name));
    }
    Ok(metrics)
}

/// The truth of a generated recording. Metrics carry the reconstruction's names.
fn against_truth(
    context: &Context,
    recording: &Path,
    dynamic: &[&Entity],
    x_wr: &DPose3,
    settings: &EvaluateSettings,
    warnings: &Warnings,
) -> anyhow::Result<Metrics> {
    let truth = read_truth(recording)?;
    let mut metrics = Metrics::new();
    let mut balls_found = 0;
    let mut found = 0;
    for object in &truth.objects {
        let center_w = x_wr.transform_point(object.x_wb.translation);
        let radius = object.aabb_w().extents().length() * 0.5;
        let Some(entity) = nearest(dynamic, center_w, radius) else {
            warnings.add(
                "evaluate",
                "not_found",
                format!("`{}` ({}) was not reconstructed", object.name, object.class),
                "look at the masks in the report",
            );
            continue;
        };
        found += 1;
        let line = compare_with_truth(entity, object, x_wr, settings, &mut metrics)?;
        let is_ball = object.name == truth.cue || object.name == truth.target;
        if is_ball && matches!(entity.shape, EntityShape::Sphere { .. }) {
            balls_found += 1;
        }
        context.say(format!("{:>12} is {} ({}): {line}", entity.name, object.name, object.class));
    }
    metrics.set("evaluate.balls_found", balls_found);
    metrics.set("evaluate.objects_found", found).set("evaluate.objects", truth.objects.len());
    Ok(metrics)
}

fn compare_with_truth(
    entity: &Entity,
    object: &TruthObject,
    x_wr: &DPose3,
    settings: &EvaluateSettings,
    metrics: &mut Metrics,
) -> anyhow::Result<String> {
    let mesh_w: Mesh = object.mesh_w().transformed(x_wr);
    let scores = evaluate_object(&entity.mesh, KnownSurface::Mesh(&mesh_w), settings)?;
    metrics.merge(scores.metrics(&entity.name));
    metrics.set(format!("evaluate.{}.truth", entity.name), object.name.clone());
    let ratio = entity.mesh.volume() / mesh_w.volume();
    metrics.set(format!("evaluate.{}.volume_ratio", entity.name), ratio);
    if let (EntityShape::Sphere { center_w, radius }, Some(true_radius)) =
        (&entity.shape, object.sphere_radius)
    {
        let true_center = x_wr.transform_point(object.x_wb.translation);
        metrics.merge(compare_sphere(&entity.name, (*center_w, *radius), (true_center, true_radius)));
        return Ok(format!(
            "centre off by {}, radius by {}",
            length_text((*center_w - true_center).length()),
            length_text((radius - true_radius).abs())
        ));
    }
    Ok(format!(
        "surface {} median, F1 {:.3} at 2.5 mm, volume × {ratio:.2}",
        length_text(scores.accuracy_median_m),
        scores.f1_2p5mm
    ))
}

/// The entity whose box's centre is nearest, within `reach` metres.
fn nearest<'a>(dynamic: &[&'a Entity], p_w: DVec3, reach: f64) -> Option<&'a Entity> {
    let distance = |e: &Entity| e.mesh.aabb().map_or(f64::INFINITY, |b| (b.center() - p_w).length());
    dynamic
        .iter()
        .copied()
        .filter(|e| distance(e) <= reach)
        .min_by(|a, b| distance(a).total_cmp(&distance(b)))
}
