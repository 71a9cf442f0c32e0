//! Recording → errors of its depth, colour and poses.

use super::frames::posed_frames;
use crate::Error;
use sms_core::{Intrinsics, StageContext};
use sms_frames::{Frame, LoadSettings, Recording, Sequence};
use sms_poses::{PoseReport, PosesConfig, PosesMode, refine_poses};

/// Frames that are examined: consecutive ones from the middle of the recording.
const EXAMINED: usize = 24;

/// Errors of a recording.
#[derive(Debug, Clone)]
pub struct SensorErrors {
    /// Report of the pose refinement that found them; its pixels are those of the loaded images.
    pub report: PoseReport,
    /// Recorded pixels of the colour images per loaded pixel.
    pub pixel_scale: f64,
}

/// Estimates the depth noise of a recording, the shift of its colour against the depth and the errors of its poses from some
/// consecutive frames. The verdict of the report says whether they could be compared.
///
/// # Errors
/// [`Error::Input`] if a file is missing or damaged, or if the recording has no poses and they cannot be estimated; an interruption.
pub fn sensor(
    recording: &Recording,
    settings: &LoadSettings,
    config: &PosesConfig,
    context: StageContext<'_>,
) -> Result<SensorErrors, Error> {
    let first = recording.frames.len().saturating_sub(EXAMINED) / 2;
    let some = LoadSettings { first, stride: 1, max_frames: EXAMINED, keyframe_views: 0, ..settings.clone() };
    let posed = posed_frames(recording, &some, config, !recording.has_poses, context)?;
    let config = PosesConfig { mode: PosesMode::Refine, ..config.for_origin(posed.origin) };
    let report =
        PoseReport { origin: posed.origin, ..refine_poses(&posed.sequence, &config, context)?.report };
    Ok(SensorErrors { report, pixel_scale: pixel_scale(recording, &posed.sequence) })
}

/// Returns the recorded pixels of the colour images per loaded pixel, along the longer side of the first loaded frame.
fn pixel_scale(recording: &Recording, sequence: &Sequence) -> f64 {
    let of = |loaded: &Frame| {
        let recorded = &recording.frames[recording.index_of(loaded)?];
        let long_side = |k: &Intrinsics| k.width.max(k.height) as f64;
        Some(long_side(&recorded.color_lens.intrinsics) / long_side(&loaded.camera.intrinsics))
    };
    sequence.frames.first().and_then(of).unwrap_or(1.0)
}
