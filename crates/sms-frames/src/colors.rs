//! Recorded colour at more than scan resolution, for textures and rendering.

use crate::exposure::divide;
use crate::resample::{resize_color, target_intrinsics, undistort_color};
use crate::{ReadOptions, Recording, Sequence};
use rayon::prelude::*;
use sms_core::{Cancel, ColorImage, CoreError, read_color};

/// Reads the recorded colour image of every frame, undistorted, at the exposure that the frames have in common, with its long
/// side at most `long_side` pixels; its camera is the frame's with `intrinsics.scaled_to` its size. `None` if the recording or
/// the image is gone; callers then use the sequence's own colour.
///
/// # Errors
/// [`CoreError::Interrupted`] when cancelled.
pub fn recorded_colors(
    sequence: &Sequence,
    options: &ReadOptions,
    long_side: usize,
    cancel: &Cancel,
) -> Result<Vec<Option<ColorImage>>, CoreError> {
    // Poses may be missing or faulty where others are used.
    let options = ReadOptions { ignore_poses: true, ..options.clone() };
    let Ok(recording) = Recording::open(&sequence.source, &options) else {
        return Ok(vec![None; sequence.len()]);
    };
    sequence
        .frames
        .par_iter()
        .map(|frame| {
            cancel.check()?;
            let read = || {
                let recorded = &recording.frames[recording.index_of(frame)?];
                let color = read_color(&recorded.color_path).ok()?;
                let color = undistort_color(&color, &recorded.color_lens);
                let target = target_intrinsics(&recorded.color_lens, long_side);
                let mut color = resize_color(&color, target.width, target.height);
                divide(&mut color, &frame.gain);
                Some(color)
            };
            Ok(read())
        })
        .collect()
}
