//! Geometry of assets: closed surfaces and their convex pieces.

mod blobs;
mod blocks;
mod clip;
mod lathe;

pub(crate) use blobs::{Ellipsoid, ellipsoid_union};
pub use blocks::cuboid_union;
pub(crate) use blocks::{between, chamfered_cuboid, gridded_cuboid, surface};
pub(crate) use lathe::{Handle, lathe_solid, lathe_vessel};

use sms_core::Mesh;

/// A closed oriented surface and convex pieces with the same union.
#[derive(Debug, Clone)]
pub struct PartedSolid {
    /// The surface.
    pub mesh: Mesh,
    /// Closed convex meshes.
    pub parts: Vec<Mesh>,
}
