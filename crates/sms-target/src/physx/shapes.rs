//! Collision shapes, cooked once per world.

use super::contacts::MODIFIED;
use super::sdk::{Sdk, take_error};
use super::tuning::Tuning;
use glamx::{DPose3, DQuat, DVec3};
use physx_sys::*;
use sms_core::Mesh;
use sms_mesh::convex_hull;
use sms_scene::BodyShape;
use std::borrow::Cow;
use std::ptr::{from_ref, null_mut};

/// Corners of the prism that models a cylinder: PhysX 5.1 has no cylinder, and a hull may have 255 corners.
const CYLINDER_SEGMENTS: usize = 96;

/// Largest number of corners of a hull: a hull of triangles has 252 faces then. PhysX builds at most 255 faces and
/// silently truncates a hull with more.
const MOST_CORNERS: usize = 128;

/// Distance from the hull under construction within which PhysX omits further corners, metres. Its default is at least
/// 0.7 mm, even for small hulls.
const PLANE_TOLERANCE: f32 = 1e-6;

/// Contact properties of a shape.
#[derive(Debug, Clone, Copy)]
pub(super) struct Surface {
    pub(super) friction: f64,
    pub(super) restitution: f64,
}

/// A shared shape; holds one reference.
pub(super) struct Shape(*mut PxShape);

// SAFETY: shapes change only before they are first attached; afterwards only their reference count changes, under the
// SDK's lock.
unsafe impl Send for Shape {}

impl Shape {
    pub(super) fn as_ptr(&self) -> *mut PxShape {
        self.0
    }
}

impl Drop for Shape {
    fn drop(&mut self) {
        let _lock = Sdk::get().lock();
        // SAFETY: `self` owns one reference; actors hold their own.
        unsafe { PxShape_release_mut(self.0) };
    }
}

pub(super) fn vector(v: DVec3) -> PxVec3 {
    PxVec3 { x: v.x as f32, y: v.y as f32, z: v.z as f32 }
}

pub(super) fn transform(x: &DPose3) -> PxTransform {
    let q = x.rotation.normalize();
    PxTransform {
        q: PxQuat { x: q.x as f32, y: q.y as f32, z: q.z as f32, w: q.w as f32 },
        p: vector(x.translation),
    }
}

/// Creates shapes of one surface in one collision group.
pub(super) struct Shaper<'a> {
    pub(super) surface: Surface,
    pub(super) group: u16,
    pub(super) is_ball: bool,
    pub(super) tuning: &'a Tuning,
}

impl Shaper<'_> {
    /// Creates the shapes of a body, in its frame.
    ///
    /// # Errors
    /// The reason why it cannot be simulated.
    pub(super) fn body(&self, shape: &BodyShape) -> Result<Vec<Shape>, String> {
        match shape {
            BodyShape::Sphere { radius } => self.sphere(*radius).map(|s| vec![s]),
            BodyShape::Box { half_extents } => self.cuboid(*half_extents).map(|s| vec![s]),
            BodyShape::Cylinder { radius, half_length } => {
                self.hull(0, &Mesh::cylinder(*radius, *half_length, CYLINDER_SEGMENTS)).map(|s| vec![s])
            }
            BodyShape::HalfSpace => self.half_space().map(|s| vec![s]),
            BodyShape::Hulls { hulls } if hulls.is_empty() => Err("it has no hulls".to_owned()),
            BodyShape::Hulls { hulls } => {
                let parts = hulls
                    .iter()
                    .enumerate()
                    .flat_map(|(i, h)| within_limits(h).into_iter().map(move |p| (i, p)));
                parts.map(|(i, part)| self.hull(i, &part)).collect()
            }
            BodyShape::TriMesh { mesh } => self.mesh(mesh).map(|s| vec![s]),
        }
    }

    fn sphere(&self, radius: f64) -> Result<Shape, String> {
        // SAFETY: a constructor of plain data.
        let sphere = unsafe { PxSphereGeometry_new(radius as f32) };
        self.shape(from_ref(&sphere).cast(), &DPose3::IDENTITY)
    }

    /// Creates a box about the origin with these half extents, metres.
    ///
    /// # Errors
    /// The reason why it cannot be simulated.
    pub(super) fn cuboid(&self, half: DVec3) -> Result<Shape, String> {
        // SAFETY: a constructor of plain data.
        let cuboid = unsafe { PxBoxGeometry_new_1(vector(half)) };
        self.shape(from_ref(&cuboid).cast(), &DPose3::IDENTITY)
    }

    fn half_space(&self) -> Result<Shape, String> {
        // PhysX's planes have the normal x.
        let upward = DPose3::from_parts(DVec3::ZERO, DQuat::from_rotation_arc(DVec3::X, DVec3::Z));
        // SAFETY: a constructor of plain data.
        let plane = unsafe { PxPlaneGeometry_new() };
        self.shape(from_ref(&plane).cast(), &upward)
    }

    fn hull(&self, index: usize, mesh: &Mesh) -> Result<Shape, String> {
        let points: Vec<PxVec3> = mesh.vertices.iter().map(|&v| vector(v)).collect();
        if points.len() < 4 || !mesh.vertices.iter().all(|v| v.is_finite()) {
            return Err(format!("hull {index} has no volume"));
        }
        let sdk = Sdk::get();
        // SAFETY: the descriptor points to `points`, which outlives the call; the mesh's reference is released after
        // the shape has taken its own.
        let cooked = {
            let _lock = sdk.lock();
            take_error();
            unsafe {
                let mut parameters = PxCookingParams_new(sdk.scale());
                parameters.planeTolerance = PLANE_TOLERANCE;
                let mut description = PxConvexMeshDesc_new();
                description.points.count = points.len() as u32;
                description.points.stride = size_of::<PxVec3>() as u32;
                description.points.data = points.as_ptr().cast();
                description.flags = PxConvexFlags::ComputeConvex;
                phys_PxCreateConvexMesh(
                    &parameters,
                    &description,
                    phys_PxGetStandaloneInsertionCallback(),
                    null_mut(),
                )
            }
        };
        if cooked.is_null() {
            let why = take_error().unwrap_or_else(|| "it has no volume".to_owned());
            return Err(format!("hull {index} cannot be used: {why}"));
        }
        // SAFETY: `cooked` is a mesh that this function owns.
        let geometry = unsafe {
            PxConvexMeshGeometry_new(cooked, &PxMeshScale_new(), PxConvexMeshGeometryFlags::empty())
        };
        let shape = self.shape(from_ref(&geometry).cast(), &DPose3::IDENTITY);
        let _lock = sdk.lock();
        // SAFETY: releases this function's reference.
        unsafe { PxConvexMesh_release_mut(cooked) };
        shape
    }

    fn mesh(&self, mesh: &Mesh) -> Result<Shape, String> {
        let points: Vec<PxVec3> = mesh.vertices.iter().map(|&v| vector(v)).collect();
        let is_sound = mesh.vertices.iter().all(|v| v.is_finite())
            && mesh.triangles.iter().flatten().all(|&i| (i as usize) < points.len());
        if mesh.triangles.is_empty() || !is_sound {
            return Err("its mesh cannot be used: it has no triangles or a bad index".to_owned());
        }
        let sdk = Sdk::get();
        let cooked = {
            let _lock = sdk.lock();
            take_error();
            // SAFETY: the descriptor points to `points` and the triangles, which outlive the call; indices are in
            // range.
            unsafe {
                let parameters = PxCookingParams_new(sdk.scale());
                let mut description = PxTriangleMeshDesc_new();
                description.points.count = points.len() as u32;
                description.points.stride = size_of::<PxVec3>() as u32;
                description.points.data = points.as_ptr().cast();
                description.triangles.count = mesh.triangles.len() as u32;
                description.triangles.stride = size_of::<[u32; 3]>() as u32;
                description.triangles.data = mesh.triangles.as_ptr().cast();
                phys_PxCreateTriangleMesh(
                    &parameters,
                    &description,
                    phys_PxGetStandaloneInsertionCallback(),
                    null_mut(),
                )
            }
        };
        if cooked.is_null() {
            let why = take_error().unwrap_or_else(|| "PhysX rejected it".to_owned());
            return Err(format!("its mesh cannot be used: {why}"));
        }
        // The normals of a reconstructed surface may point to either side.
        // SAFETY: `cooked` is a mesh that this function owns.
        let geometry = unsafe {
            PxTriangleMeshGeometry_new(cooked, &PxMeshScale_new(), PxMeshGeometryFlags::DoubleSided)
        };
        let shape = self.shape(from_ref(&geometry).cast(), &DPose3::IDENTITY);
        let _lock = sdk.lock();
        // SAFETY: releases this function's reference.
        unsafe { PxTriangleMesh_release_mut(cooked) };
        shape
    }

    fn shape(&self, geometry: *const PxGeometry, x_bs: &DPose3) -> Result<Shape, String> {
        let sdk = Sdk::get();
        let _lock = sdk.lock();
        take_error();
        let (friction, restitution) = (self.surface.friction as f32, self.surface.restitution as f32);
        // SAFETY: `geometry` points to a geometry of the caller; PhysX copies it. The shape takes its own reference to
        // the material, so this one is released. The shape is not attached yet and may change.
        unsafe {
            let material = PxPhysics_createMaterial_mut(sdk.physics(), friction, friction, restitution);
            if material.is_null() {
                return Err("PhysX cannot create another material".to_owned());
            }
            // PhysX's default combine rule is the mean, like ours.
            PxMaterial_setFlags_mut(material, self.tuning.material_flags);
            let shape = PxPhysics_createShape_mut(
                sdk.physics(),
                geometry,
                material,
                false,
                PxShapeFlags::SimulationShape,
            );
            PxRefCounted_release_mut(material.cast());
            if shape.is_null() {
                return Err(take_error().unwrap_or_else(|| "PhysX rejected its shape".to_owned()));
            }
            let modified = if self.is_ball && self.tuning.velocity_friction { MODIFIED } else { 0 };
            PxShape_setLocalPose_mut(shape, &transform(x_bs));
            if let Some(offset) = self.tuning.contact_offset {
                PxShape_setRestOffset_mut(shape, 0.0);
                PxShape_setContactOffset_mut(shape, offset);
            }
            PxShape_setSimulationFilterData_mut(
                shape,
                &PxFilterData_new_2(u32::from(self.group), modified, 0, 0),
            );
            Ok(Shape(shape))
        }
    }
}

/// Cuts a hull into parts that PhysX can build.
fn within_limits(hull: &Mesh) -> Vec<Cow<'_, Mesh>> {
    let too_many = hull.vertices.len() > MOST_CORNERS && hull.vertices.iter().all(|v| v.is_finite());
    match too_many.then(|| halves(hull)).flatten() {
        Some(halves) => halves
            .iter()
            .flat_map(|half| within_limits(half).into_iter().map(|p| Cow::Owned(p.into_owned())))
            .collect(),
        None => vec![Cow::Borrowed(hull)],
    }
}

/// Cuts a hull in two across its longest side. `None` if a half has as many corners as the hull, or no volume.
fn halves(hull: &Mesh) -> Option<[Mesh; 2]> {
    let whole = convex_hull(&hull.vertices, usize::MAX, 0.0)?;
    let bounds = whole.aabb()?;
    let (center, extents) = (bounds.center(), bounds.extents());
    let axis = [DVec3::X, DVec3::Y, DVec3::Z]
        .into_iter()
        .max_by(|a, b| a.dot(extents).total_cmp(&b.dot(extents)))?;
    let height = |p: DVec3| axis.dot(p - center);
    let mut cut = Vec::new();
    for [a, b, c] in (0..whole.triangles.len()).map(|t| whole.corners(t)) {
        for (p, q) in [(a, b), (b, c), (c, a)] {
            // Visits each edge once: the adjacent triangle has it in the opposite direction.
            if height(p) < 0.0 && height(q) > 0.0 {
                cut.push(p.lerp(q, height(p) / (height(p) - height(q))));
            }
        }
    }
    let half = |sign: f64| {
        let corners = whole.vertices.iter().copied().filter(|&v| sign * height(v) >= 0.0);
        let corners: Vec<DVec3> = corners.chain(cut.iter().copied()).collect();
        convex_hull(&corners, usize::MAX, 0.0).filter(|h| h.vertices.len() < whole.vertices.len())
    };
    Some([half(-1.0)?, half(1.0)?])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns an egg with a flat bottom, like parts of statues and toys.
    #[test]
    fn a_hull_of_many_corners_is_cut_and_loses_nothing() {
        let scale = DVec3::new(0.03, 0.035, 0.045);
        let round = Mesh::icosphere(1.0, 2).vertices.into_iter().map(|v| v * scale);
        let egg = Mesh::new(round.map(|v| v.with_z(v.z.max(-0.03))).collect(), Vec::new());
        let parts = within_limits(&egg);
        assert!(egg.vertices.len() > MOST_CORNERS && parts.len() > 1);
        assert!(parts.iter().all(|p| p.vertices.len() <= MOST_CORNERS && p.triangles.len() <= 255));
        let whole = convex_hull(&egg.vertices, usize::MAX, 0.0).unwrap().volume();
        let volume: f64 = parts.iter().map(|p| p.volume()).sum();
        assert!((volume / whole - 1.0).abs() < 1e-9, "{volume} of {whole}");
        let cube = Mesh::cuboid(DVec3::ONE);
        assert_eq!(within_limits(&cube), [Cow::Borrowed(&cube)]);
    }
}
