//! `sms robot`: plans and checks the arm's motion for the planned strike.

use crate::cli::RobotArguments;
use sms_cli::front::Console;
use sms_core::InputError;
use sms_core::glamx::{DPose3, DQuat, DVec3};
use sms_pipeline::{RobotRequest, Run};

pub(crate) fn run(console: &Console, a: &RobotArguments) -> anyhow::Result<()> {
    let run = Run::new(&a.run, &console.context);
    let x_world_robot = a.at.as_deref().map(pose_of).transpose()?;
    let outcome = run.robot(&RobotRequest { x_world_robot, keep_failed: a.keep_failed })?;
    console.say(format!("{} strikes `{}`; the checks:", outcome.robot, outcome.cue));
    if let Some(striker) = &outcome.predicted_for {
        console.say(format!("  note: the plan's prediction is for {striker}"));
    }
    if outcome.is_elsewhere_in_settings {
        console.say(
            "  note: the robot's pose in the settings differs from the plan; the check uses the plan's pose. Plan again, \
             or use --at",
        );
    }
    for item in &outcome.check.items {
        console.say(format!("  {} {}", if item.passed { "ok  " } else { "FAIL" }, item.detail));
    }
    let is_executable = outcome.check.executable();
    console.say(match (&outcome.program, is_executable) {
        (Some(file), true) => format!("executable: the motion is in {}", file.display()),
        (Some(file), false) => format!("not executable: the motion, marked so, is in {}", file.display()),
        (None, _) => {
            "not executable: no motion is written (--keep-failed writes it for inspection)".to_owned()
        }
    });
    console.conclude(&run)?;
    if !is_executable {
        anyhow::bail!(
            "the strike did not pass every check; place the robot 0.1 to 0.2 m further away from the bodies near its links \
             (`x_world_robot` of [robot], or --at), then plan again"
        );
    }
    Ok(())
}

/// Parses a pose from "x,y,z,yaw in degrees".
fn pose_of(text: &str) -> Result<DPose3, InputError> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|v| v.trim().parse::<f64>()).collect();
    match numbers.as_deref() {
        Ok(&[x, y, z, yaw_deg]) if [x, y, z, yaw_deg].iter().all(|v| v.is_finite()) => {
            let turn = DQuat::from_rotation_z(yaw_deg.to_radians());
            Ok(DPose3::from_parts(DVec3::new(x, y, z), turn))
        }
        _ => Err(InputError::new(
            format!("`{text}` is not a pose of a robot"),
            "--at",
            "use x, y and z in metres and the yaw in degrees, such as --at -0.2,0,0,0",
        )),
    }
}
