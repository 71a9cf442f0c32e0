//! The pinhole camera.

use glamx::{DPose3, DVec3};
use serde::{Deserialize, Serialize};

/// Pinhole intrinsics without distortion; the centre of pixel (i, j) is at (i + 0.5, j + 0.5).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Image width in pixels.
    pub width: usize,
    /// Image height in pixels.
    pub height: usize,
    /// Focal length along x in pixels.
    pub fx: f64,
    /// Focal length along y in pixels.
    pub fy: f64,
    /// Principal point x in pixels.
    pub cx: f64,
    /// Principal point y in pixels.
    pub cy: f64,
}

impl Intrinsics {
    /// Creates intrinsics with square pixels, centred principal point, horizontal field of view in radians.
    pub fn from_fov(width: usize, height: usize, fov_x: f64) -> Self {
        let f = 0.5 * width as f64 / (0.5 * fov_x).tan();
        Self { width, height, fx: f, fy: f, cx: 0.5 * width as f64, cy: 0.5 * height as f64 }
    }

    /// Returns the intrinsics of the same view resampled to another size.
    pub fn scaled_to(&self, width: usize, height: usize) -> Self {
        let (sx, sy) = (width as f64 / self.width as f64, height as f64 / self.height as f64);
        Self { width, height, fx: self.fx * sx, fy: self.fy * sy, cx: self.cx * sx, cy: self.cy * sy }
    }

    /// Returns the metres across one pixel at depth `z` (metres), the geometric mean of both directions.
    pub fn pixel_footprint(&self, z: f64) -> f64 {
        z / (self.fx * self.fy).sqrt()
    }
}

/// A pinhole camera with its pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// The intrinsics.
    pub intrinsics: Intrinsics,
    /// Pose of the camera (OpenCV axes) in the world, `X_WC`.
    pub x_wc: DPose3,
}

impl Camera {
    /// Creates a camera from intrinsics and pose.
    pub fn new(intrinsics: Intrinsics, x_wc: DPose3) -> Self {
        Self { intrinsics, x_wc }
    }

    /// Creates a camera at `eye_w` looking at `target_w` with the image's up along `up_w`.
    pub fn look_at(intrinsics: Intrinsics, eye_w: DVec3, target_w: DVec3, up_w: DVec3) -> Self {
        let z = (target_w - eye_w).normalize();
        let x = z.cross(up_w).normalize();
        let y = z.cross(x);
        let rotation = glamx::DQuat::from_mat3(&glamx::DMat3::from_cols(x, y, z));
        Self::new(intrinsics, DPose3::from_parts(eye_w, rotation))
    }

    /// Returns the image-plane coordinates and depth (metres) of a world point; `None` at or behind the camera plane.
    pub fn project(&self, p_w: DVec3) -> Option<(f64, f64, f64)> {
        let p_c = self.x_wc.inverse_transform_point(p_w);
        if p_c.z <= 1e-9 {
            return None;
        }
        let k = &self.intrinsics;
        Some((k.fx * p_c.x / p_c.z + k.cx, k.fy * p_c.y / p_c.z + k.cy, p_c.z))
    }

    /// Returns the world point at image-plane coordinates (u, v) at depth `z` metres.
    pub fn unproject(&self, u: f64, v: f64, z: f64) -> DVec3 {
        let k = &self.intrinsics;
        self.x_wc.transform_point(DVec3::new((u - k.cx) / k.fx * z, (v - k.cy) / k.fy * z, z))
    }

    /// Returns the world point at the centre of pixel (x, y) at depth `z` metres.
    pub fn unproject_pixel(&self, x: usize, y: usize, z: f64) -> DVec3 {
        self.unproject(x as f64 + 0.5, y as f64 + 0.5, z)
    }

    /// Returns the pixel that contains image-plane coordinates (u, v), or `None` outside the image.
    pub fn pixel_at(&self, u: f64, v: f64) -> Option<(usize, usize)> {
        let inside =
            u >= 0.0 && v >= 0.0 && u < self.intrinsics.width as f64 && v < self.intrinsics.height as f64;
        inside.then_some((u as usize, v as usize))
    }

    /// Returns `false` only if no point of the ball projects into the image. Balls beside a corner of the view may give
    /// `true` too.
    pub fn may_see(&self, center_w: DVec3, radius: f64) -> bool {
        let c = self.x_wc.inverse_transform_point(center_w);
        let k = &self.intrinsics;
        // The side of the view at this edge of the image: signed distance towards the inside.
        let inside = |f: f64, edge: f64, across: f64| (f * across + edge * c.z) / f.hypot(edge) >= -radius;
        c.z >= -radius
            && inside(k.fx, k.cx, c.x)
            && inside(k.fx, k.width as f64 - k.cx, -c.x)
            && inside(k.fy, k.cy, c.y)
            && inside(k.fy, k.height as f64 - k.cy, -c.y)
    }

    /// Returns the camera centre in the world.
    pub fn center_w(&self) -> DVec3 {
        self.x_wc.translation
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn look_at_puts_the_target_on_the_optical_axis_and_up_is_up() {
        let k = Intrinsics::from_fov(320, 200, 1.0);
        let camera = Camera::look_at(k, DVec3::new(1.0, 2.0, 0.5), DVec3::new(0.0, 0.0, 0.1), DVec3::Z);
        let (u, v, z) = camera.project(DVec3::new(0.0, 0.0, 0.1)).unwrap();
        assert!((u - 160.0).abs() < 1e-9 && (v - 100.0).abs() < 1e-9 && z > 0.0);
        let (_, v_up, _) = camera.project(DVec3::new(0.0, 0.0, 0.2)).unwrap();
        assert!(v_up < v, "a higher point is higher in the image");
        assert!((glamx::DMat3::from_quat(camera.x_wc.rotation).determinant() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn unproject_inverts_project() {
        let k = Intrinsics { width: 64, height: 48, fx: 50.0, fy: 60.0, cx: 30.0, cy: 25.0 };
        let camera = Camera::look_at(k, DVec3::new(0.3, -1.0, 0.8), DVec3::ZERO, DVec3::Z);
        let p_w = DVec3::new(0.1, 0.05, 0.02);
        let (u, v, z) = camera.project(p_w).unwrap();
        assert!((camera.unproject(u, v, z) - p_w).length() < 1e-12);
    }

    #[test]
    fn scaling_keeps_the_field_of_view() {
        let k = Intrinsics::from_fov(1280, 800, 1.1).scaled_to(320, 200);
        let same = Intrinsics::from_fov(320, 200, 1.1);
        assert!((k.fx - same.fx).abs() < 1e-9 && (k.cx - same.cx).abs() < 1e-9);
    }

    #[test]
    fn a_ball_that_reaches_into_the_image_may_be_seen() {
        let k = Intrinsics { width: 64, height: 48, fx: 50.0, fy: 60.0, cx: 30.0, cy: 25.0 };
        let camera = Camera::new(k, DPose3::IDENTITY);
        // The left edge of the view passes through (-0.6, 0, 1), at an angle of atan(0.6) to the axis.
        let beside =
            |distance: f64| DVec3::new(-0.6, 0.0, 1.0) + DVec3::new(-50.0, 0.0, -30.0).normalize() * distance;
        assert!(camera.may_see(beside(0.09), 0.1) && !camera.may_see(beside(0.11), 0.1));
        assert!(camera.may_see(beside(-0.11), 0.1));
        // The lower edge, the camera itself, and what is behind it.
        let below = DVec3::new(0.0, 23.0 / 60.0, 1.0) + DVec3::new(0.0, 60.0, -23.0).normalize() * 0.11;
        assert!(camera.may_see(below, 0.12) && !camera.may_see(below, 0.1));
        assert!(camera.may_see(DVec3::ZERO, 0.1) && camera.may_see(-0.05 * DVec3::Z, 0.1));
        assert!(!camera.may_see(-0.2 * DVec3::Z, 0.1));
    }
}
