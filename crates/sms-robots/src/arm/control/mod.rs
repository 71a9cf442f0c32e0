//! Control of an arm.

pub(crate) mod osc;

pub use osc::{FRICTION_SPEED, Osc, OscConfig, OscOutput, joint_friction};
