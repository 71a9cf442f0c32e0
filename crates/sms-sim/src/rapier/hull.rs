//! Convex hulls that stand on their flat faces.
//!
//! Parry describes the face of a convex polyhedron by its first four vertices. Of a round or many-cornered base these
//! are neighbours, a sliver at its rim: a body that stands on such a base tips over the sliver. This shape is the same
//! polyhedron, but describes each face by the four of its vertices that span the largest area.
//!
//! Parry also looks for the nearest point of a polyhedron by an iteration (GJK) that in single precision takes points
//! beside the thin parts of dishes for inside: balls sank into their walls. Here all faces are looked at; there are
//! few.
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
    SubShapeId, SupportMap, Triangle, TypedShape,
};
use super::engine::parry::transformation::try_convex_hull;
use glamx::DVec3;

/// Vertices this near to a face's plane, metres, belong to the face.
const FLAT: f64 = 2e-5;

/// A convex polyhedron whose faces are described by their best four vertices.
#[derive(Debug, Clone)]
pub(super) struct StableHull {
    hull: ConvexPolyhedron,
    /// Normal and description of each face.
    faces: Vec<(Vector, PolygonalFeature)>,
    /// The faces cut into triangles.
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
    /// The convex hull of points; `None` where parry makes none of them (fewer than three, or all on a line).
    pub(super) fn new(points: &[Vector]) -> Option<Self> {
        let (vertices, indices) = try_convex_hull(points).ok()?;
        let (planes, plane_of) = planes(&vertices, &indices);
        let faces = (0u32..).zip(&planes).map(|(id, p)| (to_engine(p.normal), describe(&vertices, id, p)));
        let faces: Vec<(Vector, PolygonalFeature)> = faces.collect();
        let pieces = indices.iter().zip(plane_of).filter_map(|(t, plane)| Some((t, plane?)));
        let triangles = pieces
            .map(|(t, plane)| FacePiece {
                shape: Triangle::from(t.map(|k| vertices[k as usize])),
                normal: faces[plane].0,
                face: plane as u32,
            })
            .collect();
        let hull = ConvexPolyhedron::from_convex_mesh(vertices, &indices)?;
        (!faces.is_empty()).then_some(Self { hull, faces, triangles })
    }

    /// The nearest point of the surface and the face that it lies on; whether `p` is inside.
    fn nearest(&self, p: Vector) -> (Vector, u32, bool) {
        let mut nearest: Option<(Real, Vector, u32)> = None;
        let mut highest = (Real::NEG_INFINITY, 0, Vector::ZERO);
        for t in &self.triangles {
            let height = (p - t.shape.a).dot(t.normal);
            if height > highest.0 {
                highest = (height, t.face, p - t.normal * height);
            }
            // The nearest point lies on a face that sees `p`.
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
}

/// The plane of a face.
#[derive(Debug, Clone, Copy)]
struct FacePlane {
    origin: DVec3,
    normal: DVec3,
}

impl FacePlane {
    fn height(&self, p: DVec3) -> f64 {
        (p - self.origin).dot(self.normal)
    }
}

fn to_double(v: Vector) -> DVec3 {
    DVec3::new(v.x as f64, v.y as f64, v.z as f64)
}

fn to_engine(v: DVec3) -> Vector {
    Vector::new(v.x as Real, v.y as Real, v.z as Real)
}

/// The planes of the faces that triangles make, the largest triangle's first, and the plane of each triangle (none for
/// one of no area on an edge). Parry joins triangles whose normals differ by up to 1.5° in single precision, and takes
/// the first one's: a heavy box sank through a board whose two sides had such a normal. Here a triangle belongs to a
/// larger one's face when it lies in its plane, whatever rounding made of a sliver's normal, and to no other.
fn planes(vertices: &[Vector], triangles: &[[u32; 3]]) -> (Vec<FacePlane>, Vec<Option<usize>>) {
    let corners: Vec<[DVec3; 3]> =
        triangles.iter().map(|t| t.map(|k| to_double(vertices[k as usize]))).collect();
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

/// The description of a face: the four of the vertices in its plane that span the largest area, put onto the plane. Of
/// less than [`FLAT`] across, an edge.
///
/// Parry takes the plane of a description from its first three corners, so these are the ones with the largest triangle:
/// of a corner on the straight line between its neighbours the rounding would decide.
fn describe(vertices: &[Vector], id: u32, plane: &FacePlane) -> PolygonalFeature {
    let points = (0u32..).zip(vertices).map(|(k, p)| (k, to_double(*p)));
    let in_plane = points.filter(|(_, p)| plane.height(*p).abs() <= FLAT);
    let mut corners: Vec<(u32, DVec3)> =
        in_plane.map(|(k, p)| (k, p - plane.normal * plane.height(p))).collect();
    let middle = corners.iter().fold(DVec3::ZERO, |sum, c| sum + c.1) / corners.len() as f64;
    let across = (plane.origin - middle).normalize_or(plane.normal.any_orthonormal_vector());
    let along = plane.normal.cross(across);
    let angle = |p: DVec3| (p - middle).dot(along).atan2((p - middle).dot(across));
    corners.sort_by(|a, b| angle(a.1).total_cmp(&angle(b.1)).then(a.0.cmp(&b.0)));
    let positions: Vec<DVec3> = corners.iter().map(|c| c.1).collect();
    let mut feature = PolygonalFeature::default();
    for (slot, &corner) in from_widest_corner(&positions, widest_four(&positions)).iter().enumerate() {
        feature.vertices[slot] = to_engine(positions[corner]);
        feature.vids[slot] = PackedFeatureId::vertex(corners[corner].0);
        // Edge ids only tell contacts of one step from those of the next.
        feature.eids[slot] = PackedFeatureId::edge(4 * id + slot as u32);
        feature.num_vertices = slot + 1;
    }
    feature.fid = PackedFeatureId::face(id);
    feature
}

/// Indices, in order, of up to four corners of a convex polygon that span the largest area.
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

/// The corners turned such that the second one makes the largest triangle with its neighbours; of a sliver its ends.
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
            // Parry's faces have other numbers.
            FeatureId::Face(id) => self.faces.get(id as usize).map(|f| f.0),
            _ => self.hull.feature_normal_at_point(subshape, feature, point),
        }
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
        // Half a round: its diameter is one of its sides. Of all quadrilaterals in a half-disc, half a hexagon is the largest.
        let mut half = arc(std::f64::consts::PI);
        half.push(DVec3::NEG_X);
        assert!((spanned(&half) - 0.75 * 3.0f64.sqrt()).abs() < 1e-9, "{}", spanned(&half));
    }

    /// A corner a few micrometres outside of the middle of a side, and below the face: the plane is the face's all the same.
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
                // The plane that parry takes.
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

    /// A piece of a scanned bowl. Parry's single-precision query takes this point, 0.16 mm outside, for inside.
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

    /// Against the closed form, and inside the way out.
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
