//! Kinematics and dynamics of an arm, without allocation.

pub(crate) mod ik;
mod kinematics;
mod recursions;
pub(crate) mod simulation;
pub(crate) mod workspace;
