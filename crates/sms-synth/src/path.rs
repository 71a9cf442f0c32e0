//! Camera paths.

use crate::scene::TruthScene;
use glamx::{DPose3, DVec3};
use serde::{Deserialize, Serialize};
use sms_core::{Camera, Intrinsics};

/// The paper's camera path (appendix "Scene Imaging and Reconstruction"): "begins at a frontal viewpoint capturing the
/// full workspace, then moves outward along a vertical plane that faces the workspace"; "upon reaching the surface of a
/// sphere of 1-meter radius, centered at the manipulator base, … continues its trajectory along the hemisphere"; "repeats
/// this path three times, with its height gradually increasing"; "always pointed at the workspace center".
///
/// We read it as a closed D: the plane stands at the robot and faces the workspace; the camera starts in its middle,
/// goes sideways to the sphere, around the far side of the workspace on the sphere, and back along the plane. With the
/// paper's words, this reading shows every object from all sides ("complete coverage of the scene objects"). The camera
/// moves evenly by arc length; `frames − 1` steps make all rounds, so that viewpoints do not repeat.
///
/// In the paper the height rises from 0.1 to 0.25 m ([`CameraPath::paper`]). There most tops and the inside of every vessel
/// stay hidden, the floor between objects is viewed at grazing angles with poor depth, and objects occlude each other. The
/// default therefore rises from 0.25 to 0.6 m on the same path, plane and sphere.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraPath {
    /// Number of rounds.
    pub rounds: usize,
    /// Radius of the sphere around the manipulator's base, metres.
    pub sphere_radius_m: f64,
    /// x of the vertical plane in the world, metres. Slightly behind the robot's base, so that the first view shows
    /// the whole workspace.
    pub plane_x_m: f64,
    /// Height above the floor at the first and at the last frame, metres.
    pub height_range_m: [f64; 2],
}

impl Default for CameraPath {
    fn default() -> Self {
        Self { rounds: 3, sphere_radius_m: 1.0, plane_x_m: -0.15, height_range_m: [0.25, 0.60] }
    }
}

impl CameraPath {
    /// Returns the path with the paper's heights.
    pub fn paper() -> Self {
        Self { height_range_m: [0.10, 0.25], ..Self::default() }
    }

    /// Returns the camera poses `X_WC` (OpenCV axes) of `frames` frames of the scene.
    pub fn poses(&self, scene: &TruthScene, frames: usize) -> Vec<DPose3> {
        let [low, high] = self.height_range_m;
        aimed_poses(scene.workspace_center_w, frames, |progress| {
            let round = (progress * self.rounds as f64).fract();
            scene.robot_base_w + self.point_on_round(round, low + (high - low) * progress)
        })
    }

    /// Returns the point at share `t` of a round, relative to the base.
    fn point_on_round(&self, t: f64, height: f64) -> DVec3 {
        // The circle of the sphere at this height.
        let circle = (self.sphere_radius_m.powi(2) - height.powi(2)).max(0.01).sqrt();
        let x = self.plane_x_m.clamp(-0.9 * circle, 0.9 * circle);
        let half_chord = (circle * circle - x * x).sqrt();
        let half_arc = half_chord.atan2(x);
        let arc = 2.0 * half_arc * circle;
        let along = t * (2.0 * half_chord + arc);
        if along < half_chord {
            DVec3::new(x, along, height)
        } else if along < half_chord + arc {
            let angle = half_arc - (along - half_chord) / circle;
            DVec3::new(circle * angle.cos(), circle * angle.sin(), height)
        } else {
            DVec3::new(x, along - (2.0 * half_chord + arc), height)
        }
    }
}

/// The paper's path around a landing structure (appendix "Scene Imaging and Reconstruction"): a helix with the camera
/// "focused on the center of the structure", from 0.35 to 1.35 m in three orbits. The paper does not give its radius.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HelicalPath {
    /// Number of orbits.
    pub orbits: usize,
    /// Distance of the camera from the vertical line through the structure's centre, metres. The default keeps the longest
    /// overhang beyond a depth camera's nearest distance, and the whole structure in view.
    pub radius_m: f64,
    /// Height above the floor at the first and at the last frame, metres.
    pub height_range_m: [f64; 2],
}

impl Default for HelicalPath {
    fn default() -> Self {
        Self { orbits: 3, radius_m: 1.2, height_range_m: [0.35, 1.35] }
    }
}

impl HelicalPath {
    /// Returns the camera poses `X_WC` (OpenCV axes) of `frames` frames (paper: 60) of the scene. They look at the centre of its
    /// workspace and begin on the side of the world's −x.
    pub fn poses(&self, scene: &TruthScene, frames: usize) -> Vec<DPose3> {
        let target = scene.workspace_center_w;
        let [low, high] = self.height_range_m;
        aimed_poses(target, frames, |progress| {
            let angle = std::f64::consts::PI + std::f64::consts::TAU * self.orbits as f64 * progress;
            let flat = DVec3::new(angle.cos(), angle.sin(), 0.0) * self.radius_m;
            (target + flat).with_z(low + (high - low) * progress)
        })
    }
}

/// Returns the poses of cameras that look at `target_w`; `eye_w` maps the progress from 0 to 1 to a position.
fn aimed_poses(target_w: DVec3, frames: usize, eye_w: impl Fn(f64) -> DVec3) -> Vec<DPose3> {
    // Only the pose is used.
    let intrinsics = Intrinsics::from_fov(2, 2, 1.0);
    let progress = |i: usize| i as f64 / frames.saturating_sub(1).max(1) as f64;
    let pose = |i: usize| Camera::look_at(intrinsics, eye_w(progress(i)), target_w, DVec3::Z).x_wc;
    (0..frames).map(pose).collect()
}
