//! Objects and frames for tests.

use glamx::{DPose3, DVec3};
use sms_core::{
    Camera, Entity, EntityKind, EntityShape, Image, Intrinsics, LabelMap, Labels, MaskSource, Mesh,
    PointCloud,
};
use sms_frames::{Frame, Sequence};

pub(crate) fn entity(name: &str, mesh: Mesh, shape: EntityShape) -> Entity {
    let parts = if shape.is_primitive() { Vec::new() } else { vec![mesh.clone()] };
    Entity {
        label: 1,
        name: name.into(),
        description: String::new(),
        kind: EntityKind::Dynamic,
        shape,
        cloud: PointCloud::default(),
        mesh,
        texture: None,
        parts,
        observed_share: 1.0,
        residual_m: 0.0,
        mean_color: [0; 3],
    }
}

/// Cameras 1 m above a plate with label 1 in the left half of their images. There is no depth beyond `width`.
pub(crate) fn over_plate(cameras: usize, width: usize) -> (Sequence, Labels) {
    let intrinsics = Intrinsics { fx: 100.0, fy: 100.0, cx: 50.0, cy: 50.0, width: 100, height: 100 };
    let frame = |index: usize| Frame {
        index,
        ..Frame::new(
            Camera::look_at(intrinsics, DVec3::Z, DVec3::ZERO, DVec3::Y),
            Image::filled(100, 100, [0; 3]),
            Image::from_vec(
                100,
                100,
                (0..10_000).map(|i| if i % 100 < width { 1.0 } else { 0.0 }).collect::<Vec<f32>>(),
            ),
            Image::filled(100, 100, [0.0, 0.0, -1.0]),
        )
    };
    let half = LabelMap::from_vec(100, 100, (0..10_000).map(|i| u16::from(i % 100 < 50)).collect::<Vec<_>>());
    let frames: Vec<Frame> = (0..cameras).map(frame).collect();
    let labels = Labels { maps: vec![half; cameras], objects: Vec::new(), source: MaskSource::Files };
    (Sequence { frames, x_world_recording: DPose3::IDENTITY, source: "none".into() }, labels)
}
