//! Integration tests of sms-target.

mod articulation;
#[cfg(any(feature = "physx", feature = "mujoco"))]
#[path = "../../../sms-sim/tests/it/common.rs"]
mod common;
mod engines;
mod execution;
mod landing;
mod suite;
