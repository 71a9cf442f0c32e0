//! Metrics of real recordings, which have no complete truth.

use crate::panels::write_panel;
use crate::reference::ScannedScene;
use crate::{BenchError, ShownView};
use glamx::{DPose3, DVec3};
use sms_core::metrics::Metrics;
use sms_core::{BACKGROUND, EntityKind, Image, PointCloud, StageContext, Warnings};
use sms_eval::TrueView;
use sms_eval::{DepthErrors, psnr_db};
use sms_eval::{DiscSampling, disc_points, score_surface};
use sms_eval::{EvaluateSettings, KnownSurface, SurfaceIndex, evaluate_object, read_known_objects};
use sms_gaussians::Trainer;
use sms_pipeline::stages;

/// Held-out colour and depth against the frames, and each object that has a scanned model against it: points on its
/// Gaussians' discs, and the default mesh.
pub(crate) fn real_metrics(
    scanned: &ScannedScene<'_>,
    trainer: &mut dyn Trainer,
    context: StageContext<'_>,
) -> Result<Metrics, BenchError> {
    let &ScannedScene { prefix, prepared, options, model, dir } = scanned;
    let mut metrics = Metrics::new();
    let mut set = |key: &str, value: f64| {
        metrics.set(format!("{prefix}{key}"), value);
    };
    let held_out = prepared.held_out(options.scan.holdout);
    let (mut depth, mut psnr, mut labels_right) = (DepthErrors::default(), Vec::new(), (0usize, 0usize));
    for (at, &i) in held_out.iter().enumerate() {
        let frame = &prepared.sequence.frames[i];
        let shown = ShownView::of_maps(&trainer.render(&frame.camera));
        let (w, h) = frame.depth.size();
        let measured = TrueView { depth: frame.depth.clone(), label: Image::filled(w, h, BACKGROUND) };
        depth.add(&shown.depth, &measured, &frame.depth);
        psnr.push(psnr_db(&shown.color, &frame.color));
        if let Some(label) = &shown.label {
            let same = label.data.iter().zip(&prepared.labels.maps[i].data).filter(|(a, b)| a == b).count();
            labels_right = (labels_right.0 + same, labels_right.1 + label.data.len());
        }
        if at == held_out.len() / 2 {
            write_panel(&dir.join("panel.png"), &frame.color, &shown, &frame.depth)?;
        }
    }
    let depth = depth.scores();
    set("holdout_psnr_db", psnr.iter().sum::<f64>() / psnr.len() as f64);
    set("holdout_depth_mae_m", depth.mae_m);
    set("holdout_depth_median_m", depth.median_m);
    set("holdout_coverage", depth.coverage);
    set("holdout_labels_right", labels_right.0 as f64 / labels_right.1.max(1) as f64);

    let Some(objects) = prepared.real.as_ref().map(|d| d.join("objects.json")).filter(|p| p.is_file()) else {
        return Ok(metrics);
    };
    let x_wr = prepared.sequence.x_world_recording;
    let points = disc_points(model, &DPose3::identity(), &DiscSampling::default());
    let known = read_known_objects(&objects)?;
    let set_entities = if known.is_empty() { None } else { Some(entities(scanned, context)?) };
    for object in known {
        let model_w: Vec<DVec3> = object.model_r.points_w.iter().map(|&p| x_wr.transform_point(p)).collect();
        let Some(index) = SurfaceIndex::of_points(&model_w) else { continue };
        let Some(label) = prepared.labels.objects.iter().find(|o| o.name == object.name) else { continue };
        let own: Vec<DVec3> = points.iter().filter(|p| p.label == label.id).map(|p| p.point).collect();
        let scores = score_surface(&own, |p| index.closest(p).distance, &[]);
        set("surface_median_m", scores.median_m);
        set("surface_p90_m", scores.p90_m);
        set("surface_precision_2p5mm", scores.precision);
        let entity = set_entities
            .as_ref()
            .and_then(|s| s.entities.iter().find(|e| e.kind == EntityKind::Dynamic && e.label == label.id));
        if let Some(entity) = entity {
            let cloud = PointCloud { points_w: model_w, ..PointCloud::default() };
            let s = evaluate_object(&entity.mesh, KnownSurface::Cloud(&cloud), &EvaluateSettings::default())?;
            set("mesh_median_m", s.accuracy_median_m);
            set("mesh_p90_m", s.accuracy_p90_m);
            let mut cloud: Vec<f64> =
                entity.cloud.points_w.iter().map(|&p| index.closest(p).distance).collect();
            cloud.sort_by(f64::total_cmp);
            if !cloud.is_empty() {
                set("cloud_median_m", cloud[cloud.len() / 2]);
                set("cloud_p90_m", cloud[cloud.len() * 9 / 10]);
            }
        }
    }
    Ok(metrics)
}

fn entities(
    scanned: &ScannedScene<'_>,
    context: StageContext<'_>,
) -> Result<sms_entities::EntitySet, BenchError> {
    let &ScannedScene { prepared, options, model, .. } = scanned;
    let (sequence, labels) = prepared.trained_only(options.scan.holdout);
    // Problems in the rest of a real scene are not measured here.
    let warnings = Warnings::new();
    let context = StageContext { warnings: &warnings, ..context };
    let made =
        stages::entities(model.clone(), &sequence, &labels, &options.entities, &options.read, context)?;
    Ok(made.set)
}
