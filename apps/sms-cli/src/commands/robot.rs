//! `sms robot`: the arm's motion for the planned strike, with what was checked.

use super::{inputs_hash, run_stage, shown};
use crate::cli::Robot;
use crate::context::Context;
use sms_core::glamx::{DPose3, DQuat, DVec3};
use sms_core::metrics::Metrics;
use sms_core::{Hasher, InputError, RunFolder, atomic};
use sms_plan::load_plan;
use sms_robot::{
    JointProgram, RobotConfig, StrikeCheck, StrikeConfig, Sweep, Workspace, check_strike, obstacles,
    plan_strike,
};
use sms_scene::load_scene;
use sms_task::Task;

pub(crate) fn run(context: &Context, a: &Robot) -> anyhow::Result<()> {
    let run = RunFolder::open(&a.run)?;
    let scene_dir = run.stage_dir("scene", "materialize")?;
    let plan_dir = run.stage_dir("plan", "plan")?;
    let scene = load_scene(&scene_dir)?;
    let config = context.settings.section("robot", RobotConfig::default())?;
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
    let plan = load_plan(&plan_dir)?;
    let task = Task::read(&plan_dir.join("task.toml"))?.resolve(&scene)?;
    let motion = task.strike(&plan.action);
    let sweep =
        Sweep::of_ball(motion.contact_w, motion.ball_radius, motion.angle, motion.speed, config.front_m);
    run.record_settings("robot", &config)?;

    let mut read = Hasher::new();
    read.file(&plan_dir.join("plan.json"))?
        .file(&plan_dir.join("task.toml"))?
        .file(&scene_dir.join("scene.json"))?;
    // All that was read of the robot counts: its URDF, and the meshes and packages that this names.
    let read_robot = format!("{robot:?}");
    let hash = inputs_hash(&[&read.finish()], &(&config, read_robot))?;
    let dir = run_stage(context, &run, "robot", &["robot."], &hash, |stage, _| {
        // Of another robot's tool it is not known whether its back is as good as its front.
        let settings = StrikeConfig { symmetric_tool: config.urdf.is_none(), ..StrikeConfig::default() };
        let mut ws = Workspace::default();
        let around = obstacles(&scene, task.cue().index);
        let strike = plan_strike(&robot, &sweep, &around, &settings, &mut ws)
            .map_err(|e| anyhow::anyhow!("the arm cannot make this strike: {e}"))?;
        let check = check_strike(&robot, &strike, &around, &settings, &mut ws);
        let program = JointProgram::of_strike(&robot, &strike, config.period_s, &mut ws);
        atomic::write_json(&stage.dir().join("check.json"), &check)?;
        program.write_json(&stage.dir().join("program.json"))?;
        program.write_parquet(&stage.dir().join("program.parquet"))?;
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
    context.say(format!("{} strikes `{}`; what was checked:", robot.name(), task.cue().name));
    for item in &check.items {
        context.say(format!("  {} {}", if item.passed { "ok  " } else { "FAIL" }, item.detail));
    }
    let words = if check.executable() { "executable" } else { "not executable" };
    context.say(format!("{words}: the motion is in {}", shown(&dir.join("program.json"))));
    context.print_metrics(&run)?;
    if !check.executable() {
        anyhow::bail!("the strike did not pass every check");
    }
    Ok(())
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
