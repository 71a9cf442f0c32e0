//! The surfaces of a scene against recorded depth: a truth that every recording carries.

use glamx::DVec3;
use parry3d_f64::query::{Ray, RayCast};
use parry3d_f64::shape::TriMesh;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sms_core::{Camera, DepthImage};
use sms_scene::{Body, BodyShape, Scene};
use std::ops::AddAssign;

/// Largest distance along the axis at which a surface agrees with a measurement: constant part, metres, and share of the depth.
pub const AGREES_M: f64 = 0.005;
/// See [`AGREES_M`].
pub const AGREES_SHARE: f64 = 0.01;

/// Numbers of measured pixels by the place of the first surface of the scene.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DepthAgreement {
    /// Pixels with a measurement.
    pub measured: usize,
    /// … where the first surface lies at the measured depth.
    pub agrees: usize,
    /// … where it lies in front of that: the camera looked through it.
    pub false_surface: usize,
    /// … where it lies behind, or where there is none.
    pub hole: usize,
}

impl DepthAgreement {
    /// Returns the shares of measured pixels that agree, that show a false surface, and that show a hole; `None` without
    /// measurements.
    pub fn shares(&self) -> Option<[f64; 3]> {
        let share = |count: usize| count as f64 / self.measured as f64;
        (self.measured > 0).then(|| [self.agrees, self.false_surface, self.hole].map(share))
    }
}

impl AddAssign for DepthAgreement {
    fn add_assign(&mut self, other: Self) {
        self.measured += other.measured;
        self.agrees += other.agrees;
        self.false_surface += other.false_surface;
        self.hole += other.hole;
    }
}

/// The agreement of a scene with recorded depth.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SceneAgreement {
    /// All measured pixels.
    pub all: DepthAgreement,
    /// The pixels whose first surface is that of each body, in the order of the scene. Pixels without a surface are in none.
    pub bodies: Vec<DepthAgreement>,
}

impl AddAssign<&Self> for SceneAgreement {
    fn add_assign(&mut self, other: &Self) {
        self.all += other.all;
        self.bodies.resize(self.bodies.len().max(other.bodies.len()), DepthAgreement::default());
        self.bodies.iter_mut().zip(&other.bodies).for_each(|(sum, body)| *sum += *body);
    }
}

/// Casts a ray through every `step`-th pixel of depth images in both directions, and compares the first surface of the scene with
/// the measured depth (metres; 0 without a measurement). Returns the agreement of each view.
pub fn depth_agreement(scene: &Scene, views: &[(Camera, &DepthImage)], step: usize) -> Vec<SceneAgreement> {
    let surfaces: Vec<Surface<'_>> = scene.bodies.iter().map(Surface::of).collect();
    let of_view = |(camera, depth): &(Camera, &DepthImage)| {
        let bodies = vec![DepthAgreement::default(); surfaces.len()];
        let mut sum = SceneAgreement { bodies, ..SceneAgreement::default() };
        for y in (0..depth.height).step_by(step.max(1)) {
            for x in (0..depth.width).step_by(step.max(1)) {
                let z = f64::from(depth[(x, y)]);
                if z > 0.0 && z.is_finite() {
                    let first = first_surface(&surfaces, camera, x, y);
                    let found = compared(z, first.map(|(_, depth)| depth));
                    sum.all += found;
                    first.into_iter().for_each(|(body, _)| sum.bodies[body] += found);
                }
            }
        }
        sum
    };
    views.par_iter().map(of_view).collect()
}

/// Returns the comparison of one pixel; `first` is the depth of the first surface.
fn compared(measured_m: f64, first: Option<f64>) -> DepthAgreement {
    let off = first.map_or(f64::INFINITY, |z| z - measured_m);
    let most = AGREES_M + AGREES_SHARE * measured_m;
    let is = |condition: bool| usize::from(condition);
    DepthAgreement {
        measured: 1,
        agrees: is(off.abs() <= most),
        false_surface: is(off < -most),
        hole: is(off > most),
    }
}

/// Returns the body whose surface is first along the ray of a pixel, and its depth along the axis.
fn first_surface(surfaces: &[Surface<'_>], camera: &Camera, x: usize, y: usize) -> Option<(usize, f64)> {
    let eye_w = camera.center_w();
    // Scaled so that its parameter is the depth.
    let ray_w = camera.unproject_pixel(x, y, 1.0) - eye_w;
    let hit = |(body, surface): (usize, &Surface<'_>)| Some((body, surface.depth_of(eye_w, ray_w)?));
    surfaces.iter().enumerate().filter_map(hit).min_by(|a, b| a.1.total_cmp(&b.1))
}

/// The visual surface of a body.
struct Surface<'a> {
    body: &'a Body,
    /// `None` for a half space, and for a body without triangles.
    mesh: Option<TriMesh>,
}

impl<'a> Surface<'a> {
    fn of(body: &'a Body) -> Self {
        let is_plane = matches!(body.shape, BodyShape::HalfSpace);
        let visual = || TriMesh::new(body.visual.vertices.clone(), body.visual.triangles.clone()).ok();
        Self { body, mesh: if is_plane { None } else { visual() } }
    }

    /// Returns the parameter of the first point of the ray on the surface.
    fn depth_of(&self, eye_w: DVec3, ray_w: DVec3) -> Option<f64> {
        let x_bw = self.body.x_wb.inverse();
        let (eye_b, ray_b) = (x_bw.transform_point(eye_w), x_bw.rotation * ray_w);
        if matches!(self.body.shape, BodyShape::HalfSpace) {
            let t = -eye_b.z / ray_b.z;
            return (t.is_finite() && t > 0.0).then_some(t);
        }
        self.mesh.as_ref()?.cast_local_ray(&Ray::new(eye_b, ray_b), f64::MAX, false)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DPose3;
    use sms_core::{Image, Intrinsics, Mesh};
    use sms_scene::{SCENE_VERSION, example_material, floor_body};

    /// A box of 20 cm on a floor, and a camera 1 m above the floor that looks down on both.
    fn box_from_above() -> (Scene, Camera) {
        let mut body = floor_body(0.0, example_material());
        body.name = "box".into();
        body.shape = BodyShape::Box { half_extents: DVec3::splat(0.1) };
        body.visual = Mesh::cuboid(DVec3::splat(0.1));
        body.x_wb = DPose3::from_translation(DVec3::Z * 0.1);
        let scene = Scene {
            version: SCENE_VERSION,
            name: "t".into(),
            gravity_w: DVec3::NEG_Z,
            size_sigma: 0.0,
            x_world_recording: DPose3::identity(),
            bodies: vec![floor_body(0.0, example_material()), body],
        };
        let k = Intrinsics::from_fov(60, 40, 0.8);
        (scene, Camera::look_at(k, DVec3::Z, DVec3::ZERO, DVec3::Y))
    }

    /// Depth of the box's top or of the floor at each pixel, by the closed form.
    fn depth_of(camera: &Camera, is_there: bool) -> DepthImage {
        let mut depth = Image::filled(60, 40, 0.0f32);
        for y in 0..40 {
            for x in 0..60 {
                let top = camera.unproject_pixel(x, y, 0.8);
                let is_on = is_there && top.x.abs() < 0.1 && top.y.abs() < 0.1;
                depth[(x, y)] = if is_on { 0.8 } else { 1.0 };
            }
        }
        depth
    }

    /// The sum over all views.
    fn agreement_of(scene: &Scene, views: &[(Camera, &DepthImage)], step: usize) -> SceneAgreement {
        let mut sum = SceneAgreement::default();
        depth_agreement(scene, views, step).iter().for_each(|of_view| sum += of_view);
        sum
    }

    #[test]
    fn surfaces_at_the_measured_depth_agree_and_others_are_false_or_holes() {
        let (scene, camera) = box_from_above();
        let depth = depth_of(&camera, true);
        let top = depth.data.iter().filter(|z| **z == 0.8).count();
        assert!(top > 300);
        let pixels = depth.data.len();
        let exact = agreement_of(&scene, &[(camera, &depth)], 1);
        // Rays beside the top may meet the sides of the box.
        let sides = exact.all.false_surface;
        assert!(sides < 40 && exact.all.hole == 0, "{exact:?}");
        assert_eq!((exact.all.measured, exact.all.agrees), (pixels, pixels - sides));
        assert_eq!(exact.bodies[1].agrees, top);

        // The camera measured a floor where the scene has a box.
        let absent = agreement_of(&scene, &[(camera, &depth_of(&camera, false))], 1);
        assert_eq!((absent.all.false_surface, absent.bodies[1].false_surface), (top + sides, top + sides));
        assert_eq!(absent.all.agrees, absent.bodies[0].agrees);

        // The scene lacks the box, then everything.
        let floor = Scene { bodies: scene.bodies[..1].to_vec(), ..scene.clone() };
        assert_eq!(agreement_of(&floor, &[(camera, &depth)], 1).all.hole, top);
        let empty = Scene { bodies: Vec::new(), ..scene };
        let nothing = agreement_of(&empty, &[(camera, &depth), (camera, &depth)], 1);
        assert_eq!((nothing.all.measured, nothing.all.hole), (2 * pixels, 2 * pixels));
    }

    #[test]
    fn depth_that_is_not_measured_is_not_compared() {
        let (scene, camera) = box_from_above();
        let mut depth = Image::filled(60, 40, 0.0f32);
        depth[(0, 0)] = f32::NAN;
        depth[(2, 2)] = f32::INFINITY;
        let found = agreement_of(&scene, &[(camera, &depth)], 2);
        assert_eq!((found.all, found.all.shares()), (DepthAgreement::default(), None));
    }

    #[test]
    fn the_tolerance_grows_with_the_depth() {
        let agrees = |measured: f64, first: f64| compared(measured, Some(first)).agrees == 1;
        assert!(agrees(1.0, 1.0149) && agrees(1.0, 0.9851) && !agrees(1.0, 1.0151) && !agrees(1.0, 0.9849));
        assert!(agrees(2.0, 2.0249) && !agrees(2.0, 2.0251));
    }
}
