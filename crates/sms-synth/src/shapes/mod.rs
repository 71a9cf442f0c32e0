//! Geometry of assets: closed surfaces together with the convex pieces that they are made of.

mod blobs;
mod blocks;
mod clip;
mod lathe;

pub(crate) use blobs::{Ellipsoid, ellipsoid_union};
pub(crate) use blocks::{Cuboid, chamfered_cuboid, cuboid_union, gridded_cuboid};
pub(crate) use lathe::{Handle, lathe_solid, lathe_vessel};

use sms_core::Mesh;

/// A closed oriented surface with convex pieces whose union is the solid that it bounds.
#[derive(Debug, Clone)]
pub(crate) struct Solid {
    pub(crate) mesh: Mesh,
    pub(crate) parts: Vec<Mesh>,
}
