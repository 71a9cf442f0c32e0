//! Conversion of frames for the trainer.

use crate::TrainFrame;
use glamx::DVec3;
use rayon::prelude::*;
use sms_core::{InputError, LabelMap, Labels};
use sms_frames::{Frame, Sequence};

/// Converts a frame and its labels, with normals in the world.
pub(crate) fn train_frame(frame: &Frame, labels: &LabelMap) -> TrainFrame {
    let rotation_wc = frame.camera.x_wc.rotation;
    let to_world = |n: &[f32; 3]| (rotation_wc * DVec3::from_array(n.map(f64::from))).as_vec3().to_array();
    // The trainer leaves out pixels without a finite colour, and without a label of the table.
    let color = |(i, c): (usize, &[u8; 3])| {
        if frame.shows_scene(i) { c.map(|v| f32::from(v) / 255.0) } else { [f32::NAN; 3] }
    };
    let label = |(i, &label): (usize, &u16)| if frame.shows_scene(i) { label } else { u16::MAX };
    TrainFrame {
        camera: frame.camera,
        color: frame.color.data.par_iter().enumerate().map(color).collect(),
        depth: frame.depth.data.clone(),
        normal_w: frame.normal_c.data.par_iter().map(to_world).collect(),
        label: labels.data.iter().enumerate().map(label).collect(),
    }
}

/// Checks the inputs of a scan.
pub(crate) fn check_inputs(sequence: &Sequence, labels: &Labels, holdout: usize) -> Result<(), InputError> {
    let refuse = |what: String, cure: &str| Err(InputError::new(what, &sequence.source, cure));
    if sequence.is_empty() {
        return refuse("there are no frames to scan".into(), "record at least one frame");
    }
    if labels.maps.len() != sequence.len() {
        return refuse(
            format!("there are {} label maps for {} frames", labels.maps.len(), sequence.len()),
            "make the masks again, one for every frame",
        );
    }
    for (frame, map) in sequence.frames.iter().zip(&labels.maps) {
        let k = &frame.camera.intrinsics;
        let size = (k.width, k.height);
        if [frame.color.size(), frame.depth.size(), frame.normal_c.size(), map.size()] != [size; 4] {
            return refuse(
                format!("colour, depth, normals and labels of frame {} differ in size", frame.index),
                "load the recording and make the masks again at one resolution",
            );
        }
    }
    let trained = sequence.trained(holdout);
    if !trained.iter().any(|&i| sequence.frames[i].depth.data.iter().any(|&z| z > 0.0)) {
        return refuse("no training frame has depth".into(), "record again with depth, or lower `holdout`");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::{Camera, Image, Intrinsics};
    use std::sync::Arc;

    #[test]
    fn what_is_attached_to_the_camera_is_not_trained_on() {
        let k = Intrinsics::from_fov(3, 1, 1.0);
        let camera = Camera::new(k, glamx::DPose3::identity());
        let depth = Image::from_vec(3, 1, vec![1.0, 0.0, 1.0]);
        let frame = Frame {
            attached: Some(Arc::new(Image::from_vec(3, 1, vec![false, true, false]))),
            ..Frame::new(camera, Image::filled(3, 1, [51; 3]), depth, Image::filled(3, 1, [0.0, 0.0, -1.0]))
        };
        let trained = train_frame(&frame, &Image::from_vec(3, 1, vec![1, 1, 0]));
        assert_eq!(trained.label, [1, u16::MAX, 0]);
        let is_used = |c: &[f32; 3]| c.iter().all(|v| v.is_finite());
        assert_eq!(trained.color.iter().map(is_used).collect::<Vec<_>>(), [true, false, true]);
    }
}
