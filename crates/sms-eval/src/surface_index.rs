//! Distances to triangle meshes.

use glamx::DVec3;
use rand::RngExt;
use sms_core::{Mesh, Seed, StageRng};

/// A bounding-volume hierarchy over the triangles of a mesh, for closest-point queries.
#[derive(Debug)]
pub struct SurfaceIndex {
    triangles: Vec<[DVec3; 3]>,
    order: Vec<u32>,
    nodes: Vec<TriangleNode>,
}

#[derive(Debug, Clone, Copy)]
struct TriangleNode {
    min: DVec3,
    max: DVec3,
    /// Leaf: first triangle in `order`; inner: index of the right child (the left one follows).
    start: u32,
    /// Number of triangles in a leaf, 0 in an inner node.
    count: u32,
}

/// A point on a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosestPoint {
    /// Distance in metres.
    pub distance: f64,
    /// Index of the triangle.
    pub triangle: u32,
    /// The point.
    pub point: DVec3,
}

const LEAF: usize = 4;

impl SurfaceIndex {
    /// Builds the hierarchy; `None` for a mesh without triangles.
    pub fn new(mesh: &Mesh) -> Option<Self> {
        Self::build((0..mesh.triangles.len()).map(|t| mesh.corners(t)).collect())
    }

    /// Like [`Self::new`], for points: a point is a triangle with three equal corners. `None` without points.
    pub fn of_points(points: &[DVec3]) -> Option<Self> {
        Self::build(points.iter().map(|&p| [p; 3]).collect())
    }

    fn build(triangles: Vec<[DVec3; 3]>) -> Option<Self> {
        if triangles.is_empty() {
            return None;
        }
        let mut index = Self { order: (0..triangles.len() as u32).collect(), nodes: Vec::new(), triangles };
        let n = index.order.len();
        index.split(0, n);
        Some(index)
    }

    fn split(&mut self, from: usize, to: usize) -> u32 {
        let corners = self.order[from..to].iter().flat_map(|&t| self.triangles[t as usize]);
        let (min, max) =
            corners.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)));
        let id = self.nodes.len() as u32;
        self.nodes.push(TriangleNode { min, max, start: from as u32, count: (to - from) as u32 });
        if to - from > LEAF {
            let extent = max - min;
            let axis = (0..3).max_by(|&a, &b| extent[a].total_cmp(&extent[b])).unwrap_or(0);
            let triangles = &self.triangles;
            let center = |t: u32| triangles[t as usize].iter().map(|p| p[axis]).sum::<f64>();
            self.order[from..to].sort_by(|&a, &b| center(a).total_cmp(&center(b)).then(a.cmp(&b)));
            let middle = (from + to) / 2;
            self.split(from, middle);
            let right = self.split(middle, to);
            self.nodes[id as usize].start = right;
            self.nodes[id as usize].count = 0;
        }
        id
    }

    /// The point of the surface closest to `p`.
    pub fn closest(&self, p: DVec3) -> ClosestPoint {
        let mut best = ClosestPoint { distance: f64::INFINITY, triangle: 0, point: p };
        let mut stack = vec![0u32];
        while let Some(id) = stack.pop() {
            let node = self.nodes[id as usize];
            if box_distance(&node, p) >= best.distance {
                continue;
            }
            if node.count == 0 {
                let (left, right) = (id + 1, node.start);
                let near_left = box_distance(&self.nodes[left as usize], p)
                    <= box_distance(&self.nodes[right as usize], p);
                stack.extend(if near_left { [right, left] } else { [left, right] });
                continue;
            }
            for &t in &self.order[node.start as usize..(node.start + node.count) as usize] {
                let point = closest_on_triangle(p, self.triangles[t as usize]);
                let distance = (point - p).length();
                if distance < best.distance {
                    best = ClosestPoint { distance, triangle: t, point };
                }
            }
        }
        best
    }
}

fn box_distance(node: &TriangleNode, p: DVec3) -> f64 {
    (node.min - p).max(p - node.max).max(DVec3::ZERO).length()
}

/// Closest point of a triangle (Ericson, "Real-Time Collision Detection", section 5.1.5).
fn closest_on_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> DVec3 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let sum = va + vb + vc;
    if sum == 0.0 {
        return a;
    }
    a + ab * (vb / sum) + ac * (vc / sum)
}

/// Returns `count` points uniform per area over the mesh (stratified over the cumulative area). The same mesh and seed
/// always give the same points.
pub fn sample_surface(mesh: &Mesh, count: usize, seed: Seed) -> Vec<DVec3> {
    let samples = sample_triangles(mesh, count, &mut seed.derive("sample_surface").rng());
    samples.into_iter().map(|(_, point)| point).collect()
}

/// Like [`sample_surface`], with the index of each point's triangle, and with the caller's generator.
pub(crate) fn sample_triangles(mesh: &Mesh, count: usize, rng: &mut StageRng) -> Vec<(usize, DVec3)> {
    let mut cumulative = Vec::with_capacity(mesh.triangles.len());
    let mut total = 0.0;
    for t in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.corners(t);
        total += 0.5 * (b - a).cross(c - a).length();
        cumulative.push(total);
    }
    if total <= 0.0 {
        return Vec::new();
    }
    (0..count)
        .map(|i| {
            let at = (i as f64 + rng.random::<f64>()) / count as f64 * total;
            let t = cumulative.partition_point(|&c| c < at).min(cumulative.len() - 1);
            let [a, b, c] = mesh.corners(t);
            let (mut u, mut v) = (rng.random::<f64>(), rng.random::<f64>());
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            (t, a + (b - a) * u + (c - a) * v)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn distances_to_a_box_are_its_closed_form() {
        let half = DVec3::new(0.1, 0.2, 0.3);
        let index = SurfaceIndex::new(&Mesh::cuboid(half)).unwrap();
        assert!((index.closest(DVec3::new(0.5, 0.0, 0.0)).distance - 0.4).abs() < 1e-12);
        assert!((index.closest(DVec3::new(0.2, 0.3, 0.4)).distance - 0.03f64.sqrt()).abs() < 1e-12);
        assert!((index.closest(DVec3::ZERO).distance - 0.1).abs() < 1e-12);
    }

    #[test]
    fn samples_are_uniform_per_area() {
        let mesh = Mesh::cuboid(DVec3::new(0.1, 0.1, 0.4));
        let points = sample_surface(&mesh, 20_000, Seed(1));
        let caps = points.iter().filter(|p| p.z.abs() > 0.4 - 1e-9).count();
        let expected = 2.0 * 0.04 / mesh.area() * 20_000.0;
        assert!((caps as f64 - expected).abs() < 60.0, "{caps} against {expected}");
    }

    proptest! {
        #[test]
        fn the_hierarchy_agrees_with_brute_force(x in -0.2..0.2f64, y in -0.2..0.2f64, z in -0.2..0.2f64) {
            let mesh = Mesh::icosphere(0.1, 2);
            let p = DVec3::new(x, y, z);
            let brute = (0..mesh.triangles.len())
                .map(|t| (closest_on_triangle(p, mesh.corners(t)) - p).length())
                .fold(f64::INFINITY, f64::min);
            prop_assert!((SurfaceIndex::new(&mesh).unwrap().closest(p).distance - brute).abs() < 1e-12);
        }
    }
}
