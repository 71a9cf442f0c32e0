//! `sms robot`: the arm's motion for the planned strike, with what was checked.

use super::materialize::run_settings;
use super::{inputs_hash, run_stage, shown};
use crate::cli::Robot;
use serde::{Deserialize, Serialize};
use sms_cli::front::Console;
use sms_core::glamx::{DPose3, DQuat, DVec3};
use sms_core::metrics::Metrics;
use sms_core::{Hasher, InputError, RunFolder, atomic};
use sms_plan::{Plan, load_plan};
use sms_robots::{
    JointProgram, RobotConfig, StrikeCheck, Sweep, Workspace, check_strike, obstacles, plan_strike,
};
use sms_scene::load_scene;
use sms_task::Task;
use std::path::Path;

pub(crate) fn run(console: &Console, a: &Robot) -> anyhow::Result<()> {
    let run = RunFolder::open(&a.run)?;
    let scene_dir = run.stage_dir("scene", "materialize")?;
    let plan_dir = run.stage_dir("plan", "plan")?;
    let scene = load_scene(&scene_dir)?;
    let stated = place(console, &run)?;
    let plan = load_plan(&plan_dir)?;
    // What was planned is what is checked.
    let config = match &plan.robot {
        Some(planned) => RobotConfig { period_s: stated.config.period_s, ..planned.clone() },
        None => stated.config.clone(),
    };
    let x_wr = match &a.at {
        Some(text) => pose_of(text)?,
        None => config.x_wr(&scene.x_world_recording).ok_or_else(|| {
            InputError::new(
                "it is not known where the robot stands",
                "[robot]",
                "give `x_world_robot`, or `x_recording_robot` from a hand-eye calibration, in a file for --settings; \
                 or --at X,Y,Z,YAW_DEG",
            )
        })?,
    };
    let robot = config.model()?.with_base(x_wr);
    let task = Task::read(&plan_dir.join("task.toml"))?.resolve(&scene)?;
    let motion = task.strike(&plan.action);
    let sweep =
        Sweep::of_ball(motion.contact_w, motion.ball_radius, motion.angle, motion.speed, config.half_m().x);
    run.record_settings("robot", &config)?;

    let mut read = Hasher::new();
    read.file(&plan_dir.join("plan.json"))?
        .file(&plan_dir.join("task.toml"))?
        .file(&scene_dir.join("scene.json"))?;
    // All that was read of the robot counts: its URDF, and the meshes and packages that this names.
    let read_robot = format!("{robot:?}");
    let hash = inputs_hash(&[&read.finish()], &(&config, read_robot, a.keep_failed))?;
    let dir = run_stage(console, &run, "robot", &["robot."], &hash, |stage, _| {
        let settings = config.strike_config();
        let mut ws = Workspace::default();
        let around = obstacles(&scene, task.cue().index);
        let strike = plan_strike(&robot, &sweep, &around, &settings, &mut ws).map_err(|e| {
            InputError::new(
                format!("the arm cannot make this strike: {e}"),
                "[robot]",
                format!(
                    "{}; then plan again, so that only strikes that the arm can make are looked at",
                    e.cure()
                ),
            )
        })?;
        let check = check_strike(&robot, &strike, &around, &settings, &mut ws);
        let program = JointProgram::of_strike(&robot, &strike, config.period_s, &mut ws).checked(&check);
        atomic::write_json(&stage.dir().join("check.json"), &check)?;
        if let Some(name) = program_name(&check, a.keep_failed) {
            program.write_json(&stage.dir().join(format!("{name}.json")))?;
            program.write_parquet(&stage.dir().join(format!("{name}.parquet")))?;
        }
        let mut m = Metrics::new();
        m.set("robot.executable", check.executable());
        if let Some(contact) = &check.tracking.contact {
            m.set("robot.contact_speed", contact.speed);
            m.set("robot.direction_error_rad", contact.direction_error_rad);
        }
        m.set("robot.contact_s", program.contact_s);
        Ok(m)
    })?;
    let check: StrikeCheck = atomic::read_json(&dir.join("check.json"))?;
    console.say(format!("{} strikes `{}`; what was checked:", robot.name(), task.cue().name));
    let planned_at = plan.robot.as_ref().and_then(|r| r.x_wr(&scene.x_world_recording));
    if planned_at.is_none_or(|p| p.translation.distance(x_wr.translation) > 1e-6) {
        console.say(format!("  note: what is predicted of this plan is for {}", planned_with(&plan)));
    }
    if plan.robot.is_some() && a.at.is_none() && !stated.is_the_recordings {
        let stated_at = stated.config.x_wr(&scene.x_world_recording);
        if stated_at.is_some_and(|p| p.translation.distance(x_wr.translation) > 1e-6) {
            console.say(
                "  note: the settings place the robot elsewhere than it was planned for; what was planned is checked. Plan \
                 again, or give --at",
            );
        }
    }
    for item in &check.items {
        console.say(format!("  {} {}", if item.passed { "ok  " } else { "FAIL" }, item.detail));
    }
    console.say(match (program_name(&check, a.keep_failed), check.executable()) {
        (Some(name), true) => {
            format!("executable: the motion is in {}", shown(&dir.join(format!("{name}.json"))))
        }
        (Some(name), false) => format!(
            "not executable: the motion, marked so, is in {}",
            shown(&dir.join(format!("{name}.json")))
        ),
        (None, _) => {
            "not executable: no motion is written (--keep-failed writes it for looking at)".to_owned()
        }
    });
    console.print_metrics(&run)?;
    if !check.executable() {
        anyhow::bail!(
            "the strike did not pass every check; place the robot 0.1 to 0.2 m further away from what its links come near \
             (`x_world_robot` of [robot], or --at), then plan again"
        );
    }
    Ok(())
}

/// Name of the program's files, without extension; `None` where none is written: a robot's own program that looks for
/// `program.json` must never find a motion that did not pass.
fn program_name(check: &StrikeCheck, keep_failed: bool) -> Option<&'static str> {
    match (check.executable(), keep_failed) {
        (true, _) => Some("program"),
        (false, true) => Some("program.not-executable"),
        (false, false) => None,
    }
}

fn planned_with(plan: &Plan) -> String {
    let name = if plan.striker.is_empty() { "a finger that gives no way" } else { &plan.striker };
    match &plan.robot {
        Some(_) => format!("{name}, standing elsewhere"),
        None => name.to_owned(),
    }
}

/// File of a generated recording that says where the robot stands.
pub(crate) const ROBOT_FILE: &str = "robot.toml";

/// The settings of the robot.
pub(crate) struct Place {
    pub(crate) config: RobotConfig,
    /// Whether its place is that of a generated recording, and none that the user has given.
    pub(crate) is_the_recordings: bool,
}

/// The user's settings of the robot; where they do not say where it stands, with the recording's own place, if it has
/// one.
pub(crate) fn place(console: &Console, run: &RunFolder) -> anyhow::Result<Place> {
    let own = console.context.settings.section("robot", RobotConfig::default())?;
    let is_known = own.x_world_robot.is_some() || own.x_recording_robot.is_some();
    let file =
        run_settings(run).ok().map(|s| Path::new(&s.recording).join(ROBOT_FILE)).filter(|p| p.is_file());
    let (false, Some(file)) = (is_known, file) else {
        return Ok(Place { config: own, is_the_recordings: false });
    };
    let Sections { robot } = atomic::read_toml(&file)?;
    robot.validate()?;
    let config = console.context.settings.section("robot", robot)?;
    Ok(Place { config, is_the_recordings: true })
}

/// Writes where the robot stands, in the form of a settings file.
pub(crate) fn write_place(folder: &Path, robot: &RobotConfig) -> anyhow::Result<()> {
    let file = folder.join(ROBOT_FILE);
    let text = toml::to_string(&Sections { robot: robot.clone() })?;
    let head =
        "# Where the robot stands before this recording's scene, as a hand-eye calibration would give it.\n";
    Ok(atomic::write_bytes(&file, format!("{head}{text}").as_bytes())?)
}

#[derive(Serialize, Deserialize)]
struct Sections {
    robot: RobotConfig,
}

/// A pose from "x,y,z,yaw in degrees".
fn pose_of(text: &str) -> Result<DPose3, InputError> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|v| v.trim().parse::<f64>()).collect();
    match numbers.as_deref() {
        Ok(&[x, y, z, yaw_deg]) if [x, y, z, yaw_deg].iter().all(|v| v.is_finite()) => {
            let turn = DQuat::from_rotation_z(yaw_deg.to_radians());
            Ok(DPose3::from_parts(DVec3::new(x, y, z), turn))
        }
        _ => Err(InputError::new(
            format!("`{text}` is no place of a robot"),
            "--at",
            "give x, y and z in metres and the yaw in degrees, such as --at -0.2,0,0,0",
        )),
    }
}
