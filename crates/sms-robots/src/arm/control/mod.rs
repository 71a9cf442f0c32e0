//! Control of an arm.

pub(crate) mod osc;

pub use osc::{Osc, OscConfig, joint_friction};
