//! Recording → frames.

use super::tracking::{EstimatedPoses, with_estimated_poses};
use crate::Error;
use sms_core::metrics::Metrics;
use sms_core::{InputError, StageContext};
use sms_frames::{DepthNoise, LoadSettings, Recording, Sequence, Severity, check, load};
use sms_poses::{PoseOrigin, PoseReport, PosesConfig, PosesMode, refine_poses};
use std::time::Instant;

/// Settings of [`frames`].
#[derive(Debug, Clone)]
pub struct FramesRequest {
    /// Loading of images.
    pub load: LoadSettings,
    /// Refinement of camera poses.
    pub poses: PosesConfig,
    /// Whether to use the recording even if its check finds a fault.
    pub accept_faults: bool,
}

/// Frames of a recording.
#[derive(Debug, Clone)]
pub struct Frames {
    /// The frames with their final poses.
    pub sequence: Sequence,
    /// Report of the pose refinement; `None` for recorded poses.
    pub poses: Option<PoseReport>,
    /// Metrics `check.*` and `poses.*`.
    pub metrics: Metrics,
}

/// Checks a recording, estimates its poses if it has none, loads its frames and refines their poses.
///
/// # Errors
/// [`Error::Input`] that names the fault of the recording; otherwise the error of the step that failed.
pub fn frames(
    recording: &Recording,
    request: &FramesRequest,
    context: StageContext<'_>,
) -> Result<Frames, Error> {
    let mode = request.poses.mode;
    let must_estimate = mode == PosesMode::Estimate || (mode == PosesMode::Auto && !recording.has_poses);
    if !must_estimate && !recording.has_poses {
        return Err(recording.without_poses().into());
    }
    let checked = checked(recording, request.accept_faults, context)?;
    let posed = posed_frames(recording, &request.load, &request.poses, must_estimate, context)?;
    let request = FramesRequest { poses: request.poses.for_origin(posed.origin), ..request.clone() };
    let mut frames = refined(posed.sequence, &request, context)?;
    frames.metrics.merge(checked);
    frames.metrics.merge(posed.metrics);
    if let Some(report) = &mut frames.poses {
        report.origin = posed.origin;
    }
    Ok(frames)
}

/// Frames with the poses that a refinement begins with.
pub(super) struct PosedFrames {
    /// The frames.
    pub(super) sequence: Sequence,
    /// World of the poses.
    pub(super) origin: PoseOrigin,
    /// Metrics `poses.*` of the estimate; none for recorded poses.
    pub(super) metrics: Metrics,
}

/// Loads the selected frames of a recording with its poses, or with poses that are estimated from the images.
///
/// # Errors
/// As [`load`] and [`with_estimated_poses`].
pub(super) fn posed_frames(
    recording: &Recording,
    settings: &LoadSettings,
    config: &PosesConfig,
    must_estimate: bool,
    context: StageContext<'_>,
) -> Result<PosedFrames, Error> {
    if !must_estimate {
        let sequence = load(recording, settings, context)?;
        return Ok(PosedFrames { sequence, origin: PoseOrigin::Recorded, metrics: Metrics::new() });
    }
    let EstimatedPoses { recording, origin, metrics } =
        with_estimated_poses(recording, settings, config, context)?;
    // The frames were selected before.
    let all = LoadSettings { first: 0, stride: 1, max_frames: 0, ..settings.clone() };
    Ok(PosedFrames { sequence: load(&recording, &all, context)?, origin, metrics })
}

/// Refines the poses of loaded frames, unless the mode is `given`, and gives the frames the depth noise that they show.
///
/// # Errors
/// As [`refine_poses`].
pub fn refined(
    sequence: Sequence,
    request: &FramesRequest,
    context: StageContext<'_>,
) -> Result<Frames, Error> {
    let FramesRequest { load, poses: config, .. } = request;
    let mut metrics = Metrics::new();
    if config.mode == PosesMode::Given {
        return Ok(Frames { sequence, poses: None, metrics });
    }
    let began = Instant::now();
    let mut refined = refine_poses(&sequence, config, context)?;
    // Noise that is out of the range of the setting says nothing of a sensor.
    let is_possible = |noise: &DepthNoise| noise.validate("frames", "noise.").is_ok();
    let estimated = refined.report.depth_noise.filter(|n| load.estimate_noise && is_possible(n));
    // Another focal length changes the normals, too.
    let own = refined.sequence.frames.first().zip(sequence.frames.first()).and_then(|(after, before)| {
        (after.camera.intrinsics != before.camera.intrinsics).then_some(before.depth_noise)
    });
    if let Some(noise) = estimated.or(own) {
        refined.sequence.set_depth_noise(noise, load.normal_radius);
    }
    metrics.merge(refined.report.metrics());
    metrics.set("poses.seconds", began.elapsed().as_secs_f64());
    Ok(Frames { sequence: refined.sequence, poses: Some(refined.report), metrics })
}

/// Checks the recording: faults are errors unless accepted, other findings become warnings.
fn checked(recording: &Recording, accept_faults: bool, context: StageContext<'_>) -> Result<Metrics, Error> {
    let report = check(recording, context.progress, context.cancel)?;
    for finding in &report.findings {
        if finding.severity == Severity::Fault && !accept_faults {
            let cure = format!("{}; or scan anyway with --no-check", finding.cure);
            return Err(InputError::new(finding.what.clone(), &recording.root, cure).into());
        }
        if finding.severity != Severity::Info {
            context.warnings.add("frames", finding.code, finding.what.clone(), finding.cure.clone());
        }
    }
    Ok(report.metrics())
}
