//! Objects that stand on each other: their bottoms and the pieces below them.

use crate::piece::{are_apart, is_exact};
use glamx::{DVec2, DVec3};
use parry3d_f64::query::{Ray, RayCast};
use parry3d_f64::shape::ConvexPolyhedron;
use sms_core::{Aabb, Entity, EntityKind, EntityShape, Mesh};
use sms_mesh::clip;
use sms_mesh::outline::{is_within, outline_of};

/// Largest step or gap that is closed, metres. Larger ones were seen, or come from another shape.
pub(crate) const REACH_M: f64 = 0.005;
/// A carrier extends at least this far below the face, metres.
pub(crate) const BELOW_M: f64 = 0.005;
/// Gap that physics engines do not notice, metres.
pub(crate) const CLOSED_M: f64 = 1e-5;

/// The index of an object that stands on a level face, and the height of that face, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LevelFace {
    pub(crate) upper: usize,
    pub(crate) height: f64,
}

/// Returns the objects that stand on other objects instead of the floor, lowest first. Balls, which touch at a point,
/// are handled elsewhere.
pub(crate) fn standing(entities: &[Entity], floor: f64) -> Vec<usize> {
    let can_stand = |e: &Entity| {
        let is_ball = matches!(e.shape, EntityShape::Sphere { .. });
        e.kind == EntityKind::Dynamic && !is_ball && bottom(e) > floor + BELOW_M + REACH_M
    };
    let mut order: Vec<usize> = (0..entities.len()).filter(|&i| can_stand(&entities[i])).collect();
    order.sort_by(|&a, &b| bottom(&entities[a]).total_cmp(&bottom(&entities[b])));
    order
}

/// Returns whether an object may carry another object that ends at `height`.
pub(crate) fn can_carry(entity: &Entity, height: f64) -> bool {
    entity.kind == EntityKind::Dynamic && bottom(entity) < height - BELOW_M
}

fn vertices(entity: &Entity) -> Box<dyn Iterator<Item = DVec3> + '_> {
    if is_exact(entity) {
        return Box::new(entity.mesh.vertices.iter().copied());
    }
    Box::new(entity.parts.iter().flat_map(|p| p.vertices.iter().copied()))
}

pub(crate) fn bottom(entity: &Entity) -> f64 {
    vertices(entity).map(|v| v.z).fold(f64::INFINITY, f64::min)
}

/// Returns the convex outline of an object's bottom from above, counterclockwise.
pub(crate) fn bottom_outline(entity: &Entity) -> Vec<DVec2> {
    let low = bottom(entity) + REACH_M;
    outline_of(vertices(entity).filter(|v| v.z < low))
}

/// Returns the corners of the part of a piece's surface over or under an outline.
pub(crate) fn under(part: &Mesh, outline: &[DVec2]) -> Vec<DVec3> {
    // Most pieces of a scene are beside the outline.
    let points = outline.iter().flat_map(|p| [f64::MIN, f64::MAX].map(|z| p.extend(z)));
    let (Some(column), Some(bounds)) = (Aabb::of_points(points), part.aabb()) else { return Vec::new() };
    if are_apart(&column, &bounds) {
        return Vec::new();
    }
    let mut under: Vec<[DVec3; 3]> = (0..part.triangles.len()).map(|t| part.corners(t)).collect();
    for i in 0..outline.len() {
        let (a, b) = (outline[i], outline[(i + 1) % outline.len()]);
        let outward = DVec2::new(b.y - a.y, a.x - b.x).normalize_or_zero();
        under = clip(&under, outward.extend(0.0), outward.dot(a)).0;
    }
    under.into_flattened()
}

/// Returns whether a piece reaches more than `margin` (metres) above a face, outside the outline of the object on that
/// face. Such a part was seen and is kept.
pub(crate) fn reaches_beside(part: &Mesh, outline: &[DVec2], height: f64, margin: f64) -> bool {
    part.vertices.iter().any(|v| v.z > height + REACH_M && !is_within(outline, v.truncate(), margin))
}

/// Marks the corners of a hull's faces that satisfy `wanted`, which gets the upward component of a face's normal.
pub(crate) fn corners_of_faces(part: &Mesh, wanted: impl Fn(f64) -> bool) -> Vec<bool> {
    let mut is = vec![false; part.vertices.len()];
    for (t, corners) in part.triangles.iter().enumerate() {
        let [a, b, c] = part.corners(t);
        let faces = wanted((b - a).cross(c - a).normalize_or_zero().z);
        corners.iter().for_each(|&k| is[k as usize] |= faces);
    }
    is
}

/// Heights at which vertical lines meet a convex piece.
pub(crate) struct PieceColumn(ConvexPolyhedron);

impl PieceColumn {
    pub(crate) fn of(part: &Mesh) -> Option<Self> {
        ConvexPolyhedron::from_convex_mesh(part.vertices.clone(), &part.triangles).map(Self)
    }

    /// Returns the height of the top, searched from `above` to one metre lower.
    pub(crate) fn top(&self, p: DVec2, above: f64) -> Option<f64> {
        self.0.cast_local_ray(&Ray::new(p.extend(above), DVec3::NEG_Z), 2.0, true).map(|t| above - t)
    }

    /// Returns the height of the underside, searched from `below` upwards.
    pub(crate) fn underside(&self, p: DVec2, below: f64) -> Option<f64> {
        self.0.cast_local_ray(&Ray::new(p.extend(below), DVec3::Z), 2.0, true).map(|t| below + t)
    }
}
