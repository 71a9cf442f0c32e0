//! The Rapier world in double precision.

use rapier3d_f64 as engine;

#[allow(clippy::duplicate_mod, reason = "one adapter source serves both precisions of the engine")]
#[path = "adapter.rs"]
pub(super) mod adapter;

#[allow(clippy::duplicate_mod, reason = "one source serves both precisions of the engine")]
#[path = "hull.rs"]
mod hull;

#[allow(clippy::duplicate_mod, reason = "one source serves both precisions of the engine")]
#[path = "face.rs"]
mod face;
