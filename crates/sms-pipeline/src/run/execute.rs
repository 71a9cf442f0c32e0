//! Executes the plan in the target world.

use super::poses::refuse_foreign_world;
use super::status::is_generated;
use super::{Run, RunSettings};
use crate::Error;
use crate::cache::{inputs_hash, run_stage};
use crate::command_options::record_options;
use crate::origin::{current_dir, stage_state};
use sms_core::metrics::Metrics;
use sms_core::{Hash, Hasher, InputError, RunFolder, Warnings};
use sms_landing::{LANDING_PLAN_FILE, LandingPlan};
use sms_plan::{Plan, load_plan};
use sms_scene::{Scene, load_scene};
use sms_sim::ArmKind;
use sms_synth::{TruthScene, read_truth};
use sms_target::{
    LandingExecution, LandingTargetOptions, Target, TargetEngine, TargetOptions, execute, execute_landing,
};
use sms_task::{Execution, Task};
use std::path::{Path, PathBuf};

/// Options of [`Run::execute`].
#[derive(Debug, Clone, Copy, Default)]
pub struct ExecuteRequest {
    /// Engine of the target world; by default the best one of this build.
    pub engine: Option<TargetEngine>,
    /// Who simulates the joints of the robot's arm.
    pub arm: ArmKind,
}

/// Result of [`Run::execute`].
#[derive(Debug, Clone)]
pub enum ExecuteOutcome {
    /// A strike.
    Strike {
        /// The plan.
        plan: Box<Plan>,
        /// Its execution.
        execution: Box<Execution>,
        /// Folder of the execution.
        dir: PathBuf,
    },
    /// A landing.
    Landing {
        /// The execution.
        execution: Box<LandingExecution>,
        /// Folder of the execution.
        dir: PathBuf,
    },
}

/// A plan to execute.
struct Order<'a> {
    /// State of the scene with its meshes.
    scene: Option<Hash>,
    plan_dir: &'a Path,
    scene_dir: &'a Path,
    recording: &'a Path,
    target: &'a dyn Target,
}

impl Order<'_> {
    /// Hashes the plan, the current scene, the ground truth and the engine.
    fn hash(&self, plan: &str) -> Result<Hash, Error> {
        let mut read = Hasher::new();
        read.file(&self.plan_dir.join(plan))?
            .file(&self.scene_dir.join("scene.json"))?
            .file(&self.recording.join("truth").join("truth.json"))?;
        read.text(self.target.label());
        if let Some(scene) = &self.scene {
            read.text(&scene.0);
        }
        Ok(read.finish())
    }
}

/// Returns whether a plan is for a landing.
pub(super) fn is_landing(plan_dir: &Path) -> bool {
    plan_dir.join(LANDING_PLAN_FILE).is_file()
}

impl Run<'_> {
    /// Executes the plan in an independent target world built from the recording's ground truth.
    ///
    /// # Errors
    /// [`Error::Input`] if the plan is stale, the recording has no ground truth, or the engine is not built in;
    /// [`Error::Target`] if the world cannot be built.
    pub fn execute(&self, request: &ExecuteRequest) -> Result<ExecuteOutcome, Error> {
        let run = self.open()?;
        let plan_dir = current_dir(&run, "plan", "plan --task TASK.toml")?;
        self.warn_stale(&run, "plan");
        let scene_dir = run.stage_dir("scene", "materialize")?;
        let recording = PathBuf::from(RunSettings::of(&run)?.recording);
        if !is_generated(&recording) {
            return Err(InputError::new(
                "this recording has no ground truth to execute in",
                &recording,
                "use a generated recording (`sms sample DIR`, `sms demo billiards`); for a real scene, execute \
                 plan/plan.json on your robot",
            )
            .into());
        }
        refuse_foreign_world(
            &run,
            "the true scene is placed in the recording's world",
            "give the recording its poses; --poses estimate moves estimated ones to these",
        )?;
        let engine = request.engine.unwrap_or_else(TargetEngine::preferred);
        let is_strike = !is_landing(&plan_dir);
        let arm = if is_strike { arm_of(request.arm, engine)? } else { request.arm };
        let target = engine.target()?;
        record_options(self.context, &run, "execute")?;
        let order = Order {
            scene: stage_state(&run, "scene"),
            plan_dir: &plan_dir,
            scene_dir: &scene_dir,
            recording: &recording,
            target: &*target,
        };
        if is_strike { self.execute_strike(&run, &order, arm) } else { self.execute_landing(&run, &order) }
    }

    fn execute_strike(
        &self,
        run: &RunFolder,
        order: &Order<'_>,
        arm: ArmKind,
    ) -> Result<ExecuteOutcome, Error> {
        let scene = load_scene(order.scene_dir)?;
        let plan = load_plan(order.plan_dir)?;
        let task = Task::read(&order.plan_dir.join("task.toml"))?;
        // Uses the robot of the plan, even if the settings have changed since.
        let robot = plan.robot.clone().unwrap_or_default();
        let options = TargetOptions { robot, arm, ..TargetOptions::default() };
        let hash = inputs_hash(&[&order.hash("plan.json")?], &options)?;
        let dir = run_stage(self.context, run, "target", &hash, |stage, warnings| {
            let truth = read_truth(order.recording)?;
            let mut execution = execute(order.target, &task, &plan.action, &scene, &truth, &options)?;
            execution.predicted = plan.against(execution.objective);
            execution.save(stage.dir())?;
            warn_other_target(&plan, &task, &scene, &truth, &execution, warnings)?;
            Ok(strike_metrics(&execution))
        })?;
        let execution = Box::new(Execution::load(&dir)?);
        Ok(ExecuteOutcome::Strike { plan: Box::new(plan), execution, dir })
    }

    fn execute_landing(&self, run: &RunFolder, order: &Order<'_>) -> Result<ExecuteOutcome, Error> {
        let plan = LandingPlan::load(order.plan_dir)?;
        let options = LandingTargetOptions { planner_sph: plan.wash.sph, ..LandingTargetOptions::default() };
        let hash = inputs_hash(&[&order.hash(LANDING_PLAN_FILE)?], &options)?;
        let dir = run_stage(self.context, run, "target", &hash, |stage, _| {
            let (scene, truth) = (load_scene(order.scene_dir)?, read_truth(order.recording)?);
            let world = plan.world(&scene);
            let execution =
                execute_landing(order.target, &plan.landing(), &plan.action, &world, &truth, &options)?;
            execution.save(stage.dir())?;
            Ok(landing_metrics(&execution))
        })?;
        Ok(ExecuteOutcome::Landing { execution: Box::new(LandingExecution::load(&dir)?), dir })
    }
}

/// Refuses an articulation in engines that have none.
fn arm_of(arm: ArmKind, engine: TargetEngine) -> Result<ArmKind, InputError> {
    if arm == ArmKind::Shared || matches!(engine, TargetEngine::Physx | TargetEngine::PhysxStock) {
        return Ok(arm);
    }
    let what = format!("the engine {} cannot simulate the arm as an articulation", engine.name());
    Err(InputError::new(what, "--arm", "add `--engine physx`, or leave `--arm` out"))
}

/// Warns if the plan's target is not the scene's target ball.
fn warn_other_target(
    plan: &Plan,
    task: &Task,
    scene: &Scene,
    truth: &TruthScene,
    execution: &Execution,
    warnings: &Warnings,
) -> Result<(), Error> {
    let planned = task.resolve(scene)?.target().name.clone();
    let struck = execution.matches.iter().find(|m| m.0 == planned).map(|m| m.1.as_str());
    if plan.task == "billiards" && struck != Some(truth.target.as_str()) {
        warnings.add(
            "target",
            "other_target",
            format!(
                "the plan's target `{planned}` matches {} in the true world, where the target ball is `{}`",
                struck.map_or_else(|| "nothing".to_owned(), |name| format!("`{name}`")),
                truth.target
            ),
            "check the task's `target` selector",
        );
    }
    Ok(())
}

fn strike_metrics(execution: &Execution) -> Metrics {
    let mut m = Metrics::new();
    m.set("execute.engine", execution.engine.clone());
    m.set("execute.objective", execution.objective);
    m.set("execute.success", execution.success);
    m.set("execute.chaos_floor", execution.chaos_floor);
    if let Some(p) = &execution.predicted {
        m.set("execute.predicted_mean", p.mean);
        m.set("execute.predicted_q90", p.q90);
        m.set("execute.predicted_rank", p.rank);
    }
    m
}

fn landing_metrics(execution: &LandingExecution) -> Metrics {
    let outcome = &execution.outcome;
    let mut m = Metrics::new();
    m.set("execute.engine", execution.engine.clone());
    m.set("execute.success", outcome.is_success());
    if let Some(objective) = outcome.objective {
        m.set("execute.objective", objective).set("execute.landing_error_m", outcome.landing_error_m);
    }
    if let Some(second) = &execution.second_opinion {
        m.set("execute.jet_success", second.is_success());
    }
    m
}
