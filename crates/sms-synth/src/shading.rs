//! Lighting (three soft lamps and a room with a window) and exposure.

use crate::texture::smoothstep;
use glamx::Vec3;

/// Number of lamps.
pub(crate) const LAMPS: usize = 3;

/// A round lamp that faces every lit point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Lamp {
    pub(crate) center: Vec3,
    pub(crate) radius: f32,
    /// Irradiance / π on a surface that faces it from `REFERENCE`'s distance.
    color: Vec3,
}

/// Point at which lamps have their nominal strength, amid the workspace.
const REFERENCE: Vec3 = Vec3::new(0.5, 0.0, 0.0);

impl Lamp {
    /// Returns the direction to its centre, the tangent of its half-angle, and its irradiance / π on an unobstructed surface
    /// that faces it, which falls with the square of the distance.
    pub(crate) fn seen_from(&self, point: Vec3) -> (Vec3, f32, Vec3) {
        let to = self.center - point;
        let square = to.length_squared();
        let distance = square.sqrt();
        let nominal = (self.center - REFERENCE).length_squared();
        (to / distance, self.radius / distance, self.color * (nominal / square))
    }
}

/// Returns the lamps: a warm key light, a cooler fill light from the other side, and a back light.
pub(crate) fn lamps() -> [Lamp; LAMPS] {
    [
        Lamp { center: Vec3::new(-0.5, -1.3, 2.1), radius: 0.20, color: Vec3::new(1.28, 1.24, 1.17) },
        Lamp { center: Vec3::new(1.9, 1.5, 1.9), radius: 0.35, color: Vec3::new(0.30, 0.34, 0.40) },
        Lamp { center: Vec3::new(-0.9, 1.3, 2.4), radius: 0.28, color: Vec3::new(0.24, 0.24, 0.23) },
    ]
}

/// Returns the radiance of the room from direction `d`: walls, a ceiling and a window on one side, blurred by `blur` (0 sharp,
/// 1 very rough surfaces).
pub(crate) fn backdrop(d: Vec3, blur: f32) -> Vec3 {
    let d = d.normalize_or_zero();
    let wall = Vec3::new(0.32, 0.335, 0.36);
    let ceiling = Vec3::new(0.50, 0.51, 0.53);
    let glow = 0.06 * (d.x * 0.8 + d.y * 0.6);
    let room = wall.lerp(ceiling, smoothstep(0.0, 0.75, d.z)) * (1.0 + glow);
    // The window is 2 m beyond the workspace's far side, above the views of cameras on the path.
    if d.y <= 0.05 {
        return room;
    }
    let (x, z) = (d.x / d.y + 0.25, d.z / d.y);
    let edge = 0.03 + 0.6 * blur;
    let within = |v: f32, low: f32, high: f32| {
        smoothstep(low - edge, low + edge, v) * (1.0 - smoothstep(high - edge, high + edge, v))
    };
    // A bar divides the window.
    let bar = 1.0 - (1.0 - smoothstep(0.02, 0.02 + edge, x.abs())) * (1.0 - blur).max(0.0);
    room + Vec3::new(1.7, 1.85, 2.05) * (within(x, -0.5, 0.5) * within(z, 0.45, 1.25) * bar)
}

/// Applies exposure and a highlight shoulder that reaches white at about twice a white surface: linear light in [0, 1].
pub(crate) fn tone_map(c: Vec3) -> Vec3 {
    let c = c * 0.80;
    // Linear up to a knee, then bent with continuous slope and value.
    const KNEE: f32 = 0.7;
    let bend = |v: f32| {
        if v <= KNEE {
            v
        } else {
            let over = (v - KNEE) / (1.0 - KNEE);
            KNEE + (1.0 - KNEE) * (1.0 - (-over).exp())
        }
    };
    Vec3::new(bend(c.x), bend(c.y), bend(c.z))
}
