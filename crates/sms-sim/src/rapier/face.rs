//! Faces of a convex hull, and the four corners that describe each of them to the engine.
#![allow(
    clippy::unnecessary_cast,
    reason = "`Real` is f32 in one instance of this file and f64 in the other"
)]

use super::engine::math::{Real, Vector};
use super::engine::parry::shape::{PackedFeatureId, PolygonalFeature};
use glamx::DVec3;

/// Vertices within this distance of a face's plane belong to the face, metres.
const FLAT: f64 = 2e-5;

/// A corner replaces the described corners if it is lower by this, metres. Rounding errors are a hundredth of this.
const LOWER: Real = 1e-6;

/// The plane of a face.
#[derive(Debug, Clone, Copy)]
pub(super) struct FacePlane {
    origin: DVec3,
    pub(super) normal: DVec3,
}

impl FacePlane {
    fn height(&self, p: DVec3) -> f64 {
        (p - self.origin).dot(self.normal)
    }
}

pub(super) fn from_engine(v: Vector) -> DVec3 {
    DVec3::new(v.x as f64, v.y as f64, v.z as f64)
}

pub(super) fn to_engine(v: DVec3) -> Vector {
    Vector::new(v.x as Real, v.y as Real, v.z as Real)
}

/// Returns the planes of the faces, starting with the largest triangle's, and the plane of each triangle (none for a
/// triangle without area on an edge). Parry joins triangles with normals up to 1.5° apart in single precision and uses
/// the normal of the first one. Such a normal on two sides of a board lets a heavy box sink through. Here a triangle
/// belongs to the face of a larger one if and only if it lies in its plane, regardless of its own rounded normal.
pub(super) fn planes(vertices: &[Vector], triangles: &[[u32; 3]]) -> (Vec<FacePlane>, Vec<Option<usize>>) {
    let corners: Vec<[DVec3; 3]> =
        triangles.iter().map(|t| t.map(|k| from_engine(vertices[k as usize]))).collect();
    let areas: Vec<DVec3> = corners.iter().map(|[a, b, c]| (b - a).cross(c - a)).collect();
    let mut order: Vec<usize> = (0..corners.len()).collect();
    order.sort_by(|&a, &b| areas[b].length_squared().total_cmp(&areas[a].length_squared()).then(a.cmp(&b)));
    let mut found: Vec<FacePlane> = Vec::new();
    let mut of = vec![None; corners.len()];
    for t in order {
        let lies_in = |plane: &FacePlane| {
            plane.normal.dot(areas[t]) >= 0.0 && corners[t].iter().all(|&p| plane.height(p).abs() <= FLAT)
        };
        of[t] = found.iter().position(lies_in);
        if of[t].is_none()
            && let Some(normal) = areas[t].try_normalize()
        {
            of[t] = Some(found.len());
            found.push(FacePlane { origin: corners[t][0], normal });
        }
    }
    (found, of)
}

/// The descriptions of a face.
#[derive(Debug, Clone)]
pub(super) struct HullFace {
    /// Description by the four corners that span the largest area.
    whole: PolygonalFeature,
    /// The corners, counter-clockwise around the normal. Each has the description by this corner, the next one, and the
    /// two others that span the largest area with them. Empty for at most four corners.
    sides: Vec<(Vector, PolygonalFeature)>,
}

impl HullFace {
    /// Returns the description with the lowest corner along `dir`.
    pub(super) fn toward(&self, dir: Vector) -> &PolygonalFeature {
        let height = |k: usize| self.sides[k % self.sides.len()].0.dot(dir);
        let described = &self.whole.vertices[..self.whole.num_vertices];
        let reached = described.iter().map(|v| v.dot(dir)).fold(Real::NEG_INFINITY, Real::max);
        let mut lowest: Option<(usize, Real)> = None;
        for k in 0..self.sides.len() {
            let h = height(k);
            if lowest.is_none_or(|(_, most)| h > most) {
                lowest = Some((k, h));
            }
        }
        match lowest {
            Some((k, most)) if most > reached + LOWER => {
                let before = (k + self.sides.len() - 1) % self.sides.len();
                let side = if height(before) > height(k + 1) { before } else { k };
                &self.sides[side].1
            }
            _ => &self.whole,
        }
    }

    /// Returns the description that contains a point of the face.
    pub(super) fn around(&self, point: Vector, normal: Vector) -> &PolygonalFeature {
        let outside = |a: Vector, b: Vector| (point - a).dot((b - a).cross(normal)) / (b - a).length();
        let n = self.whole.num_vertices;
        let v = &self.whole.vertices;
        if self.sides.is_empty() || (0..n).all(|k| outside(v[k], v[(k + 1) % n]) <= LOWER) {
            return &self.whole;
        }
        let mut nearest = (Real::NEG_INFINITY, 0);
        for k in 0..self.sides.len() {
            let d = outside(self.sides[k].0, self.sides[(k + 1) % self.sides.len()].0);
            if d > nearest.0 {
                nearest = (d, k);
            }
        }
        &self.sides[nearest.1].1
    }
}

/// Describes a face by the vertices in its plane, projected onto the plane.
pub(super) fn describe(vertices: &[Vector], id: u32, plane: &FacePlane) -> HullFace {
    let points = (0u32..).zip(vertices).map(|(k, p)| (k, from_engine(*p)));
    let in_plane = points.filter(|(_, p)| plane.height(*p).abs() <= FLAT);
    let mut corners: Vec<(u32, DVec3)> =
        in_plane.map(|(k, p)| (k, p - plane.normal * plane.height(p))).collect();
    let middle = corners.iter().fold(DVec3::ZERO, |sum, c| sum + c.1) / corners.len() as f64;
    let across = (plane.origin - middle).normalize_or(plane.normal.any_orthonormal_vector());
    let along = plane.normal.cross(across);
    let angle = |p: DVec3| (p - middle).dot(along).atan2((p - middle).dot(across));
    corners.sort_by(|a, b| angle(a.1).total_cmp(&angle(b.1)).then(a.0.cmp(&b.0)));
    let positions: Vec<DVec3> = corners.iter().map(|c| c.1).collect();
    let feature = |chosen: Vec<usize>| {
        let mut feature = PolygonalFeature::default();
        for (slot, &corner) in from_widest_corner(&positions, chosen).iter().enumerate() {
            feature.vertices[slot] = to_engine(positions[corner]);
            feature.vids[slot] = PackedFeatureId::vertex(corners[corner].0);
            // Edge ids only match contacts between steps.
            feature.eids[slot] = PackedFeatureId::edge(4 * id + slot as u32);
            feature.num_vertices = slot + 1;
        }
        feature.fid = PackedFeatureId::face(id);
        feature
    };
    let whole = feature(widest_four(&positions));
    let many = if positions.len() > 4 { positions.len() } else { 0 };
    let side = |k: usize| (to_engine(positions[k]), feature(widest_beside(&positions, k)));
    HullFace { whole, sides: (0..many).map(side).collect() }
}

/// Indices of up to four corners of a convex polygon that span the largest area, in order.
fn widest_four(corners: &[DVec3]) -> Vec<usize> {
    let n = corners.len();
    if n <= 4 {
        return (0..n).collect();
    }
    let mut widest: (f64, Vec<usize>) = (f64::NEG_INFINITY, Vec::new());
    for a in 0..n {
        for c in a + 1..n {
            let diagonal = corners[c] - corners[a];
            let far = |k: &usize| diagonal.cross(corners[*k] - corners[a]).length();
            let farthest = |side: &mut dyn Iterator<Item = usize>| {
                side.map(|k| (far(&k), k)).max_by(|p, q| p.0.total_cmp(&q.0).then(q.1.cmp(&p.1)))
            };
            let (b, d) = (farthest(&mut (a + 1..c)), farthest(&mut (c + 1..n).chain(0..a)));
            let area = b.map_or(0.0, |b| b.0) + d.map_or(0.0, |d| d.0);
            if area > widest.0 {
                let chosen = [Some(a), b.map(|b| b.1), Some(c), d.map(|d| d.1)];
                widest = (area, chosen.into_iter().flatten().collect());
            }
        }
    }
    widest.1
}

/// Indices of the `k`-th side of a convex polygon of more than four corners, and of the two other corners that span the
/// largest area with it, in order.
fn widest_beside(corners: &[DVec3], k: usize) -> Vec<usize> {
    let n = corners.len();
    let at = |i: usize| corners[(k + i) % n];
    let mut widest = (f64::NEG_INFINITY, 2, 3);
    for b in 2..n {
        for d in b + 1..n {
            let area = (at(b) - at(0)).cross(at(d) - at(1)).length();
            if area > widest.0 {
                widest = (area, b, d);
            }
        }
    }
    [0, 1, widest.1, widest.2].map(|i| (k + i) % n).to_vec()
}

/// Rotates the corners so that the second one forms the largest triangle with its neighbours. Parry derives the plane
/// of a description from this triangle; with a corner between collinear neighbours, rounding errors would determine the
/// plane. Returns the ends of a polygon less than [`FLAT`] across.
fn from_widest_corner(corners: &[DVec3], chosen: Vec<usize>) -> Vec<usize> {
    let n = chosen.len();
    if n < 3 {
        return chosen;
    }
    let at = |k: usize| corners[chosen[k % n]];
    let area = |k: usize| (at(k + 2) - at(k + 1)).cross(at(k) - at(k + 1)).length();
    let mut first = 0;
    for k in 1..n {
        if area(k) > area(first) {
            first = k;
        }
    }
    let pairs = (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j)));
    let length = |&(i, j): &(usize, usize)| (at(j) - at(i)).length();
    let longest = pairs.max_by(|p, q| length(p).total_cmp(&length(q)));
    match longest {
        Some(ends) if area(first) < FLAT * length(&ends) => vec![chosen[ends.0], chosen[ends.1]],
        _ => (0..n).map(|k| chosen[(first + k) % n]).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_round_base_is_described_by_a_square_across_it() {
        let arc = |turn: f64| -> Vec<DVec3> {
            let angle = |i: i32| f64::from(i) * turn / 24.0;
            (0..24).map(|i| DVec3::new(angle(i).cos(), angle(i).sin(), 0.0)).collect()
        };
        let spanned = |arc: &[DVec3]| {
            let chosen = widest_four(arc);
            let cross = |i: usize| arc[chosen[i]].cross(arc[chosen[(i + 1) % chosen.len()]]).z / 2.0;
            (0..chosen.len()).map(cross).sum::<f64>()
        };
        assert!((spanned(&arc(std::f64::consts::TAU)) - 2.0).abs() < 1e-9);
        // A half disc: its diameter is one of its sides. The largest quadrilateral in it is half a hexagon.
        let mut half = arc(std::f64::consts::PI);
        half.push(DVec3::NEG_X);
        assert!((spanned(&half) - 0.75 * 3.0f64.sqrt()).abs() < 1e-9, "{}", spanned(&half));
    }
}
