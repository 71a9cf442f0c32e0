//! The robot.

mod clearance;
mod dynamics;
mod kinematics;
mod linalg;
mod model;
mod shape;
mod urdf;
mod workspace;

use glamx::DVec3;

pub use linalg::MAX_JOINTS;
pub use model::{Frame, FrameId, GRAVITY_W, Joint, JointKind, JointLimits, LinkCollision, RobotModel};
pub use shape::{Clearance, LinkShape, Obstacle, ObstacleShape, floor};
pub use urdf::{FR3_HOME, FR3_URDF, OffChain, UrdfOptions};
pub use workspace::{Jacobian, JointVector, MassMatrix, Workspace};

/// Half extents, metres, of the closed fingertips of a Franka Hand as one box, in the frame of the tool.
pub const FIST_HALF: DVec3 = DVec3::new(0.008_75, 0.015_18, 0.009_25);
