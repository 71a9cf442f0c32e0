//! Boxes: chamfered, gridded (so that vertex colours have detail), and unions of axis-aligned ones.

use super::{PartedSolid, clip::clip_convex};
use glamx::DVec3;
use sms_core::{Aabb, Mesh};
use std::collections::BTreeMap;

/// Returns the box between two opposite corners.
pub(crate) fn between(a: [f64; 3], b: [f64; 3]) -> Aabb {
    let (a, b) = (DVec3::from(a), DVec3::from(b));
    Aabb { min: a.min(b), max: a.max(b) }
}

/// Returns the surface of a box.
pub(crate) fn surface(of: &Aabb) -> Mesh {
    let mut mesh = Mesh::cuboid(0.5 * of.extents());
    mesh.vertices.iter_mut().for_each(|v| *v += of.center());
    mesh
}

/// The union of boxes as one closed surface. Faces lie on the grid of all the boxes' planes, refined to cells of at
/// most `cell` metres, so that the surface has no T-junctions. Boxes may touch in faces but should not overlap (the
/// pieces' volumes then add up) and must not touch in a lone edge (the surface would not be a manifold).
pub fn cuboid_union(boxes: &[Aabb], cell: f64) -> PartedSolid {
    let planes: [Vec<f64>; 3] = std::array::from_fn(|axis| {
        let mut all: Vec<f64> = boxes.iter().flat_map(|b| [b.min[axis], b.max[axis]]).collect();
        all.sort_by(f64::total_cmp);
        all.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
        let mut fine = vec![all[0]];
        for w in all.windows(2) {
            let steps = ((w[1] - w[0]) / cell).ceil().max(1.0) as usize;
            fine.extend((1..=steps).map(|i| w[0] + (w[1] - w[0]) * i as f64 / steps as f64));
        }
        fine
    });
    let inside = |i: i64, j: i64, k: i64| -> bool {
        let ijk = [i, j, k];
        let mut p = DVec3::ZERO;
        for axis in 0..3 {
            let at = ijk[axis];
            if at < 0 || at as usize + 1 >= planes[axis].len() {
                return false;
            }
            p[axis] = 0.5 * (planes[axis][at as usize] + planes[axis][at as usize + 1]);
        }
        boxes.iter().any(|b| p.cmpge(b.min).all() && p.cmple(b.max).all())
    };
    let mut mesh = Mesh::default();
    let mut known: BTreeMap<[usize; 3], u32> = BTreeMap::new();
    let size: [i64; 3] = std::array::from_fn(|a| planes[a].len() as i64 - 1);
    for k in 0..size[2] {
        for j in 0..size[1] {
            for i in 0..size[0] {
                if !inside(i, j, k) {
                    continue;
                }
                for axis in 0..3 {
                    for up in [false, true] {
                        let mut next = [i, j, k];
                        next[axis] += if up { 1 } else { -1 };
                        if inside(next[0], next[1], next[2]) {
                            continue;
                        }
                        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                        let mut corner = |du: usize, dv: usize| {
                            let mut at = [i as usize, j as usize, k as usize];
                            at[axis] += usize::from(up);
                            at[u] += du;
                            at[v] += dv;
                            *known.entry(at).or_insert_with(|| {
                                mesh.vertices.push(DVec3::new(
                                    planes[0][at[0]],
                                    planes[1][at[1]],
                                    planes[2][at[2]],
                                ));
                                (mesh.vertices.len() - 1) as u32
                            })
                        };
                        let [a, b, c, d] = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
                        mesh.triangles.extend(if up {
                            [[a, b, c], [a, c, d]]
                        } else {
                            [[a, c, b], [a, d, c]]
                        });
                    }
                }
            }
        }
    }
    PartedSolid { mesh, parts: boxes.iter().map(surface).collect() }
}

/// One box standing on z = 0 with faces in cells of about `cell` metres.
pub(crate) fn gridded_cuboid(extents: DVec3, cell: f64) -> PartedSolid {
    let half = 0.5 * extents;
    cuboid_union(&[between([-half.x, -half.y, 0.0], [half.x, half.y, extents.z])], cell)
}

/// One box standing on z = 0 with its edges cut at 45° by `chamfer` metres.
pub(crate) fn chamfered_cuboid(extents: DVec3, chamfer: f64) -> PartedSolid {
    let half = 0.5 * extents;
    let mut mesh = Mesh::cuboid(half);
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for (su, sv) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
            let mut normal = DVec3::ZERO;
            normal[u] = su;
            normal[v] = sv;
            mesh = clip_convex(&mesh, normal, half[u] + half[v] - chamfer);
        }
    }
    mesh.vertices.iter_mut().for_each(|p| p.z += half.z);
    PartedSolid { parts: vec![mesh.clone()], mesh }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_l_of_two_boxes_has_the_right_volume_and_area() {
        let boxes = [between([0.0; 3], [2.0, 1.0, 1.0]), between([0.0, 0.0, 1.0], [1.0, 1.0, 3.0])];
        let solid = cuboid_union(&boxes, 0.7);
        assert!(solid.mesh.is_closed_oriented());
        assert!((solid.mesh.volume() - 4.0).abs() < 1e-12);
        assert!((solid.mesh.area() - 18.0).abs() < 1e-12);
        assert!((solid.parts.iter().map(Mesh::volume).sum::<f64>() - 4.0).abs() < 1e-12);
    }

    #[test]
    fn a_chamfered_box_loses_its_edges() {
        let (e, c) = (DVec3::new(0.2, 0.1, 0.06), 0.004);
        let solid = chamfered_cuboid(e, c);
        assert!(solid.mesh.is_closed_oriented());
        let mut cut = 4.0 * 0.5 * c * c * (e.x + e.y + e.z);
        // The prisms overlap at the corners: each corner is counted at most twice too often.
        let corners = 8.0 * c.powi(3);
        let lost = e.x * e.y * e.z - solid.mesh.volume();
        assert!(lost < cut && lost > cut - corners, "{lost} {cut}");
        cut -= lost;
        assert!(cut > 0.0);
        assert!(solid.mesh.aabb().unwrap().min.z.abs() < 1e-15);
    }
}
