//! Pictures of observed and rendered frames.

use crate::colormap::{depth_picture, error_picture, label_picture};
use crate::html::write_picture;
use sms_core::{Camera, ColorImage, CoreError, DepthImage, LabelMap};
use std::fmt::Write;
use std::path::Path;

/// A frame as observed and as rendered from the Gaussians; all images have the same size.
#[derive(Debug, Clone)]
pub struct ViewPair {
    /// Index in the sequence.
    pub frame_index: usize,
    /// Whether the frame was held out of training.
    pub held_out: bool,
    /// The camera, in the world.
    pub camera: Camera,
    /// Observed colour.
    pub observed_color: ColorImage,
    /// Observed depth, metres.
    pub observed_depth: DepthImage,
    /// Labels of the masks.
    pub observed_label: LabelMap,
    /// Rendered colour.
    pub rendered_color: ColorImage,
    /// Rendered depth, metres.
    pub rendered_depth: DepthImage,
    /// Rendered labels.
    pub rendered_label: LabelMap,
}

/// Depth error at the top of the colour scale, metres.
const ERROR_FULL_SCALE_M: f32 = 0.02;

/// Writes the pictures of each view as PNG into `dir` and returns the HTML that shows them.
pub(crate) fn view_rows(views: &[ViewPair], dir: &Path) -> Result<String, CoreError> {
    let mut html = String::new();
    for view in views {
        let (near, far) = depth_range(&view.observed_depth);
        let pictures = [
            ("observed", "observed colour", view.observed_color.clone()),
            ("rendered", "rendered colour", view.rendered_color.clone()),
            ("depth_observed", "observed depth", depth_picture(&view.observed_depth, near, far)),
            ("depth_rendered", "rendered depth", depth_picture(&view.rendered_depth, near, far)),
            (
                "depth_error",
                "depth error, 0 to 20 mm",
                error_picture(&view.rendered_depth, &view.observed_depth, ERROR_FULL_SCALE_M),
            ),
            ("masks", "masks", label_picture(&view.observed_color, &view.observed_label)),
            ("labels", "rendered labels", label_picture(&view.rendered_color, &view.rendered_label)),
        ];
        let tag = if view.held_out { "<span class=\"tag\">held out of training</span>" } else { "" };
        let _ = write!(html, "<h3>Frame {} {tag}</h3><div class=\"views\">", view.frame_index);
        for (name, caption, picture) in pictures {
            let path = dir.join(format!("view_{:03}_{name}.png", view.frame_index));
            let _ = write!(
                html,
                "<figure><img loading=\"lazy\" width=\"{}\" height=\"{}\" src=\"{}\" alt=\"{caption}, frame {}\"><figcaption>{caption}</figcaption></figure>",
                picture.width,
                picture.height,
                write_picture(&path, &picture)?,
                view.frame_index
            );
        }
        html.push_str("</div>");
    }
    Ok(html)
}

/// Returns the 2 % and 98 % quantiles of the valid depths, so that outliers do not compress the colour scale.
fn depth_range(depth: &DepthImage) -> (f32, f32) {
    let mut valid: Vec<f32> = depth.data.iter().copied().filter(|&z| z > 0.0).collect();
    if valid.is_empty() {
        return (0.0, 1.0);
    }
    valid.sort_by(f32::total_cmp);
    let at = |q: f64| valid[((valid.len() - 1) as f64 * q) as usize];
    (at(0.02), at(0.98))
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::glamx::DPose3;
    use sms_core::{Image, Intrinsics};

    #[test]
    fn a_view_becomes_seven_pictures_on_disk_and_in_the_page() {
        let dir = tempfile::tempdir().unwrap();
        let depth = Image::from_vec(4, 2, vec![0.0, 1.0, 1.1, 1.2, 1.0, 1.0, 1.0, 9.0]);
        let view = ViewPair {
            frame_index: 7,
            held_out: true,
            camera: Camera::new(Intrinsics::from_fov(4, 2, 1.0), DPose3::identity()),
            observed_color: Image::filled(4, 2, [9, 9, 9]),
            observed_depth: depth.clone(),
            observed_label: Image::filled(4, 2, 1),
            rendered_color: Image::filled(4, 2, [9, 9, 9]),
            rendered_depth: depth,
            rendered_label: Image::filled(4, 2, 0),
        };
        let html = view_rows(&[view], dir.path()).unwrap();
        assert_eq!(html.matches("data:image/jpeg;base64,").count(), 7);
        assert!(html.contains("held out"));
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 7);
    }
}
