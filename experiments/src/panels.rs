//! A picture of one held-out view: observed, rendered, depth error, labels.

use crate::ShownView;
use sms_core::{ColorImage, CoreError, DepthImage, Image, write_png_color};
use sms_report::{error_picture, label_picture};
use std::path::Path;

/// Depth error that is shown as the hottest colour, metres.
const FULL_SCALE_M: f32 = 0.01;

/// Writes observed colour, rendered colour, error against `depth` (0 to 10 mm) and rendered labels, side by side.
///
/// # Errors
/// [`CoreError::Write`].
pub fn write_panel(
    path: &Path,
    observed: &ColorImage,
    shown: &ShownView,
    depth: &DepthImage,
) -> Result<(), CoreError> {
    let rendered = shown.color.map(|c| c.map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8));
    let error = error_picture(&shown.depth, depth, FULL_SCALE_M);
    let labels = shown.label.as_ref().map(|l| label_picture(observed, l));
    let pictures: Vec<&ColorImage> =
        [Some(observed), Some(&rendered), Some(&error), labels.as_ref()].into_iter().flatten().collect();
    write_png_color(path, &beside(&pictures))
}

fn beside(pictures: &[&ColorImage]) -> ColorImage {
    let (width, height) = pictures.first().map_or((0, 0), |p| p.size());
    let mut data = Vec::with_capacity(width * height * pictures.len());
    for y in 0..height {
        for p in pictures {
            data.extend_from_slice(&p.data[y * width..(y + 1) * width]);
        }
    }
    Image::from_vec(width * pictures.len(), height, data)
}
