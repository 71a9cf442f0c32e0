//! A real lens: pinhole intrinsics with distortion.

use glamx::DVec3;
use serde::{Deserialize, Serialize};
use sms_core::Intrinsics;

/// Brown-Conrady distortion with OpenCV's coefficients, acting on normalised image coordinates x = X/Z, y = Y/Z.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Distortion {
    /// Radial, r².
    pub k1: f64,
    /// Radial, r⁴.
    pub k2: f64,
    /// Tangential.
    pub p1: f64,
    /// Tangential.
    pub p2: f64,
    /// Radial, r⁶.
    pub k3: f64,
}

impl Distortion {
    /// Creates the distortion from OpenCV's order k1, k2, p1, p2, k3.
    pub fn from_opencv([k1, k2, p1, p2, k3]: [f64; 5]) -> Self {
        Self { k1, k2, p1, p2, k3 }
    }

    /// Returns whether the lens is a pinhole.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Returns the distorted position of the ideal point (x, y), normalised coordinates.
    pub fn distort(&self, x: f64, y: f64) -> (f64, f64) {
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        (
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )
    }

    /// Returns the ideal point of the distorted (xd, yd), by Newton's method; `None` outside the field of view in which
    /// the polynomial is invertible.
    pub fn undistort(&self, xd: f64, yd: f64) -> Option<(f64, f64)> {
        if self.is_none() {
            return Some((xd, yd));
        }
        let (mut x, mut y) = (xd, yd);
        for _ in 0..30 {
            let (fx, fy) = self.distort(x, y);
            let (ex, ey) = (fx - xd, fy - yd);
            if ex.abs().max(ey.abs()) < 1e-12 {
                return Some((x, y));
            }
            let r2 = x * x + y * y;
            let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
            // Derivative of the radial factor by r², times 2: d(radial)/dx = slope · x.
            let slope = 2.0 * (self.k1 + r2 * (2.0 * self.k2 + r2 * 3.0 * self.k3));
            let jxx = radial + slope * x * x + 2.0 * self.p1 * y + 6.0 * self.p2 * x;
            let jxy = slope * x * y + 2.0 * self.p1 * x + 2.0 * self.p2 * y;
            let jyy = radial + slope * y * y + 6.0 * self.p1 * y + 2.0 * self.p2 * x;
            let det = jxx * jyy - jxy * jxy;
            if det < 1e-3 {
                return None;
            }
            x -= (jyy * ex - jxy * ey) / det;
            y -= (jxx * ey - jxy * ex) / det;
        }
        None
    }
}

/// Intrinsics of the recorded images (pixel centres at +0.5) with their remaining lens distortion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Lens {
    /// Pinhole part.
    pub intrinsics: Intrinsics,
    /// Distortion.
    pub distortion: Distortion,
}

impl Lens {
    /// Maps image-plane coordinates (u, v) of the pinhole `ideal` to the recorded image.
    pub fn from_ideal(&self, ideal: &Intrinsics, u: f64, v: f64) -> (f64, f64) {
        let k = &self.intrinsics;
        let (x, y) = self.distortion.distort((u - ideal.cx) / ideal.fx, (v - ideal.cy) / ideal.fy);
        (k.fx * x + k.cx, k.fy * y + k.cy)
    }

    /// Maps image-plane coordinates (u, v) of the recorded image to the pinhole `ideal`.
    pub fn to_ideal(&self, ideal: &Intrinsics, u: f64, v: f64) -> Option<(f64, f64)> {
        let ray_c = self.ray_c(u, v)?;
        Some((ideal.fx * ray_c.x + ideal.cx, ideal.fy * ray_c.y + ideal.cy))
    }

    /// Returns the point at depth 1 that image-plane coordinates (u, v) of the recorded image show, in the camera frame.
    pub(crate) fn ray_c(&self, u: f64, v: f64) -> Option<DVec3> {
        let k = &self.intrinsics;
        let (x, y) = self.distortion.undistort((u - k.cx) / k.fx, (v - k.cy) / k.fy)?;
        Some(DVec3::new(x, y, 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn undistort_inverts_distort(x in -0.55f64..0.55, y in -0.42f64..0.42) {
            // The published lens of TUM's freiburg1 camera.
            let lens = Distortion::from_opencv([0.2624, -0.9531, -0.0054, 0.0026, 1.1633]);
            let (xd, yd) = lens.distort(x, y);
            let (xu, yu) = lens.undistort(xd, yd).unwrap();
            prop_assert!((xu - x).abs() < 1e-9 && (yu - y).abs() < 1e-9);
        }
    }

    #[test]
    fn beyond_the_fold_there_is_no_ideal_point() {
        // r (1 - 0.5 r²) never exceeds 0.544.
        let lens = Distortion { k1: -0.5, ..Distortion::default() };
        assert!(lens.undistort(0.8, 0.0).is_none());
        assert!(lens.undistort(0.5, 0.0).is_some());
    }
}
