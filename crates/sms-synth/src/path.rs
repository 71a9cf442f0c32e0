//! Where the camera goes.

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
/// paper's own words this is the reading that sees every object from all sides ("complete coverage of the scene
/// objects"). The camera moves evenly by arc length; `frames − 1` steps make all rounds, so that rounds do not repeat
/// each other's viewpoints.
///
/// The paper lets the height rise from 0.1 to 0.25 m ([`CameraPath::paper`]). From there most tops and the inside of
/// every vessel stay unseen, the floor between objects is seen at grazing angles at which a depth camera measures badly,
/// and objects in front hide those behind. The default therefore rises from 0.25 to 0.6 m: the same path, three rounds,
/// on the same plane and sphere.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraPath {
    /// Rounds.
    pub rounds: usize,
    /// Radius of the sphere around the manipulator's base, metres.
    pub sphere_radius_m: f64,
    /// x of the vertical plane in the world, metres. A little behind the robot's base, so that the first view holds
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
    /// The paper's heights.
    pub fn paper() -> Self {
        Self { height_range_m: [0.10, 0.25], ..Self::default() }
    }

    /// Camera poses `X_WC` (OpenCV axes) for a scan of `frames` frames of the scene.
    pub fn poses(&self, scene: &TruthScene, frames: usize) -> Vec<DPose3> {
        let base = scene.robot_base_w;
        let target = scene.workspace_center_w;
        // Only the pose is used.
        let intrinsics = Intrinsics::from_fov(2, 2, 1.0);
        (0..frames)
            .map(|i| {
                let progress = i as f64 / frames.saturating_sub(1).max(1) as f64;
                let height =
                    self.height_range_m[0] + (self.height_range_m[1] - self.height_range_m[0]) * progress;
                let round = (progress * self.rounds as f64).fract();
                let eye = base + self.point_on_round(round, height);
                Camera::look_at(intrinsics, eye, target, DVec3::Z).x_wc
            })
            .collect()
    }

    /// The point at share `t` of a round, relative to the base.
    fn point_on_round(&self, t: f64, height: f64) -> DVec3 {
        // The circle in which the sphere is cut at this height.
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
    /// Orbits.
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
    /// Camera poses `X_WC` (OpenCV axes) for a scan of `frames` frames (paper: 60) of the scene; they look at the centre of
    /// its workspace, from the side of the world's −x first.
    pub fn poses(&self, scene: &TruthScene, frames: usize) -> Vec<DPose3> {
        let target = scene.workspace_center_w;
        // Only the pose is used.
        let intrinsics = Intrinsics::from_fov(2, 2, 1.0);
        let [low, high] = self.height_range_m;
        (0..frames)
            .map(|i| {
                let progress = i as f64 / frames.saturating_sub(1).max(1) as f64;
                let angle = std::f64::consts::PI + std::f64::consts::TAU * self.orbits as f64 * progress;
                let flat = DVec3::new(angle.cos(), angle.sin(), 0.0) * self.radius_m;
                let eye = (target + flat).with_z(low + (high - low) * progress);
                Camera::look_at(intrinsics, eye, target, DVec3::Z).x_wc
            })
            .collect()
    }
}

/// The default path around a billiards scene: `X_WC` of each frame. See [`CameraPath`] for its heights.
pub fn paper_billiards_path(scene: &TruthScene, frames: usize) -> Vec<DPose3> {
    CameraPath::default().poses(scene, frames)
}
