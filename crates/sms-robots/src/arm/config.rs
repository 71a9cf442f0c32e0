//! Settings of the robot.

use crate::{FIST_HALF, RobotModel, StrikeConfig, UrdfOptions};
use glamx::{DMat3, DPose3, DQuat, DVec3};
use serde::{Deserialize, Serialize};
use sms_core::{InputError, Ranges};
use std::path::PathBuf;

/// The robot and the pose of its base.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RobotConfig {
    /// The robot's URDF; without one, the built-in Franka Research 3.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub urdf: Option<PathBuf>,
    /// Link of the URDF whose frame is the tool: x ahead, z up.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tool: Option<String>,
    /// Folders that are searched for `package://` paths of the URDF.
    pub package_folders: Vec<PathBuf>,
    /// Pose of the robot's base in the run's world, `X_world_robot`: 4 × 4, rigid, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub x_world_robot: Option<[[f64; 4]; 4]>,
    /// Pose of the base in the recording's world, for example from a hand-eye calibration. The run's world is the
    /// recording's world with a level floor. Excludes `x_world_robot`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub x_recording_robot: Option<[[f64; 4]; 4]>,
    /// Distance from the tool's origin to its front face, metres. Without `tool_half_m`, the striking box has this half
    /// length and the width and height of the FR3's closed fingertips.
    pub front_m: f64,
    /// Half extents of the striking box about the tool's origin, in the tool's frame (x ahead, z up), metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tool_half_m: Option<[f64; 3]>,
    /// Time between points of the program, seconds.
    pub period_s: f64,
}

impl Default for RobotConfig {
    fn default() -> Self {
        Self {
            urdf: None,
            tool: None,
            package_folders: Vec::new(),
            x_world_robot: None,
            x_recording_robot: None,
            front_m: FIST_HALF.x,
            tool_half_m: None,
            period_s: 0.001,
        }
    }
}

impl RobotConfig {
    /// Checks the values.
    ///
    /// # Errors
    /// [`InputError`] that names the key.
    pub fn validate(&self) -> Result<(), InputError> {
        let r = Ranges::of("robot");
        let fault = |key: &str, what: String, cure: &str| {
            Err(InputError::new(what, "(settings)", cure).at_key(format!("robot.{key}")))
        };
        r.within("front_m", self.front_m, 1e-3, 1.0)?;
        if let Some(half) = self.tool_half_m {
            for (k, axis) in ["x", "y", "z"].into_iter().enumerate() {
                r.within(&format!("tool_half_m ({axis})"), half[k], 1e-3, 1.0)?;
            }
            if self.front_m != FIST_HALF.x && (self.front_m - half[0]).abs() > 1e-9 {
                return fault(
                    "front_m",
                    format!(
                        "`robot.front_m` is {}, and `robot.tool_half_m` begins with {}",
                        self.front_m, half[0]
                    ),
                    "leave `front_m` out: the box reaches as far ahead as behind the tool's origin",
                );
            }
        }
        r.within("period_s", self.period_s, 1e-4, 0.1)?;
        for (key, matrix) in
            [("x_world_robot", &self.x_world_robot), ("x_recording_robot", &self.x_recording_robot)]
        {
            if matrix.as_ref().is_some_and(|m| pose_of(m).is_none()) {
                return fault(
                    key,
                    format!(
                        "`robot.{key}` is not a rigid pose: its rotation is not orthonormal, or its last row is not 0 0 0 1"
                    ),
                    "give [[r, r, r, x], [r, r, r, y], [r, r, r, z], [0, 0, 0, 1]] with metres",
                );
            }
        }
        if self.x_world_robot.is_some() && self.x_recording_robot.is_some() {
            let what = "`robot.x_world_robot` and `robot.x_recording_robot` exclude each other";
            return fault("x_world_robot", what.to_owned(), "keep one of them");
        }
        Ok(())
    }

    /// Pose of the base in the run's world; `None` if neither pose is set.
    pub fn x_wr(&self, x_world_recording: &DPose3) -> Option<DPose3> {
        let in_recording = || Some(*x_world_recording * self.x_recording_robot.as_ref().and_then(pose_of)?);
        self.x_world_robot.as_ref().and_then(pose_of).or_else(in_recording)
    }

    /// Half extents of the striking box about the tool's origin, metres. The front face is the plane `x` = half extent.
    pub fn half_m(&self) -> DVec3 {
        self.tool_half_m.map_or(FIST_HALF.with_x(self.front_m), DVec3::from_array)
    }

    /// Settings of the strike planner for this robot.
    pub fn strike_config(&self) -> StrikeConfig {
        let own = self.urdf.is_some();
        StrikeConfig {
            // The sides of an unknown tool may differ from its front.
            symmetric_tool: !own,
            half_m: self.half_m(),
            // The link shapes of an unknown robot may not contain the striking box.
            box_is_checked: own || self.tool_half_m.is_some(),
            ..StrikeConfig::default()
        }
    }

    /// Loads the robot, with its base at the world's origin.
    ///
    /// # Errors
    /// [`InputError`] of the URDF.
    pub fn model(&self) -> Result<RobotModel, InputError> {
        let Some(path) = &self.urdf else { return Ok(RobotModel::fr3()) };
        let (tool, package_folders) = (self.tool.clone(), self.package_folders.clone());
        RobotModel::from_urdf(path, &UrdfOptions { tool, package_folders, ..UrdfOptions::default() })
    }
}

/// The pose of a row-major 4 × 4 matrix; `None` if it is not rigid.
fn pose_of(m: &[[f64; 4]; 4]) -> Option<DPose3> {
    const TOLERANCE: f64 = 1e-3;
    if m.iter().flatten().any(|v| !v.is_finite()) || m[3] != [0.0, 0.0, 0.0, 1.0] {
        return None;
    }
    let column = |c: usize| DVec3::new(m[0][c], m[1][c], m[2][c]);
    let rotation = DMat3::from_cols(column(0), column(1), column(2));
    let gram = rotation.transpose() * rotation - DMat3::IDENTITY;
    let off = (0..3).map(|c| gram.col(c).abs().max_element()).fold(0.0, f64::max);
    (off < TOLERANCE && rotation.determinant() > 0.0)
        .then(|| DPose3::from_parts(column(3), DQuat::from_mat3(&rotation).normalize()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOVED: [[f64; 4]; 4] =
        [[0.0, -1.0, 0.0, 0.1], [1.0, 0.0, 0.0, 0.2], [0.0, 0.0, 1.0, 0.3], [0.0, 0.0, 0.0, 1.0]];

    #[test]
    fn a_base_in_the_recordings_world_is_carried_to_the_runs() {
        let config = RobotConfig { x_recording_robot: Some(MOVED), ..RobotConfig::default() };
        config.validate().unwrap();
        let x_world_recording = DPose3::from_translation(DVec3::Z * 0.5);
        let x_wr = config.x_wr(&x_world_recording).unwrap();
        assert!((x_wr.transform_point(DVec3::X) - DVec3::new(0.1, 1.2, 0.8)).length() < 1e-12);
        assert_eq!(RobotConfig::default().x_wr(&x_world_recording), None);
    }

    #[test]
    fn the_box_that_strikes_is_the_fist_unless_another_is_given() {
        assert_eq!(RobotConfig::default().half_m(), FIST_HALF);
        let longer = RobotConfig { front_m: 0.02, ..RobotConfig::default() };
        assert_eq!(longer.half_m(), FIST_HALF.with_x(0.02));
        let plate = RobotConfig { tool_half_m: Some([0.005, 0.04, 0.03]), ..RobotConfig::default() };
        plate.validate().unwrap();
        assert_eq!(plate.strike_config().half_m, DVec3::new(0.005, 0.04, 0.03));
        assert!(plate.strike_config().box_is_checked);
        let bad = RobotConfig { tool_half_m: Some([0.005, 0.0, 0.03]), ..RobotConfig::default() };
        assert!(bad.validate().unwrap_err().to_string().contains("tool_half_m (y)"));
        let both = RobotConfig { front_m: 0.02, ..plate };
        assert!(both.validate().unwrap_err().to_string().contains("front_m"));
    }

    #[test]
    fn poses_that_are_not_rigid_and_two_places_are_refused() {
        let mut scaled = MOVED;
        scaled[0][1] = -1.1;
        let mut mirrored = MOVED;
        mirrored[2][2] = -1.0;
        for bad in [scaled, mirrored, [[f64::NAN; 4]; 4]] {
            let config = RobotConfig { x_world_robot: Some(bad), ..RobotConfig::default() };
            assert!(config.validate().unwrap_err().to_string().contains("x_world_robot"));
        }
        let both = RobotConfig {
            x_world_robot: Some(MOVED),
            x_recording_robot: Some(MOVED),
            ..RobotConfig::default()
        };
        let refused = both.validate().unwrap_err().to_string();
        assert!(refused.contains("x_world_robot") && refused.contains("x_recording_robot"), "{refused}");
    }
}
