//! Surfaces of bodies for the air: unions of convex parts, each the intersection of half spaces.

use crate::WashError;
use glamx::{DPose3, DVec3};
use sms_core::{Aabb, Mesh};

/// Cells along the longest edge of a [`BodySurface`]'s distance grid.
const GRID_CELLS: f64 = 28.0;
/// Margin of the grid beyond the surface, as a share of the longest edge.
const GRID_MARGIN: f64 = 0.15;
/// Tolerance of a supporting plane, as a share of the hull's size; other planes are rounding errors of slivers.
const PLANE_TOLERANCE: f64 = 1e-4;
/// Largest share of a part's area on planes that are not supporting planes.
const LOST_AREA: f64 = 0.01;

/// A half space `normal · p ≤ offset`.
#[derive(Debug, Clone, Copy, PartialEq)]
struct HalfSpacePlane {
    normal: DVec3,
    offset: f64,
}

/// A convex solid: the intersection of its half spaces.
#[derive(Debug, Clone)]
struct ConvexPart {
    /// The planes. Those that face along the axes come first, because they separate most points.
    planes: Vec<HalfSpacePlane>,
    /// Bounding sphere; infinite for a half space.
    center: DVec3,
    radius: f64,
    /// Bounding box.
    bounds: Aabb,
}

/// A point of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceHit {
    /// Distance along the ray, or signed distance from the surface (negative inside), metres.
    pub distance: f64,
    /// Outward normal at the point, in the frame of the query.
    pub normal: DVec3,
}

/// Contact of a moving point with a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SurfaceContact {
    /// Time, seconds.
    pub(crate) time: f64,
    /// Outward normal in the body's frame.
    pub(crate) normal: DVec3,
    /// Penetration depth at the start, metres.
    pub(crate) depth: f64,
}

impl ConvexPart {
    fn from_mesh(part: usize, mesh: &Mesh) -> Result<Self, WashError> {
        let refuse = |why: &str| WashError::Part { part, why: why.to_owned() };
        let bounds = mesh.aabb().ok_or_else(|| refuse("it has no vertices"))?;
        let size = bounds.extents().length();
        let (mut planes, mut area, mut lost) = (Vec::<HalfSpacePlane>::new(), 0.0, 0.0);
        for t in 0..mesh.triangles.len() {
            let [a, b, c] = mesh.corners(t);
            let twice_area = (b - a).cross(c - a);
            area += twice_area.length();
            let Some(normal) = twice_area.try_normalize() else { continue };
            let offset = normal.dot(a);
            let outside = mesh.vertices.iter().map(|p| normal.dot(*p)).fold(f64::NEG_INFINITY, f64::max);
            if outside - offset > PLANE_TOLERANCE * size {
                lost += twice_area.length();
                continue;
            }
            let known = |p: &HalfSpacePlane| {
                p.normal.dot(normal) > 1.0 - 1e-9 && (p.offset - outside).abs() < PLANE_TOLERANCE * size
            };
            if !planes.iter().any(known) {
                planes.push(HalfSpacePlane { normal, offset: outside });
            }
        }
        if planes.len() < 4 || lost > LOST_AREA * area {
            return Err(refuse("its faces do not bound a convex volume"));
        }
        foremost_first(&mut planes);
        let center = bounds.center();
        let radius = mesh.vertices.iter().map(|p| p.distance(center)).fold(0.0, f64::max);
        Ok(Self { planes, center, radius, bounds })
    }

    /// Largest signed distance from a plane: exact inside and in front of faces, elsewhere a lower bound.
    fn distance(&self, p: DVec3) -> SurfaceHit {
        let mut best = SurfaceHit { distance: f64::NEG_INFINITY, normal: DVec3::Z };
        for plane in &self.planes {
            let distance = plane.normal.dot(p) - plane.offset;
            if distance > best.distance {
                best = SurfaceHit { distance, normal: plane.normal };
            }
        }
        best
    }

    /// Returns the entry point of a ray from outside within `reach`. A ray that starts inside enters immediately.
    fn ray(&self, origin: DVec3, direction: DVec3, reach: f64) -> Option<SurfaceHit> {
        let (mut enter, mut leave) = (f64::NEG_INFINITY, reach);
        let mut normal = -direction;
        for plane in &self.planes {
            let along = plane.normal.dot(direction);
            let gap = plane.offset - plane.normal.dot(origin);
            if gap < 0.0 && along >= -1e-14 {
                return None;
            }
            if along.abs() < 1e-14 {
                continue;
            }
            let t = gap / along;
            if along > 0.0 {
                leave = leave.min(t);
            } else if t > enter {
                (enter, normal) = (t, plane.normal);
            }
            if enter > leave {
                return None;
            }
        }
        Some(SurfaceHit { distance: enter.max(0.0), normal })
    }

    /// Returns the time at which a point comes within `offset` of the planes; `None` for a point inside that moves
    /// outwards or along a face.
    fn sweep(&self, p: DVec3, v: DVec3, duration: f64, offset: f64) -> Option<SurfaceContact> {
        let close = 1e-3 * offset;
        let (mut enter, mut leave) = (f64::NEG_INFINITY, duration);
        let mut normal = DVec3::Z;
        let (mut nearest, mut nearest_rate, mut nearest_normal) = (f64::NEG_INFINITY, 0.0, DVec3::Z);
        for plane in &self.planes {
            let gap = plane.normal.dot(p) - plane.offset - offset;
            let rate = plane.normal.dot(v);
            if gap > nearest {
                (nearest, nearest_rate, nearest_normal) = (gap, rate, plane.normal);
            }
            if rate < 0.0 {
                let t = -gap / rate;
                if t > enter {
                    (enter, normal) = (t, plane.normal);
                }
            } else if gap > 0.0 {
                return None;
            } else if rate > 0.0 {
                leave = leave.min(-gap / rate);
            }
            // The point is outside this plane and passes behind another before it arrives.
            if nearest > close && enter > leave {
                return None;
            }
        }
        if nearest <= close {
            let hit = SurfaceContact { time: 0.0, normal: nearest_normal, depth: (-nearest).max(0.0) };
            // Motion along a face, up to rounding, is not a contact.
            return (nearest_rate < -1e-6 * v.length()).then_some(hit);
        }
        (enter <= leave).then_some(SurfaceContact { time: enter, normal, depth: 0.0 })
    }
}

/// Moves the planes that face most along each axis, in both directions, to the front.
fn foremost_first(planes: &mut [HalfSpacePlane]) {
    for (done, way) in
        [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z].into_iter().enumerate()
    {
        let facing = |i: &usize| planes[*i].normal.dot(way);
        if let Some(best) = (done..planes.len()).max_by(|a, b| facing(a).total_cmp(&facing(b))) {
            planes.swap(done, best);
        }
    }
}

/// Lower bounds of the distance from a surface, on a grid in the body's frame.
#[derive(Debug, Clone)]
struct DistanceGrid {
    min: DVec3,
    cell: f64,
    inverse: f64,
    /// Extent of the grid, in cells.
    size: DVec3,
    count: [usize; 3],
    bounds: Vec<f32>,
}

impl DistanceGrid {
    fn new(parts: &[ConvexPart], extent: Aabb) -> Self {
        let longest = extent.extents().max_element();
        let margin = GRID_MARGIN * longest;
        let cell = (longest + 2.0 * margin) / GRID_CELLS;
        let min = extent.min - margin;
        let count = (extent.extents() + 2.0 * margin)
            .to_array()
            .map(|length| (length / cell).ceil().max(1.0) as usize);
        let half_diagonal = 0.5 * cell * 3f64.sqrt();
        let mut bounds = Vec::with_capacity(count.iter().product());
        for z in 0..count[2] {
            for y in 0..count[1] {
                for x in 0..count[0] {
                    let center = min + cell * (DVec3::new(x as f64, y as f64, z as f64) + 0.5);
                    // A distance changes by at most the distance moved.
                    bounds.push((nearest(parts, center).distance - half_diagonal) as f32);
                }
            }
        }
        let size = DVec3::from_array(count.map(|n| n as f64));
        Self { min, cell, inverse: 1.0 / cell, size, count, bounds }
    }

    /// Returns a lower bound of the distance at `p`; outside the grid, this is the distance to the grid.
    fn at_least(&self, p: DVec3) -> f64 {
        let u = (p - self.min) * self.inverse;
        let beyond = (u - self.size).max(-u).max_element();
        if beyond > 0.0 {
            return beyond * self.cell;
        }
        let [x, y, z] = std::array::from_fn(|a| (u[a] as usize).min(self.count[a] - 1));
        f64::from(self.bounds[(z * self.count[1] + y) * self.count[0] + x])
    }
}

/// Returns whether a box does not meet the box from `low` to `high`.
#[inline]
pub(crate) fn is_apart(around: &Aabb, low: DVec3, high: DVec3) -> bool {
    around.min.cmpgt(high).any() || around.max.cmplt(low).any()
}

/// Signed distance of a point from the nearest part, and the normal of the nearest face. Exact inside each part and in
/// front of its faces, a lower bound beyond its edges: the zero set has sharp edges.
fn nearest(parts: &[ConvexPart], p: DVec3) -> SurfaceHit {
    let mut best = SurfaceHit { distance: f64::INFINITY, normal: DVec3::Z };
    for part in parts {
        if p.distance(part.center) - part.radius > best.distance {
            continue;
        }
        let found = part.distance(p);
        if found.distance < best.distance {
            best = found;
        }
    }
    best
}

/// The surface of a body in its own frame `B`.
#[derive(Debug, Clone)]
pub struct BodySurface {
    parts: Vec<ConvexPart>,
    extent: Option<Aabb>,
    grid: Option<DistanceGrid>,
}

impl BodySurface {
    /// A union of convex solids, each a closed mesh in `B` with outward triangles.
    ///
    /// # Errors
    /// [`WashError::Part`] when a mesh bounds no convex volume.
    pub fn from_convex(meshes: &[Mesh]) -> Result<Self, WashError> {
        let parts: Vec<_> =
            meshes.iter().enumerate().map(|(i, m)| ConvexPart::from_mesh(i, m)).collect::<Result<_, _>>()?;
        let extent = Aabb::of_points(meshes.iter().flat_map(|m| m.vertices.iter().copied()));
        let grid = extent.map(|extent| DistanceGrid::new(&parts, extent));
        Ok(Self { parts, extent, grid })
    }

    /// A box centred at the origin with these half extents, metres.
    ///
    /// # Errors
    /// [`WashError::Part`] when it has no volume.
    pub fn cuboid(half: DVec3) -> Result<Self, WashError> {
        Self::from_convex(&[Mesh::cuboid(half)])
    }

    /// The half space z < 0: a floor. It stops the air but is not part of the structure.
    pub fn half_space() -> Self {
        let plane = HalfSpacePlane { normal: DVec3::Z, offset: 0.0 };
        let bounds = Aabb { min: DVec3::NEG_INFINITY, max: DVec3::INFINITY };
        let part = ConvexPart { planes: vec![plane], center: DVec3::ZERO, radius: f64::INFINITY, bounds };
        Self { parts: vec![part], extent: None, grid: None }
    }

    /// A surface without parts.
    pub fn empty() -> Self {
        Self { parts: Vec::new(), extent: None, grid: None }
    }

    /// Whether this is the half space.
    pub(crate) fn is_half_space(&self) -> bool {
        self.extent.is_none() && !self.parts.is_empty()
    }

    /// Bounding box in `B`; `None` for a half space and for an empty surface.
    pub fn extent(&self) -> Option<Aabb> {
        self.extent
    }

    /// Bounding box in the world, metres.
    pub fn extent_w(&self, x_wb: &DPose3) -> Option<Aabb> {
        let extent = self.extent?;
        let corner = |i: usize| {
            let pick = |axis: usize| if i >> axis & 1 == 0 { extent.min[axis] } else { extent.max[axis] };
            x_wb.transform_point(DVec3::new(pick(0), pick(1), pick(2)))
        };
        Aabb::of_points((0..8).map(corner))
    }

    /// Returns a cheap lower bound of the distance at a point of `B`, metres.
    pub fn distance_at_least(&self, p_b: DVec3) -> f64 {
        match &self.grid {
            Some(grid) => grid.at_least(p_b),
            None => nearest(&self.parts, p_b).distance,
        }
    }

    /// Returns the time at which a point at `p_b` with velocity `v_b` first comes within `offset` of the surface while
    /// not moving away. Thin parts are not missed.
    pub(crate) fn sweep(&self, p_b: DVec3, v_b: DVec3, duration: f64, offset: f64) -> Option<SurfaceContact> {
        let end_b = p_b + duration * v_b;
        // The offset surface has corners farther out than the offset; four times covers right angles.
        let (low, high) = (p_b.min(end_b) - 4.0 * offset, p_b.max(end_b) + 4.0 * offset);
        let mut best: Option<SurfaceContact> = None;
        for part in &self.parts {
            if is_apart(&part.bounds, low, high) {
                continue;
            }
            let limit = best.map_or(duration, |b| b.time);
            best = part.sweep(p_b, v_b, limit, offset).or(best);
        }
        best
    }

    /// First point of the surface on a ray of `B` within `reach` metres; `direction_b` is a unit vector.
    pub fn ray(&self, origin_b: DVec3, direction_b: DVec3, reach: f64) -> Option<SurfaceHit> {
        if let Some(grid) = &self.grid {
            // Sphere tracing: the ray advances by the lower bound.
            let mut gone = 0.0;
            loop {
                let free = grid.at_least(origin_b + gone * direction_b);
                if free < 0.5 * grid.cell {
                    break;
                }
                gone += free;
                if gone > reach {
                    return None;
                }
            }
        }
        let end_b = origin_b + reach * direction_b;
        let (low, high) = (origin_b.min(end_b), origin_b.max(end_b));
        let mut best: Option<SurfaceHit> = None;
        for part in &self.parts {
            if is_apart(&part.bounds, low, high) {
                continue;
            }
            let limit = best.map_or(reach, |b| b.distance);
            best = part.ray(origin_b, direction_b, limit).filter(|hit| hit.distance <= limit).or(best);
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plank() -> BodySurface {
        let upper = Mesh::cuboid(DVec3::new(0.3, 0.1, 0.01));
        let leg = Mesh::cuboid(DVec3::new(0.02, 0.02, 0.2))
            .transformed(&DPose3::from_translation(DVec3::new(0.25, 0.0, -0.21)));
        BodySurface::from_convex(&[upper, leg]).unwrap()
    }

    #[test]
    fn distances_of_a_box_are_exact_before_its_faces_and_inside() {
        let body = plank();
        let at = |x: f64, y: f64, z: f64| nearest(&body.parts, DVec3::new(x, y, z));
        assert!((at(0.0, 0.0, 0.05).distance - 0.04).abs() < 1e-12);
        assert_eq!(at(0.0, 0.0, 0.05).normal, DVec3::Z);
        assert!((at(0.0, 0.0, 0.004).distance + 0.006).abs() < 1e-12);
        assert!((at(0.25, 0.05, -0.3).distance - 0.03).abs() < 1e-12);
    }

    /// The grid never exceeds the distance, and is rarely much smaller far from the surface.
    #[test]
    fn the_grid_bounds_the_distance_from_below() {
        let body = plank();
        let mut useful = 0;
        for i in 0..4000u32 {
            let f = |k: f64| (f64::from(i) * k).fract() - 0.5;
            let p = DVec3::new(1.6 * f(0.618_034), 1.0 * f(0.414_214), 1.4 * f(0.732_051) - 0.2);
            let (bound, exact) = (body.distance_at_least(p), nearest(&body.parts, p).distance);
            // Beyond the grid the bound is the distance to it, which is at most the Euclidean distance.
            assert!(bound <= exact.max(0.0) + 1e-9 || bound <= exact + 1e-6, "{p}: {bound} {exact}");
            useful += usize::from(exact > 0.15 && bound > 0.02);
        }
        assert!(useful > 1000, "{useful}");
    }

    #[test]
    fn rays_meet_the_first_surface() {
        let body = plank();
        let down = body.ray(DVec3::new(0.25, 0.0, 1.0), DVec3::NEG_Z, 2.0).unwrap();
        assert!((down.distance - 0.99).abs() < 1e-12 && down.normal == DVec3::Z);
        assert!(body.ray(DVec3::new(0.25, 0.0, 1.0), DVec3::NEG_Z, 0.9).is_none());
        let side = body.ray(DVec3::new(-1.0, 0.0, -0.2), DVec3::X, 5.0).unwrap();
        assert!((side.distance - 1.23).abs() < 1e-12 && side.normal == DVec3::NEG_X);
        assert!(body.ray(DVec3::new(-1.0, 0.5, -0.2), DVec3::X, 5.0).is_none());
        let floor = BodySurface::half_space().ray(DVec3::new(0.0, 0.0, 2.0), DVec3::NEG_Z, 5.0).unwrap();
        assert!((floor.distance - 2.0).abs() < 1e-12);
    }

    #[test]
    fn a_mesh_that_is_not_convex_is_refused() {
        let mut mesh = Mesh::cuboid(DVec3::splat(0.1));
        let dent = mesh.vertices.len() as u32;
        mesh.vertices.push(DVec3::ZERO);
        let [a, b, c] = mesh.triangles[0];
        mesh.triangles[0] = [a, b, dent];
        mesh.triangles.push([b, c, dent]);
        mesh.triangles.push([c, a, dent]);
        assert!(matches!(BodySurface::from_convex(&[mesh]), Err(WashError::Part { part: 0, .. })));
    }
}
