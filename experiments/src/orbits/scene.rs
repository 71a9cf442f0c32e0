//! The scenes of the orbits, and their recordings.

use glamx::{DPose3, DVec2, DVec3};
use serde::{Deserialize, Serialize};
use sms_core::{Aabb, Camera, DepthImage, Intrinsics, LabelMap, Seed};
use sms_frames::{DepthNoise, Frame, Sequence, normals_from_depth};
use sms_synth::{
    AssetBlueprint, CameraModel, DepthCamera, Pattern, Renderer, Sensor, Texture, TruthFloor, TruthScene,
    cuboid_union, draw_floor,
};

/// Number of frames of an orbit.
const FRAMES: usize = 58;
/// Size of the loaded images, pixels.
const SIZE: (usize, usize) = (320, 240);
/// Horizontal field of view of an Xtion, radians.
const FOV_X: f64 = 58.0 * std::f64::consts::PI / 180.0;

/// Kinds of scenes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OrbitKind {
    /// Printed boxes on a floor of boards, from 0.9 m.
    Desk,
    /// One large box of one colour on a floor of one colour, from 1.6 m.
    Box,
}

impl OrbitKind {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Desk, Self::Box];

    /// The word in tables and keys.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Desk => "desk",
            Self::Box => "box",
        }
    }

    /// Extents of the box in the middle, metres.
    pub fn extents_m(self) -> DVec3 {
        match self {
            Self::Desk => DVec3::new(0.30, 0.20, 0.18),
            Self::Box => DVec3::new(0.80, 0.45, 0.70),
        }
    }

    /// Radius and mean height of the orbit, metres.
    fn orbit_m(self) -> (f64, f64) {
        match self {
            Self::Desk => (0.80, 0.50),
            Self::Box => (1.35, 1.00),
        }
    }

    fn scene(self, seed: Seed) -> TruthScene {
        let mut rng = seed.derive("orbit").rng();
        let mut object = |pattern, colors, extents: DVec3, at: DVec2, yaw: f64| {
            let half = 0.5 * extents;
            let solid =
                Aabb { min: DVec3::new(-half.x, -half.y, 0.0), max: DVec3::new(half.x, half.y, extents.z) };
            let texture = Texture::drawn(&mut rng, pattern, colors, 0.05, 0.1);
            let solid = cuboid_union(&[solid], 1.0);
            AssetBlueprint::new("box", "box", "wood", solid, texture).place(at, yaw, &mut rng)
        };
        let gray = ([170, 168, 164], [160, 158, 154]);
        let mut objects = Vec::new();
        match self {
            Self::Box => {
                objects.push(object(Pattern::Plain, gray, self.extents_m(), DVec2::ZERO, 0.0));
            }
            Self::Desk => {
                let brown = ([186, 140, 92], [70, 46, 30]);
                objects.push(object(Pattern::Cardboard, brown, self.extents_m(), DVec2::ZERO, 0.0));
                for (pattern, colors, size, at, yaw) in [
                    (
                        Pattern::Checker,
                        ([200, 60, 50], [240, 230, 210]),
                        [0.10, 0.08, 0.12],
                        [0.30, 0.12],
                        0.4,
                    ),
                    (
                        Pattern::Marble,
                        ([60, 90, 150], [220, 220, 230]),
                        [0.12, 0.09, 0.07],
                        [-0.28, 0.16],
                        1.1,
                    ),
                    (
                        Pattern::Bands,
                        ([60, 140, 80], [230, 220, 120]),
                        [0.08, 0.08, 0.16],
                        [0.04, -0.30],
                        0.2,
                    ),
                ] {
                    objects.push(object(pattern, colors, DVec3::from(size), DVec2::from(at), yaw));
                }
            }
        }
        sms_synth::name_uniquely(&mut objects);
        let drawn = draw_floor(Seed(1), seed);
        let floor = match self {
            Self::Desk => drawn,
            Self::Box => {
                let texture = Texture { pattern: Pattern::Plain, color: [120, 118, 116], ..drawn.texture };
                TruthFloor { half_size_m: 3.0, texture, ..drawn }
            }
        };
        let scene = TruthScene::of_objects(format!("orbit {}", self.as_str()), seed, objects, floor);
        TruthScene { workspace_center_w: DVec3::Z * 0.5 * self.extents_m().z, ..scene }
    }

    /// Camera poses of a full circle whose height varies, as a hand holds it.
    fn poses(self, target_w: DVec3) -> Vec<DPose3> {
        let (radius, height) = self.orbit_m();
        let intrinsics = Intrinsics::from_fov(SIZE.0, SIZE.1, FOV_X);
        let pose = |i: usize| {
            let angle = std::f64::consts::TAU * i as f64 / FRAMES as f64;
            let sway = 1.0 + 0.12 * (3.0 * angle).sin();
            let eye = DVec3::new(radius * angle.cos(), radius * angle.sin(), height * sway);
            Camera::look_at(intrinsics, eye, target_w, DVec3::Z).x_wc
        };
        (0..FRAMES).map(pose).collect()
    }
}

/// The depth camera of an Xtion without missing patches, and with edges as narrow as the default's.
fn xtion() -> DepthCamera {
    DepthCamera { edge_px: DepthCamera::default().edge_px, missing_share: 0.0, ..Sensor::Xtion.model().depth }
}

/// A recorded orbit with its truth.
#[derive(Debug)]
pub struct Orbit {
    /// Kind of its scene.
    pub kind: OrbitKind,
    /// The frames with their true poses.
    pub sequence: Sequence,
    /// True depth of each frame.
    pub(crate) true_depth: Vec<DepthImage>,
    /// True labels of each frame; the box in the middle is 1.
    pub(crate) labels: Vec<LabelMap>,
}

impl Orbit {
    /// Renders an orbit; scene and noise follow from the seed.
    pub fn record(kind: OrbitKind, seed: Seed) -> Self {
        let scene = kind.scene(seed);
        let poses = kind.poses(scene.workspace_center_w);
        let Rendered { sequence, true_depth, labels } = Rendered::along(&scene, &poses, seed);
        Self { kind, sequence, true_depth, labels }
    }
}

/// A scene seen by an Xtion.
pub(crate) struct Rendered {
    pub(crate) sequence: Sequence,
    pub(crate) true_depth: Vec<DepthImage>,
    pub(crate) labels: Vec<LabelMap>,
}

impl Rendered {
    /// Renders a scene from camera poses; noise follows from the seed.
    pub(crate) fn along(scene: &TruthScene, poses: &[DPose3], seed: Seed) -> Self {
        let renderer = Renderer::new(scene);
        let intrinsics = Intrinsics::from_fov(SIZE.0, SIZE.1, FOV_X);
        let (mut frames, mut true_depth, mut labels) = (Vec::new(), Vec::new(), Vec::new());
        for (index, &x_wc) in poses.iter().enumerate() {
            let model = CameraModel {
                depth: xtion(),
                seed: seed.derive_index("frame", index as u64),
                ..CameraModel::default()
            };
            let camera = Camera::new(intrinsics, x_wc);
            let seen = renderer.render(&camera, &model);
            let normal_c = normals_from_depth(&seen.depth_noisy, &intrinsics, &DepthNoise::default(), 2);
            true_depth.push(seen.depth);
            labels.push(seen.label);
            frames.push(Frame {
                index,
                color_path: "rendered".into(),
                ..Frame::new(camera, seen.color, seen.depth_noisy, normal_c)
            });
        }
        let source = "rendered".into();
        let sequence = Sequence { frames, x_world_recording: DPose3::identity(), source };
        Self { sequence, true_depth, labels }
    }
}
