//! Objects of stacked structures: a stool, a low table, a crate, a plank, a flat box and a tote.

use glamx::{DVec2, DVec3};
use rand::RngExt;
use sms_core::{Aabb, Mesh, StageRng};
use sms_synth::{AssetBlueprint, PartedSolid, Pattern, Texture, TruthObject, cuboid_union};

/// The kinds of furniture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Furniture {
    Stool,
    Table,
    Crate,
    Plank,
    FlatBox,
    Tote,
}

impl Furniture {
    pub(crate) fn as_str(self) -> &'static str {
        match self {
            Self::Stool => "stool",
            Self::Table => "low_table",
            Self::Crate => "crate",
            Self::Plank => "plank",
            Self::FlatBox => "flat_box",
            Self::Tote => "tote",
        }
    }
}

/// Size of the cells of faces, which carry the vertex colours of exported meshes.
const CELL_M: f64 = 0.03;
const WOODS: [([u8; 3], [u8; 3]); 3] =
    [([206, 160, 104], [150, 98, 52]), ([112, 70, 44], [76, 44, 26]), ([226, 196, 150], [186, 140, 92])];
const BOARDS: [[u8; 3]; 3] = [[186, 140, 92], [172, 126, 82], [232, 230, 222]];
const PLASTICS: [[u8; 3]; 4] = [[120, 124, 128], [34, 78, 150], [42, 120, 74], [190, 52, 40]];

/// Draws from `[low, high)`.
pub(crate) fn uniform(rng: &mut StageRng, [low, high]: [f64; 2]) -> f64 {
    low + (high - low) * rng.random::<f64>()
}

/// Makes a piece of furniture standing at `p_w` on the floor, turned by `yaw` radians about z.
pub(crate) fn make_furniture(kind: Furniture, p_w: DVec2, yaw: f64, rng: &mut StageRng) -> TruthObject {
    blueprint(kind, rng).place(p_w, yaw, rng)
}

fn blueprint(kind: Furniture, rng: &mut StageRng) -> AssetBlueprint {
    let wood = WOODS[rng.random_range(0..WOODS.len())];
    let plastic = PLASTICS[rng.random_range(0..PLASTICS.len())];
    let board = BOARDS[rng.random_range(0..BOARDS.len())];
    let size = |rng: &mut StageRng, ranges: [[f64; 2]; 3]| DVec3::from(ranges.map(|r| uniform(rng, r)));
    let (class, material, solid, look) = match kind {
        Furniture::Stool => {
            let top = size(rng, [[0.27, 0.32], [0.24, 0.28], [0.025, 0.035]]);
            let solid = on_legs(top, uniform(rng, [0.36, 0.42]), uniform(rng, [0.026, 0.034]), 0.012);
            ("wooden stool", "wood", solid, (Pattern::Wood, wood, 0.03, 0.15))
        }
        Furniture::Table => {
            let top = size(rng, [[0.46, 0.54], [0.34, 0.40], [0.02, 0.03]]);
            let solid = on_legs(top, uniform(rng, [0.26, 0.32]), uniform(rng, [0.03, 0.04]), 0.02);
            ("low table", "wood", solid, (Pattern::Plain, ([226, 222, 214], [190, 186, 176]), 0.03, 0.3))
        }
        Furniture::Crate => {
            let solid = standing_box(size(rng, [[0.20, 0.26], [0.20, 0.24], [0.24, 0.32]]));
            ("plastic crate", "plastic", solid, (Pattern::Plain, (plastic, plastic), 0.03, 0.3))
        }
        Furniture::Plank => {
            let solid = standing_box(size(rng, [[0.52, 0.62], [0.15, 0.19], [0.02, 0.03]]));
            ("wooden plank", "wood", solid, (Pattern::Wood, wood, 0.03, 0.12))
        }
        Furniture::FlatBox => {
            let size = size(rng, [[0.30, 0.38], [0.22, 0.28], [0.08, 0.12]]);
            let look = (Pattern::Cardboard, (board, [70, 46, 30]), 0.3 * size.z as f32, 0.05);
            ("cardboard box", "cardboard", standing_box(size), look)
        }
        Furniture::Tote => {
            let solid = open_box(size(rng, [[0.34, 0.40], [0.24, 0.28], [0.12, 0.16]]), 0.005);
            ("plastic tote", "plastic", solid, (Pattern::Plain, (plastic, plastic), 0.03, 0.3))
        }
    };
    let (pattern, colors, scale_m, gloss) = look;
    let texture = Texture::drawn(rng, pattern, colors, scale_m, gloss);
    let made = AssetBlueprint::new(kind.as_str(), class, material, solid, texture);
    match kind {
        Furniture::Crate | Furniture::FlatBox => {
            let void = inside(&made.solid, 0.004);
            made.around(void, 0.004)
        }
        Furniture::Tote => made.open(0.005),
        _ => made,
    }
}

/// Returns the air inside a closed box with walls of this thickness.
fn inside(solid: &PartedSolid, wall: f64) -> Mesh {
    let bounds = solid.mesh.aabb().expect("a box has corners");
    let mut void = Mesh::cuboid(0.5 * bounds.extents() - DVec3::splat(wall));
    void.vertices.iter_mut().for_each(|v| *v += bounds.center());
    void
}

fn between(min: [f64; 3], max: [f64; 3]) -> Aabb {
    Aabb { min: min.into(), max: max.into() }
}

/// A closed box that stands on z = 0.
fn standing_box(size: DVec3) -> PartedSolid {
    let half = 0.5 * size;
    cuboid_union(&[between([-half.x, -half.y, 0.0], [half.x, half.y, size.z])], CELL_M)
}

/// A top of these extents with its upper face at `height`, on four square legs set in from its corners.
fn on_legs(top: DVec3, height: f64, leg: f64, inset: f64) -> PartedSolid {
    let under = height - top.z;
    let (x, y) = (0.5 * top.x, 0.5 * top.y);
    let mut boxes = vec![between([-x, -y, under], [x, y, height])];
    for (sx, sy) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
        let (a, b) = (sx * (x - inset), sy * (y - inset));
        let (c, d) = (a - sx * leg, b - sy * leg);
        boxes.push(between([a.min(c), b.min(d), 0.0], [a.max(c), b.max(d), under]));
    }
    cuboid_union(&boxes, CELL_M)
}

/// A box without a lid: a floor and four walls.
fn open_box(size: DVec3, wall: f64) -> PartedSolid {
    let (x, y, z) = (0.5 * size.x, 0.5 * size.y, size.z);
    let boxes = [
        between([-x, -y, 0.0], [x, y, wall]),
        between([-x, -y, wall], [-x + wall, y, z]),
        between([x - wall, -y, wall], [x, y, z]),
        between([-x + wall, -y, wall], [x - wall, -y + wall, z]),
        between([-x + wall, y - wall, wall], [x - wall, y, z]),
    ];
    cuboid_union(&boxes, CELL_M)
}
