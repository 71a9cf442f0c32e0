//! Assets before they are placed: shape, class, material and texture in the asset frame.

use crate::shapes::PartedSolid;
use crate::texture::Texture;
use sms_core::Mesh;

/// Facets around a turned object.
pub(super) const SEGMENTS: usize = 32;

/// An asset in its frame `A`: standing on z = 0, axis at x = y = 0.
#[derive(Debug, Clone)]
pub struct AssetBlueprint {
    /// Name, usable as a file name.
    pub name: &'static str,
    /// Description ("ceramic mug").
    pub class: &'static str,
    /// Key of the table of true materials.
    pub material: &'static str,
    /// Surface and convex pieces.
    pub solid: PartedSolid,
    /// The air inside a closed shell.
    pub void: Option<Mesh>,
    /// Interior of the surface.
    pub hollow: HollowKind,
    /// Radius in metres if the asset is exactly a sphere.
    pub sphere_radius: Option<f64>,
    /// Surface appearance.
    pub texture: Texture,
}

/// [`Hollow`](crate::Hollow) without the density of the wall.
#[derive(Debug, Clone, Copy)]
pub enum HollowKind {
    /// Solid material.
    Solid,
    /// An open vessel with this wall thickness, metres.
    Vessel(f64),
    /// A closed shell with this wall thickness, metres.
    Shell(f64),
}

impl AssetBlueprint {
    /// Creates a solid asset that is no sphere.
    pub fn new(
        name: &'static str,
        class: &'static str,
        material: &'static str,
        solid: PartedSolid,
        texture: Texture,
    ) -> Self {
        let hollow = HollowKind::Solid;
        Self { name, class, material, solid, void: None, hollow, sphere_radius: None, texture }
    }

    /// Makes the asset a closed shell of this thickness (metres) around air.
    #[must_use]
    pub fn around(self, void: Mesh, wall_m: f64) -> Self {
        Self { void: Some(void), hollow: HollowKind::Shell(wall_m), ..self }
    }

    /// Makes the asset an open vessel with walls of this thickness (metres).
    #[must_use]
    pub fn open(self, wall_m: f64) -> Self {
        Self { hollow: HollowKind::Vessel(wall_m), ..self }
    }
}

/// Turns a texture into bare brass, filed and slightly tarnished.
pub(super) fn brass(texture: Texture) -> Texture {
    Texture { metalness: 0.95, gloss: 0.62, ..texture }
}
