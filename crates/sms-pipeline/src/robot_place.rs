//! The pose of the robot's base.

use crate::{Error, RunSettings, Settings};
use serde::{Deserialize, Serialize};
use sms_core::{InputError, atomic};
use sms_robots::RobotConfig;
use std::path::Path;

/// File of a generated recording with the robot's pose.
const ROBOT_FILE: &str = "robot.toml";

/// The robot and the source of its pose.
#[derive(Debug, Clone, Default)]
pub struct RobotPlace {
    /// Settings of the robot.
    pub config: RobotConfig,
    /// Whether the pose is from a generated recording instead of the user.
    pub is_from_recording: bool,
}

impl RobotPlace {
    /// Returns the robot of the settings. Without a pose there, it has the pose from the recording, if any.
    pub(crate) fn of(settings: &Settings, run: Option<&RunSettings>) -> Result<Self, Error> {
        let own = settings.section("robot", RobotConfig::default())?;
        let is_known = own.x_world_robot.is_some() || own.x_recording_robot.is_some();
        let file = run.map(|s| Path::new(&s.recording).join(ROBOT_FILE)).filter(|p| p.is_file());
        let (false, Some(file)) = (is_known, file) else {
            return Ok(Self { config: own, is_from_recording: false });
        };
        let Sections { robot } = atomic::read_toml(&file)?;
        robot.validate()?;
        Ok(Self { config: settings.section("robot", robot)?, is_from_recording: true })
    }
}

/// Writes the robot's pose into a recording, in the format of a settings file.
///
/// # Errors
/// [`Error::Core`] if the file cannot be written.
pub fn write_robot_place(recording: &Path, robot: &RobotConfig) -> Result<(), Error> {
    let text = toml::to_string(&Sections { robot: robot.clone() })?;
    let head = "# Pose of the robot in front of this recording's scene, as from a hand-eye calibration.\n";
    Ok(atomic::write_bytes(&recording.join(ROBOT_FILE), format!("{head}{text}").as_bytes())?)
}

#[derive(Serialize, Deserialize)]
struct Sections {
    robot: RobotConfig,
}

/// Returns the error for a robot without a pose.
pub(crate) fn no_place() -> InputError {
    InputError::new(
        "the robot's pose is not known",
        "[robot]",
        "set `x_world_robot`, or `x_recording_robot` from a hand-eye calibration, in a file for --settings; \
         or --at X,Y,Z,YAW_DEG",
    )
}
