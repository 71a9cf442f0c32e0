//! One scene: prepared, scanned, measured.

use crate::align::{pose_difference, refine_on_surfaces};
use crate::growing::growing_metrics;
use crate::options::BenchOptions;
use crate::panels::write_panel;
use crate::prepare::{Prepared, prepare};
use crate::real::real_metrics;
use crate::reference::{ScannedScene, Yardstick};
use crate::scenes::BenchScene;
use crate::score::{write_points, write_view};
use crate::steps::{fixed_step_cpu_ms, step_shares};
use crate::timer::Timer;
use crate::{BenchError, ShownView};
use glamx::{DPose3, DVec3};
use serde::Serialize;
use sms_core::metrics::Metrics;
use sms_core::process;
use sms_core::{CoreError, EntityKind, Seed, StageContext, atomic};
use sms_eval::carried;
use sms_eval::sample_surface;
use sms_eval::{DepthErrors, DepthScores, mean_iou, psnr_db};
use sms_eval::{
    DiscSampling, LabelledPoint, SceneScores, UNMATCHED, disc_points, is_near, score_cropped, score_labelled,
    stray_share,
};
use sms_gaussians::{CpuTrainer, GROWING_CLASSES, GaussianModel, TrainConfig, Trainer};
use sms_pipeline::stages::{self, GaussiansRequest};
use sms_poses::align_cameras;
use std::path::Path;

/// The scan's seed; `sms scan` has the same default.
const SCAN_SEED: Seed = Seed(0);

/// Scans a scene and measures it; keys are `bench.scan.{scene}.…` (see `experiments/metrics.md`). Into `dir` come the scan's
/// own files (`scan/scene.ply` …), `panel.png`, `objects.json` and `metrics.json`. `None` for a real recording that is
/// not there.
///
/// Run it in a process of its own where peak memory matters: it is the process's.
///
/// # Errors
/// [`BenchError`] of the stage that failed.
pub fn run_scene(
    scene: &BenchScene,
    options: &BenchOptions,
    dir: &Path,
    context: StageContext<'_>,
) -> Result<Option<Metrics>, BenchError> {
    let cpu = |train: &TrainConfig, classes, seed| Ok(CpuTrainer::new(train, classes, seed));
    let figures = |prefix: &str, trainer: &mut CpuTrainer, prepared: &Prepared| {
        let mut metrics = step_shares(prefix, &trainer.times());
        if options.steps {
            let k = &prepared.sequence.frames[0].camera.intrinsics;
            if let Some(ms) = fixed_step_cpu_ms(&options.scan.train, k.width, k.height) {
                metrics.set(format!("{prefix}step_cpu_ms"), ms);
            }
        }
        metrics
    };
    run_scene_with(scene, options, dir, cpu, figures, context)
}

/// [`run_scene`] on another back end: `make` constructs its trainer, and `figures` measures, after all other
/// measurements, the back end's own figures under the given prefix.
///
/// # Errors
/// [`BenchError`] of the stage that failed.
pub fn run_scene_with<T: Trainer>(
    scene: &BenchScene,
    options: &BenchOptions,
    dir: &Path,
    make: impl Fn(&TrainConfig, usize, Seed) -> Result<T, BenchError>,
    figures: impl FnOnce(&str, &mut T, &Prepared) -> Metrics,
    context: StageContext<'_>,
) -> Result<Option<Metrics>, BenchError> {
    let Some(prepared) = prepare(scene, options, context)? else { return Ok(None) };
    let prefix = format!("bench.scan.{scene}.");
    let work = dir.join("scan");
    if work.exists() {
        // A checkpoint there would be continued, and its time would be missing.
        std::fs::remove_dir_all(&work).map_err(CoreError::write(&work))?;
    }
    std::fs::create_dir_all(&work).map_err(CoreError::write(&work))?;

    let mut trainer = make(&options.scan.train, prepared.labels.class_count(), SCAN_SEED)?;
    let timer = Timer::start();
    let result = stages::gaussians(
        &prepared.sequence,
        &prepared.labels,
        &GaussiansRequest { config: &options.scan, work_dir: &work },
        &mut trainer,
        &mut (),
        context.with_seed(SCAN_SEED),
    )?;
    let scan_seconds = timer.seconds();
    // Before anything is measured, which takes memory, too.
    let peak = process::peak_bytes();

    let mut metrics = Metrics::new();
    let mut set = |key: &str, value: f64| {
        metrics.set(format!("{prefix}{key}"), value);
    };
    let steps = result.metrics.number("scan.steps").unwrap_or(0.0);
    let frames = prepared.trained(options.scan.holdout).len() as f64;
    set("frames", frames);
    set("gaussians", result.model.len() as f64);
    set("steps", steps);
    set("load_seconds", prepared.load_seconds.0);
    set("masks_seconds", prepared.masks_seconds.0);
    set("poses_seconds", prepared.poses_seconds.0);
    set("seconds", scan_seconds.0);
    set("cpu_seconds", scan_seconds.1);
    let stages = [prepared.load_seconds, prepared.poses_seconds, prepared.masks_seconds, scan_seconds];
    set("total_seconds", stages.iter().map(|s| s.0).sum());
    set("total_cpu_seconds", stages.iter().map(|s| s.1).sum());
    set("seconds_per_frame", scan_seconds.0 / frames);
    for (stage, seconds) in result.stages.iter() {
        set(&format!("stage_{stage}_s"), seconds);
    }
    if let Some(bytes) = peak {
        set("peak_bytes", bytes as f64);
    }
    if scan_seconds.1.is_finite() {
        metrics.set(format!("{prefix}scan_step_cpu_ms"), 1e3 * scan_seconds.1 / steps.max(1.0));
    }
    let scanned = ScannedScene { prefix: &prefix, prepared: &prepared, options, model: &result.model, dir };
    let measured = if !options.quality {
        Metrics::new()
    } else if prepared.truth.is_some() {
        measure(&scanned, &mut trainer, context)?
    } else {
        real_metrics(&scanned, &mut trainer, context)?
    };
    metrics.merge(measured);
    if options.follow {
        let mut trainer = make(&options.scan.train, GROWING_CLASSES, SCAN_SEED)?;
        metrics.merge(growing_metrics(
            &prefix,
            &prepared,
            options,
            &mut trainer,
            context.with_seed(SCAN_SEED),
        )?);
    }
    metrics.merge(figures(&prefix, &mut trainer, &prepared));
    metrics.save(&dir.join("metrics.json"))?;
    Ok(Some(metrics))
}

/// One object of `objects.json`.
#[derive(Serialize)]
struct ObjectRecord<'a> {
    name: &'a str,
    mask_label: Option<usize>,
    observed_samples: usize,
    gaussians: sms_eval::SurfaceScores,
    mesh: Option<sms_eval::SurfaceScores>,
}

fn measure(
    scanned: &ScannedScene<'_>,
    trainer: &mut dyn Trainer,
    context: StageContext<'_>,
) -> Result<Metrics, BenchError> {
    let &ScannedScene { prefix, prepared, options, model, dir } = scanned;
    let timer = Timer::start();
    let Some(truth) = Yardstick::new(prepared, options.scan.holdout) else { return Ok(Metrics::new()) };
    let mut metrics = Metrics::new();
    let x_tw = alignment(prepared, options, model, &truth, prefix, &mut metrics);
    let mut set = |key: &str, value: f64| {
        metrics.set(format!("{prefix}{key}"), value);
    };

    // Held-out views from the true cameras, carried into the world that the model was made in.
    let x_wt = x_tw.inverse() * prepared.x_tw();
    let (shown, psnr_db, depth) = held_out_views(prepared, &truth, trainer, &x_wt);
    set("holdout_psnr_db", psnr_db);
    set("holdout_depth_mae_m", depth.mae_m);
    set("holdout_depth_median_m", depth.median_m);
    set("holdout_depth_inner_mae_m", depth.inner_mae_m);
    set("holdout_depth_measured_mae_m", depth.measured_mae_m);
    set("holdout_coverage", depth.coverage);
    let classes = truth.surfaces.len() + 1;
    let pairs: Vec<_> = shown
        .iter()
        .zip(&truth.held_out)
        .filter_map(|(s, (_, view))| Some((s.label.as_ref()?, view)))
        .collect();
    set("holdout_miou", mean_iou(&pairs, &truth.truth_of, classes));
    let masks: Vec<_> = truth.held_out.iter().map(|(i, view)| (&prepared.labels.maps[*i], view)).collect();
    set("masks_miou", mean_iou(&masks, &truth.truth_of, classes));
    let matched = truth.truth_of.iter().filter(|t| **t != 0 && **t != UNMATCHED).count();
    set("objects", truth.surfaces.len() as f64);
    set("objects_matched", matched as f64);
    set("labels_unmatched", truth.truth_of.iter().filter(|t| **t == UNMATCHED).count() as f64);

    let points = disc_points(model, &x_tw, &DiscSampling::default());
    let own = score_labelled(&points, &truth.truth_of, &truth.surfaces, &truth.observed);
    set("surface_median_m", own.mean.median_m);
    set("surface_p90_m", own.mean.p90_m);
    set("surface_precision_2p5mm", own.mean.precision);
    set("surface_recall_2p5mm", own.mean.recall);
    set("f1_2p5mm", own.mean.f1);
    set("surface_stray_share", stray_share(&points, &truth.truth_of));
    // The sampling radius of the entities stage.
    let wide = disc_points(model, &x_tw, &DiscSampling { sigmas: 2.0, ..DiscSampling::default() });
    let wide = score_labelled(&wide, &truth.truth_of, &truth.surfaces, &truth.observed);
    set("wide_median_m", wide.mean.median_m);
    set("wide_f1_2p5mm", wide.mean.f1);
    let bare: Vec<DVec3> = points.iter().map(|p| p.point).collect();
    let cropped = score_cropped(&bare, &truth.surfaces, &truth.observed);
    set("cropped_median_m", cropped.mean.median_m);
    set("cropped_f1_2p5mm", cropped.mean.f1);
    let rendered = rendered_points(prepared, options, trainer, &x_tw);
    let from_depth = score_labelled(&rendered, &truth.truth_of, &truth.surfaces, &truth.observed);
    set("rendered_median_m", from_depth.mean.median_m);
    set("rendered_p90_m", from_depth.mean.p90_m);
    set("rendered_f1_2p5mm", from_depth.mean.f1);
    let mesh = if options.meshes {
        let (mesh, cloud, seconds) = mesh_scores(scanned, &x_tw, &truth, context)?;
        set("mesh_median_m", mesh.mean.median_m);
        set("mesh_p90_m", mesh.mean.p90_m);
        set("mesh_f1_2p5mm", mesh.mean.f1);
        set("cloud_median_m", cloud.mean.median_m);
        set("cloud_f1_2p5mm", cloud.mean.f1);
        set("mesh_seconds", seconds);
        Some(mesh)
    } else {
        None
    };
    let records: Vec<ObjectRecord<'_>> = own
        .objects
        .iter()
        .enumerate()
        .map(|(i, (name, scores))| ObjectRecord {
            name,
            mask_label: truth.truth_of.iter().position(|t| usize::from(*t) == i + 1),
            observed_samples: truth.observed[i].len(),
            gaussians: *scores,
            mesh: mesh.as_ref().map(|m| m.objects[i].1),
        })
        .collect();
    atomic::write_json(&dir.join("objects.json"), &records)?;
    // The input of `score_files`, so that its agreement can be checked.
    for ((i, _), shown) in truth.held_out.iter().zip(&shown) {
        write_view(&dir.join("views"), *i, shown)?;
    }
    // Background points far from objects are left out; they would be most of the file.
    let x_wt = x_tw.inverse();
    let kept: Vec<LabelledPoint> = points
        .iter()
        .filter(|p| p.label != 0 || truth.surfaces.iter().any(|s| is_near(s, p.point)))
        .map(|p| LabelledPoint { point: x_wt.transform_point(p.point), ..*p })
        .collect();
    write_points(&dir.join("surface.ply"), &kept)?;
    if let Some(((i, view), shown)) = truth.held_out.iter().zip(&shown).nth(truth.held_out.len() / 2) {
        let frame = &prepared.sequence.frames[*i];
        write_panel(&dir.join("panel.png"), &frame.color, shown, &view.depth)?;
    }
    set("measure_seconds", timer.seconds().0);
    Ok(metrics)
}

/// Returns the held-out views from the true cameras, carried into the world of the model by `x_wt`, their mean PSNR and their depth errors.
pub(crate) fn held_out_views(
    prepared: &Prepared,
    truth: &Yardstick,
    trainer: &mut dyn Trainer,
    x_wt: &DPose3,
) -> (Vec<ShownView>, f64, DepthScores) {
    let (mut shown, mut psnr, mut depth) = (Vec::new(), 0.0, DepthErrors::default());
    for (i, view) in &truth.held_out {
        let frame = &prepared.sequence.frames[*i];
        let maps = ShownView::of_maps(&trainer.render(&carried(&prepared.true_cameras[*i], x_wt)));
        depth.add(&maps.depth, view, &frame.depth);
        psnr += psnr_db(&maps.color, &frame.color) / truth.held_out.len() as f64;
        shown.push(maps);
    }
    (shown, psnr, depth.scores())
}

/// `X_TW` of the result: as recorded, or, where poses were disturbed, from true against used cameras, refined on the
/// surfaces.
fn alignment(
    prepared: &Prepared,
    options: &BenchOptions,
    model: &GaussianModel,
    truth: &Yardstick,
    prefix: &str,
    metrics: &mut Metrics,
) -> DPose3 {
    if !options.disturbance.disturbs_poses() {
        return prepared.x_tw();
    }
    let trained = prepared.trained(options.scan.holdout);
    let x_tc: Vec<DPose3> =
        trained.iter().map(|&i| prepared.x_tw() * prepared.true_cameras[i].x_wc).collect();
    let x_wc: Vec<DPose3> = trained.iter().map(|&i| prepared.sequence.frames[i].camera.x_wc).collect();
    let first = align_cameras(&x_wc, &x_tc);
    let points = disc_points(model, &DPose3::identity(), &DiscSampling::default());
    let on_objects: Vec<(DVec3, usize)> = points
        .iter()
        .filter_map(|p| {
            let truth = *truth.truth_of.get(usize::from(p.label))?;
            (truth != 0 && truth != UNMATCHED).then(|| (p.point, usize::from(truth) - 1))
        })
        .collect();
    let x_tw = refine_on_surfaces(&on_objects, &truth.surfaces, first);
    let (turn, shift) = pose_difference(&x_tw, &prepared.x_tw());
    metrics.set(format!("{prefix}alignment_turn_rad"), turn);
    metrics.set(format!("{prefix}alignment_shift_m"), shift);
    x_tw
}

/// Points of the depth rendered at the frames trained on, with the labels rendered there.
fn rendered_points(
    prepared: &Prepared,
    options: &BenchOptions,
    trainer: &mut dyn Trainer,
    x_tw: &DPose3,
) -> Vec<LabelledPoint> {
    let mut points = Vec::new();
    for i in prepared.trained(options.scan.holdout) {
        let camera = prepared.sequence.frames[i].camera;
        let view = ShownView::of_maps(&trainer.render(&camera));
        let Some(label) = view.label else { continue };
        for (at, (&z, &label)) in view.depth.data.iter().zip(&label.data).enumerate() {
            if z > 0.0 && label > 0 {
                let p_w = camera.unproject_pixel(at % view.depth.width, at / view.depth.width, f64::from(z));
                points.push(LabelledPoint { point: x_tw.transform_point(p_w), label });
            }
        }
    }
    points
}

/// Scores of the default meshes and of the clouds that they are made of, and the seconds it took to make them.
fn mesh_scores(
    scanned: &ScannedScene<'_>,
    x_tw: &DPose3,
    truth: &Yardstick,
    context: StageContext<'_>,
) -> Result<(SceneScores, SceneScores, f64), BenchError> {
    let &ScannedScene { prepared, options, model, .. } = scanned;
    let timer = Timer::start();
    let (sequence, labels) = prepared.trained_only(options.scan.holdout);
    let made = stages::entities(
        model.clone(),
        &sequence,
        &labels,
        &options.entities,
        &options.read,
        context.with_seed(SCAN_SEED),
    )?;
    let seconds = timer.seconds().0;
    let (mut mesh, mut cloud) = (Vec::new(), Vec::new());
    for entity in made.set.entities.iter().filter(|e| e.kind == EntityKind::Dynamic) {
        let label = entity.label;
        let labelled = |p: DVec3| LabelledPoint { point: x_tw.transform_point(p), label };
        let count = (entity.mesh.area() * 1e6).ceil() as usize;
        mesh.extend(sample_surface(&entity.mesh, count, SCAN_SEED).into_iter().map(labelled));
        cloud.extend(entity.cloud.points_w.iter().copied().map(labelled));
    }
    let score =
        |points: &[LabelledPoint]| score_labelled(points, &truth.truth_of, &truth.surfaces, &truth.observed);
    Ok((score(&mesh), score(&cloud), seconds))
}
