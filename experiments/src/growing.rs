//! A map that grows frame by frame, measured after the last frame.

use crate::BenchError;
use crate::options::BenchOptions;
use crate::prepare::Prepared;
use crate::reference::Yardstick;
use crate::run::held_out_views;
use crate::timer::Timer;
use glamx::DVec3;
use sms_core::StageContext;
use sms_core::metrics::Metrics;
use sms_eval::{DiscSampling, disc_points, score_cropped};
use sms_gaussians::Trainer;
use sms_pipeline::stages;

/// Grows a map from the frames that are trained on, and measures it as the scan is measured; keys are `{prefix}growing_…`. A real recording
/// has seconds and a number of Gaussians only.
///
/// # Errors
/// As [`stages::grow`].
pub(crate) fn growing_metrics(
    prefix: &str,
    prepared: &Prepared,
    options: &BenchOptions,
    trainer: &mut dyn Trainer,
    context: StageContext<'_>,
) -> Result<Metrics, BenchError> {
    let mut metrics = Metrics::new();
    let mut set = |key: &str, value: f64| {
        metrics.set(format!("{prefix}growing_{key}"), value);
    };
    let timer = Timer::start();
    let trained = prepared.trained(options.scan.holdout);
    let frames = trained.iter().map(|&i| Ok(&prepared.sequence.frames[i]));
    let count = stages::grow(frames, &options.scan, trainer, &mut (), context)?;
    set("seconds_per_frame", timer.seconds().0 / count as f64);
    set("gaussians", trainer.len() as f64);
    let Some(truth) = Yardstick::new(prepared, options.scan.holdout) else { return Ok(metrics) };
    let x_tw = prepared.x_tw();
    let (_, psnr_db, depth) = held_out_views(prepared, &truth, trainer, &x_tw.inverse());
    set("holdout_psnr_db", psnr_db);
    set("holdout_depth_mae_m", depth.mae_m);
    let points = disc_points(&trainer.model(), &x_tw, &DiscSampling::default());
    let points: Vec<DVec3> = points.iter().map(|p| p.point).collect();
    set("cropped_f1_2p5mm", score_cropped(&points, &truth.surfaces, &truth.observed).mean.f1);
    Ok(metrics)
}
