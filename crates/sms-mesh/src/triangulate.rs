//! An open triangle mesh through oriented points of a surface, by local Delaunay triangulations (Gopi, Krishnan and Silva,
//! "Surface reconstruction based on lower dimensional localized Delaunay triangulation", Eurographics 2000).
//!
//! Each point is triangulated with its neighbours in its own tangent plane. Points whose normals differ by more than
//! [`LEAST_ALIKE`] are no neighbours, so the two faces of a wall stay apart however thin it is. The triangles that most of their
//! corners agree on become the mesh.

use crate::point_grid::PointGrid;
use crate::statistics::median;
use glamx::{DVec2, DVec3};
use rayon::prelude::*;
use std::collections::HashSet;

/// Least cosine between the normals of neighbours: right angles are closed.
const LEAST_ALIKE: f64 = -0.05;
/// Largest slope from a point to a neighbour against its tangent plane: steeper ones are of another layer.
const STEEPEST: f64 = 2.0;
/// Largest circumradius of a triangle as a multiple of the sampling distance of its corners. On a sampled surface, no circle without
/// points is wider than that distance; slopes against the tangent plane and noise make some wider.
const WIDEST: f64 = 1.5;

/// Returns triangles of an open mesh through `points` with unit `normals`, which face free space. `spacings` are the largest
/// distances from places of the surface around each point to their nearest one. Triangles face free space, and no directed edge
/// belongs to two of them. The mesh ends where points are farther apart than their spacings tell, and at creases sharper than a right angle.
///
/// # Panics
/// If the slices are not equally long.
pub fn triangulate(points: &[DVec3], normals: &[DVec3], spacings: &[f64]) -> Vec<[u32; 3]> {
    assert!(points.len() == normals.len() && points.len() == spacings.len(), "one normal and spacing each");
    let grid = PointGrid::new(points, median(spacings.to_vec()));
    let mut proposed: Vec<Proposal> = (0..points.len())
        .into_par_iter()
        .with_min_len(64)
        .flat_map_iter(|i| star(i, points, normals, spacings, &grid))
        .collect();
    proposed.par_sort_unstable_by(|p, q| p.corners.cmp(&q.corners).then(p.radius.total_cmp(&q.radius)));
    let mut candidates: Vec<(u8, Proposal)> = Vec::new();
    for p in proposed {
        match candidates.last_mut() {
            Some((votes, last)) if last.corners == p.corners => *votes += 1,
            _ => candidates.push((1, p)),
        }
    }
    candidates.sort_by(|(a, p), (b, q)| {
        b.cmp(a).then(p.radius.total_cmp(&q.radius)).then(p.corners.cmp(&q.corners))
    });
    let agreed = candidates.partition_point(|(votes, _)| *votes > 1);
    let mut sheet = Sheet::new(points, normals);
    for (_, p) in &candidates[..agreed] {
        sheet.add(p.corners);
    }
    // Triangles of one corner only close gaps: they share two edges with others.
    let mut left: Vec<[u32; 3]> = candidates[agreed..].iter().map(|(_, p)| p.corners).collect();
    loop {
        let before = left.len();
        left.retain(|&corners| !(sheet.shared_edges(corners) > 1 && sheet.add(corners)));
        if left.len() == before {
            break;
        }
    }
    sheet.triangles
}

/// A triangle that one of its corners proposes.
#[derive(Clone, Copy)]
struct Proposal {
    /// Corners in ascending order.
    corners: [u32; 3],
    /// Circumradius in the tangent plane of the corner, metres.
    radius: f64,
}

/// Returns the triangles of the Delaunay triangulation of point `i` and its neighbours in its tangent plane.
fn star(
    i: usize,
    points: &[DVec3],
    normals: &[DVec3],
    spacings: &[f64],
    grid: &PointGrid<'_>,
) -> Vec<Proposal> {
    let (p, n) = (points[i], normals[i]);
    let x_axis = n.any_orthonormal_vector();
    let y_axis = n.cross(x_axis);
    let reach = 2.0 * WIDEST * spacings[i];
    let mut neighbors: Vec<(u32, DVec2)> = Vec::new();
    grid.for_each_within(p, reach, |j, _| {
        let off = points[j] - p;
        let flat = DVec2::new(off.dot(x_axis), off.dot(y_axis));
        let is_other_layer = off.dot(n).abs() > STEEPEST * flat.length();
        if j != i && flat != DVec2::ZERO && normals[j].dot(n) > LEAST_ALIKE && !is_other_layer {
            neighbors.push((j as u32, flat));
        }
    });
    neighbors.sort_by(|a, b| a.1.length_squared().total_cmp(&b.1.length_squared()).then(a.0.cmp(&b.0)));
    let cell = voronoi_cell(&neighbors, 0.5 * reach);
    let mut found = Vec::new();
    for k in 0..cell.len() {
        let (corner, a) = cell[k];
        let (_, b) = cell[(k + 1) % cell.len()];
        let (Some(a), Some(b)) = (a, b) else { continue };
        let (a, b) = (neighbors[a].0, neighbors[b].0);
        let sampled = [i as u32, a, b].iter().map(|&v| spacings[v as usize]).fold(0.0, f64::max);
        let radius = corner.length();
        // Wider circles may hold points that are no neighbours.
        if a != b && radius <= (WIDEST * sampled).min(0.5 * reach) {
            let mut corners = [i as u32, a, b];
            corners.sort_unstable();
            found.push(Proposal { corners, radius });
        }
    }
    found
}

/// Returns the Voronoi cell of the origin among `neighbors`, nearest first, within a square of half-width `half`: its corners
/// anticlockwise, each with the neighbour whose edge ends there (the next one begins with that of the following corner); `None` for a
/// side of the square.
fn voronoi_cell(neighbors: &[(u32, DVec2)], half: f64) -> Vec<(DVec2, Option<usize>)> {
    let square = [(1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)];
    let mut cell: Vec<(DVec2, Option<usize>)> =
        square.iter().map(|&(x, y)| (DVec2::new(x, y) * half, None)).collect();
    let mut next = Vec::new();
    for (k, (_, q)) in neighbors.iter().enumerate() {
        let (length, limit) = (q.length_squared(), 0.5 * q.length_squared());
        let farthest = cell.iter().map(|(c, _)| c.length_squared()).fold(0.0, f64::max);
        if length > 4.0 * farthest {
            break;
        }
        // Corner c belongs to the edge that ends in it.
        next.clear();
        for at in 0..cell.len() {
            let (c, edge) = cell[at];
            let (d, next_edge) = cell[(at + 1) % cell.len()];
            let (over_c, over_d) = (c.dot(*q) - limit, d.dot(*q) - limit);
            if over_c <= 0.0 {
                next.push((c, edge));
            }
            if (over_c <= 0.0) != (over_d <= 0.0) {
                let meets = c + (d - c) * (over_c / (over_c - over_d));
                // Leaving the half plane, the old edge ends here; entering it, the new one does.
                next.push((meets, if over_c <= 0.0 { next_edge } else { Some(k) }));
            }
        }
        std::mem::swap(&mut cell, &mut next);
        if cell.len() < 3 {
            return Vec::new();
        }
    }
    cell
}

/// The triangles chosen so far.
struct Sheet<'a> {
    points: &'a [DVec3],
    normals: &'a [DVec3],
    triangles: Vec<[u32; 3]>,
    /// Directed edges of the triangles.
    edges: HashSet<(u32, u32)>,
}

impl<'a> Sheet<'a> {
    fn new(points: &'a [DVec3], normals: &'a [DVec3]) -> Self {
        Self { points, normals, triangles: Vec::new(), edges: HashSet::new() }
    }

    /// Returns the corners in the order in which the triangle faces its normals.
    fn facing(&self, [a, b, c]: [u32; 3]) -> [u32; 3] {
        let [p, q, r] = [a, b, c].map(|v| self.points[v as usize]);
        let n: DVec3 = [a, b, c].iter().map(|&v| self.normals[v as usize]).sum();
        if (q - p).cross(r - p).dot(n) < 0.0 { [a, c, b] } else { [a, b, c] }
    }

    /// Returns the number of edges that other triangles have in the opposite direction.
    fn shared_edges(&self, corners: [u32; 3]) -> usize {
        let [a, b, c] = self.facing(corners);
        [(b, a), (c, b), (a, c)].iter().filter(|edge| self.edges.contains(edge)).count()
    }

    /// Adds a triangle unless one of its directed edges is taken; returns whether it was added.
    fn add(&mut self, corners: [u32; 3]) -> bool {
        let [a, b, c] = self.facing(corners);
        let edges = [(a, b), (b, c), (c, a)];
        if edges.iter().any(|edge| self.edges.contains(edge)) {
            return false;
        }
        self.edges.extend(edges);
        self.triangles.push([a, b, c]);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::thin;
    use proptest::prelude::*;
    use rand::RngExt;
    use sms_core::{Mesh, Seed};
    use std::f64::consts::PI;

    /// Distance between the points of these tests, metres.
    const SPACING_M: f64 = 0.01;

    /// Random points of a surface, at least [`SPACING_M`] apart, and so many that no further one fits.
    fn packed(count: usize, mut point: impl FnMut() -> (DVec3, DVec3)) -> (Vec<DVec3>, Vec<DVec3>) {
        let (points, normals): (Vec<DVec3>, Vec<DVec3>) = (0..count).map(|_| point()).unzip();
        let kept = thin(&points, &normals, SPACING_M);
        (kept.iter().map(|&i| points[i]).collect(), kept.iter().map(|&i| normals[i]).collect())
    }

    /// A square of side 0.3 m at the height, that faces up or down.
    fn square(z: f64, faces_up: bool, seed: u64) -> (Vec<DVec3>, Vec<DVec3>) {
        let mut rng = Seed(seed).rng();
        let normal = if faces_up { DVec3::Z } else { DVec3::NEG_Z };
        packed(60_000, || (DVec3::new(rng.random_range(0.0..0.3), rng.random_range(0.0..0.3), z), normal))
    }

    fn meshed((points, normals): &(Vec<DVec3>, Vec<DVec3>)) -> Mesh {
        Mesh::new(points.clone(), triangulate(points, normals, &vec![SPACING_M; points.len()]))
    }

    /// Numbers of edges with one triangle and with two.
    fn edges(mesh: &Mesh) -> (usize, usize) {
        let directed: HashSet<(u32, u32)> =
            mesh.triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]).collect();
        assert_eq!(directed.len(), 3 * mesh.triangles.len(), "every directed edge has one triangle");
        let shared = directed.iter().filter(|(a, b)| directed.contains(&(*b, *a))).count();
        (directed.len() - shared, shared / 2)
    }

    #[test]
    fn a_flat_square_is_covered_once_and_open_only_at_its_border() {
        let mesh = meshed(&square(0.2, true, 1));
        let covered = mesh.area() / 0.09;
        assert!((0.93..1.0001).contains(&covered), "{covered}");
        edges(&mesh);
        let border = |v: u32| {
            let p = mesh.vertices[v as usize];
            p.x.min(p.y).min(0.3 - p.x).min(0.3 - p.y) < 2.5 * SPACING_M
        };
        let directed: HashSet<(u32, u32)> =
            mesh.triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]).collect();
        assert!(directed.iter().filter(|(a, b)| !directed.contains(&(*b, *a))).all(|&(a, _)| border(a)));
        assert!((0..mesh.triangles.len()).all(|t| {
            let [a, b, c] = mesh.corners(t);
            (b - a).cross(c - a).z > 0.0
        }));
    }

    #[test]
    fn a_ball_is_nearly_closed_and_has_its_area() {
        let mut rng = Seed(2).rng();
        let ball = packed(80_000, || {
            let p = DVec3::from_array([0; 3].map(|_| rng.random_range(-1.0..1.0f64)));
            (p.normalize_or_zero() * 0.1, p.normalize_or(DVec3::Z))
        });
        let mesh = meshed(&ball);
        let (open, shared) = edges(&mesh);
        assert!(100 * open < shared, "{open} {shared}");
        let area = mesh.area() / (4.0 * PI * 0.01);
        assert!((0.985..1.001).contains(&area), "{area}");
    }

    #[test]
    fn a_box_is_nearly_closed_across_its_edges() {
        let mut rng = Seed(6).rng();
        let cuboid = packed(120_000, || {
            let (axis, sign) = (rng.random_range(0..3), if rng.random::<bool>() { 1.0 } else { -1.0 });
            let mut p = DVec3::from_array([0; 3].map(|_| rng.random_range(-0.1..0.1)));
            p[axis] = 0.1 * sign;
            (p, DVec3::AXES[axis] * sign)
        });
        let mesh = meshed(&cuboid);
        let (open, shared) = edges(&mesh);
        assert!(20 * open < shared, "{open} {shared}");
        let area = mesh.area() / 0.24;
        assert!((0.95..1.01).contains(&area), "{area}");
    }

    #[test]
    fn the_faces_of_a_wall_thinner_than_the_sampling_stay_apart() {
        let (front, back) = (square(0.001, true, 3), square(0.0, false, 4));
        let both = ([front.0.clone(), back.0.clone()].concat(), [front.1.clone(), back.1.clone()].concat());
        let mesh = meshed(&both);
        assert!((0..mesh.triangles.len()).all(|t| {
            let [a, b, c] = mesh.corners(t);
            a.z == b.z && b.z == c.z
        }));
        assert_eq!(mesh.triangles.len(), meshed(&front).triangles.len() + meshed(&back).triangles.len());
    }

    #[test]
    fn gaps_wider_than_the_sampling_stay_open() {
        let (points, normals) = square(0.0, true, 5);
        let outside = |p: &DVec3| p.truncate().distance(glamx::DVec2::splat(0.15)) > 0.05;
        let (points, normals): (Vec<_>, Vec<_>) =
            points.into_iter().zip(normals).filter(|(p, _)| outside(p)).unzip();
        let mesh = meshed(&(points, normals));
        let covered = mesh.area() / (0.09 - PI * 0.0025);
        assert!((0.93..1.02).contains(&covered), "{covered}");
    }

    proptest! {
        #[test]
        fn any_points_give_triangles_with_edges_of_their_own(
            points in proptest::collection::vec(proptest::array::uniform3(-0.02..0.02f64), 0..60),
            repeated in any::<bool>(),
        ) {
            let mut points: Vec<DVec3> = points.into_iter().map(DVec3::from_array).collect();
            if repeated {
                points.extend(points.clone());
            }
            let normals: Vec<DVec3> = points.iter().map(|p| p.normalize_or(DVec3::Z)).collect();
            let triangles = triangulate(&points, &normals, &vec![0.01; points.len()]);
            edges(&Mesh::new(points, triangles));
        }
    }
}
