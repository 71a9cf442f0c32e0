//! Convex hulls that stand on their flat faces.
//!
//! Parry describes the face of a convex polyhedron by its first four vertices. Of a round or many-cornered base these
//! are neighbours, a sliver at its rim: a body that stands on such a base tips over the sliver. This shape is the same
//! polyhedron, but describes each face by the four of its vertices that span the largest area.
#![allow(
    clippy::unnecessary_cast,
    reason = "`Real` is f32 in one instance of this file and f64 in the other"
)]

use super::engine::math::{Pose, Real, Vector};
use super::engine::parry::bounding_volume::{Aabb, BoundingSphere};
use super::engine::parry::mass_properties::MassProperties;
use super::engine::parry::query::{PointProjection, PointQuery, Ray, RayCast, RayIntersection};
use super::engine::parry::shape::{
    ConvexPolyhedron, FeatureId, PackedFeatureId, PolygonalFeature, PolygonalFeatureMap, Shape, ShapeType,
    SubShapeId, SupportMap, TypedShape,
};

/// Vertices this near to a face's plane, metres, belong to the face.
const FLAT: f64 = 2e-5;

/// A convex polyhedron whose faces are described by their best four vertices.
#[derive(Debug, Clone)]
pub(super) struct StableHull {
    hull: ConvexPolyhedron,
    /// Normal and description of each face.
    faces: Vec<(Vector, PolygonalFeature)>,
}

impl StableHull {
    /// The convex hull of points; `None` where they enclose no volume.
    pub(super) fn new(points: &[Vector]) -> Option<Self> {
        let hull = ConvexPolyhedron::from_convex_hull(points)?;
        let faces =
            hull.faces().iter().enumerate().map(|(id, face)| (face.normal, describe(&hull, id))).collect();
        Some(Self { hull, faces })
    }
}

/// The description of a face: the widest four of the vertices that lie in its plane. Parry's own list of a face's
/// vertices is not enough: rounding splits flat bases into several faces that are a hair apart.
fn describe(hull: &ConvexPolyhedron, id: usize) -> PolygonalFeature {
    let face = &hull.faces()[id];
    let first = face.first_vertex_or_edge as usize;
    let listed = face.num_vertices_or_edges as usize;
    let origin = hull.points()[hull.vertices_adj_to_face()[first] as usize];
    let in_plane = |p: &Vector| (*p - origin).dot(face.normal).abs() <= FLAT as Real;
    let mut corners: Vec<(u32, Vector)> =
        (0u32..).zip(hull.points().iter().copied()).filter(|(_, p)| in_plane(p)).collect();
    let middle = corners.iter().fold(Vector::ZERO, |sum, c| sum + c.1) / corners.len() as Real;
    let across = (origin - middle).normalize_or(face.normal.any_orthonormal_vector());
    let along = face.normal.cross(across);
    let angle = |p: Vector| (p - middle).dot(along).atan2((p - middle).dot(across));
    corners.sort_by(|a, b| angle(a.1).total_cmp(&angle(b.1)).then(a.0.cmp(&b.0)));
    let positions: Vec<Vector> = corners.iter().map(|c| c.1).collect();
    let mut feature = PolygonalFeature::default();
    for (slot, &corner) in widest_four(&positions).iter().enumerate() {
        feature.vertices[slot] = positions[corner];
        feature.vids[slot] = PackedFeatureId::vertex(corners[corner].0);
        // Edge ids only tell contacts of one step from those of the next.
        feature.eids[slot] = PackedFeatureId::edge(hull.edges_adj_to_face()[first + slot % listed]);
        feature.num_vertices = slot + 1;
    }
    feature.fid = PackedFeatureId::face(id as u32);
    feature
}

/// Indices, in order, of up to four corners of a convex polygon that span (nearly) the largest area: its diameter and
/// the corners farthest from it on either side.
fn widest_four(corners: &[Vector]) -> Vec<usize> {
    let n = corners.len();
    if n <= 4 {
        return (0..n).collect();
    }
    let mut ends = (0, 1);
    let mut longest = 0.0;
    for i in 0..n {
        for j in i + 1..n {
            let length = (corners[j] - corners[i]).length_squared();
            if length > longest {
                (ends, longest) = ((i, j), length);
            }
        }
    }
    let (a, b) = ends;
    let along = corners[b] - corners[a];
    let farthest = |indices: &mut dyn Iterator<Item = usize>| -> Option<usize> {
        let mut best: Option<(usize, Real)> = None;
        for i in indices {
            let area = along.cross(corners[i] - corners[a]).length_squared();
            if best.is_none_or(|(_, most)| area > most) {
                best = Some((i, area));
            }
        }
        best.map(|(i, _)| i)
    };
    let mut chosen = vec![a];
    chosen.extend(farthest(&mut (a + 1..b)));
    chosen.push(b);
    chosen.extend(farthest(&mut (b + 1..n).chain(0..a)));
    chosen
}

impl PolygonalFeatureMap for StableHull {
    fn local_support_feature(&self, dir: Vector, out_feature: &mut PolygonalFeature) {
        let mut best = &self.faces[0];
        let mut most = best.0.dot(dir);
        for face in &self.faces[1..] {
            let along = face.0.dot(dir);
            if along > most {
                (best, most) = (face, along);
            }
        }
        out_feature.clone_from(&best.1);
    }

    fn is_convex_polyhedron(&self) -> bool {
        true
    }
}

impl SupportMap for StableHull {
    fn local_support_point(&self, dir: Vector) -> Vector {
        self.hull.local_support_point(dir)
    }
}

impl PointQuery for StableHull {
    fn project_local_point(&self, point: Vector, solid: bool) -> PointProjection {
        self.hull.project_local_point(point, solid)
    }

    fn project_local_point_and_get_feature(&self, point: Vector) -> (PointProjection, FeatureId) {
        self.hull.project_local_point_and_get_feature(point)
    }
}

impl RayCast for StableHull {
    fn cast_local_ray_and_get_normal(
        &self,
        ray: &Ray,
        max_time_of_impact: Real,
        solid: bool,
    ) -> Option<RayIntersection> {
        self.hull.cast_local_ray_and_get_normal(ray, max_time_of_impact, solid)
    }
}

impl Shape for StableHull {
    fn compute_local_aabb(&self) -> Aabb {
        self.hull.compute_local_aabb()
    }

    fn compute_local_bounding_sphere(&self) -> BoundingSphere {
        self.hull.compute_local_bounding_sphere()
    }

    fn compute_aabb(&self, position: &Pose) -> Aabb {
        self.hull.compute_aabb(position)
    }

    fn clone_dyn(&self) -> Box<dyn Shape> {
        Box::new(self.clone())
    }

    fn scale_dyn(&self, scale: Vector, _num_subdivisions: u32) -> Option<Box<dyn Shape>> {
        let points: Vec<Vector> = self.hull.points().iter().map(|p| p * scale).collect();
        Some(Box::new(Self::new(&points)?))
    }

    fn mass_properties(&self, density: Real) -> MassProperties {
        self.hull.mass_properties(density)
    }

    fn shape_type(&self) -> ShapeType {
        ShapeType::ConvexPolyhedron
    }

    fn as_typed_shape(&self) -> TypedShape<'_> {
        TypedShape::ConvexPolyhedron(&self.hull)
    }

    fn ccd_thickness(&self) -> Real {
        self.hull.ccd_thickness()
    }

    fn ccd_angular_thickness(&self) -> Real {
        self.hull.ccd_angular_thickness()
    }

    fn is_convex(&self) -> bool {
        true
    }

    fn as_support_map(&self) -> Option<&dyn SupportMap> {
        Some(self)
    }

    fn as_polygonal_feature_map(&self) -> Option<(&dyn PolygonalFeatureMap, Real)> {
        Some((self, 0.0))
    }

    fn feature_normal_at_point(
        &self,
        subshape: SubShapeId,
        feature: FeatureId,
        point: Vector,
    ) -> Option<Vector> {
        self.hull.feature_normal_at_point(subshape, feature, point)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_round_base_is_described_by_a_square_across_it() {
        let circle: Vec<Vector> = (0..24)
            .map(|i| {
                let angle = i as Real * (std::f64::consts::TAU / 24.0) as Real;
                Vector::new(angle.cos(), angle.sin(), 0.0)
            })
            .collect();
        let chosen = widest_four(&circle);
        let area: Real = (0..4).map(|i| circle[chosen[i]].cross(circle[chosen[(i + 1) % 4]]).z / 2.0).sum();
        assert!((area - 2.0).abs() < 1e-5, "{chosen:?} spans {area}");
    }

    #[test]
    fn a_cylinder_is_supported_across_its_base() {
        let ring = |z: Real| {
            (0..32).map(move |i| {
                let angle = i as Real * (std::f64::consts::TAU / 32.0) as Real;
                Vector::new(0.03 * angle.cos(), 0.03 * angle.sin(), z)
            })
        };
        let points: Vec<Vector> = ring(0.0).chain(ring(0.1)).collect();
        let hull = StableHull::new(&points).unwrap();
        let mut feature = PolygonalFeature::default();
        hull.local_support_feature(-Vector::Z, &mut feature);
        assert_eq!(feature.num_vertices, 4);
        let middle = feature.vertices.iter().fold(Vector::ZERO, |sum, v| sum + v) / 4.0;
        assert!(middle.length() < 1e-3, "{middle}");
    }
}
