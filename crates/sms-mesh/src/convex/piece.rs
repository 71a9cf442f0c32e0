//! Pieces of a surface, cut by planes without closing the cuts.
//!
//! The hull of a cut surface is nearly the hull of the cut solid, because the outline of a cut lies on both. Only the
//! corners where cuts meet inside the solid are missing. Pieces therefore keep, besides their surface, the *spines*:
//! the lines along which two cuts meet, as far as they run inside the solid. Volumes need the caps
//! ([`crate::convex::cap`]).

use crate::convex::cap::{Cap, Edge, between, side_of, tidy};
use crate::convex::sweep::GrowingHull;
use crate::plane::Plane;
use glamx::{DMat3, DVec3};

/// Hulls of parts leave out points that protrude less than this, in half sizes of the object.
pub(crate) const SLIGHT: f64 = 2e-4;

/// A piece of the object's surface, in unit coordinates.
#[derive(Clone, Default)]
pub(crate) struct Piece {
    pub(crate) points: Vec<DVec3>,
    pub(crate) triangles: Vec<[u32; 3]>,
    /// Caps that close the cuts, for volumes and inner corners.
    pub(crate) caps: Vec<Cap>,
    /// Lines inside the solid along which two cuts meet.
    pub(crate) spines: Vec<[u32; 2]>,
    /// Half-spaces that contain the piece.
    pub(crate) cell: Vec<Plane>,
}

impl Piece {
    /// Signed volume of the closed piece.
    pub(crate) fn volume(&self) -> f64 {
        let surface: f64 = self.triangles.iter().map(|t| six_volume(self.corners(t))).sum();
        let caps: f64 = self.caps.iter().map(Cap::six_volume).sum();
        (surface + caps) / 6.0
    }

    /// Returns the number of points, faces and edges to process.
    pub(crate) fn size(&self) -> u64 {
        let caps: usize = self.caps.iter().map(|c| c.edges.len()).sum();
        (self.points.len() + 3 * self.triangles.len() + self.spines.len() + caps) as u64
    }

    /// Returns the area of the largest side of the bounding box.
    pub(crate) fn widest_side(&self) -> f64 {
        let extents =
            sms_core::Aabb::of_points(self.points.iter().copied()).map_or(DVec3::ZERO, |b| b.extents());
        (extents.x * extents.y).max(extents.y * extents.z).max(extents.z * extents.x)
    }

    pub(crate) fn corners(&self, t: &[u32; 3]) -> [DVec3; 3] {
        t.map(|i| self.points[i as usize])
    }

    /// Returns the middle of each face, and its normal with a length of twice the area.
    pub(crate) fn faces(&self) -> impl Iterator<Item = (DVec3, DVec3)> {
        self.triangles.iter().map(move |t| {
            let [a, b, c] = self.corners(t);
            ((a + b + c) / 3.0, (b - a).cross(c - a))
        })
    }

    /// Returns the volume of the hull of all points. The hull remains in `hull`.
    pub(crate) fn hull_volume(&self, hull: &mut GrowingHull) -> f64 {
        hull.refill(SLIGHT, &self.points)
    }

    /// Returns the edges, each once, as pairs of points.
    pub(crate) fn edges(&self) -> Vec<(u32, u32)> {
        let of_faces = self.triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
        let all = of_faces.chain(self.spines.iter().copied());
        let mut edges: Vec<(u32, u32)> = all.map(|[a, b]| (a.min(b), a.max(b))).collect();
        edges.sort_unstable();
        edges.dedup();
        edges
    }

    /// Returns the axes of the surface's second moments, by ascending variance.
    pub(crate) fn axes(&self) -> [DVec3; 3] {
        let (mut weight, mut mean, mut moments) = (0.0, DVec3::ZERO, DMat3::ZERO);
        for t in &self.triangles {
            let [a, b, c] = self.corners(t);
            let area = (b - a).cross(c - a).length();
            let p = (a + b + c) / 3.0;
            weight += area;
            mean += p * area;
            moments += outer(p) * area + (outer(a - p) + outer(b - p) + outer(c - p)) * (area / 12.0);
        }
        if weight <= 0.0 {
            return DVec3::AXES;
        }
        mean /= weight;
        let eigen = glamx::DSymmetricEigen3::new(moments * (1.0 / weight) - outer(mean));
        let axes = [eigen.eigenvectors.x_axis, eigen.eigenvectors.y_axis, eigen.eigenvectors.z_axis];
        if axes.iter().all(|a| a.is_finite() && (a.length() - 1.0).abs() < 1e-3) { axes } else { DVec3::AXES }
    }

    /// Returns the sides below and above a plane. Points within a hair of the plane belong to both.
    pub(crate) fn split(&self, plane: Plane, with_caps: bool, inside: &impl Fn(DVec3) -> bool) -> [Piece; 2] {
        let side: Vec<i8> = self.points.iter().map(|&p| side_of(plane, p)).collect();
        let mut out = [PieceSide::new(self), PieceSide::new(self)];
        let mut cuts = Cuts::default();
        // Boundary of the lower side in the plane.
        let mut outline: Vec<Edge> = Vec::new();
        for t in &self.triangles {
            let s = t.map(|i| side[i as usize]);
            let (low, high) = (s.iter().any(|&s| s < 0), s.iter().any(|&s| s > 0));
            let [a, b, c] = self.corners(t);
            // The material of a face in the plane lies below if the face points up.
            let faces_up = || (b - a).cross(c - a).dot(plane.normal) > 0.0;
            match (low, high) {
                (true, true) => {
                    for k in 0..3 {
                        let (i, j) = (t[k], t[(k + 1) % 3]);
                        let (si, sj) = (s[k], s[(k + 1) % 3]);
                        for (which, keep) in [(0usize, si <= 0), (1, si >= 0)] {
                            if keep {
                                out[which].corner(self, i);
                            }
                        }
                        if si * sj < 0 {
                            let p = cuts.point(self, plane, i, j);
                            out[0].cut_corner(p, &cuts);
                            out[1].cut_corner(p, &cuts);
                        }
                    }
                    out[0].close_polygon();
                    out[1].close_polygon();
                }
                (true, false) => out[0].triangle(self, *t),
                (false, false) if faces_up() => {
                    out[0].triangle(self, *t);
                    if with_caps {
                        outline.extend([[a, b], [b, c], [c, a]].map(Edge::of_surface));
                    }
                }
                (false, _) => out[1].triangle(self, *t),
            }
            if with_caps {
                outline.extend(crossing([a, b, c], s, plane).map(Edge::of_surface));
            }
        }
        for &[i, j] in &self.spines {
            let s = side[i as usize] * side[j as usize];
            for (which, sign) in [(0usize, -1i8), (1, 1)] {
                for k in [i, j] {
                    if side[k as usize] * sign >= 0 {
                        out[which].corner(self, k);
                    }
                }
                if s < 0 {
                    let p = cuts.point(self, plane, i, j);
                    out[which].cut_corner(p, &cuts);
                }
                out[which].close_spine();
            }
        }
        let mut sides = out.map(|s| s.piece);
        for [a, b] in self.new_spines(plane, if with_caps { 0.03 } else { 0.1 }, inside) {
            for s in &mut sides {
                let n = s.points.len() as u32;
                s.points.extend([a, b]);
                s.spines.push([n, n + 1]);
            }
        }
        for (s, sign) in sides.iter_mut().zip([1.0, -1.0]) {
            s.cell.clone_from(&self.cell);
            s.cell.push(Plane { normal: plane.normal * sign, offset: plane.offset * sign });
        }
        if with_caps {
            let [below, above] = &mut sides;
            for cap in &self.caps {
                cap.split(plane, [&mut below.caps, &mut above.caps], &mut outline);
            }
            let mut outline = tidy(outline);
            if !outline.is_empty() {
                above.caps.push(Cap { normal: -plane.normal, edges: outline.clone() });
                outline.iter_mut().for_each(|e| e.weight = -e.weight);
                below.caps.push(Cap { normal: plane.normal, edges: outline });
            }
        }
        sides
    }

    /// Returns the lines where the plane meets earlier cuts inside the cell and the solid.
    fn new_spines(&self, plane: Plane, step: f64, inside: &impl Fn(DVec3) -> bool) -> Vec<[DVec3; 2]> {
        let mut out = Vec::new();
        let Some(bounds) = sms_core::Aabb::of_points(self.points.iter().copied()) else { return out };
        for (k, other) in self.cell.iter().enumerate() {
            let along = plane.normal.cross(other.normal);
            let sin2 = along.length_squared();
            if sin2 < 1e-4 {
                continue;
            }
            let foot =
                (other.normal.cross(along) * plane.offset + along.cross(plane.normal) * other.offset) / sin2;
            let along = along / sin2.sqrt();
            // Clip the line to the piece's box.
            let (mut from, mut to) = (-4.0f64, 4.0f64);
            for axis in 0..3 {
                let (a, b) = (bounds.min[axis] - foot[axis], bounds.max[axis] - foot[axis]);
                if along[axis].abs() > 1e-9 {
                    let (a, b) = (a / along[axis], b / along[axis]);
                    (from, to) = (from.max(a.min(b)), to.min(a.max(b)));
                } else if a > 1e-6 || b < -1e-6 {
                    to = from - 1.0;
                }
            }
            for (m, bound) in self.cell.iter().enumerate() {
                if m == k {
                    continue;
                }
                let (rise, rest) = (bound.normal.dot(along), -bound.height(foot));
                if rise.abs() < 1e-9 {
                    if rest < 0.0 {
                        to = from - 1.0;
                    }
                } else if rise > 0.0 {
                    to = to.min(rest / rise);
                } else {
                    from = from.max(rest / rise);
                }
            }
            if to - from < 1e-3 {
                continue;
            }
            let samples = ((to - from) / step) as usize + 4;
            let at = |i: usize| foot + along * (from + (to - from) * i as f64 / (samples - 1) as f64);
            // Between a sample inside and one outside: the last point inside.
            let edge = |mut within: DVec3, mut beyond: DVec3| {
                for _ in 0..5 {
                    let middle = within.midpoint(beyond);
                    *(if inside(middle) { &mut within } else { &mut beyond }) = middle;
                }
                within
            };
            let mut start: Option<DVec3> = None;
            let (mut last, mut before) = (DVec3::ZERO, None);
            for i in 0..samples {
                let p = at(i);
                if inside(p) {
                    if start.is_none() {
                        start = Some(before.map_or(p, |q| edge(p, q)));
                    }
                    last = p;
                } else if let Some(s) = start.take() {
                    out.push([s, edge(last, p)]);
                }
                before = Some(p);
            }
            out.extend(start.map(|s| [s, last]));
        }
        out
    }
}

pub(crate) fn six_volume([a, b, c]: [DVec3; 3]) -> f64 {
    a.dot(b.cross(c))
}

fn outer(v: DVec3) -> DMat3 {
    DMat3::from_cols(v * v.x, v * v.y, v * v.z)
}

/// Returns the boundary that the lower side of a triangle gains on the plane, oriented like the triangle.
fn crossing(t: [DVec3; 3], s: [i8; 3], plane: Plane) -> Option<[DVec3; 2]> {
    // Walking along the corners, the boundary leaves the lower side at `from` and enters it again at `to`.
    let (mut from, mut to) = (None, None);
    for k in 0..3 {
        let (a, b, sa, sb) = (t[k], t[(k + 1) % 3], s[k], s[(k + 1) % 3]);
        match (sa, sb) {
            (-1, 1) => from = Some(between(a, b, plane)),
            (1, -1) => to = Some(between(a, b, plane)),
            (-1, 0) => from = Some(b),
            (0, -1) => to = Some(a),
            _ => {}
        }
    }
    Some([from?, to?]).filter(|[from, to]| from != to)
}

/// Points where edges cross the plane, one per edge.
#[derive(Default)]
struct Cuts {
    known: std::collections::BTreeMap<(u32, u32), u32>,
    points: Vec<DVec3>,
}

impl Cuts {
    fn point(&mut self, piece: &Piece, plane: Plane, i: u32, j: u32) -> u32 {
        let key = (i.min(j), i.max(j));
        *self.known.entry(key).or_insert_with(|| {
            self.points.push(between(piece.points[key.0 as usize], piece.points[key.1 as usize], plane));
            self.points.len() as u32 - 1
        })
    }
}

/// One side during construction.
#[derive(Default)]
struct PieceSide {
    piece: Piece,
    old: Vec<u32>,
    new: Vec<u32>,
    polygon: Vec<u32>,
}

impl PieceSide {
    fn new(whole: &Piece) -> Self {
        Self { old: vec![u32::MAX; whole.points.len()], ..Self::default() }
    }

    fn point(&mut self, whole: &Piece, i: u32) -> u32 {
        let slot = &mut self.old[i as usize];
        if *slot == u32::MAX {
            *slot = self.piece.points.len() as u32;
            self.piece.points.push(whole.points[i as usize]);
        }
        *slot
    }

    fn triangle(&mut self, whole: &Piece, t: [u32; 3]) {
        let t = t.map(|i| self.point(whole, i));
        self.piece.triangles.push(t);
    }

    fn corner(&mut self, whole: &Piece, i: u32) {
        let id = self.point(whole, i);
        self.polygon.push(id);
    }

    fn cut_corner(&mut self, cut: u32, cuts: &Cuts) {
        if self.new.len() <= cut as usize {
            self.new.resize(cut as usize + 1, u32::MAX);
        }
        if self.new[cut as usize] == u32::MAX {
            self.new[cut as usize] = self.piece.points.len() as u32;
            self.piece.points.push(cuts.points[cut as usize]);
        }
        self.polygon.push(self.new[cut as usize]);
    }

    fn close_spine(&mut self) {
        if let [a, b] = self.polygon[..]
            && a != b
        {
            self.piece.spines.push([a, b]);
        }
        self.polygon.clear();
    }

    fn close_polygon(&mut self) {
        for k in 1..self.polygon.len().saturating_sub(1) {
            self.piece.triangles.push([self.polygon[0], self.polygon[k], self.polygon[k + 1]]);
        }
        self.polygon.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::RngExt;
    use sms_core::Mesh;

    fn piece_of(mesh: &Mesh) -> Piece {
        Piece { points: mesh.vertices.clone(), triangles: mesh.triangles.clone(), ..Piece::default() }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]
        #[test]
        fn volumes_of_repeated_cuts_add_up(seed in 0u64..10_000, aligned in proptest::bool::ANY) {
            let mut rng = sms_core::Seed(seed).rng();
            // An inverted ball in a box makes a hollow box, so that outlines are nested.
            let mut mesh = Mesh::cuboid(DVec3::splat(1.0));
            let hole = Mesh::icosphere(0.7, 2);
            let n = mesh.vertices.len() as u32;
            mesh.vertices.extend(&hole.vertices);
            mesh.triangles.extend(hole.triangles.iter().map(|&[a, b, c]| [a + n, c + n, b + n]));
            let mut pieces = vec![piece_of(&mesh)];
            let inside = |p: DVec3| p.abs().max_element() <= 1.0 && p.length() >= 0.7;
            for _ in 0..6 {
                let mut normal =
                    DVec3::new(rng.random(), rng.random(), rng.random()) * 2.0 - DVec3::splat(1.0);
                if aligned {
                    normal = [DVec3::X, DVec3::Y, DVec3::Z][rng.random_range(0..3)];
                }
                let offset = if aligned { [0.0, 0.3, 1.0][rng.random_range(0..3)] } else { 0.3 * rng.random::<f64>() };
                let plane = Plane { normal: normal.normalize_or(DVec3::X), offset };
                pieces = pieces.iter().flat_map(|p| p.split(plane, true, &inside)).collect();
            }
            // The number of a cap's edges does not grow with every cut.
            let edges: usize = pieces.iter().flat_map(|p| &p.caps).map(|c| c.edges.len()).sum();
            let faces: usize = pieces.iter().map(|p| p.triangles.len()).sum();
            prop_assert!(edges < 2 * faces, "{edges} {faces}");
            let sum: f64 = pieces.iter().map(Piece::volume).sum();
            prop_assert!((sum - mesh.volume()).abs() < 1e-7, "{sum} {}", mesh.volume());
            let mut hull = GrowingHull::default();
            for p in &pieces {
                let (v, h) = (p.volume(), p.hull_volume(&mut hull));
                prop_assert!(v > -1e-7 && v < h + 1e-5, "{v} {h}");
            }
        }
    }
}
