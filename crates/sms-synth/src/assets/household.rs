//! Objects of landing structures: a step ladder, stools, a recycling bin, flat platforms, and ballast.
//!
//! Sizes are those of commercial products; masses follow from walls and materials:
//! - step ladder: three rises of 21 cm with a standing platform, as domestic step stools have them (EN 14183); aluminium
//!   profiles of 1.5 mm. About 4 kg.
//! - stools: seats 45 cm (chair height) and 63 cm (counter height) above the floor, about 35 cm square. 3 to 5 kg.
//! - recycling bin: a deskside container of 41 US quarts, 15 1/4 × 11 in wide and 20 in high (Rubbermaid 2957), polyethylene
//!   of 2.5 mm. About 2 kg.
//! - tote: a Euro container of 594 × 396 mm and 147.5 mm height (VDA 4500), with a lid. About 2 kg.
//! - box: flat, of double-wall corrugated board of 6.5 mm (B and C flute). About 0.9 kg.
//! - board: a shelf of 90 × 40 cm, 12 mm thick. About 2.7 kg.

use super::blueprint::{AssetBlueprint, brass};
use crate::random::{pick, uniform};
use crate::shapes::{PartedSolid, between, chamfered_cuboid, cuboid_union, gridded_cuboid, surface};
use crate::texture::{Pattern, Spot, Texture};
use glamx::{DVec2, DVec3};
use sms_core::{Aabb, Mesh, StageRng};

/// The kinds of objects.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Household {
    StepLadder,
    Stool,
    CounterStool,
    RecyclingBin,
    FlatBox,
    LiddedTote,
    Board,
    BrassBar,
    MarbleSlab,
}

impl Household {
    /// Name of the object, and key of its random numbers.
    pub(crate) fn as_str(self) -> &'static str {
        match self {
            Self::StepLadder => "step_ladder",
            Self::Stool => "stool",
            Self::CounterStool => "counter_stool",
            Self::RecyclingBin => "recycling_bin",
            Self::FlatBox => "flat_box",
            Self::LiddedTote => "tote",
            Self::Board => "board",
            Self::BrassBar => "brass_bar",
            Self::MarbleSlab => "marble_slab",
        }
    }
}

/// Size of the cells of faces, which carry the vertex colours of exported meshes.
const CELL_M: f64 = 0.03;
/// Thickness of walls, metres.
const ALUMINIUM_WALL_M: f64 = 0.0015;
const PLASTIC_WALL_M: f64 = 0.0025;
const BOARD_WALL_M: f64 = 0.0065;

const WOODS: [([u8; 3], [u8; 3]); 2] = [([206, 160, 104], [150, 98, 52]), ([226, 196, 150], [186, 140, 92])];
const PLASTICS: [[u8; 3]; 3] = [[120, 124, 128], [42, 120, 74], [178, 52, 40]];

/// Draws an object with sizes that differ from the usual ones by up to the share `spread`. Its longer side lies along x, like
/// overhangs.
pub(super) fn blueprint(kind: Household, spread: f64, rng: &mut StageRng) -> AssetBlueprint {
    let mut size =
        |usual: [f64; 3]| DVec3::from(usual.map(|m| m * uniform(rng, [1.0 - spread, 1.0 + spread])));
    match kind {
        Household::StepLadder => step_ladder(size([0.22, 0.34, 0.63]), rng),
        Household::Stool => stool(kind.as_str(), size([0.34, 0.34, 0.45]), 0.10, rng),
        Household::CounterStool => stool(kind.as_str(), size([0.36, 0.36, 0.63]), 0.08, rng),
        Household::RecyclingBin => {
            let size = size([0.387, 0.279, 0.508]);
            // Platforms are at least half a metre high.
            recycling_bin(size.with_z(size.z.max(0.5)), rng)
        }
        Household::FlatBox => flat_box(size([0.60, 0.40, 0.11]), rng),
        Household::LiddedTote => lidded_tote(size([0.594, 0.396, 0.1475]), rng),
        Household::Board => {
            let size = size([0.90, 0.40, 0.012]);
            let wood = pick(rng, &WOODS);
            let look = Texture::drawn(rng, Pattern::Wood, wood, 0.03, 0.15);
            AssetBlueprint::new(kind.as_str(), "wooden board", "wood", gridded_cuboid(size, CELL_M), look)
        }
        Household::BrassBar => {
            let solid = chamfered_cuboid(size([0.05, 0.15, 0.06]), 0.002);
            let look = Texture::drawn(rng, Pattern::Marble, ([226, 188, 108], [190, 146, 74]), 0.04, 0.9);
            AssetBlueprint::new(kind.as_str(), "brass bar", "brass", solid, brass(look))
        }
        Household::MarbleSlab => {
            let solid = chamfered_cuboid(size([0.08, 0.28, 0.05]), 0.002);
            let look = Texture::drawn(rng, Pattern::Marble, ([222, 220, 214], [110, 112, 118]), 0.05, 0.5);
            AssetBlueprint::new(kind.as_str(), "marble slab", "marble", solid, look)
        }
    }
}

/// A folding step ladder, set up: a standing platform of `size` (its height is that of its top), two treads between the
/// front rails, two bars between the rear ones, and spreaders at both sides.
fn step_ladder(size: DVec3, rng: &mut StageRng) -> AssetBlueprint {
    let (x, y, height) = (0.5 * size.x, 0.5 * size.y, size.z);
    let under = height - 0.045;
    let rail = DVec2::new(0.045, 0.025);
    let (rx, ry) = (x - 0.005, y - rail.y);
    let middle = 0.25 * size.x - 0.035;
    let mut hollow = vec![between([-x, -y, under], [x, y, height])];
    let mut massive = Vec::new();
    for side in [-1.0, 1.0] {
        for end in [-1.0, 1.0] {
            hollow.push(between([end * rx, side * y, 0.0], [end * (rx - rail.x), side * ry, under]));
        }
        // In three pieces, because splaying the rails stretches the middle one.
        let z = [0.50 * under, 0.50 * under + 0.012];
        let edges = [-(rx - rail.x), -middle, middle, rx - rail.x];
        for w in edges.windows(2) {
            massive.push(between([w[0], side * (ry + 0.006), z[0]], [w[1], side * (ry + 0.016), z[1]]));
        }
    }
    for step in [1.0 / 3.0, 2.0 / 3.0] {
        let z = step * height;
        hollow.push(between([middle, -ry, z - 0.028], [rx, ry, z]));
        massive.push(between([-rx + 0.012, -ry, z - 0.03], [-rx + 0.032, ry, z - 0.01]));
    }
    let spread = Splay { below: under, inner: DVec2::new(middle, ry), slope: DVec2::new(0.32, 0.085) };
    let boxes: Vec<Aabb> = hollow.iter().chain(&massive).copied().collect();
    let solid = spread.solid(cuboid_union(&boxes, CELL_M));
    let void = spread.mesh(voids(&hollow, ALUMINIUM_WALL_M));
    let mut look = Texture::drawn(rng, Pattern::Plain, ([204, 207, 210], [150, 154, 158]), 0.05, 0.45);
    // Black ribbed pads on the treads and the platform, black feet.
    let pad = |x: f64, z: f64, rx: f64| Spot {
        center: [x as f32, 0.0, z as f32],
        radii: [rx as f32, 0.85 * ry as f32, 0.006],
        color: [36, 36, 38],
    };
    look.spots.push(pad(0.0, height, 0.75 * x));
    for step in [1.0 / 3.0, 2.0 / 3.0] {
        let z = step * height;
        look.spots.push(pad(0.5 * (middle + rx) + spread.slope.x * (under - z), z, 0.3 * rx));
    }
    for (sx, sy) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
        let foot = DVec2::new(rx - 0.5 * rail.x, y - 0.5 * rail.y) + spread.slope * under;
        let center = [(sx * foot.x) as f32, (sy * foot.y) as f32, 0.0];
        look.spots.push(Spot { center, radii: [0.06, 0.06, 0.035], color: [30, 30, 32] });
    }
    let name = Household::StepLadder.as_str();
    AssetBlueprint::new(name, "aluminium step ladder", "aluminium", solid, look)
        .around(void, ALUMINIUM_WALL_M)
}

/// A wooden stool with splayed legs and rungs; `size` is that of the seat, z the height of its top.
fn stool(name: &'static str, size: DVec3, slope: f64, rng: &mut StageRng) -> AssetBlueprint {
    let (x, y, height) = (0.5 * size.x, 0.5 * size.y, size.z);
    let under = height - 0.03;
    let (inset, leg) = (0.02, 0.035);
    let outer = DVec2::new(x - inset, y - inset);
    let inner = outer - DVec2::splat(leg);
    let middle = 0.5 * (outer + inner);
    let mut boxes = vec![between([-x, -y, under], [x, y, height])];
    for side in [-1.0, 1.0] {
        for end in [-1.0, 1.0] {
            boxes.push(between([end * outer.x, side * outer.y, 0.0], [end * inner.x, side * inner.y, under]));
        }
        let (low, high) = (0.34 * height, 0.42 * height);
        let (a, b) = (side * (middle.y - 0.009), side * (middle.y + 0.009));
        boxes.push(between([-inner.x, a, low], [inner.x, b, low + 0.028]));
        let (a, b) = (side * (middle.x - 0.009), side * (middle.x + 0.009));
        boxes.push(between([a, -inner.y, high], [b, inner.y, high + 0.028]));
    }
    let spread = Splay { below: under, inner, slope: DVec2::splat(slope) };
    let wood = pick(rng, &WOODS);
    let solid = spread.solid(cuboid_union(&boxes, CELL_M));
    AssetBlueprint::new(
        name,
        "wooden stool",
        "wood",
        solid,
        Texture::drawn(rng, Pattern::Wood, wood, 0.03, 0.2),
    )
}

/// An open bin with a rim around its top; `size` is that of the rim, z the height. Towards the floor it is narrower.
fn recycling_bin(size: DVec3, rng: &mut StageRng) -> AssetBlueprint {
    let wall = PLASTIC_WALL_M;
    let rim = DVec2::new(0.012, 0.03);
    let (x, y, z) = (0.5 * size.x - rim.x, 0.5 * size.y - rim.x, size.z);
    let mut boxes = vec![between([-x, -y, 0.0], [x, y, wall])];
    let mut ring = |x: f64, y: f64, thickness: f64, low: f64| {
        for side in [-1.0, 1.0] {
            boxes.push(between([side * (x - thickness), -y, low], [side * x, y, z]));
            boxes.push(between([thickness - x, side * (y - thickness), low], [x - thickness, side * y, z]));
        }
    };
    ring(x, y, wall, wall);
    ring(x + rim.x, y + rim.x, rim.x, z - rim.y);
    let narrowing = 0.14;
    let mut solid = cuboid_union(&boxes, CELL_M);
    let narrow = |v: &mut DVec3| {
        let share = 1.0 - narrowing * (1.0 - v.z / z);
        (v.x, v.y) = (v.x * share, v.y * share);
    };
    solid.mesh.vertices.iter_mut().for_each(narrow);
    solid.parts.iter_mut().flat_map(|p| p.vertices.iter_mut()).for_each(narrow);
    let mut look = Texture::drawn(rng, Pattern::Plain, ([30, 84, 168], [24, 66, 140]), 0.05, 0.3);
    // The recycling sign, in dots: three arrows around a triangle, on both broad sides.
    let (center, radius, dot) = (0.56 * z, 0.085, 0.0125f32);
    for side in [-1.0, 1.0] {
        for arrow in 0..3 {
            let corner = |k: i32| DVec2::from_angle((90.0 + 120.0 * f64::from(k)).to_radians()) * radius;
            let (from, to) = (corner(arrow), corner(arrow + 1));
            for step in 0..5 {
                let p = from.lerp(to, 0.22 + 0.17 * f64::from(step));
                // The last dot is the arrow's head.
                let dot = if step == 3 { 1.7 * dot } else { dot };
                let center = [p.x as f32, (side * y) as f32, (center + p.y) as f32];
                look.spots.push(Spot { center, radii: [dot, 0.5 * y as f32, dot], color: [240, 242, 244] });
            }
        }
    }
    let name = Household::RecyclingBin.as_str();
    AssetBlueprint::new(name, "plastic recycling bin", "plastic", solid, look).open(wall)
}

fn flat_box(size: DVec3, rng: &mut StageRng) -> AssetBlueprint {
    let board = pick(rng, &[[186, 140, 92], [172, 126, 82], [198, 156, 106]]);
    let half = 0.5 * size;
    let whole = [between([-half.x, -half.y, 0.0], [half.x, half.y, size.z])];
    let look = Texture::drawn(rng, Pattern::Cardboard, (board, [70, 46, 30]), 0.3 * size.z as f32, 0.05);
    let name = Household::FlatBox.as_str();
    AssetBlueprint::new(name, "cardboard box", "cardboard", cuboid_union(&whole, CELL_M), look)
        .around(voids(&whole, BOARD_WALL_M), BOARD_WALL_M)
}

/// A closed container: `size` without the lid, which sits on top and juts out a little. Towards the bottom it is narrower.
fn lidded_tote(size: DVec3, rng: &mut StageRng) -> AssetBlueprint {
    let (lid, rim) = (0.018, 0.006);
    let (x, y, z) = (0.5 * size.x - rim, 0.5 * size.y - rim, size.z);
    let body = between([-x, -y, 0.0], [x, y, z]);
    let cover = between([-x - rim, -y - rim, z], [x + rim, y + rim, z + lid]);
    // The air of body and lid is connected.
    let wall = DVec3::splat(PLASTIC_WALL_M);
    let air = [
        Aabb { min: body.min + wall, max: body.max - wall.with_z(0.0) },
        Aabb { min: (body.min + wall).with_z(z), max: (body.max - wall).with_z(z + lid - wall.z) },
    ];
    let narrowing = Splay { below: z, inner: DVec2::new(x, y), slope: DVec2::splat(-0.06) };
    let plastic = pick(rng, &PLASTICS);
    let solid = narrowing.solid(cuboid_union(&[body, cover], CELL_M));
    let look = Texture::drawn(rng, Pattern::Plain, (plastic, plastic), 0.03, 0.3);
    AssetBlueprint::new(Household::LiddedTote.as_str(), "plastic tote", "plastic", solid, look)
        .around(narrowing.mesh(joined(&air)), PLASTIC_WALL_M)
}

/// Returns the air inside boxes with walls of this thickness.
fn voids(boxes: &[Aabb], wall: f64) -> Mesh {
    let wall = DVec3::splat(wall);
    joined(&boxes.iter().map(|b| Aabb { min: b.min + wall, max: b.max - wall }).collect::<Vec<_>>())
}

/// Joins boxes to one mesh of several closed pieces.
fn joined(boxes: &[Aabb]) -> Mesh {
    let mut mesh = Mesh::default();
    for b in boxes {
        let one = surface(b);
        let first = mesh.vertices.len() as u32;
        mesh.vertices.extend(one.vertices);
        mesh.triangles.extend(one.triangles.iter().map(|t| t.map(|i| i + first)));
    }
    mesh
}

/// Splays legs below a height: points beyond `inner` move outwards by the slope, points within are stretched. Boxes that do not
/// cross `inner` or `below` stay convex, with plane faces.
#[derive(Debug, Clone, Copy)]
struct Splay {
    below: f64,
    inner: DVec2,
    slope: DVec2,
}

impl Splay {
    fn point(&self, v: &mut DVec3) {
        let depth = (self.below - v.z).max(0.0);
        let share = (v.truncate() / self.inner).clamp(DVec2::NEG_ONE, DVec2::ONE);
        *v += (self.slope * share * depth).extend(0.0);
    }

    fn mesh(&self, mut mesh: Mesh) -> Mesh {
        mesh.vertices.iter_mut().for_each(|v| self.point(v));
        mesh
    }

    fn solid(&self, solid: PartedSolid) -> PartedSolid {
        let parts = solid.parts.into_iter().map(|p| self.mesh(p)).collect();
        PartedSolid { mesh: self.mesh(solid.mesh), parts }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::Seed;

    /// Surface, pieces and enclosed air agree, and masses are realistic.
    #[test]
    fn things_are_closed_and_weigh_what_they_do() {
        let weights = [
            (Household::StepLadder, 2.5, 5.0),
            (Household::Stool, 2.5, 5.0),
            (Household::CounterStool, 3.0, 6.0),
            (Household::RecyclingBin, 1.2, 2.6),
            (Household::FlatBox, 0.6, 1.2),
            (Household::LiddedTote, 1.5, 3.0),
            (Household::Board, 2.0, 3.3),
            (Household::BrassBar, 3.5, 4.1),
            (Household::MarbleSlab, 2.8, 3.3),
        ];
        for (kind, low, high) in weights {
            let made = blueprint(kind, 0.0, &mut Seed(1).rng());
            assert!(made.solid.mesh.is_closed_oriented(), "{kind:?}");
            assert_eq!(made.solid.mesh.components().len(), 1, "{kind:?}");
            assert!(made.solid.parts.iter().all(Mesh::is_closed_oriented), "{kind:?}");
            let pieces: f64 = made.solid.parts.iter().map(Mesh::volume).sum();
            assert!((pieces / made.solid.mesh.volume() - 1.0).abs() < 1e-9, "{kind:?}");
            let o = crate::assets::make_household(kind, 0.0, 0.4, Seed(1));
            assert!((low..high).contains(&o.mass.mass()), "{kind:?} weighs {} kg", o.mass.mass());
            assert!(o.aabb_w().min.z.abs() < 1e-9);
        }
    }

    #[test]
    fn pieces_stay_convex_when_they_are_spread() {
        for kind in [Household::StepLadder, Household::Stool, Household::RecyclingBin, Household::LiddedTote]
        {
            for part in blueprint(kind, 0.08, &mut Seed(2).rng()).solid.parts {
                for t in 0..part.triangles.len() {
                    let [a, b, c] = part.corners(t);
                    let normal = (b - a).cross(c - a).normalize();
                    let above = part.vertices.iter().map(|v| (*v - a).dot(normal)).fold(f64::MIN, f64::max);
                    assert!(above < 1e-9, "{kind:?}: {above}");
                }
            }
        }
    }
}
