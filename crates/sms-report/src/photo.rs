//! Recorded views: photographs with their cameras and labels.

use crate::html::base64_of;
use sms_core::{Camera, ColorImage, DepthImage, LabelMap, jpeg_bytes};

/// Quality of photographs, 1 to 100.
const PHOTO_QUALITY: u8 = 82;

/// A recorded frame for the page.
#[derive(Debug, Clone)]
pub struct RecordedView {
    /// Index in the sequence.
    pub frame_index: usize,
    /// Whether the frame was held out of training.
    pub held_out: bool,
    /// The camera, in the world, at the size of `depth` and `labels`.
    pub camera: Camera,
    /// The photograph: the same view at any size.
    pub photo: ColorImage,
    /// Observed depth, metres.
    pub depth: DepthImage,
    /// Labels, with the ids of the scene's bodies.
    pub labels: LabelMap,
}

/// Encodes a picture as JPEG and returns it as a `data:` address, empty for an empty picture.
pub(crate) fn jpeg_address(picture: &ColorImage, quality: u8) -> String {
    let bytes = jpeg_bytes(picture, quality);
    if bytes.is_empty() { String::new() } else { format!("data:image/jpeg;base64,{}", base64_of(&bytes)) }
}

/// Returns a photograph as a `data:` address.
pub(crate) fn photo_address(photo: &ColorImage) -> String {
    jpeg_address(photo, PHOTO_QUALITY)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::Image;

    #[test]
    fn pictures_are_cut_and_encoded() {
        let picture = Image::from_vec(4, 3, (0..12u8).map(|v| [v, 0, 0]).collect());
        let part = picture.cropped((1, 1), (3, 9));
        assert_eq!((part.size(), part.data[0], part.data[3]), ((2, 2), [5, 0, 0], [10, 0, 0]));
        assert_eq!(picture.cropped((9, 9), (9, 9)).size(), (1, 1));
        assert!(jpeg_address(&picture, 80).starts_with("data:image/jpeg;base64,/9j/"));
        assert_eq!(jpeg_address(&Image::from_vec(0, 0, Vec::new()), 80), "");
    }
}
