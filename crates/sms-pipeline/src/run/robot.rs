//! Plans the arm's motion for a planned strike.

use super::poses::refuse_robot_in_foreign_world;
use super::{Refusal, Run, RunSettings};
use crate::cache::{inputs_hash, run_stage};
use crate::origin::{current_dir, stage_state};
use crate::robot_place::no_place;
use crate::{Error, RobotPlace};
use glamx::DPose3;
use sms_core::metrics::Metrics;
use sms_core::{Hasher, InputError, atomic};
use sms_plan::{Plan, load_plan};
use sms_robots::{
    JointProgram, RobotConfig, RobotModel, StrikeCheck, Sweep, Workspace, check_strike, obstacles,
    plan_strike,
};
use sms_scene::{Scene, load_scene};
use sms_task::{ResolvedTask, Task};
use std::path::{Path, PathBuf};

/// A strike that the arm cannot make: a robot must not load the motion of another pose by mistake.
const REFUSED_MOTION: Refusal =
    Refusal { code: "motion_refused", what: "no motion was planned", stages: &["robot"] };

/// Options of [`Run::robot`].
#[derive(Debug, Clone, Copy, Default)]
pub struct RobotRequest {
    /// Pose of the robot's base in the run's world; by default from the plan or the settings.
    pub x_world_robot: Option<DPose3>,
    /// Whether to write a motion that fails a check, too, under another name.
    pub keep_failed: bool,
}

/// Result of [`Run::robot`].
#[derive(Debug, Clone)]
pub struct RobotOutcome {
    /// Name of the robot.
    pub robot: String,
    /// Name of the struck ball.
    pub cue: String,
    /// The checks.
    pub check: StrikeCheck,
    /// File of the motion, if one was written.
    pub program: Option<PathBuf>,
    /// The striker of the plan's prediction, if it is not this robot at this pose.
    pub predicted_for: Option<String>,
    /// Whether the settings and the plan have different poses of the robot.
    pub is_elsewhere_in_settings: bool,
}

impl Run<'_> {
    /// Plans the arm's motion for the planned strike, checks it, and writes it for the robot.
    ///
    /// # Errors
    /// [`Error::Input`] if the plan is stale, the robot's pose is not known, or the arm cannot make the strike; an earlier
    /// motion is then set aside.
    pub fn robot(&self, request: &RobotRequest) -> Result<RobotOutcome, Error> {
        let run = self.open()?;
        let scene_dir = run.stage_dir("scene", "materialize")?;
        let plan_dir = current_dir(&run, "plan", "plan")?;
        self.warn_stale(&run, "plan");
        let scene = load_scene(&scene_dir)?;
        let scan = RunSettings::of(&run).ok();
        let stated = RobotPlace::of(&self.context.settings, scan.as_ref())?;
        let plan = load_plan(&plan_dir)?;
        // Checks the robot of the plan.
        let config = match &plan.robot {
            Some(planned) => RobotConfig { period_s: stated.config.period_s, ..planned.clone() },
            None => stated.config.clone(),
        };
        let x_wr = match request.x_world_robot {
            Some(x_wr) => x_wr,
            None => {
                refuse_robot_in_foreign_world(&run, &config)?;
                config.x_wr(&scene.x_world_recording).ok_or_else(no_place)?
            }
        };
        let robot = config.model()?.with_base(x_wr);
        let task = Task::read(&plan_dir.join("task.toml"))?.resolve(&scene)?;
        run.record_settings("robot", &config)?;

        let mut read = Hasher::new();
        read.file(&plan_dir.join("plan.json"))?
            .file(&plan_dir.join("task.toml"))?
            .file(&scene_dir.join("scene.json"))?;
        if let Some(state) = stage_state(&run, "scene") {
            read.text(&state.0);
        }
        // Includes all files of the robot: its URDF, and the meshes and packages that it names.
        let robot_text = format!("{robot:?}");
        let hash = inputs_hash(&[&read.finish()], &(&config, robot_text, request.keep_failed))?;
        let motion =
            PlannedMotion { robot: &robot, config: &config, task: &task, scene: &scene, plan: &plan };
        let made = run_stage(self.context, &run, "robot", &hash, |stage, _| {
            motion.write(request.keep_failed, stage.dir())
        });
        let dir = made.map_err(|error| self.refused(&run, &REFUSED_MOTION, error))?;
        let check: StrikeCheck = atomic::read_json(&dir.join("check.json"))?;
        let is_other = |place: &DPose3| place.translation.distance(x_wr.translation) > 1e-6;
        let planned_at = plan.robot.as_ref().and_then(|r| r.x_wr(&scene.x_world_recording));
        let stated_at = stated.config.x_wr(&scene.x_world_recording);
        Ok(RobotOutcome {
            robot: robot.name().to_owned(),
            cue: task.cue().name.clone(),
            program: program_name(&check, request.keep_failed).map(|name| dir.join(format!("{name}.json"))),
            predicted_for: planned_at.as_ref().is_none_or(is_other).then(|| striker_of(&plan)),
            is_elsewhere_in_settings: plan.robot.is_some()
                && request.x_world_robot.is_none()
                && !stated.is_from_recording
                && stated_at.as_ref().is_some_and(is_other),
            check,
        })
    }
}

/// A planned strike and its robot.
struct PlannedMotion<'a> {
    robot: &'a RobotModel,
    config: &'a RobotConfig,
    task: &'a ResolvedTask,
    scene: &'a Scene,
    plan: &'a Plan,
}

impl PlannedMotion<'_> {
    /// Plans and checks the motion and writes it into `dir`; returns the metrics.
    fn write(&self, keep_failed: bool, dir: &Path) -> Result<Metrics, Error> {
        let &Self { robot, config, task, scene, plan } = self;
        let motion = task.strike(&plan.action);
        let sweep = Sweep::of_ball(
            motion.contact_w,
            motion.ball_radius,
            motion.angle,
            motion.speed,
            config.half_m().x,
        );
        let settings = config.strike_config();
        let mut ws = Workspace::default();
        let around = obstacles(scene, task.cue().index);
        let strike = plan_strike(robot, &sweep, &around, &settings, &mut ws).map_err(|e| {
            let cure = format!(
                "{}; then plan again, so that the search only compares strikes within the arm's reach",
                e.cure()
            );
            InputError::new(format!("the arm cannot make this strike: {e}"), "[robot]", cure)
        })?;
        let check = check_strike(robot, &strike, &around, &settings, &mut ws);
        let program = JointProgram::of_strike(robot, &strike, config.period_s, &mut ws).checked(&check);
        atomic::write_json(&dir.join("check.json"), &check)?;
        if let Some(name) = program_name(&check, keep_failed) {
            atomic::write_json(&dir.join(format!("{name}.json")), &program)?;
            program.write_parquet(&dir.join(format!("{name}.parquet")))?;
        }
        let mut m = Metrics::new();
        m.set("robot.executable", check.executable());
        if let Some(contact) = &check.tracking.contact {
            m.set("robot.contact_speed", contact.speed);
            m.set("robot.direction_error_rad", contact.direction_error_rad);
        }
        m.set("robot.contact_s", program.contact_s);
        Ok(m)
    }
}

/// Returns the name of the program's files, without extension; `None` if no file is written. A motion that failed must
/// have another name than `program`, which robots load.
fn program_name(check: &StrikeCheck, keep_failed: bool) -> Option<&'static str> {
    match (check.executable(), keep_failed) {
        (true, _) => Some("program"),
        (false, true) => Some("program.not-executable"),
        (false, false) => None,
    }
}

fn striker_of(plan: &Plan) -> String {
    let name = if plan.striker.is_empty() { "a kinematic finger" } else { &plan.striker };
    match &plan.robot {
        Some(_) => format!("{name} at another pose"),
        None => name.to_owned(),
    }
}
