//! Recording without poses → recording with estimated poses.

use crate::Error;
use sms_core::metrics::Metrics;
use sms_core::{InputError, StageContext, Warnings};
use sms_frames::{LoadSettings, Recording, load_frame};
use sms_poses::{PosesConfig, Trajectory, track_cameras};
use std::time::Instant;

/// Longer image side of tracked frames, pixels: twice the pixels would take four times as long.
const LONG_SIDE: usize = 320;
/// Most frames that a warning names.
const MOST_NAMED: usize = 8;

/// Estimates the poses of all frames from their images. Frames whose pose is not found are left out.
///
/// # Errors
/// [`Error::Input`] if there are no two frames that fit together, or a file is missing or damaged; an interruption.
pub fn with_estimated_poses(
    recording: &Recording,
    load: &LoadSettings,
    config: &PosesConfig,
    context: StageContext<'_>,
) -> Result<(Recording, Metrics), Error> {
    let began = Instant::now();
    let settings = LoadSettings { long_side: LONG_SIDE, ..load.clone() };
    let count = recording.frames.len();
    let found = track_cameras(count, &|i| load_frame(recording, i, &settings), config, context)?;
    let posed = found.poses.iter().flatten().count();
    if posed < 2 && count > 1 {
        let what = "the camera poses cannot be estimated: no two frames fit together";
        let cure = "record more slowly, with more overlap between frames, and keep objects within the depth camera's range";
        return Err(InputError::new(what, &recording.root, cure).into());
    }
    warn(&found, context.warnings);
    let mut metrics = Metrics::new();
    metrics.set("poses.tracked_frames", posed as f64);
    metrics.set("poses.lost_frames", (count - posed) as f64);
    metrics.set("poses.keyframes", found.keyframes as f64);
    metrics.set("poses.loops", found.loops as f64);
    metrics.set("poses.tracking_seconds", began.elapsed().as_secs_f64());
    Ok((recording.clone().with_poses(&found.poses), metrics))
}

fn warn(found: &Trajectory, warnings: &Warnings) {
    let named = |frames: &[usize]| {
        let first: Vec<String> = frames.iter().take(MOST_NAMED).map(ToString::to_string).collect();
        let more = if frames.len() > MOST_NAMED {
            format!(" and {} more", frames.len() - MOST_NAMED)
        } else {
            String::new()
        };
        format!("{}{more}", first.join(", "))
    };
    let lost: Vec<usize> = found.other_pieces.iter().flatten().copied().collect();
    if !lost.is_empty() {
        warnings.add(
            "frames",
            "frames_lost",
            format!(
                "frames {} are left out: the camera's motion to them could not be followed",
                named(&lost)
            ),
            "record more slowly there, or return to a place that was seen before",
        );
    }
    if !found.without_depth.is_empty() {
        warnings.add(
            "frames",
            "frames_without_depth",
            format!(
                "frames {} are left out: they have too little depth to follow the camera",
                named(&found.without_depth)
            ),
            "keep the scene within the range of the depth camera",
        );
    }
}
