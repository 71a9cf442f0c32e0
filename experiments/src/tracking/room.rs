//! A generated room, recorded from its middle.

use crate::orbits::Rendered;
use glamx::{DPose3, DVec2, DVec3};
use sms_core::{Aabb, Camera, Intrinsics, Seed};
use sms_frames::Sequence;
use sms_synth::{AssetBlueprint, Pattern, Texture, TruthFloor, TruthScene, cuboid_union, draw_floor};

/// Frames of one turn of the camera.
const FRAMES: usize = 240;
/// Half of the width and of the depth of the room, metres.
const HALF_M: [f64; 2] = [2.2, 1.8];
/// Height of the walls, and their thickness, metres.
const WALL_M: [f64; 2] = [2.4, 0.1];

/// Renders a turn around the room; furniture, textures and noise follow from the seed.
pub(crate) fn record_room(seed: Seed) -> Sequence {
    Rendered::along(&room(seed), &turn(), seed).sequence
}

/// Camera poses of one turn near the middle, looking outward, as a hand holds the camera.
fn turn() -> Vec<DPose3> {
    let intrinsics = Intrinsics::from_fov(320, 240, 1.0);
    let pose = |i: usize| {
        let angle = std::f64::consts::TAU * i as f64 / FRAMES as f64;
        let out = DVec3::new(angle.cos(), angle.sin(), 0.0);
        let eye = 0.4 * out + DVec3::Z * (1.35 + 0.1 * (3.0 * angle).sin());
        let target = eye + out - DVec3::Z * (0.35 + 0.1 * (2.0 * angle).cos());
        Camera::look_at(intrinsics, eye, target, DVec3::Z).x_wc
    };
    (0..FRAMES).map(pose).collect()
}

fn room(seed: Seed) -> TruthScene {
    let mut rng = seed.derive("room").rng();
    let mut object = |pattern, colors, extents: DVec3, at: DVec2, yaw: f64| {
        let half = 0.5 * extents;
        let solid =
            Aabb { min: DVec3::new(-half.x, -half.y, 0.0), max: DVec3::new(half.x, half.y, extents.z) };
        let texture = Texture::drawn(&mut rng, pattern, colors, 0.08, 0.1);
        AssetBlueprint::new("box", "box", "wood", cuboid_union(&[solid], 1.0), texture)
            .place(at, yaw, &mut rng)
    };
    let ([x, y], [height, thick]) = (HALF_M, WALL_M);
    let plaster = ([205, 200, 190], [188, 184, 176]);
    let wood = ([150, 105, 65], [95, 62, 38]);
    let blue = ([60, 90, 150], [220, 220, 230]);
    let mut objects = Vec::new();
    for (side, at) in [
        (DVec3::new(2.0 * x, thick, height), DVec2::new(0.0, y)),
        (DVec3::new(thick, 2.0 * y, height), DVec2::new(x, 0.0)),
    ] {
        for sign in [1.0, -1.0] {
            objects.push(object(Pattern::Marble, plaster, side, sign * at, 0.0));
        }
    }
    // Furniture along the walls: size, place, turn.
    for (pattern, colors, size, at, yaw) in [
        (Pattern::Cardboard, wood, [1.2, 0.6, 0.75], [0.9, 1.4], 0.0),
        (Pattern::Bands, blue, [0.4, 0.3, 1.8], [-1.1, 1.5], 0.1),
        (Pattern::Marble, blue, [0.8, 0.9, 0.45], [-1.6, 0.1], 0.3),
        (Pattern::Cardboard, wood, [0.5, 0.5, 0.5], [1.7, 0.2], 0.5),
        (Pattern::Bands, wood, [1.4, 0.4, 0.9], [-0.4, -1.45], 0.0),
        (Pattern::Checker, blue, [0.3, 0.3, 0.6], [1.5, -1.3], 0.7),
    ] {
        objects.push(object(pattern, colors, DVec3::from(size), DVec2::from(at), yaw));
    }
    sms_synth::name_uniquely(&mut objects);
    let floor = TruthFloor { half_size_m: 3.0, ..draw_floor(Seed(1), seed) };
    let scene = TruthScene::of_objects("room".to_owned(), seed, objects, floor);
    TruthScene { workspace_center_w: DVec3::Z, ..scene }
}
