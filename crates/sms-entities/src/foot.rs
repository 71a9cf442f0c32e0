//! Keeps the outermost corners of an object's foot when convex parts reach their vertex limit.

use glamx::DVec3;
use sms_core::Mesh;
use sms_mesh::{Plane, convex_hull};

/// Vertices within this distance of the lowest one belong to the foot, metres.
const FOOT_M: f64 = 3e-4;
/// Vertices of parts within this distance of the foot's level are moved onto it, metres.
const LEVEL_M: f64 = 1e-4;
/// Number of directions in which the outermost corner of the foot is kept.
const DIRECTIONS: usize = 16;

/// Adds each outermost corner of the foot to the part nearest to it. A hull with a vertex limit spends its vertices
/// where the surface bulges most. On a flat foot only a sliver would remain, and the object would tip over.
pub(crate) fn keep_foot(parts: &mut [Mesh], mesh: &Mesh, plane: &Plane, max_vertices: usize) {
    let height = |p: DVec3| plane.height(p);
    let lowest = mesh.vertices.iter().map(|&p| height(p)).fold(f64::INFINITY, f64::min);
    let foot: Vec<DVec3> = mesh.vertices.iter().copied().filter(|&p| height(p) <= lowest + FOOT_M).collect();
    let across = plane.normal.any_orthonormal_vector();
    let along = plane.normal.cross(across);
    let mut corners: Vec<DVec3> = Vec::new();
    for k in 0..DIRECTIONS {
        let angle = std::f64::consts::TAU * k as f64 / DIRECTIONS as f64;
        let direction = across * angle.cos() + along * angle.sin();
        let outermost = foot.iter().copied().max_by(|a, b| a.dot(direction).total_cmp(&b.dot(direction)));
        corners.extend(outermost.filter(|p| !corners.contains(p)));
    }
    let mut wanted: Vec<Vec<DVec3>> = vec![Vec::new(); parts.len()];
    for corner in corners {
        let nearest = (0..parts.len()).min_by(|&a, &b| {
            outside(&parts[a], corner).total_cmp(&outside(&parts[b], corner)).then(a.cmp(&b))
        });
        if let Some(part) = nearest {
            wanted[part].push(corner);
        }
    }
    // Hulls that were enlarged to keep their volume may reach below the foot; the engine would push them out.
    for part in parts.iter_mut() {
        if part.vertices.iter().any(|&p| (height(p) - lowest).abs() < LEVEL_M || height(p) < lowest) {
            let level = |p: DVec3| {
                let h = height(p);
                if h < lowest + LEVEL_M { p + plane.normal * (lowest - h) } else { p }
            };
            let points: Vec<DVec3> = part.vertices.iter().map(|&p| level(p)).collect();
            if let Some(hull) = convex_hull(&points, max_vertices, 0.0) {
                *part = hull;
            }
        }
    }
    for (part, corners) in parts.iter_mut().zip(wanted) {
        if corners.is_empty() {
            continue;
        }
        let room = max_vertices.saturating_sub(corners.len()).max(8);
        let Some(reduced) = convex_hull(&part.vertices, room, 1e-5) else { continue };
        let points: Vec<DVec3> = reduced.vertices.iter().copied().chain(corners).collect();
        if let Some(hull) = convex_hull(&points, max_vertices, 0.0) {
            *part = hull;
        }
    }
}

/// Returns the distance of a point outside a convex part: its largest distance in front of a face, metres.
fn outside(part: &Mesh, p: DVec3) -> f64 {
    (0..part.triangles.len())
        .map(|t| {
            let [a, b, c] = part.corners(t);
            (p - a).dot((b - a).cross(c - a).normalize_or_zero())
        })
        .fold(f64::NEG_INFINITY, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_corners_of_a_flat_foot_survive_the_vertex_limit() {
        // A dome on a flat base: nearly all vertices of a small hull would go to the dome.
        let mut points: Vec<DVec3> =
            Mesh::icosphere(0.04, 4).vertices.into_iter().filter(|p| p.z > 0.001).collect();
        points.extend((0..24).map(|i| {
            let angle = std::f64::consts::TAU * f64::from(i) / 24.0;
            DVec3::new(0.04 * angle.cos(), 0.04 * angle.sin(), 0.0)
        }));
        let mesh = convex_hull(&points, usize::MAX, 0.0).unwrap();
        let plane = Plane { normal: DVec3::Z, offset: 0.0 };
        let mut parts = vec![convex_hull(&points, 24, 0.0).unwrap()];
        let foot = |part: &Mesh| part.vertices.iter().filter(|p| p.z < 1e-6).count();
        let before = foot(&parts[0]);
        keep_foot(&mut parts, &mesh, &plane, 24);
        assert!(before < 12 && foot(&parts[0]) >= 12, "{before} → {}", foot(&parts[0]));
        assert!(parts[0].vertices.len() <= 24 && parts[0].is_closed_oriented());
        // A part that extends below the foot is moved back to its level.
        parts[0].vertices.iter_mut().for_each(|v| v.z -= 5e-5);
        keep_foot(&mut parts, &mesh, &plane, 24);
        let lowest = parts[0].vertices.iter().map(|v| v.z).fold(f64::MAX, f64::min);
        assert!(lowest.abs() < 1e-12, "{lowest}");
    }
}
