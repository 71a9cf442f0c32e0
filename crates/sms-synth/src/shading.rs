//! Light: two soft lamps, a sky, and what the floor throws back.

use crate::texture::{Texture, smoothstep};
use glamx::Vec3;

/// A round lamp. Its strength does not fall off with distance, as for a large softbox far away.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Lamp {
    pub(crate) center: Vec3,
    pub(crate) radius: f32,
    pub(crate) color: Vec3,
}

/// The lamps of the studio: a warm key light and a cooler fill light from the other side.
pub(crate) fn lamps() -> [Lamp; 2] {
    [
        Lamp { center: Vec3::new(-0.5, -1.3, 2.1), radius: 0.22, color: Vec3::new(1.75, 1.65, 1.48) },
        Lamp { center: Vec3::new(1.9, 1.5, 1.9), radius: 0.35, color: Vec3::new(0.46, 0.52, 0.62) },
    ]
}

/// Light that arrives from direction `d` where nothing is hit: walls with a soft horizon.
pub(crate) fn backdrop(d: Vec3) -> Vec3 {
    let d = d.normalize_or_zero();
    let wall = Vec3::new(0.46, 0.50, 0.56);
    let ceiling = Vec3::new(0.78, 0.82, 0.88);
    let glow = 0.06 * (d.x * 0.8 + d.y * 0.6);
    wall.lerp(ceiling, smoothstep(-0.05, 0.75, d.z)) * (1.0 + glow)
}

/// Everything about a surface point that its colour depends on.
pub(crate) struct SurfacePoint<'a> {
    /// Shading normal, unit, facing the viewer.
    pub(crate) normal: Vec3,
    /// Unit direction to the viewer.
    pub(crate) to_eye: Vec3,
    /// Height above the floor, metres.
    pub(crate) height: f32,
    /// Linear albedo.
    pub(crate) albedo: Vec3,
    /// Appearance, for its gloss.
    pub(crate) texture: &'a Texture,
    /// Share of the sky that neighbours leave open.
    pub(crate) openness: f32,
    /// For each lamp: unit direction to it and the share of it that is visible.
    pub(crate) lamps: [(Vec3, f32); 2],
}

/// Outgoing linear light, before tone mapping.
pub(crate) fn shade(s: &SurfacePoint, floor_color: Vec3) -> Vec3 {
    let gloss = s.texture.gloss;
    let up = 0.5 + 0.5 * s.normal.z;
    // Close to the floor an object shades what the floor could throw back to it.
    let bounce = floor_color * (0.45 * (0.35 + 0.65 * smoothstep(0.0, 0.05, s.height)));
    let mut diffuse = bounce.lerp(Vec3::new(0.42, 0.45, 0.50), up) * s.openness;
    let mut highlight = Vec3::ZERO;
    let exponent = 16.0 + 160.0 * gloss * gloss;
    for ((direction, visible), lamp) in s.lamps.iter().zip(lamps()) {
        let facing = s.normal.dot(*direction).max(0.0) * visible;
        diffuse += lamp.color * facing * 0.85;
        let half = (*direction + s.to_eye).normalize_or_zero();
        let aligned = s.normal.dot(half);
        // Outside of this cone the lobe is below a thousandth.
        if facing > 0.0 && (1.0 - aligned) * exponent < 7.0 {
            highlight += lamp.color * (aligned.powf(exponent) * (0.10 + 0.5 * gloss) * gloss * visible);
        }
    }
    let cos = s.normal.dot(s.to_eye).clamp(0.0, 1.0);
    let fresnel = (0.04 + 0.5 * (1.0 - cos).powi(5)) * gloss;
    let mirrored = 2.0 * s.normal.dot(s.to_eye) * s.normal - s.to_eye;
    let surroundings = floor_color.lerp(backdrop(mirrored), smoothstep(-0.15, 0.15, mirrored.z));
    s.albedo * diffuse + highlight + surroundings * (fresnel * s.openness)
}

/// Compresses highlights so that white is reached at three times middle light; linear light in [0, 1].
pub(crate) fn tone_map(c: Vec3) -> Vec3 {
    let c = c * 0.92;
    c * (Vec3::ONE + c / 9.0) / (Vec3::ONE + 0.42 * c)
}
