//! One file per recording format.

pub(crate) mod nerfstudio;
pub(crate) mod tum;

use crate::{Axes, PoseDirection};
use glamx::{DPose3, DQuat};

/// Converts a pose matrix as written to the camera pose (OpenCV axes) in the recording's world.
pub(crate) fn to_opencv(written: DPose3, axes: Axes, poses: PoseDirection) -> DPose3 {
    let x_rc = match poses {
        PoseDirection::CameraToWorld => written,
        PoseDirection::WorldToCamera => written.inverse(),
    };
    match axes {
        Axes::Opencv => x_rc,
        // Half a turn about x exchanges (x right, y up, z backward) and (x right, y down, z forward).
        Axes::Opengl => {
            DPose3::from_parts(x_rc.translation, x_rc.rotation * DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0))
        }
    }
}
