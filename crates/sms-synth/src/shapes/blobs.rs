//! Figures made of ellipsoids, standing on a flat base: the surface of the union by marching tetrahedra, with every
//! vertex moved onto the exact surface along its grid edge.

use super::{PartedSolid, clip::clip_convex};
use glamx::DVec3;
use sms_core::Mesh;
use std::collections::BTreeMap;

/// An axis-aligned ellipsoid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Ellipsoid {
    pub(crate) center: DVec3,
    pub(crate) radii: DVec3,
}

impl Ellipsoid {
    pub(crate) fn new(center: [f64; 3], radii: [f64; 3]) -> Self {
        Self { center: DVec3::from_array(center), radii: DVec3::from_array(radii) }
    }

    /// Returns a value that is negative inside and about the distance in metres near the surface.
    fn level(&self, p: DVec3) -> f64 {
        (((p - self.center) / self.radii).length() - 1.0) * self.radii.min_element()
    }

    /// Returns a convex polyhedron of the ellipsoid's volume.
    fn polyhedron(&self) -> Mesh {
        let mut mesh = Mesh::icosphere(1.0, 2);
        let fill = (4.0 / 3.0 * std::f64::consts::PI / mesh.volume()).cbrt();
        mesh.vertices.iter_mut().for_each(|v| *v = self.center + *v * fill * self.radii);
        mesh
    }
}

/// The six tetrahedra of a cube cut along its main diagonal, by corner number (bit 0: x, 1: y, 2: z). Neighbouring
/// cubes cut their common face in the same way.
const TETRAHEDRA: [[usize; 4]; 6] =
    [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]];

/// The union of ellipsoids above z = 0, meshed with cells of `cell` metres; pieces are polyhedra of 162 corners, cut
/// at z = 0.
pub(crate) fn ellipsoid_union(blobs: &[Ellipsoid], cell: f64) -> PartedSolid {
    let level = |p: DVec3| blobs.iter().map(|b| b.level(p)).fold(f64::INFINITY, f64::min).max(-p.z);
    let low =
        blobs.iter().fold(DVec3::MAX, |m, b| m.min(b.center - b.radii)).max(DVec3::new(-1e9, -1e9, 0.0));
    let high = blobs.iter().fold(DVec3::MIN, |m, b| m.max(b.center + b.radii));
    // Half a cell of offset keeps the base plane away from grid points.
    let origin = low - DVec3::splat(1.5 * cell);
    let counts = ((high - origin) / cell + DVec3::splat(2.0)).as_ivec3();
    let size = [counts.x as usize + 1, counts.y as usize + 1, counts.z as usize + 1];
    let point = |g: usize| {
        let (i, j, k) = (g % size[0], g / size[0] % size[1], g / (size[0] * size[1]));
        origin + DVec3::new(i as f64, j as f64, k as f64) * cell
    };
    let value: Vec<f64> = (0..size[0] * size[1] * size[2]).map(|g| level(point(g))).collect();
    let mut mesh = Mesh::default();
    let mut on_edge: BTreeMap<(usize, usize), u32> = BTreeMap::new();
    let mut vertex = |a: usize, b: usize, mesh: &mut Mesh| -> u32 {
        *on_edge.entry((a.min(b), a.max(b))).or_insert_with(|| {
            let (inside, outside) = if value[a] < 0.0 { (a, b) } else { (b, a) };
            let (mut p, mut q) = (point(inside), point(outside));
            for _ in 0..48 {
                let middle = 0.5 * (p + q);
                if level(middle) < 0.0 { p = middle } else { q = middle }
            }
            let mut root = 0.5 * (p + q);
            if root.z.abs() < 1e-9 {
                root.z = 0.0;
            }
            mesh.vertices.push(root);
            (mesh.vertices.len() - 1) as u32
        })
    };
    for k in 0..size[2] - 1 {
        for j in 0..size[1] - 1 {
            for i in 0..size[0] - 1 {
                let corner = |c: usize| {
                    (i + (c & 1)) + (j + (c >> 1 & 1)) * size[0] + (k + (c >> 2)) * size[0] * size[1]
                };
                for tetrahedron in TETRAHEDRA {
                    march(tetrahedron.map(corner), &value, &mut vertex, &mut mesh);
                }
            }
        }
    }
    let parts = blobs.iter().map(|b| clip_convex(&b.polyhedron(), -DVec3::Z, 0.0)).collect();
    PartedSolid { mesh, parts }
}

/// The surface within one positively oriented tetrahedron (all of [`TETRAHEDRA`] are).
fn march(
    t: [usize; 4],
    value: &[f64],
    vertex: &mut impl FnMut(usize, usize, &mut Mesh) -> u32,
    mesh: &mut Mesh,
) {
    let inside: Vec<usize> = (0..4).filter(|&c| value[t[c]] < 0.0).collect();
    // For each corner, the other three in the order that makes (corner, others) an even permutation.
    const OTHERS: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];
    match inside.len() {
        1 => {
            let c = inside[0];
            let [x, y, z] = OTHERS[c].map(|o| vertex(t[c], t[o], mesh));
            mesh.triangles.push([x, y, z]);
        }
        3 => {
            let Some(c) = (0..4).find(|c| !inside.contains(c)) else { return };
            let [x, y, z] = OTHERS[c].map(|o| vertex(t[c], t[o], mesh));
            mesh.triangles.push([x, z, y]);
        }
        2 => {
            let (a, b) = (inside[0], inside[1]);
            // The two outside corners, ordered so that (a, b, c, d) is an even permutation.
            let (c, d) = match (a, b) {
                (0, 1) => (2, 3),
                (0, 2) => (3, 1),
                (0, 3) => (1, 2),
                (1, 2) => (0, 3),
                (1, 3) => (2, 0),
                _ => (0, 1),
            };
            let [ac, ad, bc, bd] = [(a, c), (a, d), (b, c), (b, d)].map(|(p, q)| vertex(t[p], t[q], mesh));
            mesh.triangles.extend([[ac, ad, bd], [ac, bd, bc]]);
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn one_ellipsoid_has_its_closed_form_volume_and_faces_outwards() {
        let blob = Ellipsoid::new([0.01, -0.02, 0.06], [0.03, 0.04, 0.05]);
        let solid = ellipsoid_union(&[blob], 0.004);
        assert!(solid.mesh.is_closed_oriented());
        let exact = 4.0 / 3.0 * PI * 0.03 * 0.04 * 0.05;
        assert!((solid.mesh.volume() / exact - 1.0).abs() < 0.01, "{}", solid.mesh.volume() / exact);
        assert!((solid.parts[0].volume() / exact - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_cut_sphere_stands_flat_on_the_floor() {
        let solid = ellipsoid_union(&[Ellipsoid::new([0.0, 0.0, 0.03], [0.04; 3])], 0.004);
        assert!(solid.mesh.is_closed_oriented());
        let on_floor = solid.mesh.vertices.iter().filter(|v| v.z == 0.0).count();
        assert!(on_floor > 50, "{on_floor}");
        assert!(solid.mesh.vertices.iter().all(|v| v.z >= 0.0));
        let cap = 0.01;
        let exact = 4.0 / 3.0 * PI * 0.04f64.powi(3) - PI * cap * cap * (0.04 - cap / 3.0);
        assert!((solid.mesh.volume() / exact - 1.0).abs() < 0.02);
        assert!((solid.parts[0].volume() / exact - 1.0).abs() < 0.02);
    }
}
