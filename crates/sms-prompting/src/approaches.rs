//! Candidate approaches.

use glamx::DVec3;
use serde::{Deserialize, Serialize};
use sms_robots::BezierPath;

/// Settings of [`approaches`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ApproachSettings {
    /// Number of approaches (paper: 9). Odd, so that the middle one is straight.
    pub count: usize,
    /// Distance of the approach point from the landing point, metres.
    pub radius: f64,
    /// Angle between the directions of the first and the last approach point, radians.
    pub spread: f64,
}

impl Default for ApproachSettings {
    /// Nine approach points, 30° apart and 1 m from the landing point.
    fn default() -> Self {
        Self { count: 9, radius: 1.0, spread: 240f64.to_radians() }
    }
}

/// A candidate approach: a quadratic Bézier curve.
#[derive(Debug, Clone, PartialEq)]
pub struct Approach {
    /// Its number in pictures, from 1.
    pub id: u32,
    /// Distance of the approach point from the landing point, metres.
    pub radius: f64,
    /// Direction of the approach point from the landing point, about z from x, radians in (−π, π].
    pub angle: f64,
    /// The curve, at the height of the start.
    pub path: BezierPath,
}

/// Returns curves from the start to a point above the landing point, with approach points in directions on both
/// sides of the start's direction.
pub fn approaches(start_w: DVec3, landing_w: DVec3, settings: &ApproachSettings) -> Vec<Approach> {
    let back = (start_w - landing_w).truncate();
    let straight = back.to_angle();
    // The vehicle would fly away from an approach point beyond the start first.
    let radius = settings.radius.min(back.length());
    let middle = 0.5 * (settings.count.max(1) - 1) as f64;
    let step = if settings.count > 1 { settings.spread / (2.0 * middle) } else { 0.0 };
    (0..settings.count.max(1))
        .map(|k| {
            let angle = sms_core::wrapped_angle(straight + (k as f64 - middle) * step);
            let path = BezierPath::approach(start_w, landing_w, radius, angle);
            Approach { id: k as u32 + 1, radius, angle, path }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nine_curves_of_which_the_middle_one_is_straight() {
        let (start, landing) = (DVec3::new(-2.0, 0.3, 1.1), DVec3::new(0.1, 0.2, 0.7));
        let all = approaches(start, landing, &ApproachSettings::default());
        assert_eq!(all.len(), 9);
        let direct = (start - landing).truncate().length();
        assert!((all[4].path.length() - direct).abs() < 1e-9);
        for (k, a) in all.iter().enumerate() {
            assert!(a.id as usize == k + 1 && a.angle.abs() <= std::f64::consts::PI);
            assert!(k == 4 || a.path.length() > direct + 0.01);
            let [from, via, to] = a.path.control_w();
            assert!(from == start && to.distance(landing.with_z(1.1)) < 1e-12 && (via.z - 1.1).abs() < 1e-12);
            assert!(((via - to).length() - 1.0).abs() < 1e-12);
            let mirrored = all[8 - k].path.length();
            assert!((a.path.length() - mirrored).abs() < 1e-9, "both sides alike");
        }
        let near = approaches(DVec3::new(0.5, 0.0, 1.0), DVec3::ZERO, &ApproachSettings::default());
        assert!(near.iter().all(|a| (a.radius - 0.5).abs() < 1e-12));
    }
}
