//! Objects of stacked structures: a stool, a low table, a crate, a plank, a flat box and a tote.

use super::blueprint::{AssetBlueprint, HollowKind, texture};
use crate::random::{pick, uniform};
use crate::shapes::{Cuboid, PartedSolid, cuboid_union, gridded_cuboid};
use crate::texture::Pattern;
use glamx::DVec3;
use sms_core::{Mesh, StageRng};

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

pub(super) fn blueprint(kind: Furniture, rng: &mut StageRng) -> AssetBlueprint {
    let wood = pick(rng, &WOODS);
    let plastic = pick(rng, &PLASTICS);
    let board = pick(rng, &BOARDS);
    let (class, material, solid, look) = match kind {
        Furniture::Stool => {
            let top = DVec3::new(
                uniform(rng, [0.27, 0.32]),
                uniform(rng, [0.24, 0.28]),
                uniform(rng, [0.025, 0.035]),
            );
            let solid = on_legs(top, uniform(rng, [0.36, 0.42]), uniform(rng, [0.026, 0.034]), 0.012);
            ("wooden stool", "wood", solid, (Pattern::Wood, wood, 0.03, 0.15))
        }
        Furniture::Table => {
            let top = DVec3::new(
                uniform(rng, [0.46, 0.54]),
                uniform(rng, [0.34, 0.40]),
                uniform(rng, [0.02, 0.03]),
            );
            let solid = on_legs(top, uniform(rng, [0.26, 0.32]), uniform(rng, [0.03, 0.04]), 0.02);
            ("low table", "wood", solid, (Pattern::Plain, ([226, 222, 214], [190, 186, 176]), 0.03, 0.3))
        }
        Furniture::Crate => {
            let size = DVec3::new(
                uniform(rng, [0.20, 0.26]),
                uniform(rng, [0.20, 0.24]),
                uniform(rng, [0.24, 0.32]),
            );
            (
                "plastic crate",
                "plastic",
                gridded_cuboid(size, CELL_M),
                (Pattern::Plain, (plastic, plastic), 0.03, 0.3),
            )
        }
        Furniture::Plank => {
            let size = DVec3::new(
                uniform(rng, [0.52, 0.62]),
                uniform(rng, [0.15, 0.19]),
                uniform(rng, [0.02, 0.03]),
            );
            ("wooden plank", "wood", gridded_cuboid(size, CELL_M), (Pattern::Wood, wood, 0.03, 0.12))
        }
        Furniture::FlatBox => {
            let size = DVec3::new(
                uniform(rng, [0.30, 0.38]),
                uniform(rng, [0.22, 0.28]),
                uniform(rng, [0.08, 0.12]),
            );
            let scale = 0.3 * size.z as f32;
            (
                "cardboard box",
                "cardboard",
                gridded_cuboid(size, CELL_M),
                (Pattern::Cardboard, (board, [70, 46, 30]), scale, 0.05),
            )
        }
        Furniture::Tote => {
            let size = DVec3::new(
                uniform(rng, [0.34, 0.40]),
                uniform(rng, [0.24, 0.28]),
                uniform(rng, [0.12, 0.16]),
            );
            (
                "plastic tote",
                "plastic",
                open_box(size, 0.005),
                (Pattern::Plain, (plastic, plastic), 0.03, 0.3),
            )
        }
    };
    let hollow = match kind {
        Furniture::Crate | Furniture::FlatBox => HollowKind::Shell(0.004),
        Furniture::Tote => HollowKind::Vessel(0.005),
        _ => HollowKind::Solid,
    };
    let void = matches!(hollow, HollowKind::Shell(_)).then(|| inside(&solid, 0.004));
    let (pattern, colors, scale_m, gloss) = look;
    AssetBlueprint {
        name: kind.as_str(),
        class,
        material,
        solid,
        void,
        hollow,
        sphere_radius: None,
        texture: texture(rng, pattern, colors, scale_m, gloss),
    }
}

/// Returns the air inside a closed box with walls of this thickness.
fn inside(solid: &PartedSolid, wall: f64) -> Mesh {
    let bounds = solid.mesh.aabb().expect("a box has corners");
    let mut void = Mesh::cuboid(0.5 * bounds.extents() - DVec3::splat(wall));
    void.vertices.iter_mut().for_each(|v| *v += bounds.center());
    void
}

/// A top of these extents with its upper face at `height`, on four square legs set in from its corners.
fn on_legs(top: DVec3, height: f64, leg: f64, inset: f64) -> PartedSolid {
    let under = height - top.z;
    let (x, y) = (0.5 * top.x, 0.5 * top.y);
    let mut boxes = vec![Cuboid::new(DVec3::new(-x, -y, under), DVec3::new(x, y, height))];
    for (sx, sy) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
        let (a, b) = (sx * (x - inset), sy * (y - inset));
        let (c, d) = (a - sx * leg, b - sy * leg);
        boxes.push(Cuboid::new(DVec3::new(a.min(c), b.min(d), 0.0), DVec3::new(a.max(c), b.max(d), under)));
    }
    cuboid_union(&boxes, CELL_M)
}

/// A box without a lid: a floor and four walls.
fn open_box(size: DVec3, wall: f64) -> PartedSolid {
    let (x, y, z) = (0.5 * size.x, 0.5 * size.y, size.z);
    let boxes = [
        Cuboid::new(DVec3::new(-x, -y, 0.0), DVec3::new(x, y, wall)),
        Cuboid::new(DVec3::new(-x, -y, wall), DVec3::new(-x + wall, y, z)),
        Cuboid::new(DVec3::new(x - wall, -y, wall), DVec3::new(x, y, z)),
        Cuboid::new(DVec3::new(-x + wall, -y, wall), DVec3::new(x - wall, -y + wall, z)),
        Cuboid::new(DVec3::new(-x + wall, y - wall, wall), DVec3::new(x - wall, y, z)),
    ];
    cuboid_union(&boxes, CELL_M)
}
