//! Triangle meshes.

use glamx::{DPose3, DVec3};
use serde::{Deserialize, Serialize};

/// An axis-aligned box.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Aabb {
    /// Smallest corner.
    pub min: DVec3,
    /// Largest corner.
    pub max: DVec3,
}

impl Aabb {
    /// Returns the box around points; `None` without points.
    pub fn of_points(points: impl IntoIterator<Item = DVec3>) -> Option<Self> {
        points.into_iter().fold(None, |acc, p| {
            Some(acc.map_or(Self { min: p, max: p }, |b: Self| Self { min: b.min.min(p), max: b.max.max(p) }))
        })
    }

    /// Returns the centre.
    pub fn center(&self) -> DVec3 {
        0.5 * (self.min + self.max)
    }

    /// Returns the edge lengths.
    pub fn extents(&self) -> DVec3 {
        self.max - self.min
    }
}

/// An indexed triangle mesh in metres; triangles are counter-clockwise seen from outside.
///
/// The owner of the mesh states its frame (world `W` or body `B`).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Mesh {
    /// Vertex positions.
    pub vertices: Vec<DVec3>,
    /// Vertex indices of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// sRGB colour per vertex, or empty.
    #[serde(default)]
    pub colors: Vec<[u8; 3]>,
}

impl Mesh {
    /// Creates a mesh without colours.
    pub fn new(vertices: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> Self {
        Self { vertices, triangles, colors: Vec::new() }
    }

    /// Returns the corners of triangle `t`.
    pub fn corners(&self, t: usize) -> [DVec3; 3] {
        self.triangles[t].map(|i| self.vertices[i as usize])
    }

    /// Transforms the mesh by `x_ab`: vertices in `B` become vertices in `A`.
    pub fn transformed(&self, x_ab: &DPose3) -> Self {
        Self {
            vertices: self.vertices.iter().map(|&p| x_ab.transform_point(p)).collect(),
            triangles: self.triangles.clone(),
            colors: self.colors.clone(),
        }
    }

    /// Returns the box around all vertices; `None` for an empty mesh.
    pub fn aabb(&self) -> Option<Aabb> {
        Aabb::of_points(self.vertices.iter().copied())
    }

    /// Returns the total surface area in m².
    pub fn area(&self) -> f64 {
        (0..self.triangles.len())
            .map(|t| {
                let [a, b, c] = self.corners(t);
                0.5 * (b - a).cross(c - a).length()
            })
            .sum()
    }

    /// Returns the signed enclosed volume in m³ (divergence theorem); positive when triangles face outwards.
    pub fn volume(&self) -> f64 {
        let origin = self.vertices.first().copied().unwrap_or(DVec3::ZERO);
        (0..self.triangles.len())
            .map(|t| {
                let [a, b, c] = self.corners(t).map(|p| p - origin);
                a.dot(b.cross(c)) / 6.0
            })
            .sum()
    }

    /// Returns the unit normal of each vertex: the area-weighted mean of its triangles' normals, or zero without triangles.
    pub fn vertex_normals(&self) -> Vec<DVec3> {
        let mut normals = vec![DVec3::ZERO; self.vertices.len()];
        for t in 0..self.triangles.len() {
            let [a, b, c] = self.corners(t);
            for v in self.triangles[t] {
                normals[v as usize] += (b - a).cross(c - a);
            }
        }
        normals.iter().map(|n| n.normalize_or_zero()).collect()
    }

    /// Creates an axis-aligned box centred at the origin with the given half extents.
    pub fn cuboid(half: DVec3) -> Self {
        let vertices = (0..8)
            .map(|i| {
                let sign = |bit: u32| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
                DVec3::new(sign(0) * half.x, sign(1) * half.y, sign(2) * half.z)
            })
            .collect();
        let triangles = vec![
            [0, 2, 1],
            [1, 2, 3],
            [4, 5, 6],
            [5, 7, 6],
            [0, 1, 4],
            [1, 5, 4],
            [2, 6, 3],
            [3, 6, 7],
            [0, 4, 2],
            [2, 4, 6],
            [1, 3, 5],
            [3, 7, 5],
        ];
        Self::new(vertices, triangles)
    }

    /// Creates a cylinder centred at the origin with its axis along z: a prism whose side faces `segments` (at least 3) directions,
    /// corners on the cylinder.
    pub fn cylinder(radius: f64, half_length: f64, segments: usize) -> Self {
        let n = segments.max(3) as u32;
        let mut vertices = vec![DVec3::NEG_Z * half_length, DVec3::Z * half_length];
        let mut triangles = Vec::with_capacity(4 * n as usize);
        for k in 0..n {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / f64::from(n)).sin_cos();
            vertices.push(DVec3::new(radius * cos, radius * sin, -half_length));
            vertices.push(DVec3::new(radius * cos, radius * sin, half_length));
            let (a, b) = (2 + 2 * k, 2 + 2 * ((k + 1) % n));
            triangles.extend([[0, b, a], [1, a + 1, b + 1], [a, b, b + 1], [a, b + 1, a + 1]]);
        }
        Self::new(vertices, triangles)
    }

    /// Creates a sphere centred at the origin: an icosahedron subdivided `levels` times, vertices on the sphere.
    pub fn icosphere(radius: f64, levels: usize) -> Self {
        let phi = (1.0 + 5f64.sqrt()) / 2.0;
        let mut vertices: Vec<DVec3> = [
            (-1.0, phi, 0.0),
            (1.0, phi, 0.0),
            (-1.0, -phi, 0.0),
            (1.0, -phi, 0.0),
            (0.0, -1.0, phi),
            (0.0, 1.0, phi),
            (0.0, -1.0, -phi),
            (0.0, 1.0, -phi),
            (phi, 0.0, -1.0),
            (phi, 0.0, 1.0),
            (-phi, 0.0, -1.0),
            (-phi, 0.0, 1.0),
        ]
        .map(|(x, y, z)| DVec3::new(x, y, z).normalize())
        .to_vec();
        let mut triangles: Vec<[u32; 3]> = vec![
            [0, 11, 5],
            [0, 5, 1],
            [0, 1, 7],
            [0, 7, 10],
            [0, 10, 11],
            [1, 5, 9],
            [5, 11, 4],
            [11, 10, 2],
            [10, 7, 6],
            [7, 1, 8],
            [3, 9, 4],
            [3, 4, 2],
            [3, 2, 6],
            [3, 6, 8],
            [3, 8, 9],
            [4, 9, 5],
            [2, 4, 11],
            [6, 2, 10],
            [8, 6, 7],
            [9, 8, 1],
        ];
        for _ in 0..levels {
            let mut middle = std::collections::BTreeMap::new();
            let mut next = Vec::with_capacity(triangles.len() * 4);
            for [a, b, c] in triangles {
                let mut mid = |i: u32, j: u32| {
                    *middle.entry((i.min(j), i.max(j))).or_insert_with(|| {
                        vertices.push((vertices[i as usize] + vertices[j as usize]).normalize());
                        (vertices.len() - 1) as u32
                    })
                };
                let (ab, bc, ca) = (mid(a, b), mid(b, c), mid(c, a));
                next.extend([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]);
            }
            triangles = next;
        }
        for v in &mut vertices {
            *v *= radius;
        }
        Self::new(vertices, triangles)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn closed_forms_of_box_and_sphere() {
        let cuboid = Mesh::cuboid(DVec3::new(0.1, 0.2, 0.3));
        assert!((cuboid.volume() - 8.0 * 0.006).abs() < 1e-15);
        assert!((cuboid.area() - 8.0 * (0.02 + 0.03 + 0.06)).abs() < 1e-12);
        let sphere = Mesh::icosphere(0.03, 4);
        let exact = 4.0 / 3.0 * std::f64::consts::PI * 0.03f64.powi(3);
        assert!((sphere.volume() / exact - 1.0).abs() < 5e-3);
        assert!(sphere.is_closed_oriented());
        let cylinder = Mesh::cylinder(0.03, 0.05, 96);
        assert!((cylinder.volume() / (std::f64::consts::PI * 9e-4 * 0.1) - 1.0).abs() < 1e-3);
        assert!(cylinder.is_closed_oriented());
        assert!(cuboid.is_closed_oriented());
    }
}
