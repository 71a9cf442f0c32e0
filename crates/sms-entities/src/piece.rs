//! Convex pieces of objects: overlap, cutting, moving.

use glamx::{DPose3, DQuat, DVec3};
use parry3d_f64::query;
use parry3d_f64::shape::{Ball, ConvexPolyhedron, Cuboid, Cylinder, Shape};
use sms_core::{Aabb, Entity, EntityShape, Mesh};
use sms_mesh::{clip, convex_hull};

/// Overlap that physics engines tolerate, metres.
const ALLOWED: f64 = 1e-5;

/// Mean thickness of the thinnest part that is kept after cutting, metres.
const THINNEST: f64 = 1e-4;

/// Returns whether an object is an exact solid: it keeps its shape, and overlapping hulls are cut.
pub(crate) fn is_exact(entity: &Entity) -> bool {
    entity.shape.is_primitive()
}

pub(crate) fn piece_count(entity: &Entity) -> usize {
    if is_exact(entity) { 1 } else { entity.parts.len() }
}

pub(crate) fn are_apart(p: &Aabb, q: &Aabb) -> bool {
    p.min.cmpgt(q.max).any() || q.min.cmpgt(p.max).any()
}

/// The box around an object's pieces.
pub(crate) fn bounds(entity: &Entity) -> Option<Aabb> {
    if is_exact(entity) {
        return entity.mesh.aabb();
    }
    Aabb::of_points(entity.parts.iter().flat_map(|p| p.vertices.iter().copied()))
}

/// A convex piece of an object in the world frame.
pub(crate) struct CollisionPiece {
    x_ws: DPose3,
    shape: Box<dyn Shape>,
    bounds: Aabb,
}

impl CollisionPiece {
    /// Makes a piece from a hull; `None` if it has no volume.
    pub(crate) fn of(part: &Mesh) -> Option<Self> {
        let shape = ConvexPolyhedron::from_convex_mesh(part.vertices.clone(), &part.triangles)?;
        Some(Self { x_ws: DPose3::identity(), shape: Box::new(shape), bounds: part.aabb()? })
    }

    /// Returns the normal towards the other piece and the deepest points of both, if they overlap.
    fn overlap(&self, other: &Self) -> Option<(DVec3, DVec3, DVec3)> {
        if are_apart(&self.bounds, &other.bounds) {
            return None;
        }
        let contact = query::contact(&self.x_ws, &*self.shape, &other.x_ws, &*other.shape, 0.0).ok()??;
        let usable = contact.dist < -ALLOWED && contact.normal1.is_finite();
        usable.then_some((contact.normal1, contact.point1, contact.point2))
    }

    /// Returns whether the piece contains a point of the world.
    pub(crate) fn holds(&self, p_w: DVec3) -> bool {
        self.shape.contains_point(&self.x_ws, p_w)
    }

    /// Returns the depth inside another piece, metres; 0 without overlap.
    pub(crate) fn depth_in(&self, other: &Self) -> f64 {
        self.overlap(other).map_or(0.0, |(normal, p, q)| (p - q).dot(normal))
    }
}

/// Returns the pieces of an object that may be inside a box.
pub(crate) fn pieces_near<'a>(
    entity: &'a Entity,
    near: &'a Aabb,
) -> impl Iterator<Item = CollisionPiece> + 'a {
    let is_near = move |i: &usize| piece_bounds(entity, *i).is_some_and(|b| !are_apart(&b, near));
    (0..piece_count(entity)).filter(is_near).filter_map(|i| piece(entity, i))
}

fn piece_bounds(entity: &Entity, i: usize) -> Option<Aabb> {
    if is_exact(entity) { entity.mesh.aabb() } else { entity.parts[i].aabb() }
}

fn piece(entity: &Entity, i: usize) -> Option<CollisionPiece> {
    let exact = |x_ws: DPose3, shape: Box<dyn Shape>| {
        Some(CollisionPiece { x_ws, shape, bounds: entity.mesh.aabb()? })
    };
    match &entity.shape {
        EntityShape::Sphere { center_w, radius } => {
            exact(DPose3::from_translation(*center_w), Box::new(Ball::new(*radius)))
        }
        EntityShape::Box { x_ws, half_extents } => exact(*x_ws, Box::new(Cuboid::new(*half_extents))),
        EntityShape::Cylinder { x_ws, radius, half_length } => {
            // Parry's cylinders stand along y.
            let upright = DPose3::from_rotation(DQuat::from_rotation_arc(DVec3::Y, DVec3::Z));
            exact(*x_ws * upright, Box::new(Cylinder::new(*half_length, *radius)))
        }
        EntityShape::Convex | EntityShape::TriMesh => CollisionPiece::of(&entity.parts[i]),
    }
}

/// Returns the normal from `a` to `b` and the deepest points of both, if the pieces overlap.
pub(crate) fn overlap(a: &Entity, i: usize, b: &Entity, j: usize) -> Option<(DVec3, DVec3, DVec3)> {
    // Most pairs are far apart, and shapes are expensive to build.
    if are_apart(&piece_bounds(a, i)?, &piece_bounds(b, j)?) {
        return None;
    }
    piece(a, i)?.overlap(&piece(b, j)?)
}

/// Smallest share of a piece that a cut between deepest points may leave. If less is left, the overlap is not at a
/// contact face.
const LEAST_LEFT: f64 = 0.2;

/// Keeps the part below the plane. Returns `false` and changes nothing if less than [`LEAST_LEFT`] of the piece would
/// be left.
pub(crate) fn cut(part: &mut Mesh, normal: DVec3, offset: f64, max_vertices: usize) -> bool {
    cut_to(part, normal, offset, max_vertices, LEAST_LEFT)
}

/// Like [`cut`], with the smallest share that must be left.
pub(crate) fn cut_to(
    part: &mut Mesh,
    normal: DVec3,
    offset: f64,
    max_vertices: usize,
    least_left: f64,
) -> bool {
    let triangles: Vec<[DVec3; 3]> = (0..part.triangles.len()).map(|t| part.corners(t)).collect();
    let (below, _) = clip(&triangles, normal, offset);
    let points: Vec<DVec3> = below.into_iter().flatten().collect();
    match convex_hull(&points, max_vertices, 1e-6) {
        Some(hull) if hull.volume() > least_left * part.volume() => {
            *part = hull;
            true
        }
        _ => false,
    }
}

/// Returns whether a convex piece is thick enough for engines.
pub(crate) fn is_thick(part: &Mesh) -> bool {
    2.0 * part.volume() > THINNEST * part.area()
}

pub(crate) fn translate(entity: &mut Entity, by: DVec3) {
    match &mut entity.shape {
        EntityShape::Sphere { center_w, .. } => *center_w += by,
        EntityShape::Box { x_ws, .. } | EntityShape::Cylinder { x_ws, .. } => x_ws.translation += by,
        EntityShape::Convex | EntityShape::TriMesh => {}
    }
    let points = entity.mesh.vertices.iter_mut().chain(&mut entity.cloud.points_w);
    points.chain(entity.parts.iter_mut().flat_map(|p| &mut p.vertices)).for_each(|p| *p += by);
}
