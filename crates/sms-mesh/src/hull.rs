//! Convex hulls with exact predicates and a vertex limit.

use crate::predicates::{ACROSS, FACES, collinear, orient};
use glamx::DVec3;
use sms_core::Mesh;

struct GrowingFace {
    corners: [u32; 3],
    /// The face across the edge from corner `k` to corner `k + 1`.
    across: [u32; 3],
    alive: bool,
    /// Points that see the face, with the farthest of them.
    outside: Vec<u32>,
    farthest: (f64, u32),
}

impl GrowingFace {
    fn new(corners: [u32; 3], across: [u32; 3]) -> Self {
        Self { corners, across, alive: true, outside: Vec::new(), farthest: (0.0, 0) }
    }
}

/// Returns the convex hull of `points` as a closed mesh: quickhull (Barber, Dobkin and Huhdanpaa 1996), which always
/// adds the point farthest outside. It stops at `max_vertices`, or when no point is farther outside than `tolerance`
/// metres. A hull that stopped early lies inside the exact one. Returns `None` when the points are coplanar.
///
/// ```
/// use sms_core::{Mesh, glamx::DVec3};
/// let hull = sms_mesh::convex_hull(&Mesh::icosphere(0.1, 3).vertices, 64, 0.0).unwrap();
/// assert_eq!(hull.vertices.len(), 64);
/// assert!(hull.is_closed_oriented());
/// ```
pub fn convex_hull(points: &[DVec3], max_vertices: usize, tolerance: f64) -> Option<Mesh> {
    let seed = extreme_simplex(points)?;
    let faces = (0..4).map(|f| GrowingFace::new(FACES[f].map(|k| seed[k]), ACROSS[f])).collect();
    let mut hull = Hull { points, faces };
    let all: Vec<u32> = (0..points.len() as u32).filter(|i| !seed.contains(i)).collect();
    hull.assign(&all, &[0, 1, 2, 3]);
    let mut vertices = 4;
    while vertices < max_vertices.max(4) {
        let next = hull
            .faces
            .iter()
            .enumerate()
            .filter(|(_, f)| f.alive && !f.outside.is_empty())
            .max_by(|a, b| a.1.farthest.0.total_cmp(&b.1.farthest.0).then(b.0.cmp(&a.0)));
        let Some((face, data)) = next else { break };
        let (distance, point) = data.farthest;
        if distance <= tolerance {
            break;
        }
        hull.add(point, face as u32);
        vertices += 1;
    }
    let triangles = hull.faces.iter().filter(|f| f.alive).map(|f| f.corners).collect();
    Some(Mesh::new(points.to_vec(), triangles).compacted())
}

const NO_FACE: u32 = u32::MAX;

/// Returns a positively oriented tetrahedron of far-apart points.
fn extreme_simplex(points: &[DVec3]) -> Option<[u32; 4]> {
    let farthest = |measure: &dyn Fn(DVec3) -> f64| {
        (0..points.len()).max_by(|&i, &j| measure(points[i]).total_cmp(&measure(points[j])).then(j.cmp(&i)))
    };
    let a = farthest(&|p| -p.x)?;
    let b = farthest(&|p| p.distance_squared(points[a]))?;
    let along = points[b] - points[a];
    let mut c = farthest(&|p| (p - points[a]).cross(along).length_squared())?;
    if collinear(points[a], points[b], points[c]) {
        c = (0..points.len()).find(|&i| !collinear(points[a], points[b], points[i]))?;
    }
    let side = |p: DVec3| orient(points[a], points[b], points[c], p);
    let d = farthest(&|p| side(p).abs())?;
    let [a, b, c, d] = [a, b, c, d].map(|i| i as u32);
    match side(points[d as usize]) {
        s if s > 0.0 => Some([a, b, c, d]),
        s if s < 0.0 => Some([b, a, c, d]),
        _ => None,
    }
}

struct Hull<'a> {
    points: &'a [DVec3],
    faces: Vec<GrowingFace>,
}

impl Hull<'_> {
    fn edge(&self, face: u32, k: usize) -> (u32, u32) {
        let corners = self.faces[face as usize].corners;
        (corners[k], corners[(k + 1) % 3])
    }

    /// Returns a positive value for a point in front of a face, and zero for a point in its plane.
    fn side(&self, point: u32, face: u32) -> f64 {
        let [a, b, c] = self.faces[face as usize].corners.map(|i| self.points[i as usize]);
        orient(a, b, c, self.points[point as usize])
    }

    /// Assigns each point to the face of `faces` that it is farthest above. Points that see no face are inside.
    fn assign(&mut self, points: &[u32], faces: &[u32]) {
        for &p in points {
            let at = self.points[p as usize];
            let mut highest: Option<(f64, u32)> = None;
            for &f in faces.iter().filter(|&&f| self.side(p, f) > 0.0) {
                let [a, b, c] = self.faces[f as usize].corners.map(|i| self.points[i as usize]);
                let normal = (b - a).cross(c - a).normalize_or_zero();
                let distance = normal.dot(at - a).max(f64::MIN_POSITIVE);
                if highest.is_none_or(|h| distance > h.0) {
                    highest = Some((distance, f));
                }
            }
            let Some((distance, f)) = highest else { continue };
            let face = &mut self.faces[f as usize];
            if face.outside.is_empty() || distance > face.farthest.0 {
                face.farthest = (distance, p);
            }
            face.outside.push(p);
        }
    }

    fn add(&mut self, point: u32, first: u32) {
        let mut visible = vec![first];
        let mut is_visible = std::collections::BTreeSet::from([first]);
        let mut horizon = Vec::new();
        let mut at = 0;
        while at < visible.len() {
            let f = visible[at];
            at += 1;
            for k in 0..3 {
                let g = self.faces[f as usize].across[k];
                if is_visible.contains(&g) {
                    continue;
                }
                // A face in the plane of the point is also replaced. Otherwise an edge in line with the point could
                // create a face without area, which no point sees and which would remain.
                if self.side(point, g) >= 0.0 {
                    is_visible.insert(g);
                    visible.push(g);
                } else {
                    horizon.push((f, k, g));
                }
            }
        }
        let base = self.faces.len() as u32;
        // Around the horizon, each new face follows the face whose edge ends where its own edge begins.
        let starts: std::collections::BTreeMap<u32, u32> =
            horizon.iter().zip(base..).map(|(&(f, k, _), id)| (self.edge(f, k).0, id)).collect();
        for (&(f, k, g), id) in horizon.iter().zip(base..) {
            let (a, b) = self.edge(f, k);
            for m in 0..3 {
                if self.edge(g, m) == (b, a) {
                    self.faces[g as usize].across[m] = id;
                }
            }
            let next = starts.get(&b).copied().unwrap_or(NO_FACE);
            self.faces.push(GrowingFace::new([a, b, point], [g, next, NO_FACE]));
        }
        let fresh: Vec<u32> = (base..self.faces.len() as u32).collect();
        for &id in &fresh {
            let next = self.faces[id as usize].across[1];
            self.faces[next as usize].across[2] = id;
        }
        let mut orphans = Vec::new();
        for &f in &visible {
            let face = &mut self.faces[f as usize];
            face.alive = false;
            orphans.append(&mut face.outside);
        }
        orphans.retain(|&p| p != point);
        self.assign(&orphans, &fresh);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_box_with_points_on_its_faces_has_eight_corners() {
        let mut points = Mesh::cuboid(DVec3::new(0.1, 0.2, 0.3)).vertices;
        for i in 0..50 {
            let (u, v) = ((i % 7) as f64 / 3.5 - 1.0, (i % 11) as f64 / 5.5 - 1.0);
            points.push(DVec3::new(0.1, 0.2 * u, 0.3 * v));
            points.push(DVec3::new(0.1 * v, 0.2 * u, -0.3));
        }
        let hull = convex_hull(&points, 1000, 0.0).unwrap();
        assert!(hull.is_closed_oriented());
        assert!((hull.volume() - 8.0 * 0.006).abs() < 1e-12);
    }

    #[test]
    fn flat_and_tiny_sets_have_no_hull() {
        let flat: Vec<DVec3> = (0..30).map(|i| DVec3::new((i % 5) as f64, (i / 5) as f64, 1.0)).collect();
        assert!(convex_hull(&flat, 100, 0.0).is_none());
        assert!(convex_hull(&flat[..3], 100, 0.0).is_none());
        assert!(convex_hull(&[], 100, 0.0).is_none());
        assert!(convex_hull(&vec![DVec3::ONE; 9], 100, 0.0).is_none());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]
        #[test]
        fn every_point_is_inside_and_the_hull_is_closed(seed in 0u64..1000, grid in proptest::bool::ANY) {
            use rand::RngExt;
            let mut rng = sms_core::Seed(seed).rng();
            let points: Vec<DVec3> = (0..200)
                .map(|_| {
                    let p = DVec3::new(rng.random(), rng.random(), rng.random());
                    if grid { (p * 4.0).round() } else { p }
                })
                .collect();
            let hull = convex_hull(&points, usize::MAX, 0.0).unwrap();
            prop_assert!(hull.is_closed_oriented());
            for t in 0..hull.triangles.len() {
                let [a, b, c] = hull.corners(t);
                prop_assert!(points.iter().all(|&p| orient(a, b, c, p) <= 0.0));
            }
        }
    }
}
