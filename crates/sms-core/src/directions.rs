//! Directions spread evenly over a sphere.

use glamx::DVec3;

/// The golden angle, radians: successive points at this angle never line up, so that their spiral covers a disc or a sphere
/// evenly (Vogel, "A better way to construct the sunflower head", 1979).
pub const GOLDEN_ANGLE_RAD: f64 = 2.399_963_229_728_653;

/// Returns `count` unit directions spread evenly over the sphere, from +z to −z, on the Fibonacci spiral: each represents an
/// equal area (González, "Measurement of areas on a sphere using Fibonacci and latitude-longitude lattices", 2010).
///
/// ```
/// let up = sms_core::even_directions(100).filter(|d| d.z > 0.0).count();
/// assert_eq!(up, 50);
/// ```
pub fn even_directions(count: usize) -> impl ExactSizeIterator<Item = DVec3> {
    (0..count).map(move |k| {
        let z = 1.0 - (2.0 * k as f64 + 1.0) / count as f64;
        let across = (1.0 - z * z).sqrt();
        let (sin, cos) = (GOLDEN_ANGLE_RAD * k as f64).sin_cos();
        DVec3::new(across * cos, across * sin, z)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn the_golden_angle_parts_the_circle_in_the_golden_ratio() {
        assert_eq!(GOLDEN_ANGLE_RAD, PI * (3.0 - 5f64.sqrt()));
        let (small, large) = (GOLDEN_ANGLE_RAD, 2.0 * PI - GOLDEN_ANGLE_RAD);
        assert!((large / small - 2.0 * PI / large).abs() < 1e-14);
    }

    #[test]
    fn moments_are_those_of_the_sphere_and_no_gap_is_wide() {
        let all: Vec<DVec3> = even_directions(1000).collect();
        assert!(all.iter().all(|d| (d.length() - 1.0).abs() < 1e-14));
        let mean = |f: &dyn Fn(&DVec3) -> f64| all.iter().map(f).sum::<f64>() / 1000.0;
        for axis in 0..3 {
            assert!(mean(&|d| d[axis]).abs() < 1e-3, "{axis}");
            assert!((mean(&|d| d[axis].powi(2)) - 1.0 / 3.0).abs() < 1e-3, "{axis}");
        }
        // A thousand equal areas have a width of 6.4°.
        for d in all.iter().copied().step_by(37) {
            let nearest = all.iter().filter(|e| **e != d).map(|e| e.angle_between(d)).fold(PI, f64::min);
            assert!((0.045..0.12).contains(&nearest), "{d}: {nearest}");
        }
        assert_eq!(even_directions(0).len(), 0);
    }
}
