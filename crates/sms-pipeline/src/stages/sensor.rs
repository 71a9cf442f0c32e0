//! Recording → errors of its depth, colour and poses.

use super::frames::posed_frames;
use crate::Error;
use sms_core::StageContext;
use sms_frames::{LoadSettings, Recording};
use sms_poses::{PoseReport, PosesConfig, PosesMode, refine_poses};

/// Frames that are examined: consecutive ones from the middle of the recording.
const EXAMINED: usize = 24;

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
) -> Result<PoseReport, Error> {
    let first = recording.frames.len().saturating_sub(EXAMINED) / 2;
    let some = LoadSettings { first, stride: 1, max_frames: EXAMINED, ..settings.clone() };
    let posed = posed_frames(recording, &some, config, !recording.has_poses, context)?;
    let config = PosesConfig { mode: PosesMode::Refine, ..config.clone() };
    Ok(PoseReport { origin: posed.origin, ..refine_poses(&posed.sequence, &config, context)?.report })
}
