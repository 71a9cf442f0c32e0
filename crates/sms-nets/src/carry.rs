//! Boxes transferred from one frame to the next by pose and depth.

use crate::owlv2::PixelBox;
use sms_core::LabelMap;
use sms_frames::Frame;

/// Share of an object's pixels ignored at each edge of its transferred box, so that a few wrong depths at its border do
/// not enlarge the box.
const TRIM: f64 = 0.005;
/// Widening of a transferred box, as a share of its size: border pixels seldom have depth.
const WIDEN: f64 = 0.03;
/// Smallest number of pixels with depth for transferring a box.
const MIN_PIXELS: usize = 8;

/// The expected position of an object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Carried {
    /// In this box.
    At(PixelBox),
    /// Outside the picture.
    OutOfView,
    /// Unknown: too few of the object's pixels have depth.
    Unknown,
}

/// Returns the expected box of object `id` in frame `to` if the object does not move: the projected points of its
/// pixels in `map`, the labels of frame `from`.
pub(crate) fn carried_box(from: &Frame, map: &LabelMap, id: u16, to: &Frame) -> Carried {
    let (width, height) = to.color.size();
    let (mut us, mut vs) = (Vec::new(), Vec::new());
    let mut with_depth = 0;
    for (i, _) in map.data.iter().enumerate().filter(|(_, label)| **label == id) {
        let (x, y) = (i % map.width, i / map.width);
        let z = f64::from(from.depth[(x, y)]);
        if z <= 0.0 {
            continue;
        }
        with_depth += 1;
        // Points behind the camera have no projection.
        if let Some((u, v, _)) = to.camera.project(from.camera.unproject_pixel(x, y, z)) {
            us.push(u);
            vs.push(v);
        }
    }
    if with_depth < MIN_PIXELS {
        return Carried::Unknown;
    }
    if us.len() < MIN_PIXELS {
        return Carried::OutOfView;
    }
    let range = |values: &mut Vec<f64>| {
        values.sort_by(f64::total_cmp);
        let trim = (values.len() as f64 * TRIM) as usize;
        let (low, high) = (values[trim], values[values.len() - 1 - trim]);
        let margin = WIDEN * (high - low) + 0.5;
        (low - margin, high + margin)
    };
    let ((x0, x1), (y0, y1)) = (range(&mut us), range(&mut vs));
    let clipped = PixelBox { x0, y0, x1, y1 }.clipped(width, height);
    if clipped.area() >= 1.0 { Carried::At(clipped) } else { Carried::OutOfView }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::{DPose3, DVec3};
    use sms_core::{Camera, ColorImage, DepthImage, Intrinsics, NormalImage};

    fn frame(index: usize, x_m: f64) -> Frame {
        let intrinsics = Intrinsics::from_fov(80, 60, 1.0);
        let x_wc = DPose3::from_parts(DVec3::new(x_m, 0.0, 0.0), glamx::DQuat::IDENTITY);
        Frame {
            index,
            ..Frame::new(
                Camera::new(intrinsics, x_wc),
                ColorImage::filled(80, 60, [0; 3]),
                DepthImage::filled(80, 60, 1.0),
                NormalImage::filled(80, 60, [0.0, 0.0, -1.0]),
            )
        }
    }

    #[test]
    fn a_box_moves_against_the_camera_and_is_lost_without_depth_or_view() {
        let (a, b) = (frame(0, 0.0), frame(1, 0.1));
        let mut map = LabelMap::filled(80, 60, 0);
        for y in 20..30 {
            for x in 30..50 {
                map[(x, y)] = 2;
            }
        }
        let shift = 0.1 * a.camera.intrinsics.fx;
        let at = |to: &Frame| match carried_box(&a, &map, 2, to) {
            Carried::At(bbox) => bbox,
            other => panic!("{other:?}"),
        };
        let (still, moved) = (at(&a), at(&b));
        assert!((still.x0 - moved.x0 - shift).abs() < 1e-6 && (still.y1 - moved.y1).abs() < 1e-6);
        assert!((still.x0 - 30.0).abs() < 2.0 && (still.x1 - 50.0).abs() < 2.0, "{still:?}");
        assert_eq!(carried_box(&a, &map, 1, &b), Carried::Unknown);
        assert_eq!(carried_box(&a, &map, 2, &frame(2, 5.0)), Carried::OutOfView);
        let mut blind = frame(0, 0.0);
        blind.depth = DepthImage::filled(80, 60, 0.0);
        assert_eq!(carried_box(&blind, &map, 2, &b), Carried::Unknown);
    }
}
