//! The report on the camera poses of a run.

use crate::Error;
use sms_core::{InputError, RunFolder, atomic};
use sms_poses::{PoseOrigin, PoseReport};
use sms_robots::RobotConfig;
use std::path::Path;

/// File of the report, in the folder of the frames.
pub(super) const POSES: &str = "poses.json";

/// Reads the report; `None` for poses that were used as recorded.
pub(super) fn pose_report(frames_dir: &Path) -> Result<Option<PoseReport>, Error> {
    let path = frames_dir.join(POSES);
    Ok(if path.is_file() { Some(atomic::read_json(&path)?) } else { None })
}

/// Refuses a statement in the recording's world if the recording has none: its poses were estimated, in a world of their own.
pub(super) fn refuse_foreign_world(run: &RunFolder, what: &str, cure: &str) -> Result<(), Error> {
    let Ok(frames_dir) = run.stage_dir("frames", "scan DIR --out") else { return Ok(()) };
    let is_foreign = pose_report(&frames_dir)?.is_some_and(|r| r.origin == PoseOrigin::EstimatedAlone);
    if !is_foreign {
        return Ok(());
    }
    let what = format!(
        "{what}, but the recording has no camera poses that could be used: the world of the scene is that of its first camera"
    );
    Err(InputError::new(what, frames_dir.join(POSES), cure).into())
}

/// Refuses a robot whose pose is stated in the recording's world, as [`refuse_foreign_world`].
pub(super) fn refuse_robot_in_foreign_world(run: &RunFolder, robot: &RobotConfig) -> Result<(), Error> {
    if robot.x_recording_robot.is_none() {
        return Ok(());
    }
    let what = "`robot.x_recording_robot` is the robot's pose in the recording's world";
    refuse_foreign_world(run, what, "state its pose in the scene's world: `robot.x_world_robot`")
}
