//! Fixed-base arms.

mod clearance;
pub(crate) mod config;
pub(crate) mod dynamics;
pub(crate) mod model;
pub(crate) mod obstacles;
pub(crate) mod osc;
pub(crate) mod shape;
pub(crate) mod strike;
pub(crate) mod urdf;

/// Half extents, metres, of the closed fingertips of a Franka Hand as one box, in the frame of the tool.
pub const FIST_HALF: glamx::DVec3 = glamx::DVec3::new(0.008_75, 0.015_18, 0.009_25);
