//! The Rapier world in single precision.

use rapier3d as engine;

#[path = "adapter.rs"]
pub(super) mod adapter;

#[path = "hull.rs"]
mod hull;

#[path = "face.rs"]
mod face;
