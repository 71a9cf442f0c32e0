//! Convex hulls that rest on their flat faces.
//!
//! Parry describes the face of a convex polyhedron by its first four vertices. On a round or many-cornered base, these
//! are neighbours that span only a sliver at the rim, and a body tips over the sliver. This shape is the same
//! polyhedron, but describes each face by the four vertices that span the largest area. If another vertex is lower, or
//! a contact lies outside the four, it uses the nearby side of the face and the two vertices that span the largest area
//! with this side.
//!
//! Parry also searches for the nearest point of a polyhedron iteratively (GJK). In single precision, this treats points
//! next to the thin walls of dishes as inside, and balls sink into the walls. Here all faces are tested; there are few.
#![allow(
    clippy::unnecessary_cast,
    reason = "`Real` is f32 in one instance of this file and f64 in the other"
)]

use super::engine::math::{Pose, Real, Vector};
use super::engine::parry::bounding_volume::{Aabb, BoundingSphere};
use super::engine::parry::mass_properties::MassProperties;
use super::engine::parry::query::{PointProjection, PointQuery, Ray, RayCast, RayIntersection};
use super::engine::parry::shape::{
    ConvexPolyhedron, FeatureId, PolygonalFeature, PolygonalFeatureMap, Shape, ShapeType, SubShapeId,
    SupportMap, Triangle, TypedShape,
};
use super::engine::parry::transformation::try_convex_hull;
use super::face::{HullFace, describe, planes, to_engine};

/// A convex polyhedron with well-conditioned face descriptions.
#[derive(Debug, Clone)]
pub(super) struct StableHull {
    hull: ConvexPolyhedron,
    /// Normal of each face.
    normals: Vec<Vector>,
    faces: Vec<HullFace>,
    /// Triangulation of the faces.
    triangles: Vec<FacePiece>,
}

/// A triangle of a face.
#[derive(Debug, Clone, Copy)]
struct FacePiece {
    shape: Triangle,
    normal: Vector,
    face: u32,
}

impl StableHull {
    /// The convex hull of points; `None` if degenerate (fewer than three points, or collinear).
    pub(super) fn new(points: &[Vector]) -> Option<Self> {
        let (vertices, indices) = try_convex_hull(points).ok()?;
        let (planes, plane_of) = planes(&vertices, &indices);
        let normals: Vec<Vector> = planes.iter().map(|p| to_engine(p.normal)).collect();
        let faces: Vec<HullFace> = (0u32..).zip(&planes).map(|(id, p)| describe(&vertices, id, p)).collect();
        let pieces = indices.iter().zip(plane_of).filter_map(|(t, plane)| Some((t, plane?)));
        let triangles = pieces
            .map(|(t, plane)| FacePiece {
                shape: Triangle::from(t.map(|k| vertices[k as usize])),
                normal: normals[plane],
                face: plane as u32,
            })
            .collect();
        let hull = ConvexPolyhedron::from_convex_mesh(vertices, &indices)?;
        (!faces.is_empty()).then_some(Self { hull, normals, faces, triangles })
    }

    /// The nearest point of the surface, its face, and whether `p` is inside.
    fn nearest(&self, p: Vector) -> (Vector, u32, bool) {
        let mut nearest: Option<(Real, Vector, u32)> = None;
        let mut highest = (Real::NEG_INFINITY, 0, Vector::ZERO);
        for t in &self.triangles {
            let height = (p - t.shape.a).dot(t.normal);
            if height > highest.0 {
                highest = (height, t.face, p - t.normal * height);
            }
            // The nearest point lies on a face that is visible from `p`.
            if height <= 0.0 || nearest.is_some_and(|n| height * height > n.0) {
                continue;
            }
            let q = t.shape.project_local_point(p, false).point;
            let distance = (p - q).length_squared();
            if nearest.is_none_or(|n| distance < n.0) {
                nearest = Some((distance, q, t.face));
            }
        }
        match nearest {
            Some((_, q, face)) => (q, face, false),
            None => (highest.2, highest.1, true),
        }
    }

    fn face_toward(&self, dir: Vector) -> usize {
        let (mut best, mut most) = (0, self.normals[0].dot(dir));
        for (k, normal) in self.normals.iter().enumerate().skip(1) {
            let along = normal.dot(dir);
            if along > most {
                (best, most) = (k, along);
            }
        }
        best
    }
}

impl PolygonalFeatureMap for StableHull {
    fn local_support_feature(&self, dir: Vector, out_feature: &mut PolygonalFeature) {
        out_feature.clone_from(self.faces[self.face_toward(dir)].toward(dir));
    }

    fn local_support_feature_toward(&self, dir: Vector, hint: Vector, out_feature: &mut PolygonalFeature) {
        let face = self.face_toward(dir);
        out_feature.clone_from(self.faces[face].around(hint, self.normals[face]));
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
        let (nearest, _, is_inside) = self.nearest(point);
        PointProjection {
            point: if solid && is_inside { point } else { nearest },
            is_inside,
            subshape: SubShapeId::default(),
        }
    }

    fn project_local_point_and_get_feature(&self, point: Vector) -> (PointProjection, FeatureId) {
        let (nearest, face, is_inside) = self.nearest(point);
        (
            PointProjection { point: nearest, is_inside, subshape: SubShapeId::default() },
            FeatureId::Face(face),
        )
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
        match feature {
            // Parry's faces are numbered differently.
            FeatureId::Face(id) => self.normals.get(id as usize).copied(),
            _ => self.hull.feature_normal_at_point(subshape, feature, point),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Five corners, with four of them in the description: the fifth does not sink in, and a contact next to it is
    /// found.
    #[test]
    fn no_corner_of_a_face_is_left_out_where_it_matters() {
        let corner = |k: i32, z: f64| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 5.0).sin_cos();
            Vector::new((0.05 * cos) as Real, (0.05 * sin) as Real, z as Real)
        };
        let points: Vec<Vector> = (0..5).flat_map(|k| [corner(k, 0.0), corner(k, 0.1)]).collect();
        let hull = StableHull::new(&points).unwrap();
        let described = |feature: &PolygonalFeature, p: Vector| {
            feature.vertices[..feature.num_vertices].iter().any(|v| (*v - p).length() < 1e-6)
        };
        for k in 0..5 {
            let low = corner(k, 0.0);
            let mut feature = PolygonalFeature::default();
            hull.local_support_feature((low * 0.02 - Vector::Z).normalize(), &mut feature);
            assert!(feature.num_vertices == 4 && described(&feature, low), "{k}");
            hull.local_support_feature_toward(-Vector::Z, low * 0.99, &mut feature);
            assert!(feature.num_vertices == 4 && described(&feature, low), "{k}");
        }
        let mut flat = PolygonalFeature::default();
        hull.local_support_feature(-Vector::Z, &mut flat);
        let mut middle = PolygonalFeature::default();
        hull.local_support_feature_toward(-Vector::Z, Vector::ZERO, &mut middle);
        assert_eq!(flat.vids, middle.vids);
    }

    /// A corner slightly outside the middle of a side and below the face does not change the plane.
    #[test]
    fn a_corner_on_a_side_does_not_tilt_its_face() {
        let corner = |x: f64, y: f64, z: f64| Vector::new(x as Real, y as Real, z as Real);
        for (out, below) in [(2e-6, 1.5e-5), (2e-6, 0.0), (1e-4, 1.5e-5)] {
            for turn in 0..3 {
                let angle = |k: i32| std::f64::consts::TAU * (f64::from(k + turn) / 3.0);
                let top = |k: i32| corner(0.2 * angle(k).cos(), 0.2 * angle(k).sin(), 0.1);
                let middle = 0.1 + out;
                let (sin, cos) = ((angle(0) + angle(1)) * 0.5).sin_cos();
                let mut points: Vec<Vector> = (0..3).map(top).collect();
                points.push(corner(middle * cos, middle * sin, 0.1 - below));
                points.extend((0..3).map(|k| top(k) - Vector::Z * 0.1));
                let hull = StableHull::new(&points).unwrap();
                let mut feature = PolygonalFeature::default();
                hull.local_support_feature(Vector::Z, &mut feature);
                let v = feature.vertices;
                // The plane that Parry computes.
                let normal = (v[2] - v[1]).cross(v[0] - v[1]).normalize();
                assert!(
                    feature.num_vertices >= 3 && normal.z.abs() > 1.0 - 1e-6,
                    "{out} {below} {turn}: {feature:?}"
                );
            }
        }
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

    /// A roof of two faces that differ by 0.5° to 2.7°, on either side of parry's 1.5°.
    #[test]
    fn faces_that_differ_by_a_degree_stay_apart() {
        for slope in [0.004, 0.008, 0.016, 0.024] {
            let corner = |x: f64, y: f64, z: f64| Vector::new(x as Real, y as Real, z as Real);
            let mut points = Vec::new();
            for y in [-0.2, 0.2] {
                points.extend([corner(0.0, y, 0.01), corner(0.0, y, -0.01)]);
                for x in [-0.4, 0.4] {
                    points.extend([corner(x, y, 0.01 - 0.4 * slope), corner(x, y, -0.01)]);
                }
            }
            let hull = StableHull::new(&points).unwrap();
            for side in [-1.0, 1.0] {
                let length = (1.0 + slope * slope).sqrt();
                let normal = corner(side * slope / length, 0.0, 1.0 / length);
                let mut feature = PolygonalFeature::default();
                hull.local_support_feature(normal, &mut feature);
                let v = feature.vertices;
                let spanned = (v[2] - v[0]).cross(v[3] - v[1]) * 0.5;
                assert_eq!(feature.num_vertices, 4);
                assert!((spanned.length() - (0.4 * 0.4 * length) as Real).abs() < 1e-4, "{slope}: {v:?}");
                assert!(spanned.normalize().dot(normal).abs() > 1.0 - 1e-7, "{slope}: {v:?}");
            }
        }
    }

    /// A part of a scanned bowl. Parry's single-precision query treats this point, 0.16 mm outside, as inside.
    #[test]
    fn points_beside_a_thin_wall_are_outside() {
        let wall: [[f64; 3]; 29] = [
            [-0.0187594, -0.0613350, 0.0040344],
            [-0.0092235, -0.0294716, -0.0140726],
            [-0.0159609, -0.0519567, 0.0040344],
            [-0.0230061, -0.0097064, -0.0164858],
            [-0.0441531, -0.0252504, 0.0003786],
            [-0.0228939, -0.0153720, -0.0241797],
            [-0.0260199, -0.0195540, -0.0241797],
            [-0.0431794, -0.0307846, -0.0086663],
            [-0.0403436, -0.0368299, 0.0040344],
            [-0.0503191, -0.0386905, 0.0040344],
            [-0.0104064, -0.0334778, -0.0222706],
            [-0.0162984, -0.0256545, -0.0241797],
            [-0.0322696, -0.0342422, -0.0140293],
            [-0.0262963, -0.0434562, -0.0110197],
            [-0.0457285, -0.0307631, -0.0041263],
            [-0.0361470, -0.0438337, -0.0044949],
            [-0.0173983, -0.0546736, -0.0052128],
            [-0.0142840, -0.0464237, -0.0127880],
            [-0.0284879, -0.0573595, 0.0040344],
            [-0.0166791, -0.0544120, -0.0053643],
            [-0.0337650, -0.0503918, -0.0000831],
            [-0.0346538, -0.0537090, 0.0040344],
            [-0.0393083, -0.0482233, 0.0023953],
            [-0.0406877, -0.0429994, -0.0014285],
            [-0.0198867, -0.0239005, -0.0241797],
            [-0.0360085, -0.0525824, 0.0040344],
            [-0.0122563, -0.0396541, -0.0178080],
            [-0.0283301, -0.0569908, 0.0034916],
            [-0.0162696, -0.0434692, -0.0141223],
        ];
        let points: Vec<Vector> =
            wall.iter().map(|p| Vector::new(p[0] as Real, p[1] as Real, p[2] as Real)).collect();
        let hull = StableHull::new(&points).unwrap();
        let p = Vector::new(-0.026_317_125, -0.027_550_613, -0.005_160_526);
        let found = hull.project_local_point(p, true);
        let distance = (p - found.point).length();
        assert!(!found.is_inside && (distance - 1.589e-4).abs() < 2e-6, "{distance}");
    }

    /// Compares with the closed form; inside points with the shortest way out.
    #[test]
    fn nearest_points_are_those_of_a_box() {
        let half = [0.02, 0.03, 0.05];
        let corner = |k: usize| {
            let side = |bit: usize| if k >> bit & 1 == 1 { half[bit] } else { -half[bit] } as Real;
            Vector::new(side(0), side(1), side(2))
        };
        let hull = StableHull::new(&(0..8).map(corner).collect::<Vec<_>>()).unwrap();
        let most = Vector::new(half[0] as Real, half[1] as Real, half[2] as Real);
        for k in 0..1000 {
            let t = |m: f64| ((f64::from(k) * m).fract() * 0.2 - 0.1) as Real;
            let p = Vector::new(t(0.618_034), t(0.754_878), t(0.569_840));
            let (q, _, is_inside) = hull.nearest(p);
            let out = (p.abs() - most).max_element();
            assert_eq!(is_inside, out <= 0.0, "{p}");
            let expected = if is_inside { -out } else { (p - p.clamp(-most, most)).length() };
            assert!(((p - q).length() - expected).abs() < 1e-6, "{p}: {q}");
        }
    }
}
