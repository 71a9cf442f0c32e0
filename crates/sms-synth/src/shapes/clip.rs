//! Cutting convex polyhedra.

use glamx::DVec3;
use sms_core::Mesh;
use std::collections::BTreeMap;

/// Returns the part of a closed convex mesh with `normal · p ≤ offset`, closed again by a flat cap.
pub(crate) fn clip_convex(mesh: &Mesh, normal: DVec3, offset: f64) -> Mesh {
    let scale = mesh.vertices.iter().map(|v| v.length()).fold(0.0, f64::max) * normal.length();
    // Vertices within rounding of the plane count as inside, so that no sliver is cut off.
    let height: Vec<f64> = mesh.vertices.iter().map(|v| v.dot(normal) - offset - 1e-12 * scale).collect();
    if height.iter().all(|&h| h <= 0.0) {
        return mesh.clone();
    }
    let mut out = Mesh { vertices: mesh.vertices.clone(), ..Mesh::default() };
    let mut cuts: BTreeMap<(u32, u32), u32> = BTreeMap::new();
    let mut next_on_cap: BTreeMap<u32, u32> = BTreeMap::new();
    for &triangle in &mesh.triangles {
        let mut polygon: Vec<u32> = Vec::with_capacity(4);
        let (mut leaves, mut enters) = (None, None);
        for i in 0..3 {
            let (a, b) = (triangle[i], triangle[(i + 1) % 3]);
            let (ha, hb) = (height[a as usize], height[b as usize]);
            if ha <= 0.0 {
                polygon.push(a);
            }
            if (ha <= 0.0) != (hb <= 0.0) {
                let cut = *cuts.entry((a.min(b), a.max(b))).or_insert_with(|| {
                    let (low, high) = (a.min(b) as usize, a.max(b) as usize);
                    let t = height[low] / (height[low] - height[high]);
                    out.vertices.push(mesh.vertices[low].lerp(mesh.vertices[high], t));
                    (out.vertices.len() - 1) as u32
                });
                polygon.push(cut);
                if ha <= 0.0 { leaves = Some(cut) } else { enters = Some(cut) }
            }
        }
        for i in 1..polygon.len().saturating_sub(1) {
            out.triangles.push([polygon[0], polygon[i], polygon[i + 1]]);
        }
        if let (Some(from), Some(to)) = (leaves, enters) {
            // The cap runs against the triangle's own cut edge.
            next_on_cap.insert(to, from);
        }
    }
    if let Some((&start, _)) = next_on_cap.iter().next() {
        let mut ring = vec![start];
        while let Some(&next) = next_on_cap.get(&ring[ring.len() - 1]) {
            if next == start || ring.len() > next_on_cap.len() {
                break;
            }
            ring.push(next);
        }
        for i in 1..ring.len().saturating_sub(1) {
            out.triangles.push([ring[0], ring[i], ring[i + 1]]);
        }
    }
    out.compacted()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn both_halves_are_closed_and_add_up(x in -1.0..1.0f64, y in -1.0..1.0f64, z in -1.0..1.0f64,
                                             d in -0.5..0.5f64) {
            let normal = DVec3::new(x, y, z);
            prop_assume!(normal.length() > 0.1);
            let normal = normal.normalize();
            for mesh in [Mesh::cuboid(DVec3::new(1.0, 0.8, 0.6)), Mesh::icosphere(1.0, 2)] {
                let below = clip_convex(&mesh, normal, d);
                let above = clip_convex(&mesh, -normal, -d);
                prop_assert!(below.is_closed_oriented() && above.is_closed_oriented());
                prop_assert!((below.volume() + above.volume() - mesh.volume()).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn a_plane_through_vertices_or_outside_cuts_cleanly() {
        let cube = Mesh::cuboid(DVec3::ONE);
        assert_eq!(clip_convex(&cube, DVec3::Z, 1.0), cube);
        let wedge = clip_convex(&cube, DVec3::new(1.0, 1.0, 0.0), 0.0);
        assert!(wedge.is_closed_oriented());
        assert!((wedge.volume() - 4.0).abs() < 1e-9);
    }
}
