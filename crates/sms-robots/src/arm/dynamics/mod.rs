//! Kinematics and dynamics of an arm, without allocation.

pub(crate) mod ik;
mod kinematics;
pub(crate) mod linalg;
mod recursions;
pub(crate) mod simulation;
pub(crate) mod workspace;

pub use ik::{IkConfig, IkSolution, IkTarget, Unreachable};
pub use linalg::MAX_JOINTS;
pub use simulation::ArmSim;
pub use workspace::{Jacobian, JointVector, Workspace};
