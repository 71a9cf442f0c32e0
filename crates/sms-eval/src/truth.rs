//! The truth as a reference for results: surfaces of the objects, the parts visible to cameras, and noise-free views.
//!
//! Everything is in the world `T` of the generator; `x_tw` maps results to this world.

use crate::surface_index::{SurfaceIndex, sample_triangles};
use glamx::{DPose3, DVec3};
use parry3d_f64::query::{Ray, RayCast};
use parry3d_f64::shape::TriMesh;
use rayon::prelude::*;
use sms_core::{Aabb, Camera, DepthImage, LabelMap, Mesh, Seed};
use sms_synth::{CameraModel, Renderer, TruthScene};

/// The true surface of one object.
#[derive(Debug)]
pub struct TrueSurface {
    /// The object's name.
    pub name: String,
    /// Closed surface in the truth's world; for a sphere, a polyhedron that approximates it.
    pub mesh: Mesh,
    /// Centre and radius of an exact sphere; its distances are exact.
    pub sphere: Option<(DVec3, f64)>,
    /// The box around the surface.
    pub(crate) bounds: Aabb,
    index: SurfaceIndex,
}

impl TrueSurface {
    /// Creates the surface of a mesh, or of an exact sphere; `None` for a mesh without triangles.
    pub fn new(name: impl Into<String>, mesh: Mesh, sphere: Option<(DVec3, f64)>) -> Option<Self> {
        let bounds = mesh.aabb()?;
        Some(Self { name: name.into(), index: SurfaceIndex::new(&mesh)?, bounds, mesh, sphere })
    }

    /// The closest surface point to `p` and the outward unit normal there.
    pub fn closest(&self, p: DVec3) -> (DVec3, DVec3) {
        if let Some((center, radius)) = self.sphere {
            let normal = (p - center).normalize_or(DVec3::Z);
            return (center + normal * radius, normal);
        }
        let hit = self.index.closest(p);
        let [a, b, c] = self.mesh.corners(hit.triangle as usize);
        (hit.point, (b - a).cross(c - a).normalize_or_zero())
    }

    /// Distance of `p` to the surface, metres.
    pub fn distance(&self, p: DVec3) -> f64 {
        match self.sphere {
            Some((center, radius)) => ((p - center).length() - radius).abs(),
            None => self.index.closest(p).distance,
        }
    }
}

/// The surfaces of a scene's objects; object `i` has label `i + 1` in true label maps.
pub fn true_surfaces(scene: &TruthScene) -> Vec<TrueSurface> {
    let surface = |o: &sms_synth::TruthObject| {
        TrueSurface::new(o.name.clone(), o.mesh_w(), o.sphere_radius.map(|r| (o.x_wb.translation, r)))
    };
    scene.objects.iter().filter_map(surface).collect()
}

/// A point of a true surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// Position.
    pub point: DVec3,
    /// Outward unit normal.
    pub normal: DVec3,
}

/// Points spread evenly over a surface, about `spacing` metres apart (stratified over the area; the same seed gives the
/// same points).
pub fn sample_true_surface(surface: &TrueSurface, spacing: f64, seed: Seed) -> Vec<SurfacePoint> {
    let mesh = &surface.mesh;
    let count = (mesh.area() / (spacing * spacing)).round() as usize;
    sample_triangles(mesh, count, &mut seed.derive(&surface.name).rng())
        .into_iter()
        .map(|(t, point)| {
            let [a, b, c] = mesh.corners(t);
            match surface.sphere {
                Some((center, radius)) => {
                    let normal = (point - center).normalize_or(DVec3::Z);
                    SurfacePoint { point: center + normal * radius, normal }
                }
                None => SurfacePoint { point, normal: (b - a).cross(c - a).normalize_or_zero() },
            }
        })
        .collect()
}

/// Distance between samples of the observed surface, metres.
pub const OBSERVED_SPACING_M: f64 = 0.001;
/// Smallest number of cameras that see a point of the observed surface.
pub const OBSERVED_BY: usize = 3;

/// Returns the observed surface of each object: samples [`OBSERVED_SPACING_M`] apart that at least [`OBSERVED_BY`] of
/// the cameras see. A camera sees a point if the point projects into the image, the surface faces the camera (any
/// positive cosine between normal and line of sight), and no object hides the point (a ray is cast against all true
/// surfaces). `cameras` are the true ones of the training frames. On large surfaces, samples are farther apart, so that
/// there are at most about `samples` before the unseen ones are removed.
pub fn observed_surface_at_most(
    surfaces: &[TrueSurface],
    cameras: &[Camera],
    samples: usize,
) -> Vec<Vec<SurfacePoint>> {
    let blockers = Blockers::new(surfaces);
    surfaces
        .iter()
        .map(|surface| {
            let spacing = OBSERVED_SPACING_M.max((surface.mesh.area() / samples as f64).sqrt());
            let samples = sample_true_surface(surface, spacing, Seed(0).derive("observed surface"));
            let seen: Vec<bool> = samples
                .par_iter()
                .map(|s| {
                    let sees = |camera: &&Camera| blockers.sees(camera, s);
                    cameras.iter().filter(sees).take(OBSERVED_BY).count() == OBSERVED_BY
                })
                .collect();
            samples.into_iter().zip(seen).filter(|(_, seen)| *seen).map(|(s, _)| s).collect()
        })
        .collect()
}

/// Occluders: meshes of all objects, and exact spheres.
struct Blockers {
    meshes: Vec<TriMesh>,
    spheres: Vec<(DVec3, f64)>,
}

impl Blockers {
    fn new(surfaces: &[TrueSurface]) -> Self {
        let mesh = |s: &TrueSurface| TriMesh::new(s.mesh.vertices.clone(), s.mesh.triangles.clone()).ok();
        Self {
            meshes: surfaces.iter().filter(|s| s.sphere.is_none()).filter_map(mesh).collect(),
            spheres: surfaces.iter().filter_map(|s| s.sphere).collect(),
        }
    }

    fn sees(&self, camera: &Camera, s: &SurfacePoint) -> bool {
        /// Rays start this far off the surface, so that the surface does not hide its own points.
        const LIFT_M: f64 = 1e-5;
        let to_eye = camera.center_w() - s.point;
        if to_eye.dot(s.normal) <= 0.0 {
            return false;
        }
        let inside = camera.project(s.point).and_then(|(u, v, _)| camera.pixel_at(u, v)).is_some();
        if !inside {
            return false;
        }
        let origin = s.point + s.normal * LIFT_M;
        let direction = camera.center_w() - origin;
        let behind_sphere = self.spheres.iter().any(|&(center, radius)| {
            let along = (center - origin).dot(direction) / direction.length_squared();
            let nearest = origin + direction * along.clamp(0.0, 1.0);
            (nearest - center).length() < radius
        });
        let ray = Ray::new(origin, direction);
        !behind_sphere && !self.meshes.iter().any(|m| m.intersects_local_ray(&ray, 1.0))
    }
}

/// A view without noise.
#[derive(Debug, Clone, PartialEq)]
pub struct TrueView {
    /// Depth along the optical axis at pixel centres, metres; 0 where nothing is hit.
    pub depth: DepthImage,
    /// Object index + 1, 0 for the floor and beyond.
    pub label: LabelMap,
}

/// Renders true views of cameras in the truth's world.
pub fn true_views(scene: &TruthScene, cameras: &[Camera]) -> Vec<TrueView> {
    let model = CameraModel { antialias: false, ..CameraModel::perfect() };
    let renderer = Renderer::new(scene);
    let view = |camera: &Camera| {
        let frame = renderer.render(camera, &model);
        TrueView { depth: frame.depth, label: frame.label }
    };
    cameras.iter().map(view).collect()
}

/// Transforms a camera into another world: `x_aw` maps `W` to `A`.
pub fn carried(camera: &Camera, x_aw: &DPose3) -> Camera {
    Camera::new(camera.intrinsics, *x_aw * camera.x_wc)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::Intrinsics;

    fn observed_surface(surfaces: &[TrueSurface], cameras: &[Camera]) -> Vec<Vec<SurfacePoint>> {
        observed_surface_at_most(surfaces, cameras, usize::MAX)
    }

    fn ring(height: f64, count: usize) -> Vec<Camera> {
        (0..count)
            .map(|i| {
                let angle = std::f64::consts::TAU * i as f64 / count as f64;
                let eye = DVec3::new(angle.cos(), angle.sin(), height);
                Camera::look_at(Intrinsics::from_fov(64, 48, 0.8), eye, DVec3::ZERO, DVec3::Z)
            })
            .collect()
    }

    #[test]
    fn three_cameras_at_one_side_of_a_cube_observe_that_face_and_no_other() {
        let cube = TrueSurface::new("cube", Mesh::cuboid(DVec3::splat(0.05)), None).unwrap();
        let camera = |y: f64| {
            let k = Intrinsics::from_fov(64, 48, 0.8);
            Camera::look_at(k, DVec3::new(1.0, y, 0.0), DVec3::ZERO, DVec3::Z)
        };
        let cameras = [camera(-0.02), camera(0.0), camera(0.02)];
        let observed = observed_surface(std::slice::from_ref(&cube), &cameras);
        assert_eq!(observed[0].len(), 10_000);
        assert!(observed[0].iter().all(|s| s.normal == DVec3::X && (s.point.x - 0.05).abs() < 1e-12));
        // Two cameras are too few.
        assert!(observed_surface(std::slice::from_ref(&cube), &cameras[..2])[0].is_empty());
        // A ring from above sees the top and the four sides.
        let observed = observed_surface(std::slice::from_ref(&cube), &ring(0.8, 12));
        assert_eq!(observed[0].len(), 50_000);
        // A wall in front hides the cube.
        let wall = Mesh::cuboid(DVec3::new(0.001, 0.3, 0.3));
        let wall = wall.transformed(&DPose3::from_translation(DVec3::X * 0.5));
        let wall = TrueSurface::new("wall", wall, None).unwrap();
        assert!(observed_surface(&[cube, wall], &cameras)[0].is_empty());
    }

    #[test]
    fn spheres_are_exact_and_hide() {
        let sphere = |x: f64, name: &str| {
            let mesh = Mesh::icosphere(0.05, 2).transformed(&DPose3::from_translation(DVec3::X * x));
            TrueSurface::new(name, mesh, Some((DVec3::X * x, 0.05))).unwrap()
        };
        let ball = sphere(0.0, "ball");
        assert!((ball.distance(DVec3::new(0.0, 0.03, 0.04)) - 0.0).abs() < 1e-15);
        assert!((ball.distance(DVec3::new(0.0, 0.0, 0.02)) - 0.03).abs() < 1e-15);
        let cameras = ring(0.0, 12);
        let all = observed_surface(&[ball], &cameras)[0].len();
        assert!(all > 28_000, "{all}");
        // From +x alone, a ball in front hides all of the ball behind.
        let near = [cameras[0]; 3];
        let observed = observed_surface(&[sphere(0.0, "back"), sphere(0.3, "front")], &near);
        assert!(observed[0].is_empty() && observed[1].len() > 10_000);
    }
}
