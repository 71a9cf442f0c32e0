//! Triangle meshes for graphics formats: vertices are split at seams of normals, colours and texture coordinates.

use glamx::DVec3;
use sms_core::{Mesh, MeshTexture};
use sms_scene::{Body, BodyShape};
use std::borrow::Cow;
use std::collections::BTreeMap;

/// Faces that meet at less than this angle are shaded as one smooth surface, radians (35°).
const CREASE: f64 = 0.61;

/// Half of the edge length in metres of the square that shows a half space.
pub(crate) const GROUND_HALF_EDGE: f64 = 1.5;

/// Returns the visible surface of a body in its frame: its visual mesh, else its collision shape.
pub(crate) fn drawn(body: &Body) -> Cow<'_, Mesh> {
    if !body.visual.triangles.is_empty() {
        return Cow::Borrowed(&body.visual);
    }
    let mut all = Mesh::default();
    if matches!(body.shape, BodyShape::HalfSpace) {
        let at = |x, y| DVec3::new(x, y, 0.0) * GROUND_HALF_EDGE;
        all = Mesh::new(
            vec![at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)],
            vec![[0, 1, 2], [0, 2, 3]],
        );
    }
    for part in body.shape.meshes() {
        let first = all.vertices.len() as u32;
        all.vertices.extend(part.vertices);
        all.triangles.extend(part.triangles.iter().map(|t| t.map(|i| i + first)));
    }
    Cow::Owned(all)
}

/// Returns the unit normals of each corner of each triangle: the area-weighted mean of the faces around the vertex without
/// those beyond a crease.
pub(crate) fn corner_normals(mesh: &Mesh) -> Vec<[DVec3; 3]> {
    let faces: Vec<DVec3> = (0..mesh.triangles.len())
        .map(|t| {
            let [a, b, c] = mesh.corners(t);
            (b - a).cross(c - a)
        })
        .collect();
    let mut around = vec![Vec::new(); mesh.vertices.len()];
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        for &i in triangle {
            around[i as usize].push(t);
        }
    }
    let crease_cos = CREASE.cos();
    let units: Vec<DVec3> = faces.iter().map(|f| f.normalize_or_zero()).collect();
    mesh.triangles
        .iter()
        .enumerate()
        .map(|(t, triangle)| {
            triangle.map(|i| {
                let smooth = around[i as usize].iter().filter(|&&o| units[o].dot(units[t]) >= crease_cos);
                let sum: DVec3 = smooth.map(|&o| faces[o]).sum();
                sum.normalize_or(units[t].normalize_or(DVec3::Z))
            })
        })
        .collect()
}

/// Indexed vertices with all their attributes.
#[derive(Debug, Clone, Default)]
pub(crate) struct SplitMesh {
    pub(crate) positions: Vec<[f32; 3]>,
    pub(crate) normals: Vec<[f32; 3]>,
    /// sRGB; empty if the mesh has none.
    pub(crate) colors: Vec<[u8; 3]>,
    /// OBJ's convention (v up); empty without a texture.
    pub(crate) uv: Vec<[f32; 2]>,
    pub(crate) indices: Vec<u32>,
}

/// Splits the vertices of `mesh`. Colours are left out if there is a texture.
pub(crate) fn split(mesh: &Mesh, texture: Option<&MeshTexture>) -> SplitMesh {
    let normals = corner_normals(mesh);
    let colored = texture.is_none() && mesh.colors.len() == mesh.vertices.len();
    let mut surface = SplitMesh::default();
    let mut known = BTreeMap::new();
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        for (k, &i) in triangle.iter().enumerate() {
            let normal = normals[t][k].as_vec3().to_array();
            let uv = texture.and_then(|x| x.corner_uv.get(t)).map(|uv| uv[k]);
            let key = (i, normal.map(f32::to_bits), uv.map(|uv| uv.map(f32::to_bits)));
            let next = surface.positions.len() as u32;
            let index = *known.entry(key).or_insert(next);
            if index == next {
                surface.positions.push(mesh.vertices[i as usize].as_vec3().to_array());
                surface.normals.push(normal);
                if colored {
                    surface.colors.push(mesh.colors[i as usize]);
                }
                surface.uv.extend(uv);
            }
            surface.indices.push(index);
        }
    }
    surface
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_is_split_at_its_edges_and_a_ball_is_not() {
        let cuboid = split(&Mesh::cuboid(DVec3::ONE), None);
        assert_eq!(cuboid.positions.len(), 24);
        assert!(cuboid.normals.iter().all(|n| n.iter().map(|c| c.abs()).sum::<f32>() == 1.0));
        let ball = Mesh::icosphere(0.1, 3);
        let smooth = split(&ball, None);
        assert_eq!(smooth.positions.len(), ball.vertices.len());
        for (p, n) in smooth.positions.iter().zip(&smooth.normals) {
            let radial = DVec3::from_array(p.map(f64::from)).normalize();
            assert!(radial.dot(DVec3::from_array(n.map(f64::from))) > 0.999);
        }
    }

    #[test]
    fn texture_seams_split_vertices() {
        let mesh = Mesh::icosphere(0.1, 1);
        let corner_uv =
            (0..mesh.triangles.len()).map(|t| [[t as f32, 0.0], [0.0, 1.0], [0.5, 0.5]]).collect();
        let image = sms_core::Image::from_vec(1, 1, vec![[1, 2, 3]]);
        let surface = split(&mesh, Some(&MeshTexture { corner_uv, image }));
        assert!(surface.positions.len() > mesh.vertices.len());
        assert_eq!(surface.uv.len(), surface.positions.len());
        assert_eq!(surface.indices.len(), 3 * mesh.triangles.len());
    }
}
