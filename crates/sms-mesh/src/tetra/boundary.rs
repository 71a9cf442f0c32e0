//! The boundary of a set of tetrahedra as a closed, oriented two-manifold.

use crate::predicates::FACES;
use crate::tetra::delaunay::{NONE, Tetrahedralization};
use crate::union_find::{find, unite};
use sms_core::Mesh;
use std::collections::BTreeMap;

/// Returns the outer faces of the `inside` tetrahedra. Where the solid touches itself along an edge or at a corner, the
/// edge or corner is split so that every sheet has its own. The result is always closed and consistently oriented. Also
/// returns the source point of each vertex ([`NONE`] for vertices on split edges).
pub fn boundary(mesh: &Tetrahedralization, inside: &[bool]) -> (Mesh, Vec<u32>) {
    let is_inside = |t: u32| t != NONE && inside[t as usize];
    let mut face_id = vec![[NONE; 4]; inside.len()];
    let mut faces: Vec<(u32, u8)> = Vec::new();
    for t in 0..inside.len() {
        if !inside[t] {
            continue;
        }
        for face in 0..4 {
            if !is_inside(mesh.neighbors[t][face]) {
                face_id[t][face] = faces.len() as u32;
                faces.push((t as u32, face as u8));
            }
        }
    }
    let corners = |id: usize| {
        let (t, face) = faces[id];
        FACES[face as usize].map(|i| mesh.tetrahedra[t as usize][i])
    };
    let partner = |id: usize, a: u32, b: u32| {
        let (t, face) = faces[id];
        let (t, face) = partner_across(mesh, &is_inside, t, face as usize, a, b);
        face_id[t as usize][face] as usize
    };
    // Corner c of face f has slot 3 f + c; slots of the same vertex of the same sheet are united.
    let mut parent: Vec<u32> = (0..faces.len() as u32 * 3).collect();
    let corner_slot =
        |id: usize, point: u32| (id * 3 + corners(id).iter().position(|&p| p == point).unwrap_or(0)) as u32;
    for id in 0..faces.len() {
        let corners = corners(id);
        for k in 0..3 {
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            let other = partner(id, a, b);
            unite(&mut parent, corner_slot(id, a), corner_slot(other, a));
            unite(&mut parent, corner_slot(id, b), corner_slot(other, b));
        }
    }
    let mut vertex_of_root = BTreeMap::new();
    let mut out = Mesh::default();
    let mut source = Vec::new();
    for id in 0..faces.len() {
        let corners = corners(id);
        let triangle = std::array::from_fn(|k| {
            let root = find(&mut parent, id as u32 * 3 + k as u32);
            *vertex_of_root.entry(root).or_insert_with(|| {
                out.vertices.push(mesh.points[corners[k] as usize]);
                source.push(corners[k]);
                (out.vertices.len() - 1) as u32
            })
        });
        out.triangles.push(triangle);
    }
    split_shared_edges(&mut out, &mut source, partner);
    (out, source)
}

/// Returns the boundary face that bounds the same wedge of solid around edge (a, b) as face `face` of `t`.
fn partner_across(
    mesh: &Tetrahedralization,
    is_inside: &impl Fn(u32) -> bool,
    mut t: u32,
    face: usize,
    a: u32,
    b: u32,
) -> (u32, usize) {
    let mut entered = mesh.tetrahedra[t as usize][face];
    loop {
        let tet = mesh.tetrahedra[t as usize];
        // Leave through the other face with the edge: the one opposite the corner that is neither on the edge nor
        // opposite the entered face.
        let exit = (0..4).find(|&k| tet[k] != a && tet[k] != b && tet[k] != entered).unwrap_or(0);
        let next = mesh.neighbors[t as usize][exit];
        if !is_inside(next) {
            return (t, exit);
        }
        // The entered face of the next tetrahedron is opposite its corner that this tetrahedron lacks.
        entered =
            mesh.tetrahedra[next as usize].iter().copied().find(|v| !tet.contains(v)).unwrap_or(entered);
        t = next;
    }
}

/// Two sheets can still share an edge through the same two vertices; each sheet gets a new vertex in the middle.
fn split_shared_edges(mesh: &mut Mesh, source: &mut Vec<u32>, partner: impl Fn(usize, u32, u32) -> usize) {
    let mut directed: BTreeMap<(u32, u32), Vec<usize>> = BTreeMap::new();
    for (f, &[a, b, c]) in mesh.triangles.iter().enumerate() {
        for edge in [(a, b), (b, c), (c, a)] {
            directed.entry(edge).or_default().push(f);
        }
    }
    // Per face, the new vertex on each of its edges.
    let mut middle: BTreeMap<(usize, usize), u32> = BTreeMap::new();
    for (&(a, b), faces) in &directed {
        if faces.len() < 2 || a > b {
            continue;
        }
        for &f in faces {
            let g = partner(f, source[a as usize], source[b as usize]);
            let m = mesh.vertices.len() as u32;
            mesh.vertices.push(0.5 * (mesh.vertices[a as usize] + mesh.vertices[b as usize]));
            source.push(NONE);
            for (face, from) in [(f, a), (g, b)] {
                if let Some(k) = mesh.triangles[face].iter().position(|&v| v == from) {
                    middle.insert((face, k), m);
                }
            }
        }
    }
    let touched: std::collections::BTreeSet<usize> = middle.keys().map(|k| k.0).collect();
    for f in touched {
        let triangle = mesh.triangles[f];
        let mut polygon = Vec::with_capacity(6);
        for k in 0..3 {
            polygon.push(triangle[k]);
            polygon.extend(middle.get(&(f, k)));
        }
        // Fan from a new vertex, so that no fan edge repeats an edge of the original mesh.
        let start = polygon.iter().position(|v| !triangle.contains(v)).unwrap_or(0);
        polygon.rotate_left(start);
        mesh.triangles[f] = [polygon[0], polygon[1], polygon[2]];
        for k in 2..polygon.len() - 1 {
            mesh.triangles.push([polygon[0], polygon[k], polygon[k + 1]]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tetra::delaunay::delaunay;
    use glamx::DVec3;
    use proptest::prelude::*;
    use rand::RngExt;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        // Random sets of tetrahedra touch themselves at many edges and corners.
        #[test]
        fn any_set_of_tetrahedra_has_a_closed_boundary(seed in 0u64..1000, share in 0.1f64..0.9) {
            let mut rng = sms_core::Seed(seed).rng();
            let points: Vec<DVec3> =
                (0..60).map(|_| DVec3::new(rng.random(), rng.random(), rng.random())).collect();
            let mesh = delaunay(&points);
            let inside: Vec<bool> = mesh.tetrahedra.iter().map(|_| rng.random::<f64>() < share).collect();
            prop_assume!(inside.iter().any(|&i| i));
            let (surface, _) = boundary(&mesh, &inside);
            prop_assert!(surface.is_closed_oriented(), "{} open edges", surface.boundary_edge_count());
            let volume: f64 =
                (0..inside.len()).filter(|&t| inside[t]).map(|t| mesh.volume(t)).sum();
            prop_assert!((surface.volume() - volume).abs() < 1e-12);
        }
    }
}
