//! The asset catalogue: household objects generated in code, each with seeded proportions, colours and material.

mod blueprint;
mod dishware;
mod figures;
mod household;

pub use blueprint::{AssetBlueprint, HollowKind};
pub(crate) use household::Household;

use self::blueprint::brass;
use crate::materials::{draw_material, with_effective_density};
use crate::random::{pick, uniform};
use crate::scene::{Hollow, TruthObject};
use crate::shapes::{PartedSolid, chamfered_cuboid, gridded_cuboid};
use crate::texture::{Pattern, Spot, Texture};
use glamx::{DMat3, DPose3, DQuat, DVec2, DVec3};
use serde::{Deserialize, Serialize};
use sms_core::{
    InertiaError, MassProperties, Mesh, Seed, StageRng, polyhedron_mass_properties, sphere_mass_properties,
};

/// Radius of a pool ball, metres (57.15 mm diameter).
pub const BALL_RADIUS_M: f64 = 0.028575;

/// The kinds of obstacles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AssetKind {
    /// Closed box of corrugated board, light.
    CardboardBox,
    /// Solid chamfered block.
    WoodBlock,
    /// Open bowl.
    Bowl,
    /// Cup with a handle.
    Mug,
    /// Open vase with a waist.
    Vase,
    /// Closed plastic bottle.
    Bottle,
    /// Plate.
    Plate,
    /// Heavy turned statue of brass.
    BrassStatue,
    /// Heavy turned statue of marble.
    MarbleStatue,
    /// Duck of rubber.
    ToyDuck,
    /// Bear of glazed ceramic.
    CeramicBear,
    /// Robot of plastic bricks.
    ToyRobot,
    /// Small football.
    SoccerBall,
    /// Heavy chamfered block of brass.
    BrassBlock,
    /// Full steel can.
    Can,
    /// Heavy seated figure of marble.
    SeatedStatue,
    /// A third pool ball.
    PoolBall,
}

impl AssetKind {
    /// The kinds that [`crate::generate_billiards`] scatters, in a fixed order; frozen like its scenes.
    pub const SCATTERED: [Self; 13] = [
        Self::CardboardBox,
        Self::WoodBlock,
        Self::Bowl,
        Self::Mug,
        Self::Vase,
        Self::Bottle,
        Self::Plate,
        Self::BrassStatue,
        Self::MarbleStatue,
        Self::ToyDuck,
        Self::CeramicBear,
        Self::ToyRobot,
        Self::SoccerBall,
    ];

    /// All kinds, in a fixed order.
    pub const ALL: [Self; 17] = {
        let mut all = [Self::BrassBlock; 17];
        let mut i = 0;
        while i < Self::SCATTERED.len() {
            all[i] = Self::SCATTERED[i];
            i += 1;
        }
        all[14] = Self::Can;
        all[15] = Self::SeatedStatue;
        all[16] = Self::PoolBall;
        all
    };
}

/// Makes an obstacle standing at `p_w` on the floor (metres), turned by `yaw` radians about z; `size` is a factor.
pub fn make_asset(kind: AssetKind, p_w: DVec2, yaw: f64, size: f64, rng: &mut StageRng) -> TruthObject {
    let blueprint = match kind {
        AssetKind::CardboardBox => cardboard_box(rng, size),
        AssetKind::WoodBlock => wood_block(rng, size),
        AssetKind::Bowl => dishware::bowl(rng, size),
        AssetKind::Mug => dishware::mug(rng, size),
        AssetKind::Vase => dishware::vase(rng, size),
        AssetKind::Bottle => dishware::bottle(rng, size),
        AssetKind::Plate => dishware::plate(rng, size),
        AssetKind::BrassStatue => figures::turned_statue(rng, size, true),
        AssetKind::MarbleStatue => figures::turned_statue(rng, size, false),
        AssetKind::ToyDuck => figures::toy_duck(rng, size),
        AssetKind::CeramicBear => figures::ceramic_bear(rng, size),
        AssetKind::ToyRobot => figures::toy_robot(rng, size),
        AssetKind::SoccerBall => soccer_ball(rng, size),
        AssetKind::BrassBlock => brass_block(rng, size),
        AssetKind::Can => dishware::can(rng, size),
        AssetKind::SeatedStatue => figures::seated_statue(rng, size),
        AssetKind::PoolBall => pool_ball(rng),
    };
    blueprint.place(p_w, yaw, rng)
}

/// Makes a household object standing at the origin, turned by `yaw` radians about z; its sizes differ from the usual ones by
/// up to the share `spread`.
pub(crate) fn make_household(kind: Household, spread: f64, yaw: f64, seed: Seed) -> TruthObject {
    let mut rng = seed.rng();
    household::blueprint(kind, spread, &mut rng).place(DVec2::ZERO, yaw, &mut rng)
}

/// Makes the cue ball (white) or the target ball (saturated blue) at `p_w` on the floor, metres.
pub fn make_pool_ball(cue: bool, p_w: DVec2, rng: &mut StageRng) -> TruthObject {
    let colors = if cue { ([238, 236, 226], [214, 206, 184]) } else { ([18, 48, 190], [40, 96, 235]) };
    let mut blueprint = ball(
        BALL_RADIUS_M,
        Texture::drawn(rng, Pattern::Speckle, colors, 0.006, 0.9),
        if cue { "cue_ball" } else { "target_ball" },
        "billiard ball",
        "phenolic_resin",
    );
    if !cue {
        // The numbered disc of a pool ball, on two sides.
        let r = BALL_RADIUS_M as f32;
        for side in [-1.0f32, 1.0] {
            let center = [side * r * 0.8, 0.0, r * 1.6];
            blueprint.texture.spots.push(Spot { center, radii: [0.010; 3], color: [235, 235, 225] });
        }
    }
    blueprint.place(p_w, uniform(rng, [0.0, std::f64::consts::TAU]), rng)
}

fn ball(
    radius: f64,
    texture: Texture,
    name: &'static str,
    class: &'static str,
    material: &'static str,
) -> AssetBlueprint {
    let mut mesh = Mesh::icosphere(radius, 4);
    mesh.vertices.iter_mut().for_each(|v| v.z += radius);
    let solid = PartedSolid { mesh, parts: Vec::new() };
    let blueprint = AssetBlueprint::new(name, class, material, solid, texture);
    AssetBlueprint { sphere_radius: Some(radius), ..blueprint }
}

fn soccer_ball(rng: &mut StageRng, size: f64) -> AssetBlueprint {
    let radius = uniform(rng, [0.058, 0.072]) * size;
    let colors = ([236, 236, 232], pick(rng, &[[24, 24, 28], [150, 20, 30], [16, 70, 60]]));
    let texture = Texture::drawn(rng, Pattern::Soccer, colors, radius as f32, 0.45);
    let mut blueprint = ball(radius, texture, "soccer_ball", "small soccer ball", "synthetic_leather");
    blueprint.hollow = HollowKind::Shell(uniform(rng, [0.0025, 0.004]));
    blueprint
}

fn cardboard_box(rng: &mut StageRng, size: f64) -> AssetBlueprint {
    let extents =
        DVec3::new(uniform(rng, [0.11, 0.16]), uniform(rng, [0.08, 0.11]), uniform(rng, [0.07, 0.13])) * size;
    let wall = uniform(rng, [0.003, 0.004]);
    let mut void = Mesh::cuboid(0.5 * extents - DVec3::splat(wall));
    void.vertices.iter_mut().for_each(|v| v.z += 0.5 * extents.z);
    let colors = (pick(rng, &[[186, 140, 92], [172, 126, 82], [198, 156, 106]]), [70, 46, 30]);
    let solid = gridded_cuboid(extents, 0.008);
    let texture = Texture::drawn(rng, Pattern::Cardboard, colors, (0.3 * extents.z) as f32, 0.12);
    AssetBlueprint::new("cardboard_box", "cardboard box", "cardboard", solid, texture).around(void, wall)
}

fn wood_block(rng: &mut StageRng, size: f64) -> AssetBlueprint {
    let extents =
        DVec3::new(uniform(rng, [0.09, 0.15]), uniform(rng, [0.06, 0.09]), uniform(rng, [0.05, 0.09])) * size;
    let colors = pick(rng, &[([206, 160, 104], [150, 98, 52]), ([172, 112, 66], [112, 64, 34])]);
    let texture = Texture::drawn(rng, Pattern::Wood, colors, 0.03, 0.4);
    AssetBlueprint::new("wood_block", "wooden block", "wood", chamfered_cuboid(extents, 0.003), texture)
}

fn brass_block(rng: &mut StageRng, size: f64) -> AssetBlueprint {
    let extents =
        DVec3::new(uniform(rng, [0.11, 0.15]), uniform(rng, [0.04, 0.055]), uniform(rng, [0.055, 0.08]))
            * size;
    let texture = Texture::drawn(rng, Pattern::Marble, ([226, 188, 108], [190, 146, 74]), 0.04, 0.9);
    AssetBlueprint::new(
        "brass_block",
        "brass block",
        "brass",
        chamfered_cuboid(extents, 0.003),
        brass(texture),
    )
}

fn pool_ball(rng: &mut StageRng) -> AssetBlueprint {
    let colors = pick(rng, &[([206, 34, 30], [236, 84, 60]), ([232, 176, 24], [250, 208, 84])]);
    let texture = Texture::drawn(rng, Pattern::Speckle, colors, 0.006, 0.9);
    ball(BALL_RADIUS_M, texture, "pool_ball", "billiard ball", "phenolic_resin")
}

impl AssetBlueprint {
    /// Draws the material and places the asset at `p_w` on the floor (metres), turned by `yaw` radians about z.
    ///
    /// # Panics
    /// If the surface encloses no volume, or `material` is not a key of the table.
    pub fn place(self, p_w: DVec2, yaw: f64, rng: &mut StageRng) -> TruthObject {
        let material = draw_material(self.material, rng);
        let density = material.density.value.best;
        // All drawn shapes enclose volume; a test covers many seeds.
        let mass_a = mass_properties(&self, density).expect("an asset of the catalogue has mass");
        // A → B: the origin moves to the centre of mass and the yaw goes into the geometry.
        let turn = DQuat::from_rotation_z(yaw);
        let com_a = mass_a.com();
        let x_ba = DPose3::from_parts(-(turn * com_a), turn);
        let rotation = DMat3::from_quat(turn);
        let inertia = rotation * mass_a.inertia() * rotation.transpose();
        let mass = MassProperties::new(mass_a.mass(), DVec3::ZERO, inertia)
            .expect("turning keeps the inertia valid");
        let volume = match self.sphere_radius {
            Some(r) => 4.0 / 3.0 * std::f64::consts::PI * r.powi(3),
            None => self.solid.mesh.volume(),
        };
        let mut mesh = self.solid.mesh.transformed(&x_ba);
        mesh.colors = vertex_colors(&self.solid.mesh, &self.texture);
        let hollow = match self.hollow {
            HollowKind::Solid => Hollow::Solid,
            HollowKind::Vessel(wall_m) => Hollow::Vessel { wall_m },
            HollowKind::Shell(wall_m) => Hollow::Shell { wall_m, wall_density: density },
        };
        TruthObject {
            name: self.name.to_owned(),
            class: self.class.to_owned(),
            material: with_effective_density(material, mass.mass() / volume),
            sphere_radius: self.sphere_radius,
            mesh,
            parts: self.solid.parts.iter().map(|p| p.transformed(&x_ba)).collect(),
            x_wb: DPose3::from_parts(DVec3::new(p_w.x, p_w.y, 0.0) + turn * com_a, DQuat::IDENTITY),
            texture: self.texture,
            x_ab: x_ba.inverse(),
            hollow,
            mass,
        }
    }
}

/// Returns the mass properties in `A`: of the solid, or of the shell around the void.
fn mass_properties(blueprint: &AssetBlueprint, density: f64) -> Result<MassProperties, InertiaError> {
    if let Some(radius) = blueprint.sphere_radius {
        let center = DVec3::Z * radius;
        let outer = sphere_mass_properties(center, radius, density)?;
        let HollowKind::Shell(wall) = blueprint.hollow else { return Ok(outer) };
        return without(&outer, &sphere_mass_properties(center, radius - wall, density)?);
    }
    let outer = polyhedron_mass_properties(&blueprint.solid.mesh, density)?;
    match &blueprint.void {
        Some(void) => without(&outer, &polyhedron_mass_properties(void, density)?),
        None => Ok(outer),
    }
}

/// Removes an inner part from a body (parallel-axis theorem).
fn without(whole: &MassProperties, part: &MassProperties) -> Result<MassProperties, InertiaError> {
    let mass = whole.mass() - part.mass();
    let com = (whole.com() * whole.mass() - part.com() * part.mass()) / mass;
    let about = |m: &MassProperties| {
        let d = m.com() - com;
        let square = DMat3::from_diagonal(DVec3::splat(d.length_squared()));
        m.inertia() + (square - DMat3::from_cols(d * d.x, d * d.y, d * d.z)) * m.mass()
    };
    MassProperties::new(mass, com, about(whole) - about(part))
}

fn vertex_colors(mesh_a: &Mesh, texture: &Texture) -> Vec<[u8; 3]> {
    let normals = mesh_a.vertex_normals();
    mesh_a.vertices.iter().zip(&normals).map(|(v, n)| texture.srgb(v.as_vec3(), n.as_vec3(), 0.004)).collect()
}
