//! Assets before they are placed: shape, class, material and texture in the asset frame.

use crate::shapes::PartedSolid;
use crate::texture::{Pattern, Texture};
use rand::RngExt;
use sms_core::{Mesh, StageRng};

/// Facets around a turned object.
pub(super) const SEGMENTS: usize = 32;

/// An asset in its frame `A`: standing on z = 0, axis at x = y = 0.
#[derive(Debug, Clone)]
pub(super) struct AssetBlueprint {
    pub(super) name: &'static str,
    pub(super) class: &'static str,
    pub(super) material: &'static str,
    pub(super) solid: PartedSolid,
    /// The air inside a closed shell.
    pub(super) void: Option<Mesh>,
    pub(super) hollow: HollowKind,
    pub(super) sphere_radius: Option<f64>,
    pub(super) texture: Texture,
}

/// [`Hollow`](crate::Hollow) without the density of the wall.
#[derive(Debug, Clone, Copy)]
pub(super) enum HollowKind {
    Solid,
    /// Wall thickness, metres.
    Vessel(f64),
    /// Wall thickness, metres.
    Shell(f64),
}

/// A texture without metal or spots; its noise seed is drawn.
pub(super) fn texture(
    rng: &mut StageRng,
    pattern: Pattern,
    colors: ([u8; 3], [u8; 3]),
    scale_m: f32,
    gloss: f32,
) -> Texture {
    let seed = rng.random::<u32>();
    Texture {
        pattern,
        color: colors.0,
        accent: colors.1,
        scale_m,
        seed,
        gloss,
        metalness: 0.0,
        spots: Vec::new(),
    }
}

/// Turns a texture into bare brass, filed and slightly tarnished.
pub(super) fn brass(texture: Texture) -> Texture {
    Texture { metalness: 0.95, gloss: 0.62, ..texture }
}
