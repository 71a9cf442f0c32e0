//! A furnished room with many objects on desks and boards, and the path of a camera through it.

use crate::furniture::{Furniture, make_furniture, uniform};
use glamx::{DPose3, DVec2, DVec3};
use rand::RngExt;
use sms_core::{Aabb, Camera, Intrinsics, Seed, StageRng};
use sms_synth::{
    AssetBlueprint, AssetKind, Pattern, Texture, TruthFloor, TruthObject, TruthScene, cuboid_union,
    draw_floor, make_asset, name_uniquely, on_top,
};
use std::f64::consts::TAU;

/// Half of the room's inner length and width, metres.
const HALF_M: DVec2 = DVec2::new(2.2, 1.9);
/// Height of the walls, metres.
const WALL_M: f64 = 2.3;
/// Height of the desks, metres.
const DESK_M: f64 = 0.72;
/// Height of the wall boards, metres.
const BOARD_M: f64 = 1.25;
/// Smallest gap between two objects, metres.
const GAP_M: f64 = 0.03;
/// Attempts to place one object.
const ATTEMPTS: usize = 200;
/// Sizes of the cells of large faces, metres.
const CELL_M: f64 = 0.25;

/// A furnished room.
#[derive(Debug, Clone)]
pub struct Room {
    /// Walls, desks and boards first, then the objects on them.
    pub scene: TruthScene,
    /// Number of objects that could be carried away.
    pub objects: usize,
}

/// Something to put objects on.
struct Support {
    object: TruthObject,
    /// Rectangle that objects may cover, in the world's x and y, metres.
    area: Aabb,
    /// Boxes of the objects on it.
    taken: Vec<Aabb>,
}

impl Room {
    /// Furnishes a room with up to `objects` objects; fewer if they do not fit. The same arguments give the same room.
    pub fn furnish(objects: usize, seed: Seed) -> Self {
        let mut rng = seed.derive("room").rng();
        let mut all = walls(&mut rng);
        let mut supports = supports(&mut rng);
        let mut placed = Vec::new();
        for i in 0..objects {
            let kind = AssetKind::SCATTERED[i % AssetKind::SCATTERED.len()];
            let first = rng.random_range(0..supports.len());
            let count = supports.len();
            let found = (0..count).find_map(|k| supports[(first + k) % count].put(kind, &mut rng));
            placed.extend(found);
        }
        for at in [DVec2::new(-1.3, -1.6), DVec2::new(1.35, 1.62), DVec2::new(-1.35, 1.62)] {
            let kind = if placed.len() % 2 == 0 { Furniture::Crate } else { Furniture::Tote };
            placed.push(make_furniture(kind, at, uniform(&mut rng, [-0.2, 0.2]), &mut rng));
        }
        let objects = placed.len();
        all.extend(supports.into_iter().map(|support| support.object));
        all.extend(placed);
        name_uniquely(&mut all);
        let floor = TruthFloor { half_size_m: HALF_M.max_element() + 0.3, ..draw_floor(Seed(1), seed) };
        let scene = TruthScene::of_objects(format!("room seed {}", seed.0), seed, all, floor);
        Self { scene: TruthScene { workspace_center_w: DVec3::Z * DESK_M, ..scene }, objects }
    }

    /// Returns the poses `X_WC` of a camera that is carried through the room: two rounds between the walls and the table in the middle that look
    /// at the walls, and one that looks at the table.
    pub fn path(frames: usize) -> Vec<DPose3> {
        let intrinsics = Intrinsics::from_fov(640, 480, 1.0);
        let pose = |i: usize| {
            let progress = i as f64 / frames.max(2) as f64;
            let angle = 3.0 * TAU * progress;
            let outward = DVec2::from_angle(angle);
            let eye = outward * DVec2::new(1.15, 0.9);
            // A hand neither keeps its height nor the direction of the view.
            let sway = 0.06 * (7.3 * angle).sin();
            let (target, height) = match (3.0 * progress) as usize {
                0 => ((eye + outward).extend(0.62), 1.30),
                1 => ((eye + DVec2::from_angle(angle + 0.5)).extend(1.0), 1.55),
                _ => (DVec3::Z * (DESK_M - 0.05), 1.40),
            };
            let eye_w = eye.extend(height + sway);
            Camera::look_at(intrinsics, eye_w, target + DVec3::splat(0.5 * sway), DVec3::Z).x_wc
        };
        (0..frames).map(pose).collect()
    }
}

/// A box with these corners that stands still.
fn fixed_box(
    name: &'static str,
    min: DVec3,
    max: DVec3,
    texture: Texture,
    rng: &mut StageRng,
) -> TruthObject {
    let (middle, half) = (0.5 * (min + max), 0.5 * (max - min));
    let at_origin =
        Aabb { min: DVec3::new(-half.x, -half.y, 0.0), max: DVec3::new(half.x, half.y, 2.0 * half.z) };
    let solid = cuboid_union(&[at_origin], CELL_M);
    let mut made = AssetBlueprint::new(name, name, "wood", solid, texture).place(middle.truncate(), 0.0, rng);
    made.x_wb = DPose3::from_translation(DVec3::Z * min.z) * made.x_wb;
    made
}

fn walls(rng: &mut StageRng) -> Vec<TruthObject> {
    let (x, y, thick) = (HALF_M.x, HALF_M.y, 0.1);
    let boxes = [
        ([-x - thick, -y - thick], [-x, y + thick]),
        ([x, -y - thick], [x + thick, y + thick]),
        ([-x, -y - thick], [x, -y]),
        ([-x, y], [x, y + thick]),
    ];
    let wall = |(min, max): ([f64; 2], [f64; 2])| {
        let colors = ([214, 208, 196], [176, 160, 140]);
        let texture = Texture::drawn(rng, Pattern::Speckle, colors, 0.05, 0.05);
        fixed_box("wall", DVec2::from(min).extend(0.0), DVec2::from(max).extend(WALL_M), texture, rng)
    };
    boxes.into_iter().map(wall).collect()
}

/// Desks along the walls, a table in the middle, and boards on two walls.
fn supports(rng: &mut StageRng) -> Vec<Support> {
    let (x, y) = (HALF_M.x, HALF_M.y);
    let desks = [
        ("desk", [-x, -0.9], [-x + 0.55, 0.9]),
        ("desk", [x - 0.55, -0.9], [x, 0.9]),
        ("desk", [-0.9, -y], [0.9, -y + 0.55]),
        ("desk", [-0.9, y - 0.55], [0.9, y]),
        ("table", [-0.5, -0.35], [0.5, 0.35]),
    ];
    let boards = [("board", [-x, -0.9], [-x + 0.25, 0.9]), ("board", [-0.9, y - 0.25], [0.9, y])];
    let mut make = |(name, min, max): (&'static str, [f64; 2], [f64; 2]), top_m: f64| {
        let colors = ([196, 150, 100], [140, 92, 54]);
        let texture = Texture::drawn(rng, Pattern::Wood, colors, 0.05, 0.2);
        let (min, max) = (DVec2::from(min), DVec2::from(max));
        let object = fixed_box(name, min.extend(top_m - 0.03), max.extend(top_m), texture, rng);
        Support { object, area: Aabb { min: min.extend(0.0), max: max.extend(0.0) }, taken: Vec::new() }
    };
    let desks: Vec<Support> = desks.into_iter().map(|desk| make(desk, DESK_M)).collect();
    desks.into_iter().chain(boards.map(|board| make(board, BOARD_M))).collect()
}

impl Support {
    /// Puts an object at a free place; `None` if none is found.
    fn put(&mut self, kind: AssetKind, rng: &mut StageRng) -> Option<TruthObject> {
        let size = uniform(rng, [0.6, 0.85]);
        let made = make_asset(kind, DVec2::ZERO, uniform(rng, [0.0, TAU]), size, rng);
        let own = made.aabb_w();
        for _ in 0..ATTEMPTS {
            let low = self.area.min - own.min;
            let high = self.area.max - own.max;
            let draw =
                |rng: &mut StageRng, a: f64, b: f64| uniform(rng, [a + GAP_M, (b - GAP_M).max(a + GAP_M)]);
            let at = DVec3::new(draw(rng, low.x, high.x), draw(rng, low.y, high.y), 0.0);
            let moved = Aabb { min: own.min + at, max: own.max + at };
            let fits = (0..2).all(|k| moved.min[k] >= self.area.min[k] && moved.max[k] <= self.area.max[k]);
            let is_free = |other: &Aabb| {
                (0..2).any(|k| moved.min[k] > other.max[k] + GAP_M || moved.max[k] + GAP_M < other.min[k])
            };
            if fits && self.taken.iter().all(is_free) {
                self.taken.push(moved);
                let shifted = TruthObject { x_wb: DPose3::from_translation(at) * made.x_wb, ..made };
                return Some(on_top(shifted, &self.object));
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_stand_on_furniture_apart_and_the_camera_stays_free_of_both() {
        let room = Room::furnish(100, Seed(1));
        assert!(room.objects >= 95, "{}", room.objects);
        let boxes: Vec<Aabb> = room.scene.objects.iter().map(TruthObject::aabb_w).collect();
        let overlaps =
            |a: &Aabb, b: &Aabb| (0..3).all(|k| a.min[k] < b.max[k] - 1e-6 && b.min[k] < a.max[k] - 1e-6);
        let objects = &boxes[boxes.len() - room.objects..];
        for (i, a) in objects.iter().enumerate() {
            assert!(boxes[..boxes.len() - room.objects + i].iter().all(|b| !overlaps(a, b)), "{i}");
        }
        for pose in Room::path(300) {
            let eye = pose.translation;
            let around = Aabb { min: eye - DVec3::splat(0.2), max: eye + DVec3::splat(0.2) };
            assert!(boxes.iter().all(|b| !overlaps(b, &around)), "{eye}");
        }
        assert_eq!(Room::furnish(100, Seed(1)).scene, room.scene);
        assert_ne!(Room::furnish(100, Seed(2)).scene, room.scene);
    }
}
