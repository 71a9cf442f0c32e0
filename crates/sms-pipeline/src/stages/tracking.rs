//! Recording without poses → recording with estimated poses.

use crate::Error;
use glamx::DPose3;
use sms_core::metrics::Metrics;
use sms_core::{InputError, StageContext, Warnings};
use sms_frames::{Align, LoadSettings, ReadOptions, Recording, load_frame};
use sms_poses::{PoseOrigin, PosesConfig, Trajectory, align_cameras, track_cameras};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

/// Longer image side of tracked frames, pixels: twice the pixels would take four times as long.
const LONG_SIDE: usize = 320;
/// Most frames that a warning names.
const MOST_NAMED: usize = 8;

/// A recording with estimated poses.
#[derive(Debug, Clone)]
pub struct EstimatedPoses {
    /// The recording.
    pub recording: Recording,
    /// World of the poses.
    pub origin: PoseOrigin,
    /// Metrics `poses.*`.
    pub metrics: Metrics,
}

/// Estimates the poses of the selected frames from their images. Frames that are not selected, or whose pose is not found, are
/// left out. If the recording holds poses, the estimated ones are moved rigidly to them, so that its world stays the same.
///
/// # Errors
/// [`Error::Input`] if there are no two frames that fit together, if a file is missing or damaged, or if the world is to be taken
/// as recorded, but no poses are; an interruption.
pub fn with_estimated_poses(
    recording: &Recording,
    load: &LoadSettings,
    config: &PosesConfig,
    context: StageContext<'_>,
) -> Result<EstimatedPoses, Error> {
    let began = Instant::now();
    let recorded = recorded_poses(recording, context.warnings);
    let settings = LoadSettings { long_side: LONG_SIDE, ..load.clone() };
    // Frames that are not selected are followed, too: the camera moves less between them.
    let end = match load.max_frames {
        0 => recording.frames.len(),
        most => load.first.saturating_add((most - 1).saturating_mul(load.stride.max(1)).saturating_add(1)),
    };
    let tracked = load.first.min(recording.frames.len())..end.min(recording.frames.len());
    let (first, count) = (tracked.start, tracked.len());
    let found = track_cameras(count, &|i| load_frame(recording, first + i, &settings), config, context)?;
    let posed = found.poses.iter().flatten().count();
    if posed < count.min(2) {
        let what = "the camera poses cannot be estimated: no two frames fit together";
        let cure = "record more slowly, with more overlap between frames, and keep objects within the depth camera's range";
        return Err(InputError::new(what, &recording.root, cure).into());
    }
    warn(&found, first, context.warnings);
    let mut metrics = Metrics::new();
    metrics.set("poses.tracked_frames", posed as f64);
    metrics.set("poses.lost_frames", (count - posed) as f64);
    metrics.set("poses.keyframes", found.keyframes as f64);
    metrics.set("poses.loops", found.loops as f64);
    metrics.set("poses.tracking_seconds", began.elapsed().as_secs_f64());
    let mut selected: Vec<Option<DPose3>> = vec![None; recording.frames.len()];
    for k in (0..count).step_by(load.stride.max(1)) {
        selected[first + k] = found.poses[k];
    }
    let both = selected.iter().zip(&recorded).filter_map(|(found, given)| (*found).zip(*given));
    let (found, given): (Vec<DPose3>, Vec<DPose3>) = both.unzip();
    let mut posed = recording.clone();
    // Two cameras do not show whether their recorded poses belong together.
    let origin = if found.len() >= 3 {
        let moved = align_cameras(&found, &given);
        selected.iter_mut().flatten().for_each(|x| *x = moved * *x);
        posed = posed.with_poses(&selected);
        (posed.world_up_r, posed.world_is_aligned) = (recording.world_up_r, recording.world_is_aligned);
        PoseOrigin::Estimated
    } else if load.align == Align::None {
        let what =
            "`frames.align = \"none\"` takes the recording's world as it is, but it has no camera poses";
        let cure = "leave it out, or state the up direction: --up";
        return Err(InputError::new(what, &recording.root, cure).into());
    } else {
        posed = posed.with_poses(&selected);
        PoseOrigin::EstimatedAlone
    };
    Ok(EstimatedPoses { recording: posed, origin, metrics })
}

/// Returns the poses that the files of a recording hold, for each of its frames, although the recording may ignore them.
pub(crate) fn recorded_poses(recording: &Recording, warnings: &Warnings) -> Vec<Option<DPose3>> {
    let options = ReadOptions { ignore_poses: false, ..recording.options.clone() };
    let posed = match Recording::open(&recording.root, &options) {
        Ok(posed) => posed,
        Err(error) => {
            let what =
                format!("the poses of the recording cannot be used to place the estimated ones: {error}");
            warnings.add(
                "frames",
                "recorded_poses_unused",
                what,
                "repair them if the recording's world matters",
            );
            return vec![None; recording.frames.len()];
        }
    };
    let of: BTreeMap<&Path, DPose3> = if posed.has_poses {
        posed.frames.iter().map(|f| (&*f.color_path, f.x_rc)).collect()
    } else {
        BTreeMap::new()
    };
    recording.frames.iter().map(|f| of.get(&*f.color_path).copied()).collect()
}

fn warn(found: &Trajectory, first: usize, warnings: &Warnings) {
    let named = |frames: &[usize]| {
        let some: Vec<String> = frames.iter().take(MOST_NAMED).map(|i| (first + i).to_string()).collect();
        let more = if frames.len() > MOST_NAMED {
            format!(" and {} more", frames.len() - MOST_NAMED)
        } else {
            String::new()
        };
        format!("{}{more}", some.join(", "))
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
