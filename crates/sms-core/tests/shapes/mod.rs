//! Closed shapes for the comparison of mass properties with trimesh.

use sms_core::Mesh;
use sms_core::glamx::{DPose3, DQuat, DVec3};
use std::f64::consts::TAU;

/// Names and meshes, metres.
pub(crate) fn shapes() -> Vec<(&'static str, Mesh)> {
    let far =
        DPose3::from_parts(DVec3::new(1.3, -0.7, 0.9), DQuat::from_scaled_axis(DVec3::new(0.4, -1.1, 0.6)));
    vec![
        ("icosphere", Mesh::icosphere(0.04, 3)),
        ("cuboid_turned", Mesh::cuboid(DVec3::new(0.03, 0.08, 0.012)).transformed(&far)),
        ("torus", torus(0.06, 0.015)),
        ("torus_turned", torus(0.06, 0.015).transformed(&far)),
        ("mug", mug()),
        ("mug_turned", mug().transformed(&far)),
    ]
}

/// A tube around the z axis.
fn torus(radius: f64, tube: f64) -> Mesh {
    const AROUND: u32 = 48;
    const ACROSS: u32 = 24;
    let at = |i: u32, j: u32| {
        let (u, v) = (TAU * f64::from(i) / f64::from(AROUND), TAU * f64::from(j) / f64::from(ACROSS));
        let r = radius + tube * v.cos();
        DVec3::new(r * u.cos(), r * u.sin(), tube * v.sin())
    };
    let vertices = (0..AROUND).flat_map(|i| (0..ACROSS).map(move |j| at(i, j))).collect();
    let index = |i: u32, j: u32| (i % AROUND) * ACROSS + j % ACROSS;
    let quad = |i: u32, j: u32| {
        let (a, b, c, d) = (index(i, j), index(i + 1, j), index(i + 1, j + 1), index(i, j + 1));
        [[a, b, c], [a, c, d]]
    };
    Mesh::new(vertices, (0..AROUND).flat_map(|i| (0..ACROSS).flat_map(move |j| quad(i, j))).collect())
}

/// A vessel with walls of 4 mm and a handle on its side that cuts into it: two closed surfaces, like many models.
fn mug() -> Mesh {
    const AROUND: u32 = 64;
    // Radius and height, from the middle of the underside over the rim to the middle of the inside.
    let profile =
        [(0.036, 0.0), (0.042, 0.03), (0.042, 0.095), (0.038, 0.095), (0.038, 0.03), (0.033, 0.005)];
    let mut vertices = vec![DVec3::ZERO, DVec3::Z * 0.005];
    for k in 0..AROUND {
        let (sin, cos) = (TAU * f64::from(k) / f64::from(AROUND)).sin_cos();
        vertices.extend(profile.map(|(r, z)| DVec3::new(r * cos, r * sin, z)));
    }
    let n = profile.len() as u32;
    let index = |k: u32, j: u32| 2 + (k % AROUND) * n + j;
    let mut triangles = Vec::new();
    for k in 0..AROUND {
        triangles.push([0, index(k + 1, 0), index(k, 0)]);
        triangles.push([1, index(k, n - 1), index(k + 1, n - 1)]);
        for j in 0..n - 1 {
            let (a, b, c, d) = (index(k, j), index(k + 1, j), index(k + 1, j + 1), index(k, j + 1));
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    let upright = DPose3::from_parts(DVec3::new(0.045, 0.0, 0.05), DQuat::from_rotation_x(TAU / 4.0));
    let handle = torus(0.022, 0.005).transformed(&upright);
    let first = vertices.len() as u32;
    vertices.extend(handle.vertices);
    triangles.extend(handle.triangles.iter().map(|t| t.map(|i| i + first)));
    Mesh::new(vertices, triangles)
}
