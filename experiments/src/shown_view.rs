//! A rendered view of a reconstruction, ours or another program's.

use sms_core::{DepthImage, Image, LabelMap};
use sms_gaussians::RenderedMaps;

/// Least accumulated opacity of a covered pixel.
const COVERED: f32 = 0.5;

/// A rendered view of a reconstruction.
#[derive(Debug, Clone, PartialEq)]
pub struct ShownView {
    /// Colour, 0 to 1 (not rounded to 8 bits).
    pub color: Image<[f32; 3]>,
    /// Depth in metres, 0 for empty pixels.
    pub depth: DepthImage,
    /// Label of the masks, 0 for empty pixels; `None` when the reconstruction has no labels.
    pub label: Option<LabelMap>,
}

impl ShownView {
    /// Converts rendered maps. Pixels with less opacity than one half have no depth and the background's label.
    pub fn of_maps(maps: &RenderedMaps) -> Self {
        let (w, h) = (maps.width, maps.height);
        let covered = |i: usize| maps.alpha[i] >= COVERED;
        let depth = (0..w * h).map(|i| if covered(i) { maps.depth[i] } else { 0.0 }).collect();
        let label = (0..w * h).map(|i| if covered(i) { maps.label[i] } else { 0 }).collect();
        Self {
            color: Image::from_vec(w, h, maps.color.clone()),
            depth: Image::from_vec(w, h, depth),
            label: Some(Image::from_vec(w, h, label)),
        }
    }
}
