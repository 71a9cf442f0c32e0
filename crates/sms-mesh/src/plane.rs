//! Planes in space.

use crate::pca::{principal_axes, scatter};
use glamx::DVec3;

/// The points `p` with `normal · p = offset`; `normal` has unit length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// Unit normal.
    pub normal: DVec3,
    /// Distance from the origin along the normal, metres.
    pub offset: f64,
}

impl Plane {
    /// Returns the level plane at a height, with its normal up.
    pub fn horizontal(height: f64) -> Self {
        Self { normal: DVec3::Z, offset: height }
    }

    /// Returns the signed distance of a point, positive on the side of the normal.
    pub fn height(&self, p: DVec3) -> f64 {
        self.normal.dot(p) - self.offset
    }

    /// Returns the nearest point of the plane.
    pub fn project(&self, p: DVec3) -> DVec3 {
        p - self.normal * self.height(p)
    }

    /// Fits a plane to points by total least squares, with its normal up; `None` if they do not span a plane.
    pub fn least_squares(points: &[DVec3]) -> Option<Self> {
        let (moments, mean) = scatter(points.iter().map(|&p| (p, 1.0)))?;
        let normal = principal_axes(moments)?.1[0];
        let normal = if normal.z < 0.0 { -normal } else { normal };
        Some(Self { normal, offset: normal.dot(mean) })
    }
}
