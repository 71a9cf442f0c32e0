//! Loading: images are read, undistorted and resampled, normals computed, the world aligned.

use crate::align::align;
use crate::attached::{DepthView, attached};
use crate::exposure::equalize;
use crate::gaps::fill_gaps;
use crate::keyframes::keyframes;
use crate::normals::normals_from_depth;
use crate::resample::{resample_depth, resize_color, target_intrinsics, undistort_color};
use crate::{DepthNoise, Frame, FramesError, LoadSettings, Recording, Sequence};
use rayon::prelude::*;
use sms_core::{Camera, DepthImage, InputError, Intrinsics, StageContext, read_color};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Returns the indices of the recorded frames that `settings` select.
pub(crate) fn selected_frames(recording: &Recording, settings: &LoadSettings) -> Vec<usize> {
    let most = if settings.max_frames == 0 { usize::MAX } else { settings.max_frames };
    (settings.first..recording.frames.len()).step_by(settings.stride.max(1)).take(most).collect()
}

/// Loads a recording: its keyframes ([`LoadSettings::keyframe_views`]) at scan resolution in a metric world with z up.
///
/// Frames are read in parallel; the result does not depend on the number of threads.
///
/// # Errors
/// [`sms_core::InputError`] naming the file that is missing, damaged or empty; [`FramesError::Interrupted`] when
/// cancelled.
pub fn load(
    recording: &Recording,
    settings: &LoadSettings,
    context: StageContext<'_>,
) -> Result<Sequence, FramesError> {
    let StageContext { progress, cancel, warnings, .. } = context;
    settings.validate()?;
    for notice in &recording.notices {
        warnings.add("scan", notice.code, notice.message.clone(), notice.cure.clone());
    }
    if !recording.has_poses {
        return Err(recording.without_poses().into());
    }
    let selected = selected_frames(recording, settings);
    if selected.is_empty() {
        let what = format!("no frame is left of {} from frame {} on", recording.frames.len(), settings.first);
        return Err(InputError::new(what, &recording.root, "start earlier, or use all frames").into());
    }
    let selected = keyframes(recording, &selected, settings.keyframe_views, context)?;
    progress.begin("load", selected.len() as u64);
    let done = AtomicU64::new(0);
    let loaded: Vec<Result<Option<Frame>, FramesError>> = selected
        .par_iter()
        .map(|&i| {
            cancel.check()?;
            let frame = load_frame(recording, i, settings);
            let n = done.fetch_add(1, Ordering::Relaxed) + 1;
            progress.update(n, &format!("frame {i}"));
            frame
        })
        .collect();
    let mut frames: Vec<Frame> = Vec::with_capacity(selected.len());
    for (result, &i) in loaded.into_iter().zip(&selected) {
        match result? {
            Some(frame) => frames.push(Frame { index: frames.len(), ..frame }),
            None => warnings.add(
                "scan",
                "empty_depth_skipped",
                format!("frame {i} has no depth and was skipped"),
                "",
            ),
        }
    }
    leave_attached_out(&mut frames, context);
    if let Some((least, greatest)) = equalize(&mut frames, cancel) {
        let what = format!(
            "exposure or white balance differs between frames (gains from {least:.2} to {greatest:.2}); \
             colours are brought to one exposure"
        );
        warnings.add("frames", "exposure_varies", what, "fix both while you record");
    }
    cancel.check()?;
    if frames.is_empty() {
        return Err(recording.without_depth().into());
    }
    let x_world_recording = align(recording, settings.align, &settings.noise, &frames, warnings);
    for frame in &mut frames {
        frame.camera.x_wc = x_world_recording * frame.camera.x_wc;
    }
    let (w, h) = frames[0].color.size();
    progress.end(&format!("{} frames at {w} × {h}", frames.len()));
    Ok(Sequence { frames, x_world_recording, source: recording.root.clone() })
}

/// Removes the measurements of pixels that show something attached to the camera, and frames that measure nothing else.
fn leave_attached_out(frames: &mut Vec<Frame>, context: StageContext<'_>) {
    let StageContext { warnings, cancel, .. } = context;
    let views: Vec<DepthView<'_>> = frames.iter().map(DepthView::from).collect();
    let Some(found) = attached(&views, cancel) else { return };
    warnings.add("frames", "attached_to_camera", found.message(), "");
    let pixels = Arc::new(found.pixels);
    frames.par_iter_mut().for_each(|frame| {
        for (i, _) in pixels.data.iter().enumerate().filter(|(_, attached)| **attached) {
            frame.depth.data[i] = 0.0;
            frame.normal_c.data[i] = [0.0; 3];
        }
        frame.attached = Some(Arc::clone(&pixels));
    });
    frames.retain(|frame| {
        let measures = frame.depth.data.iter().any(|&z| z > 0.0);
        if !measures {
            let what =
                format!("{} measures nothing of the scene and was skipped", frame.color_path.display());
            warnings.add("scan", "empty_depth_skipped", what, "");
        }
        measures
    });
    frames.iter_mut().enumerate().for_each(|(i, frame)| frame.index = i);
}

fn is_empty(recording: &Recording, index: usize) -> bool {
    crate::depth_file::read_depth(&recording.frames[index].depth_path)
        .is_ok_and(|d| d.data.iter().all(|&v| v == 0))
}

/// Loads the frame with this index in the recording, at scan resolution; its pose is in the recording's world. `None` for a
/// frame without any depth, if the options of the recording skip these.
///
/// # Errors
/// [`sms_core::InputError`] naming the file that is missing, damaged or empty.
pub fn load_frame(
    recording: &Recording,
    index: usize,
    settings: &LoadSettings,
) -> Result<Option<Frame>, FramesError> {
    match read_frame(recording, index, settings) {
        Err(FramesError::Input(_)) if recording.options.skip_empty_depth && is_empty(recording, index) => {
            Ok(None)
        }
        frame => frame.map(Some),
    }
}

/// Loads the depth of the frame with this index in metres, as a camera with these intrinsics sees it.
///
/// # Errors
/// [`sms_core::InputError`] naming the file that is missing, damaged or empty.
pub(crate) fn load_depth(
    recording: &Recording,
    index: usize,
    intrinsics: &Intrinsics,
    noise: &DepthNoise,
) -> Result<DepthImage, FramesError> {
    let native = recording.read_depth_m(index)?;
    let depth = resample_depth(&native, &recording.frames[index].depth_lens, intrinsics, noise);
    Ok(fill_gaps(depth, intrinsics, noise))
}

fn read_frame(recording: &Recording, index: usize, settings: &LoadSettings) -> Result<Frame, FramesError> {
    let recorded = &recording.frames[index];
    let intrinsics = target_intrinsics(&recorded.color_lens, settings.long_side);
    let depth = load_depth(recording, index, &intrinsics, &settings.noise)?;
    let normal_c = normals_from_depth(&depth, &intrinsics, &settings.noise, settings.normal_radius);
    let color = undistort_color(&read_color(&recorded.color_path)?, &recorded.color_lens);
    let color = resize_color(&color, intrinsics.width, intrinsics.height);
    Ok(Frame {
        index,
        time_s: recorded.time_s,
        depth_noise: settings.noise,
        color_path: recorded.color_path.clone(),
        mask_path: recorded.mask_path.clone(),
        ..Frame::new(Camera::new(intrinsics, recorded.x_rc), color, depth, normal_c)
    })
}
