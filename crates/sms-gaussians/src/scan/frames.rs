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
    TrainFrame {
        camera: frame.camera,
        color: frame.color.data.par_iter().map(|c| c.map(|v| f32::from(v) / 255.0)).collect(),
        depth: frame.depth.data.clone(),
        normal_w: frame.normal_c.data.par_iter().map(to_world).collect(),
        label: labels.data.clone(),
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
