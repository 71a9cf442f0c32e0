//! Procedural surface colour: patterns in an object's asset frame `A`.

use glamx::Vec3;
use rand::RngExt;
use serde::{Deserialize, Serialize};
use sms_core::StageRng;
use std::sync::LazyLock;

/// Patterns of a surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pattern {
    /// One colour with faint mottling.
    Plain,
    /// Grains of the accent colour.
    Speckle,
    /// Year rings around an axis along x, with fibres.
    Wood,
    /// Cubes of both colours.
    Checker,
    /// Veins of the accent colour.
    Marble,
    /// Horizontal bands with a wavy border.
    Bands,
    /// Brown board with a tape along the top and printed marks.
    Cardboard,
    /// Dark pentagons on a light sphere of radius `scale_m` that stands on the asset's floor.
    Soccer,
    /// Floor boards along x.
    Planks,
    /// Square tiles with joints.
    Tiles,
    /// Stone chips in a ground colour.
    Terrazzo,
    /// Woven threads of both colours, `scale_m` apart.
    Cloth,
}

/// A patch of another colour: an ellipsoid in the asset frame within which the surface is painted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Spot {
    /// Centre in `A`, metres.
    pub center: [f32; 3],
    /// Radii, metres.
    pub radii: [f32; 3],
    /// sRGB.
    pub color: [u8; 3],
}

/// The appearance of one surface.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Texture {
    /// Pattern.
    pub pattern: Pattern,
    /// Main sRGB colour.
    pub color: [u8; 3],
    /// Second sRGB colour.
    pub accent: [u8; 3],
    /// Size of the pattern's features, metres.
    pub scale_m: f32,
    /// Seed of its noise.
    pub seed: u32,
    /// 0 (matte) to 1 (polished).
    pub gloss: f32,
    /// 0 for paint, wood, stone and glaze, 1 for bare metal, whose highlights have its colour.
    #[serde(default)]
    pub metalness: f32,
    /// Painted patches; the first that contains a point counts.
    #[serde(default)]
    pub spots: Vec<Spot>,
}

impl Texture {
    /// Creates a texture without metal or spots; its noise seed is drawn. `colors` are the main and the second colour.
    pub fn drawn(
        rng: &mut StageRng,
        pattern: Pattern,
        colors: ([u8; 3], [u8; 3]),
        scale_m: f32,
        gloss: f32,
    ) -> Self {
        let (color, accent) = colors;
        let seed = rng.random();
        Self { pattern, color, accent, scale_m, seed, gloss, metalness: 0.0, spots: Vec::new() }
    }

    /// Returns the linear-light RGB in [0, 1] at point `p_a` with unit normal `n_a` of the asset frame. Detail finer than
    /// `footprint_m` (metres across one pixel) fades out instead of aliasing.
    pub fn albedo(&self, p_a: Vec3, n_a: Vec3, footprint_m: f32) -> Vec3 {
        let color = linear_from_srgb(self.color);
        for spot in &self.spots {
            let q = (p_a - Vec3::from(spot.center)) / Vec3::from(spot.radii);
            if q.length_squared() <= 1.0 {
                let mottle = 1.0 + 0.12 * self.fbm(p_a / 0.008, 2, footprint_m / 0.008);
                return linear_from_srgb(spot.color) * mottle;
            }
        }
        let accent = linear_from_srgb(self.accent);
        let s = self.scale_m;
        let q = p_a / s;
        let width = footprint_m / s;
        let rgb = match self.pattern {
            Pattern::Plain => color * (1.0 + 0.10 * self.fbm(q, 3, width)),
            Pattern::Speckle => {
                let grain = smoothstep(0.18, 0.34, self.fbm(q, 2, width));
                color.lerp(accent, 0.75 * grain) * (1.0 + 0.08 * self.fbm(q * 0.2, 2, width * 0.2))
            }
            Pattern::Wood => {
                let bend = self.fbm(Vec3::new(q.x * 0.12, q.y * 0.5, q.z * 0.5), 2, 0.5 * width);
                let rings = (Vec3::new(0.0, q.y + 1.3, q.z + 0.7).length() + 0.8 * bend) * 2.2;
                let ring = 0.5 + 0.5 * (rings * std::f32::consts::TAU).sin() * fade(4.0 * width);
                let fibre = self.fbm(Vec3::new(q.x * 0.6, q.y * 12.0, q.z * 12.0), 2, 12.0 * width);
                color.lerp(accent, 0.6 * ring * ring) * (1.0 + 0.18 * fibre)
            }
            Pattern::Checker => {
                let odd = (q.x.floor() + q.y.floor() + q.z.floor()).rem_euclid(2.0);
                color.lerp(accent, odd) * (1.0 + 0.10 * self.fbm(q * 2.0, 2, width * 2.0))
            }
            Pattern::Marble => {
                let turbulence = self.fbm(q, 4, width);
                let vein = ((q.x + 0.6 * q.y + 0.4 * q.z + 2.6 * turbulence) * 2.1).sin().abs();
                color.lerp(accent, 0.8 * (1.0 - vein).powi(3)) * (1.0 + 0.08 * turbulence)
            }
            Pattern::Bands => {
                let angle = p_a.y.atan2(p_a.x);
                let wave = 0.16 * (angle * 9.0).sin() + 0.12 * self.fbm(q * 2.0, 2, width * 2.0);
                let band = smoothstep(-0.12, 0.12, ((q.z + wave) * std::f32::consts::PI).sin());
                color.lerp(accent, band) * (1.0 + 0.08 * self.fbm(q * 4.0, 2, width * 4.0))
            }
            Pattern::Cardboard => self.cardboard(p_a, n_a, color, accent, footprint_m),
            Pattern::Soccer => {
                soccer(p_a - Vec3::Z * s, color, accent) * (1.0 + 0.06 * self.fbm(q * 4.0, 2, width * 4.0))
            }
            Pattern::Planks => self.planks(q, color, accent, width),
            Pattern::Tiles => {
                let (fx, fy) = (q.x - q.x.floor() - 0.5, q.y - q.y.floor() - 0.5);
                let joint = (0.5 - fx.abs()).min(0.5 - fy.abs());
                let tone = self.hash01(q.x.floor() as i32, q.y.floor() as i32, 5);
                let tile = color * (0.86 + 0.28 * tone) * (1.0 + 0.16 * self.fbm(q * 7.0, 3, width * 7.0));
                let joint_width = 0.012f32.max(width);
                let strength = (0.012 / joint_width).min(1.0);
                tile.lerp(accent, strength * (1.0 - smoothstep(0.5 * joint_width, joint_width, joint)))
            }
            Pattern::Terrazzo => {
                // Thresholds need the noise at full strength; the chips' contrast fades instead.
                let chips = self.fbm(q * 9.0, 2, 0.0);
                let large = self.fbm(q * 1.1 + Vec3::splat(17.0), 3, width * 1.1);
                let contrast = fade(width * 7.0);
                let light = contrast * smoothstep(0.26, 0.34, chips);
                let dark = contrast * smoothstep(0.28, 0.36, -chips);
                let ground = color * (1.0 + 0.30 * large);
                ground.lerp(accent, 0.45 * light) * (1.0 - 0.35 * dark)
            }
            Pattern::Cloth => {
                let (u, v) = if n_a.z.abs() > 0.7 { (q.x, q.y) } else { (q.x + q.y, q.z) };
                // Plain weave: warp and weft alternate on top; each thread is darkest at its sides.
                let warp = (u.floor() + v.floor()).rem_euclid(2.0) < 0.5;
                let across = if warp { u - u.floor() } else { v - v.floor() };
                let seen = fade(2.0 * width);
                let side = (1.0 - (across * std::f32::consts::PI).sin()) * seen + 0.36 * (1.0 - seen);
                let fuzz = self.fbm(q * 2.0, 2, 2.0 * width);
                let worn = self.fbm(p_a / 0.09, 3, footprint_m / 0.09);
                color.lerp(accent, 0.7 * side) * (1.0 + 0.25 * fuzz + 0.14 * worn)
            }
        };
        rgb.clamp(Vec3::ZERO, Vec3::ONE)
    }

    /// Returns the tilt of the unit normal by the surface's fine relief: a vector of the asset frame to add to the normal. Relief
    /// finer than `footprint_m` fades out.
    pub(crate) fn tilt(&self, p_a: Vec3, footprint_m: f32) -> Vec3 {
        // Slope, and size of the features along the axes in metres.
        let (slope, size) = match self.pattern {
            Pattern::Wood => (0.10, Vec3::new(0.03, 0.002, 0.002)),
            Pattern::Cardboard => (0.07, Vec3::new(0.02, 0.02, 0.006)),
            Pattern::Soccer => (0.10, Vec3::splat(0.0025)),
            Pattern::Cloth => (0.25, Vec3::splat(self.scale_m)),
            // Cast and filed; stone and glaze are a little wavy.
            _ if self.metalness > 0.5 => (0.05, Vec3::splat(0.006)),
            Pattern::Bands | Pattern::Marble => (0.02, Vec3::splat(0.012)),
            _ => return Vec3::ZERO,
        };
        let seen = fade(footprint_m / size.min_element());
        if seen <= 0.0 {
            return Vec3::ZERO;
        }
        let q = p_a / size;
        // Three independent noises in place of a gradient: cheaper, with a similar look.
        let noise = |channel: u32| self.value_noise(q + Vec3::splat(7.3 * channel as f32), 20 + channel);
        Vec3::new(noise(0), noise(1), noise(2)) * (slope * seen)
    }

    /// Returns the sRGB at a point, for vertex colours.
    pub fn srgb(&self, p_a: Vec3, n_a: Vec3, footprint_m: f32) -> [u8; 3] {
        srgb_from_linear(self.albedo(p_a, n_a, footprint_m))
    }

    fn cardboard(&self, p: Vec3, n: Vec3, color: Vec3, accent: Vec3, footprint: f32) -> Vec3 {
        let along = if n.z.abs() > 0.7 { p.x } else { p.z };
        let flutes = (along * std::f32::consts::TAU / 0.006).sin() * fade(footprint / 0.003);
        let mottle = self.fbm(p / 0.02, 3, footprint / 0.02);
        let mut rgb = color * (1.0 + 0.05 * flutes + 0.12 * mottle);
        let top_or_end = n.z > 0.7 || (n.x.abs() > 0.7 && p.z > 2.2 * self.scale_m);
        if top_or_end && p.y.abs() < 0.022 {
            rgb = rgb.lerp(Vec3::new(0.62, 0.47, 0.26), 0.75);
        }
        // Printed marks on the long sides: a frame with a bar code beside it.
        if n.y.abs() > 0.7 {
            let (u, v) = (p.x / self.scale_m * n.y.signum(), p.z / self.scale_m);
            let frame = ((u - 0.7).abs().max((v - 1.4).abs()) - 0.5).abs() < 0.07;
            let bars = (-1.6..-0.4).contains(&u)
                && (0.9..1.7).contains(&v)
                && self.hash01((u * 18.0).floor() as i32, 3, 9) < 0.5;
            if frame || bars {
                rgb = rgb.lerp(accent, 0.85);
            }
        }
        rgb
    }

    fn planks(&self, q: Vec3, color: Vec3, accent: Vec3, width: f32) -> Vec3 {
        let row = q.y.floor();
        let shift = self.hash01(row as i32, 1, 2) * 7.0;
        let length = 7.0;
        let column = ((q.x + shift) / length).floor();
        let tone = self.hash01(row as i32, column as i32, 3);
        let (fy, fx) = (q.y - row, (q.x + shift) / length - column);
        let gap = (fy.min(1.0 - fy)).min(fx.min(1.0 - fx) * length);
        let gap_width = 0.02f32.max(width);
        let open = (0.02 / gap_width).min(1.0) * (1.0 - smoothstep(0.4 * gap_width, gap_width, gap));
        let offset = Vec3::new(tone * 31.0, tone * 57.0, 0.0);
        let grain = self.fbm(Vec3::new(q.x * 0.9, q.y * 9.0, 0.0) + offset, 3, 9.0 * width);
        let figure = self.fbm(Vec3::new(q.x * 0.35, q.y * 1.6, 3.0) + offset, 2, 1.6 * width);
        let wood = color.lerp(accent, (0.25 + 0.5 * tone + 0.9 * figure).clamp(0.0, 1.0));
        wood * (1.0 + 0.28 * grain) * (1.0 - 0.65 * open)
    }

    /// Sum of octaves of value noise, about within ±0.7; octaves finer than `width` are left out.
    fn fbm(&self, q: Vec3, octaves: u32, width: f32) -> f32 {
        let (mut sum, mut amplitude, mut frequency) = (0.0, 0.5, 1.0f32);
        for octave in 0..octaves {
            let weight = fade(width * frequency);
            if weight <= 0.0 {
                break;
            }
            sum += weight * amplitude * self.value_noise(q * frequency, octave);
            amplitude *= 0.5;
            frequency *= 2.03;
        }
        sum
    }

    /// Smooth noise in [−1, 1] with one random value per lattice point.
    fn value_noise(&self, q: Vec3, octave: u32) -> f32 {
        let cell = q.floor();
        let f = q - cell;
        let w = f * f * (Vec3::splat(3.0) - 2.0 * f);
        let (x, y, z) = (cell.x as i32, cell.y as i32, cell.z as i32);
        let seed = self.seed.wrapping_add(octave.wrapping_mul(0x9E37_79B9));
        let at = |dx: i32, dy: i32, dz: i32| {
            hash(x + dx, y + dy, z + dz, seed) as f32 * (2.0 / 4_294_967_296.0) - 1.0
        };
        let lerp = |a: f32, b: f32, t: f32| a + (b - a) * t;
        let plane =
            |dz: i32| lerp(lerp(at(0, 0, dz), at(1, 0, dz), w.x), lerp(at(0, 1, dz), at(1, 1, dz), w.x), w.y);
        lerp(plane(0), plane(1), w.z)
    }

    fn hash01(&self, x: i32, y: i32, z: i32) -> f32 {
        hash(x, y, z, self.seed) as f32 / 4_294_967_296.0
    }
}

/// A well-mixed hash of lattice coordinates.
pub(crate) fn hash(x: i32, y: i32, z: i32, seed: u32) -> u32 {
    let mut h = seed
        ^ (x as u32).wrapping_mul(0x8DA6_B343)
        ^ (y as u32).wrapping_mul(0xD816_3841)
        ^ (z as u32).wrapping_mul(0xCB1A_B31F);
    h ^= h >> 16;
    h = h.wrapping_mul(0x7FEB_352D);
    h ^= h >> 15;
    h = h.wrapping_mul(0x846C_A68B);
    h ^ (h >> 16)
}

/// 1 for features much larger than a pixel, 0 for smaller ones; `width` is pixels per feature, inverted.
fn fade(width: f32) -> f32 {
    1.0 - smoothstep(0.3, 1.6, width)
}

pub(crate) fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// The pattern of a truncated icosahedron: pentagons around the 12 corner directions of an icosahedron, dark seams
/// between the hexagons.
fn soccer(p: Vec3, light: Vec3, dark: Vec3) -> Vec3 {
    const PHI: f32 = 1.618_034;
    let d = p.normalize_or_zero();
    // Cosines to the four nearest corners, largest first.
    let mut near = [-1.0f32; 4];
    for sign in 0..4u32 {
        let (a, b) = (if sign & 1 == 0 { 1.0 } else { -1.0 }, if sign & 2 == 0 { PHI } else { -PHI });
        for corner in [Vec3::new(0.0, a, b), Vec3::new(a, b, 0.0), Vec3::new(b, 0.0, a)] {
            let mut cosine = d.dot(corner) / (1.0 + PHI * PHI).sqrt();
            for slot in &mut near {
                if cosine > *slot {
                    std::mem::swap(slot, &mut cosine);
                }
            }
        }
    }
    // A pentagon's side cuts the icosahedron's edge at a third: cos 43.3° / cos 20.1°. Two hexagons meet in the plane of
    // an edge, where the corners opposite of it are equally far.
    if near[1] < 0.775 * near[0] {
        return dark;
    }
    light.lerp(dark, 0.8 * (1.0 - smoothstep(0.02, 0.045, near[2] - near[3])))
}

/// sRGB bytes to linear light.
pub(crate) fn linear_from_srgb(c: [u8; 3]) -> Vec3 {
    let channel = |v: u8| {
        let v = f32::from(v) / 255.0;
        if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
    };
    Vec3::new(channel(c[0]), channel(c[1]), channel(c[2]))
}

/// Linear light to sRGB in [0, 1], before quantisation.
pub(crate) fn srgb_channels(rgb: Vec3) -> [f32; 3] {
    // Interpolated over the square root, in which the curve is nearly straight; a power a channel is several times
    // slower.
    const STEPS: usize = 1024;
    static CURVE: LazyLock<Vec<f32>> = LazyLock::new(|| {
        (0..=STEPS + 1)
            .map(|i| {
                let v = (i as f32 / STEPS as f32).powi(2);
                if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
            })
            .collect()
    });
    rgb.to_array().map(|v| {
        let at = v.clamp(0.0, 1.0).sqrt() * STEPS as f32;
        let i = at as usize;
        CURVE[i] + (CURVE[i + 1] - CURVE[i]) * (at - i as f32)
    })
}

pub(crate) fn srgb_from_linear(rgb: Vec3) -> [u8; 3] {
    srgb_channels(rgb).map(|v| (v * 255.0 + 0.5) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texture(pattern: Pattern) -> Texture {
        let colors = ([200, 160, 90], [40, 60, 120]);
        Texture { seed: 5, ..Texture::drawn(&mut sms_core::Seed(5).rng(), pattern, colors, 0.02, 0.0) }
    }

    const ALL: [Pattern; 12] = [
        Pattern::Plain,
        Pattern::Speckle,
        Pattern::Wood,
        Pattern::Checker,
        Pattern::Marble,
        Pattern::Bands,
        Pattern::Cardboard,
        Pattern::Soccer,
        Pattern::Planks,
        Pattern::Tiles,
        Pattern::Terrazzo,
        Pattern::Cloth,
    ];

    #[test]
    fn every_pattern_varies_over_the_surface_and_stays_in_gamut() {
        for pattern in ALL {
            let t = texture(pattern);
            let mut values = Vec::new();
            for i in 0..400 {
                let (a, b) = (i as f32 * 0.37, i as f32 * 0.11);
                let p = Vec3::new(a.cos() * b.sin(), a.sin() * b.sin(), b.cos()) * 0.06;
                let rgb = t.albedo(p, p.normalize(), 1e-4);
                assert!(rgb.min_element() >= 0.0 && rgb.max_element() <= 1.0);
                values.push(rgb.x);
            }
            let mean = values.iter().sum::<f32>() / values.len() as f32;
            let spread = values.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / values.len() as f32;
            assert!(spread.sqrt() > 0.008, "{pattern:?} is flat: {}", spread.sqrt());
        }
    }

    #[test]
    fn detail_below_a_pixel_fades_instead_of_aliasing() {
        let t = texture(Pattern::Plain);
        let far: Vec<f32> =
            (0..50).map(|i| t.albedo(Vec3::new(i as f32 * 0.0137, 0.0, 0.0), Vec3::Z, 0.5).x).collect();
        assert!(far.iter().all(|v| (v - far[0]).abs() < 1e-6));
    }

    #[test]
    fn srgb_round_trips() {
        for v in 0..=255u8 {
            assert_eq!(srgb_from_linear(linear_from_srgb([v, 255 - v, 7])), [v, 255 - v, 7]);
        }
    }
}
