//! `sms sample`: a small generated recording with a task.

use super::{robot, shown};
use crate::cli::Sample;
use sms_cli::front::Console;
use sms_core::glamx::DVec3;
use sms_core::{InputError, Seed};
use sms_landing::LandingTask;
use sms_synth::{BilliardsSettings, RecordingSettings, TruthScene, generate_billiards, write_recording};
use sms_task::{Billiards, Selector, Task};
use std::path::Path;

pub(crate) fn run(console: &Console, a: &Sample) -> anyhow::Result<()> {
    let occupied = a.folder.read_dir().is_ok_and(|mut entries| entries.next().is_some());
    if occupied && !a.folder.join("transforms.json").is_file() {
        return Err(InputError::new("this folder is not empty", &a.folder, "name a new folder").into());
    }
    let truth = generate_billiards(Seed(a.seed), &BilliardsSettings::default());
    let settings = RecordingSettings { seed: Seed(a.seed), ..RecordingSettings::small() };
    write(console, &truth, &settings, &a.folder)?;
    let folder = shown(&a.folder);
    console.say(format!("a recording of {} objects in {folder}; now try", truth.objects.len()));
    console.say(format!("  sms check {folder}"));
    console.say(format!("  sms scan {folder} --out my-run --preset draft --holdout 8"));
    console.say("  sms materialize my-run");
    console.say("  sms simulate my-run");
    console.say(format!("  sms plan my-run --task {folder}/task.toml"));
    console.say("  sms execute my-run");
    console.say("  sms evaluate my-run");
    console.say("  sms view my-run");
    Ok(())
}

/// Writes a recording, its task and the place of the robot.
pub(crate) fn write(
    console: &Console,
    truth: &TruthScene,
    settings: &RecordingSettings,
    folder: &Path,
) -> anyhow::Result<()> {
    write_recording(truth, settings, folder, console.context.progress.as_ref(), &console.context.cancel)?;
    write_beside(truth, folder)
}

/// Writes the task and the place of the robot of a recording.
pub(crate) fn write_beside(truth: &TruthScene, folder: &Path) -> anyhow::Result<()> {
    if let Some(task) = landing_task_of(truth) {
        task.write(&folder.join("task.toml"))?;
        return Ok(());
    }
    task_of(truth).write(&folder.join("task.toml"))?;
    robot::write_place(folder, &sms_target::robot_of(truth))?;
    Ok(())
}

/// Land, starting where the straight way leads over the structure's overhang; `None` for scenes of other kinds. Nothing of the
/// truth but the start of the flight is in it, and about how low the top is where that is less than tasks ask for.
pub(crate) fn landing_task_of(truth: &TruthScene) -> Option<LandingTask> {
    let landing = truth.landing.as_ref()?;
    let outward = |p: &DVec3| p.truncate().dot(landing.overhang_w.into());
    let start_w = landing.starts_w.iter().max_by(|a, b| outward(a).total_cmp(&outward(b)))?;
    let mut task = LandingTask::new(start_w.truncate().to_array());
    if landing.top_m < task.surface.height_m {
        // Whole fives of centimetres, at least a tenth below it: reconstructions are a little off.
        task.surface.height_m = (18.0 * landing.top_m).floor() / 20.0;
    }
    Some(task)
}

/// What a user would say: strike the white ball so that the blue one reaches the goal. Nothing of the truth but the
/// goal is in it.
pub(crate) fn task_of(truth: &TruthScene) -> Task {
    Task::Billiards(Billiards::new(
        Selector::sphere_of_color("white"),
        Selector::sphere_of_color("blue"),
        truth.goal_w,
    ))
}
