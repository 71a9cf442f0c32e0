//! Geometry of assets: closed surfaces and their convex pieces.

mod blobs;
mod blocks;
mod clip;
mod lathe;

pub(crate) use blobs::{Ellipsoid, ellipsoid_union};
pub(crate) use blocks::{Cuboid, chamfered_cuboid, cuboid_union, gridded_cuboid};
pub(crate) use lathe::{Handle, lathe_solid, lathe_vessel};

use sms_core::Mesh;

/// A closed oriented surface and convex pieces with the same union.
#[derive(Debug, Clone)]
pub(crate) struct PartedSolid {
    pub(crate) mesh: Mesh,
    pub(crate) parts: Vec<Mesh>,
}
