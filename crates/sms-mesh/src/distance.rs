//! Distances of points to meshes.

use glamx::DVec3;
use rayon::prelude::*;
use sms_core::Mesh;

/// Returns the distance from a point to a triangle (Ericson, "Real-Time Collision Detection", 5.1.5).
fn point_triangle_distance(p: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return ap.length();
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return bp.length();
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return (ap - ab * (d1 / (d1 - d3).max(f64::MIN_POSITIVE))).length();
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return cp.length();
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return (ap - ac * (d2 / (d2 - d6).max(f64::MIN_POSITIVE))).length();
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        let w = (d4 - d3) / ((d4 - d3) + (d5 - d6)).max(f64::MIN_POSITIVE);
        return (bp - (c - b) * w).length();
    }
    ab.cross(ac).normalize_or_zero().dot(ap).abs()
}

/// Returns the distances of points to a mesh, metres.
pub fn distances(points: &[DVec3], mesh: &Mesh) -> Vec<f64> {
    let triangles: Vec<[DVec3; 3]> = (0..mesh.triangles.len()).map(|t| mesh.corners(t)).collect();
    points
        .par_iter()
        .map(|&p| triangles.iter().map(|&t| point_triangle_distance(p, t)).fold(f64::INFINITY, f64::min))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangle_distances_are_those_of_dense_samples() {
        use rand::RngExt;
        let mut rng = sms_core::Seed(1).rng();
        let mut point = || DVec3::new(rng.random(), rng.random(), rng.random());
        for _ in 0..200 {
            let (t, p) = ([point(), point(), point()], point() * 2.0 - DVec3::splat(0.5));
            let mut best = f64::INFINITY;
            for i in 0..=60 {
                for j in 0..=60 - i {
                    let (u, v) = (f64::from(i) / 60.0, f64::from(j) / 60.0);
                    best = best.min(p.distance(t[0] * (1.0 - u - v) + t[1] * u + t[2] * v));
                }
            }
            let d = point_triangle_distance(p, t);
            assert!(d <= best + 1e-12 && d > best - 0.02, "{d} {best}");
        }
    }
}
