//! Turned shapes: regular polygons swept along a profile, solid or with a cavity, optionally with a handle.
//!
//! A lathed surface of `n` segments is a polyhedron, and its convex pieces are exact: a band of a solid is a frustum;
//! a band of a wall, in one segment, is a hexahedron with planar faces, because chords of equal angle are
//! parallel.

use super::PartedSolid;
use glamx::DVec3;
use sms_core::Mesh;
use std::f64::consts::TAU;

/// A point of a profile: (distance from the axis, height), metres.
pub(crate) type ProfilePoint = (f64, f64);

/// A handle between two bands of a vessel's outer profile, in segment 0. Both bands must lie on a cylinder.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Handle {
    /// Index of the outer profile point at which the lower band begins.
    pub(crate) low_band: usize,
    /// Index of the outer profile point at which the upper band begins.
    pub(crate) high_band: usize,
    /// Distance by which it protrudes, metres.
    pub(crate) reach: f64,
    /// Thickness in the plane of the handle, metres.
    pub(crate) thickness: f64,
}

const HANDLE_SECTIONS: usize = 10;

fn ring_point((r, z): ProfilePoint, k: usize, n: usize) -> DVec3 {
    let angle = TAU * (k % n) as f64 / n as f64;
    DVec3::new(r * angle.cos(), r * angle.sin(), z)
}

/// The surface swept by a profile that starts and ends with a flat disc; quads of `holes` (ring, segment) are left
/// out.
fn sweep(profile: &[ProfilePoint], n: usize, holes: &[(usize, usize)]) -> Mesh {
    let mut vertices: Vec<DVec3> =
        profile.iter().flat_map(|&p| (0..n).map(move |k| ring_point(p, k, n))).collect();
    let index = |ring: usize, k: usize| (ring * n + k % n) as u32;
    let (first, last) = (vertices.len() as u32, vertices.len() as u32 + 1);
    vertices.push(DVec3::new(0.0, 0.0, profile[0].1));
    vertices.push(DVec3::new(0.0, 0.0, profile[profile.len() - 1].1));
    let mut triangles = Vec::new();
    for k in 0..n {
        triangles.push([first, index(0, k + 1), index(0, k)]);
        triangles.push([last, index(profile.len() - 1, k), index(profile.len() - 1, k + 1)]);
        for ring in 0..profile.len() - 1 {
            if holes.contains(&(ring, k)) {
                continue;
            }
            let (a, b, c, d) =
                (index(ring, k), index(ring, k + 1), index(ring + 1, k + 1), index(ring + 1, k));
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    Mesh::new(vertices, triangles)
}

/// The convex hexahedron swept by the quad `p` (counter-clockwise seen with the axis to its left: outer lower, outer
/// upper, inner upper, inner lower) between two copies of it.
fn hexahedron(near: [DVec3; 4], far: [DVec3; 4]) -> Mesh {
    let mut triangles = vec![[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]];
    for i in 0..4u32 {
        let j = (i + 1) % 4;
        triangles.extend([[i, i + 4, j + 4], [i, j + 4, j]]);
    }
    let mesh = Mesh::new(near.into_iter().chain(far).collect(), triangles);
    debug_assert!(mesh.volume() > 0.0, "a wall piece is inside out");
    mesh
}

fn frustum(low: ProfilePoint, high: ProfilePoint, n: usize) -> Mesh {
    let vertices = [low, high].iter().flat_map(|&p| (0..n).map(move |k| ring_point(p, k, n))).collect();
    let n = n as u32;
    let mut triangles = Vec::new();
    for k in 0..n {
        let next = (k + 1) % n;
        triangles.extend([[k, next, n + next], [k, n + next, n + k]]);
    }
    for k in 1..n - 1 {
        triangles.push([0, k + 1, k]);
        triangles.push([n, n + k, n + k + 1]);
    }
    Mesh::new(vertices, triangles)
}

/// A solid of revolution with flat ends; heights must increase strictly and radii be positive.
pub(crate) fn lathe_solid(profile: &[ProfilePoint], segments: usize) -> PartedSolid {
    PartedSolid {
        mesh: sweep(profile, segments, &[]),
        parts: profile.windows(2).map(|w| frustum(w[0], w[1], segments)).collect(),
    }
}

/// A vessel: `outer` rises from the floor to the rim; `inner[i]` is the inside of the wall at `outer[i + 1]`, and
/// `inner[0]` is the edge of the cavity's flat bottom, at the height of `outer[1]`.
pub(crate) fn lathe_vessel(
    outer: &[ProfilePoint],
    inner: &[ProfilePoint],
    segments: usize,
    handle: Option<Handle>,
) -> PartedSolid {
    assert_eq!(inner.len() + 1, outer.len(), "each outer point above the base has its inner point");
    assert_eq!(inner[0].1, outer[1].1, "the cavity begins at the top of the base");
    let profile: Vec<ProfilePoint> = outer.iter().chain(inner.iter().rev()).copied().collect();
    let holes: Vec<(usize, usize)> =
        handle.iter().flat_map(|h| [(h.low_band, 0), (h.high_band, 0)]).collect();
    let mut mesh = sweep(&profile, segments, &holes);
    let mut parts = vec![frustum(outer[0], outer[1], segments)];
    for i in 0..inner.len() - 1 {
        let quad = [outer[i + 1], outer[i + 2], inner[i + 1], inner[i]];
        for k in 0..segments {
            let at = |k: usize| quad.map(|p| ring_point(p, k, segments));
            parts.push(hexahedron(at(k), at(k + 1)));
        }
    }
    if let Some(handle) = handle {
        attach_handle(&mut mesh, &mut parts, outer, segments, handle);
    }
    PartedSolid { mesh, parts }
}

fn attach_handle(mesh: &mut Mesh, parts: &mut Vec<Mesh>, outer: &[ProfilePoint], n: usize, handle: Handle) {
    let (radius, z1) = outer[handle.low_band];
    let (z2, z3, z4) =
        (outer[handle.low_band + 1].1, outer[handle.high_band].1, outer[handle.high_band + 1].1);
    let half_angle = 0.5 * TAU / n as f64;
    let wall = radius * half_angle.cos();
    let half_width = radius * half_angle.sin();
    let out = DVec3::new(half_angle.cos(), half_angle.sin(), 0.0);
    let side = DVec3::new(-half_angle.sin(), half_angle.cos(), 0.0);
    let middle = 0.5 * (z1 + z4);
    // One cross-section: [far side −, far side +, near side +, near side −] of the bow, − and + along `side`.
    let section = |j: usize| -> [DVec3; 4] {
        let angle = std::f64::consts::PI * (j as f64 / HANDLE_SECTIONS as f64 - 0.5);
        let bow = |reach: f64, half_height: f64, center: f64| {
            out * (wall + reach * angle.cos()) + DVec3::Z * (center + half_height * angle.sin())
        };
        let far = bow(handle.reach, 0.5 * (z4 - z1), middle);
        let near = bow(handle.reach - handle.thickness, 0.5 * (z3 - z2), 0.5 * (z2 + z3));
        [far - side * half_width, far + side * half_width, near + side * half_width, near - side * half_width]
    };
    let ring = |band: usize| -> [u32; 4] {
        let (low, high) = ((band * n) as u32, ((band + 1) * n) as u32);
        [low, low + 1, high + 1, high]
    };
    let start = ring(handle.low_band);
    let [b0, b1, a1, a0] = ring(handle.high_band);
    let end = [a0, a1, b1, b0];
    let mut previous = start;
    for j in 1..=HANDLE_SECTIONS {
        let next = if j == HANDLE_SECTIONS {
            end
        } else {
            section(j).map(|p| {
                mesh.vertices.push(p);
                (mesh.vertices.len() - 1) as u32
            })
        };
        for i in 0..4 {
            let k = (i + 1) % 4;
            mesh.triangles.extend([[previous[i], previous[k], next[k]], [previous[i], next[k], next[i]]]);
        }
        let corners = |ring: [u32; 4]| ring.map(|i| mesh.vertices[i as usize]);
        let ([p0, p1, p2, p3], [q0, q1, q2, q3]) = (corners(previous), corners(next));
        // Seen from −side, the quad in the plane of the handle is [near, far, far', near'].
        parts.push(hexahedron([p0, q0, q3, p3], [p1, q1, q2, p2]));
        previous = next;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn volumes(solid: &PartedSolid) -> (f64, f64) {
        (solid.mesh.volume(), solid.parts.iter().map(Mesh::volume).sum())
    }

    #[test]
    fn a_cylinder_has_the_volume_of_its_polygon_and_pieces_add_up() {
        let n = 32;
        let solid = lathe_solid(&[(0.05, 0.0), (0.05, 0.04), (0.05, 0.1)], n);
        let polygon = 0.5 * n as f64 * 0.05f64.powi(2) * (TAU / n as f64).sin();
        let (whole, pieces) = volumes(&solid);
        assert!((whole - polygon * 0.1).abs() < 1e-15);
        assert!((pieces - whole).abs() < 1e-15);
        assert!(solid.mesh.is_closed_oriented());
    }

    #[test]
    fn a_mug_with_its_handle_is_one_closed_surface_and_its_pieces_add_up() {
        let (r, t, h) = (0.04, 0.004, 0.09);
        let z = [0.0, 0.006, 0.02, 0.03, 0.06, 0.07, h];
        let outer: Vec<_> = z.iter().map(|&z| (r, z)).collect();
        let inner: Vec<_> = z[1..].iter().map(|&z| (r - t, z)).collect();
        let handle = Handle { low_band: 2, high_band: 4, reach: 0.03, thickness: 0.008 };
        for handle in [None, Some(handle)] {
            let solid = lathe_vessel(&outer, &inner, 32, handle);
            assert!(solid.mesh.is_closed_oriented());
            assert_eq!(solid.mesh.components().len(), 1);
            assert!(solid.parts.iter().all(Mesh::is_closed_oriented));
            let (whole, pieces) = volumes(&solid);
            assert!((pieces / whole - 1.0).abs() < 1e-9, "{pieces} {whole}");
        }
    }
}
