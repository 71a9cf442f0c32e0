//! Tasks for generated recordings.

use crate::{Error, write_robot_place};
use glamx::DVec3;
use sms_landing::LandingTask;
use sms_synth::TruthScene;
use sms_task::{Billiards, Selector, Task};
use std::path::Path;

/// Writes the task of a generated scene into its recording's folder; for strikes, also the pose of the robot.
///
/// # Errors
/// [`Error`] if a file cannot be written.
pub fn write_task_files(truth: &TruthScene, recording: &Path) -> Result<(), Error> {
    let file = recording.join("task.toml");
    if let Some(task) = landing_task_of(truth) {
        return Ok(task.write(&file)?);
    }
    strike_task_of(truth).write(&file)?;
    write_robot_place(recording, &sms_target::robot_of(truth))
}

/// Returns the landing task, with a start from which the straight path crosses the structure's overhang; `None` for
/// other scenes. From the ground truth, the task contains only the start of the flight and, if the platform is lower
/// than the default limit, its rough height.
pub fn landing_task_of(truth: &TruthScene) -> Option<LandingTask> {
    let landing = truth.landing.as_ref()?;
    let outward = |p: &DVec3| p.truncate().dot(landing.overhang_w.into());
    let start_w = landing.starts_w.iter().max_by(|a, b| outward(a).total_cmp(&outward(b)))?;
    let mut task = LandingTask::new(start_w.truncate().to_array());
    if landing.top_m < task.surface.height_m {
        // Round down to five centimetres, at least 10 cm below the platform: reconstructions are slightly inaccurate.
        task.surface.height_m = (18.0 * landing.top_m).floor() / 20.0;
    }
    Some(task)
}

/// Returns the task to strike the white ball so that the blue one reaches the goal. From the ground truth, it contains
/// only the goal.
pub fn strike_task_of(truth: &TruthScene) -> Task {
    Task::Billiards(Billiards::new(
        Selector::sphere_of_color("white"),
        Selector::sphere_of_color("blue"),
        truth.goal_w,
    ))
}
