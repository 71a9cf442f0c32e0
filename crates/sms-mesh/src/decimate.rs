//! Decimation of closed meshes by quadric edge collapses (Garland and Heckbert 1997) that never change the topology. An
//! edge is collapsed only if its ends share exactly the two neighbours opposite the edge (the link condition; Dey et
//! al. 1999), so closed manifolds stay closed manifolds.

use glamx::{DMat3, DVec3};
use sms_core::Mesh;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Smallest cosine between a face's normals before and after one collapse.
const LEAST_TURN: f64 = 0.3;
/// Smallest ratio of a face's height to its longest edge.
const LEAST_SLENDERNESS: f64 = 0.03;
/// Weight of shape against distance: keeps faces regular in flat regions.
const REGULARITY: f64 = 1e-3;

/// Sum of squared distances to planes, weighted by area: `xᵀ A x + 2 bᵀ x + c`, about an origin near the mesh.
#[derive(Debug, Clone, Copy, Default)]
struct Quadric {
    a: [f64; 6],
    b: DVec3,
    c: f64,
    weight: f64,
}

impl Quadric {
    fn plane(normal: DVec3, offset: f64, weight: f64) -> Self {
        let n = normal;
        Self {
            a: [n.x * n.x, n.x * n.y, n.x * n.z, n.y * n.y, n.y * n.z, n.z * n.z].map(|v| v * weight),
            b: n * (-offset * weight),
            c: offset * offset * weight,
            weight,
        }
    }

    /// Squared distance to a point.
    fn point(p: DVec3, weight: f64) -> Self {
        let a = [weight, 0.0, 0.0, weight, 0.0, weight];
        Self { a, b: -p * weight, c: p.length_squared() * weight, weight: 0.0 }
    }

    fn plus(&self, other: &Self) -> Self {
        Self {
            a: std::array::from_fn(|k| self.a[k] + other.a[k]),
            b: self.b + other.b,
            c: self.c + other.c,
            weight: self.weight + other.weight,
        }
    }

    fn at(&self, p: DVec3) -> f64 {
        let [xx, xy, xz, yy, yz, zz] = self.a;
        let ap = DVec3::new(
            xx * p.x + xy * p.y + xz * p.z,
            xy * p.x + yy * p.y + yz * p.z,
            xz * p.x + yz * p.y + zz * p.z,
        );
        (p.dot(ap) + 2.0 * self.b.dot(p) + self.c).max(0.0)
    }

    /// Returns the minimum of the sum, as far as the planes determine it.
    fn minimum(&self) -> Option<DVec3> {
        let [xx, xy, xz, yy, yz, zz] = self.a;
        let m = DMat3::from_cols(DVec3::new(xx, xy, xz), DVec3::new(xy, yy, yz), DVec3::new(xz, yz, zz));
        let size = xx + yy + zz;
        let determinant = m.determinant();
        if determinant.abs() <= 1e-9 * size * size * size {
            return None;
        }
        let p = m.inverse() * -self.b;
        p.is_finite().then_some(p)
    }
}

struct EdgeCollapse {
    cost: f64,
    edge: (u32, u32),
    stamps: (u32, u32),
    to: DVec3,
}

impl PartialEq for EdgeCollapse {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}
impl Eq for EdgeCollapse {}
impl PartialOrd for EdgeCollapse {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for EdgeCollapse {
    /// The cheapest candidate is the greatest. Edges break ties, so that the result does not depend on the heap.
    fn cmp(&self, other: &Self) -> Ordering {
        other.cost.total_cmp(&self.cost).then(other.edge.cmp(&self.edge)).then(other.stamps.cmp(&self.stamps))
    }
}

struct Collapser {
    points: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    alive: Vec<bool>,
    faces_of: Vec<Vec<u32>>,
    quadrics: Vec<Quadric>,
    stamps: Vec<u32>,
    heap: BinaryHeap<EdgeCollapse>,
}

/// Collapses edges, cheapest first, until `budget` faces are left or the next collapse would move the surface by more
/// than `max_error` metres (root mean square over the area). Colours are dropped.
pub fn decimate(mesh: &Mesh, budget: usize, max_error: f64) -> Mesh {
    if mesh.triangles.len() <= budget.max(4) {
        return mesh.clone();
    }
    let Some(bounds) = mesh.aabb() else { return mesh.clone() };
    let origin = bounds.center();
    let mut collapser = Collapser::new(mesh, origin);
    let mut left = mesh.triangles.len();
    while left > budget.max(4) {
        let Some(candidate) = collapser.heap.pop() else { break };
        let (a, b) = candidate.edge;
        if candidate.stamps != (collapser.stamps[a as usize], collapser.stamps[b as usize]) {
            continue;
        }
        let weight = collapser.quadrics[a as usize].weight + collapser.quadrics[b as usize].weight;
        if candidate.cost > max_error * max_error * weight {
            break;
        }
        if collapser.may_collapse(a, b, candidate.to) {
            collapser.collapse(a, b, candidate.to);
            left -= 2;
        }
    }
    let triangles = (0..collapser.triangles.len()).filter(|&t| collapser.alive[t]);
    let triangles = triangles.map(|t| collapser.triangles[t]).collect();
    let vertices = collapser.points.into_iter().map(|p| p + origin).collect();
    Mesh::new(vertices, triangles).compacted()
}

impl Collapser {
    fn new(mesh: &Mesh, origin: DVec3) -> Self {
        let points: Vec<DVec3> = mesh.vertices.iter().map(|&p| p - origin).collect();
        let mut faces_of = vec![Vec::new(); points.len()];
        let mut quadrics = vec![Quadric::default(); points.len()];
        for (t, triangle) in mesh.triangles.iter().enumerate() {
            let [a, b, c] = triangle.map(|v| points[v as usize]);
            let cross = (b - a).cross(c - a);
            let normal = cross.normalize_or_zero();
            let quadric = Quadric::plane(normal, normal.dot(a), cross.length() / 6.0);
            for &v in triangle {
                faces_of[v as usize].push(t as u32);
                quadrics[v as usize] = quadrics[v as usize].plus(&quadric);
            }
        }
        for (p, q) in points.iter().zip(&mut quadrics) {
            *q = q.plus(&Quadric::point(*p, REGULARITY * q.weight));
        }
        let mut collapser = Self {
            alive: vec![true; mesh.triangles.len()],
            stamps: vec![0; points.len()],
            heap: BinaryHeap::with_capacity(mesh.triangles.len() * 3),
            triangles: mesh.triangles.clone(),
            points,
            faces_of,
            quadrics,
        };
        for t in 0..mesh.triangles.len() {
            for k in 0..3 {
                let (a, b) = (mesh.triangles[t][k], mesh.triangles[t][(k + 1) % 3]);
                // On a closed mesh each edge occurs once in either direction.
                if a < b {
                    collapser.offer(a, b);
                }
            }
        }
        collapser
    }

    fn offer(&mut self, a: u32, b: u32) {
        let (a, b) = (a.min(b), a.max(b));
        let quadric = self.quadrics[a as usize].plus(&self.quadrics[b as usize]);
        let (p, q) = (self.points[a as usize], self.points[b as usize]);
        let middle = 0.5 * (p + q);
        let reach = p.distance(q);
        let best = quadric.minimum().filter(|m| m.distance(middle) <= reach);
        let (cost, to) = best
            .into_iter()
            .chain([middle, p, q])
            .map(|p| (quadric.at(p), p))
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .unwrap_or((f64::INFINITY, middle));
        let stamps = (self.stamps[a as usize], self.stamps[b as usize]);
        self.heap.push(EdgeCollapse { cost, edge: (a, b), stamps, to });
    }

    /// Neighbours of a vertex, sorted.
    fn neighbors(&self, v: u32) -> Vec<u32> {
        let corners = self.faces_of[v as usize].iter().flat_map(|&t| self.triangles[t as usize]);
        let mut near: Vec<u32> = corners.filter(|&w| w != v).collect();
        near.sort_unstable();
        near.dedup();
        near
    }

    fn may_collapse(&self, a: u32, b: u32, to: DVec3) -> bool {
        let (near_a, near_b) = (self.neighbors(a), self.neighbors(b));
        let common = near_a.iter().filter(|v| near_b.binary_search(v).is_ok()).count();
        let shared =
            self.faces_of[a as usize].iter().filter(|&&t| self.triangles[t as usize].contains(&b)).count();
        // With fewer than four other neighbours, the two sheets of a flat sliver would merge.
        let room = near_a.len() + near_b.len() >= 7;
        if common != 2 || shared != 2 || !room {
            return false;
        }
        [(a, b), (b, a)].into_iter().all(|(v, other)| {
            self.faces_of[v as usize].iter().all(|&t| {
                let triangle = self.triangles[t as usize];
                if triangle.contains(&other) {
                    return true;
                }
                let before = triangle.map(|w| self.points[w as usize]);
                let after = triangle.map(|w| if w == v { to } else { self.points[w as usize] });
                let cross = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a);
                let (n, m) = (cross(before), cross(after));
                let [p, q, r] = after;
                let longest = p.distance_squared(q).max(q.distance_squared(r)).max(r.distance_squared(p));
                m.length() >= LEAST_SLENDERNESS * longest && n.dot(m) >= LEAST_TURN * n.length() * m.length()
            })
        })
    }

    fn collapse(&mut self, a: u32, b: u32, to: DVec3) {
        let quadric = self.quadrics[a as usize].plus(&self.quadrics[b as usize]);
        let of_b = std::mem::take(&mut self.faces_of[b as usize]);
        for t in of_b {
            let triangle = &mut self.triangles[t as usize];
            if triangle.contains(&a) {
                self.alive[t as usize] = false;
                let gone = *triangle;
                for v in gone {
                    self.faces_of[v as usize].retain(|&f| f != t);
                }
            } else {
                for v in triangle {
                    if *v == b {
                        *v = a;
                    }
                }
                self.faces_of[a as usize].push(t);
            }
        }
        self.points[a as usize] = to;
        self.quadrics[a as usize] = quadric;
        self.stamps[a as usize] += 1;
        self.stamps[b as usize] += 1;
        for v in self.neighbors(a) {
            self.offer(a, v);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sphere_keeps_its_volume_and_topology() {
        let mesh = Mesh::icosphere(0.05, 5);
        let small = decimate(&mesh, 500, 1.0);
        assert!(small.triangles.len() <= 500 && small.is_closed_oriented());
        assert!((small.volume() / mesh.volume() - 1.0).abs() < 0.01, "{}", small.volume() / mesh.volume());
        let off = small.vertices.iter().map(|v| (v.length() - 0.05).abs()).fold(0.0, f64::max);
        assert!(off < 0.001, "{off}");
    }

    #[test]
    fn a_box_comes_down_to_its_corners() {
        let fine = crate::fit::primitive_mesh(
            &sms_core::EntityShape::Box {
                x_ws: glamx::DPose3::IDENTITY,
                half_extents: DVec3::new(0.03, 0.05, 0.02),
            },
            0.004,
        )
        .unwrap();
        let small = decimate(&fine, 60, 1.0);
        assert!(small.is_closed_oriented() && small.triangles.len() <= 60);
        assert!((small.volume() / fine.volume() - 1.0).abs() < 0.005);
        // The error limit is reached before the face budget.
        let limited = decimate(&Mesh::icosphere(0.05, 4), 20, 1e-4);
        assert!(limited.triangles.len() > 300 && limited.is_closed_oriented());
    }

    #[test]
    fn a_ring_keeps_its_hole() {
        let (n, m) = (64, 24);
        let mut ring = Mesh::default();
        for i in 0..n {
            for j in 0..m {
                let (a, b) = (f64::from(i) / f64::from(n), f64::from(j) / f64::from(m));
                let (u, v) = (a * std::f64::consts::TAU, b * std::f64::consts::TAU);
                let r = 0.05 + 0.015 * v.cos();
                ring.vertices.push(DVec3::new(r * u.cos(), r * u.sin(), 0.015 * v.sin()));
                let at = |i: i32, j: i32| ((i % n) * m + j % m) as u32;
                let quad = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                ring.triangles.extend([[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]);
            }
        }
        let small = decimate(&ring, 200, 1.0);
        assert!(small.is_closed_oriented() && small.triangles.len() <= 200);
        let euler = small.vertices.len() as i64 - small.triangles.len() as i64 / 2;
        assert_eq!(euler, 0, "a torus stays a torus");
    }
}
