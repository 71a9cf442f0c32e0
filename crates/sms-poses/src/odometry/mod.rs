//! Poses from nothing: RGB-D odometry, loop closure, and a graph of keyframes.
//!
//! Each frame is registered to the latest keyframe, densely, by depth and brightness together (Kerl, Sturm and Cremers,
//! "Dense visual SLAM for RGB-D cameras", IROS 2013), from the motion that the last frames suggest; where that fails, from
//! matched corners. A frame that fits nowhere begins a new piece. Then keyframes that look alike, and those that overlap by
//! their poses, are registered to each other, which joins pieces, and all keyframes are settled at once.

mod features;
mod loops;
mod matching;
mod pose_graph;
mod registration;
mod tracker;

use crate::PosesConfig;
use crate::views::prepared;
use glamx::DPose3;
use loops::close_loops;
use rayon::prelude::*;
use registration::TrackedView;
use sms_core::{CoreError, StageContext};
use sms_frames::Frame;
use std::collections::BTreeMap;
use tracker::Tracker;

/// Estimated camera poses of a recording.
#[derive(Debug, Clone, Default)]
pub struct Trajectory {
    /// Pose of each frame of the longest piece in the camera of its first frame; `None` for the other frames.
    pub poses: Vec<Option<DPose3>>,
    /// Frames of the other pieces, whose place relative to the longest is not known.
    pub other_pieces: Vec<Vec<usize>>,
    /// Frames without enough depth.
    pub without_depth: Vec<usize>,
    /// Number of keyframes.
    pub keyframes: usize,
    /// Number of measured motions between keyframes that do not follow each other.
    pub loops: usize,
}

/// Frames that are read at once, while the ones before are registered.
const BATCH: usize = 16;

/// Estimates the camera poses of `count` frames, which `load` reads by their index; `None` is a frame without depth. Their given
/// poses are not used.
///
/// # Errors
/// Those of `load`; [`CoreError::Interrupted`] when cancelled.
pub fn track_cameras(
    count: usize,
    load: &(dyn Fn(usize) -> Result<Option<Frame>, CoreError> + Sync),
    config: &PosesConfig,
    context: StageContext<'_>,
) -> Result<Trajectory, CoreError> {
    let StageContext { progress, cancel, .. } = context;
    config.validate()?;
    // Corners are found at the loaded size.
    let config = &PosesConfig { finest_long_side: usize::MAX, ..config.clone() };
    let prepare = |i: usize| -> Result<Option<TrackedView>, CoreError> {
        cancel.check()?;
        Ok(load(i)?.map(|frame| TrackedView::new(prepared(&frame, config), config)))
    };
    let batch = |first: usize| -> Result<Vec<Option<TrackedView>>, CoreError> {
        let read: Vec<Result<Option<TrackedView>, CoreError>> =
            (first..count.min(first + BATCH)).into_par_iter().map(prepare).collect();
        read.into_iter().collect()
    };
    progress.begin("track", count as u64);
    let mut tracker = Tracker::new(config);
    let mut ready = batch(0)?;
    while !ready.is_empty() {
        let next = tracker.frames.len() + ready.len();
        let track = || {
            for view in ready {
                tracker.push(view);
                progress
                    .update(tracker.frames.len() as u64, &format!("{} keyframes", tracker.keyframes.len()));
            }
        };
        ready = rayon::join(track, || batch(next)).1?;
    }
    let Tracker { mut keyframes, mut edges, frames, .. } = tracker;
    let loops = close_loops(&mut keyframes, &mut edges, config, cancel)?;
    progress.end(&format!("{} keyframes, {loops} loops", keyframes.len()));
    let mut pieces: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    let mut without_depth = Vec::new();
    for (frame, placed) in frames.iter().enumerate() {
        match placed {
            Some(placed) => pieces.entry(keyframes[placed.keyframe].piece).or_default().push(frame),
            None => without_depth.push(frame),
        }
    }
    let longest = pieces.iter().max_by_key(|(piece, frames)| (frames.len(), std::cmp::Reverse(**piece)));
    let longest = longest.map(|(piece, _)| *piece);
    let pose = |placed: &tracker::Placed| {
        let keyframe = &keyframes[placed.keyframe];
        (Some(keyframe.piece) == longest).then(|| keyframe.x_wc * placed.x_kc)
    };
    let poses: Vec<Option<DPose3>> = frames.iter().map(|placed| placed.as_ref().and_then(pose)).collect();
    let x_fw = poses.iter().flatten().next().map_or(DPose3::identity(), DPose3::inverse);
    Ok(Trajectory {
        poses: poses.into_iter().map(|x_wc| Some(x_fw * x_wc?)).collect(),
        other_pieces: pieces.into_iter().filter(|(piece, _)| Some(*piece) != longest).map(|p| p.1).collect(),
        without_depth,
        keyframes: keyframes.len(),
        loops,
    })
}
