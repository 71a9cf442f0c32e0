//! Generated floors.

use crate::materials::draw_material;
use crate::scene::TruthFloor;
use crate::texture::{Pattern, Texture};
use sms_core::Seed;

/// Half of the floor's edge length, metres.
const FLOOR_HALF_SIZE_M: f64 = 1.5;

/// Draws a floor. Its kind follows from the scene seed modulo 3, so that a few seeds show all kinds.
pub fn draw_floor(scene_seed: Seed, seed: Seed) -> TruthFloor {
    let mut rng = seed.derive("floor").rng();
    let (class, pattern, colors, scale_m, gloss) = match scene_seed.0 % 3 {
        1 => ("wood_floor", Pattern::Planks, ([176, 132, 86], [120, 80, 46]), 0.085, 0.5),
        2 => ("tile_floor", Pattern::Tiles, ([158, 164, 160], [92, 90, 86]), 0.24, 0.6),
        _ => ("stone_floor", Pattern::Terrazzo, ([150, 146, 138], [222, 214, 198]), 0.09, 0.55),
    };
    let texture = Texture::drawn(&mut rng, pattern, colors, scale_m, gloss);
    TruthFloor { half_size_m: FLOOR_HALF_SIZE_M, material: draw_material(class, &mut rng), texture }
}
