//! `sms execute`: the plan in the target world.

use super::landing;
use super::materialize::run_settings;
use super::{inputs_hash, length_text, of_what, run_stage, shown};
use crate::cli::{ArmName, Execute};
use sms_cli::front::Console;
use sms_cli::front::EngineName;
use sms_core::metrics::Metrics;
use sms_core::{Hasher, InputError, RunFolder};
use sms_landing::{LANDING_PLAN_FILE, LandingPlan};
use sms_plan::load_plan;
use sms_scene::load_scene;
use sms_sim::ArmKind;
use sms_synth::read_truth;
use sms_target::{LandingTargetOptions, TargetEngine, TargetOptions, execute_on};
use sms_task::{Execution, Task};
use std::path::Path;

pub(crate) fn run(console: &Console, a: &Execute) -> anyhow::Result<()> {
    let run = RunFolder::open(&a.run)?;
    let plan_dir = run.stage_dir("plan", "plan --task TASK.toml")?;
    let scene_dir = run.stage_dir("scene", "materialize")?;
    let scene = load_scene(&scene_dir)?;
    let recording = run_settings(&run)?.recording;
    let truth_file = Path::new(&recording).join("truth").join("truth.json");
    if !truth_file.is_file() {
        return Err(InputError::new(
            "this recording has no target world to execute in",
            &truth_file,
            "execution needs a generated recording (`sms sample DIR`, `sms demo billiards`); of a real scene, take \
             plan/plan.json to your robot",
        )
        .into());
    }
    if landing::is_planned(&plan_dir) {
        return run_landing(console, a, &run, &plan_dir, &scene_dir, Path::new(&recording));
    }
    let plan = load_plan(&plan_dir)?;
    let task = Task::read(&plan_dir.join("task.toml"))?;
    // The same robot as in the plan, wherever it would stand now.
    let engine = a.engine.map_or_else(TargetEngine::preferred, EngineName::engine);
    let arm = match a.arm {
        ArmName::Shared => ArmKind::Shared,
        ArmName::Articulation if matches!(engine, TargetEngine::Physx | TargetEngine::PhysxStock) => {
            ArmKind::Articulation
        }
        ArmName::Articulation => {
            let what = format!("{} has no articulation of its own for the arm", engine.name());
            return Err(InputError::new(what, "--arm", "add `--engine physx`, or leave `--arm` out").into());
        }
    };
    let robot = plan.robot.clone().unwrap_or_default();
    let options = TargetOptions { robot, arm, ..TargetOptions::default() };
    let target = engine.target()?;
    let mut read = Hasher::new();
    read.file(&plan_dir.join("plan.json"))?.file(&scene_dir.join("scene.json"))?.file(&truth_file)?;
    read.text(target.label());
    let hash = inputs_hash(&[&read.finish()], &options)?;
    let dir = run_stage(console, &run, "target", &["execute."], &hash, |stage, warnings| {
        let truth = read_truth(Path::new(&recording))?;
        let mut execution = execute_on(&*target, &task, &plan.action, &scene, &truth, &options)?;
        execution.predicted = plan.against(execution.objective);
        execution.save(stage.dir())?;
        let planned = task.resolve(&scene)?.target().name.clone();
        let struck = execution.matches.iter().find(|m| m.0 == planned).map(|m| m.1.as_str());
        if plan.task == "billiards" && struck != Some(truth.target.as_str()) {
            warnings.add(
                "target",
                "other_target",
                format!(
                    "the plan's target `{planned}` is {} in the true world, whose target ball is `{}`",
                    struck.map_or_else(|| "nothing".to_owned(), |name| format!("`{name}`")),
                    truth.target
                ),
                "check the task's `target` selector",
            );
        }
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
        Ok(m)
    })?;
    let e = Execution::load(&dir)?;
    console.say(format!("execute: {}", e.engine));
    console.say(format!(
        "  realised {} {}; {}",
        length_text(e.objective),
        of_what(&plan.task),
        if e.success { "success" } else { "missed" }
    ));
    console.say(match &e.predicted {
        Some(p) => format!(
            "  predicted {} on average, {} in 9 of 10 worlds, {} in the scanned one; {}",
            length_text(p.mean),
            length_text(p.q90),
            length_text(p.nominal),
            p.rank_text()
        ),
        None => format!("  predicted {} in the scanned world", length_text(plan.objective)),
    });
    console.say(format!("  in {}", shown(&dir.join("execution.json"))));
    console.print_metrics(&run)
}

/// The same of a landing.
fn run_landing(
    console: &Console,
    a: &Execute,
    run: &RunFolder,
    plan_dir: &Path,
    scene_dir: &Path,
    recording: &Path,
) -> anyhow::Result<()> {
    let engine = a.engine.map_or_else(TargetEngine::preferred, EngineName::engine);
    let target = engine.target()?;
    let plan = LandingPlan::load(plan_dir)?;
    let options = LandingTargetOptions { planner_sph: plan.wash.sph, ..LandingTargetOptions::default() };
    let mut read = Hasher::new();
    read.file(&plan_dir.join(LANDING_PLAN_FILE))?.file(&scene_dir.join("scene.json"))?;
    read.file(&recording.join("truth").join("truth.json"))?.text(target.label());
    let hash = inputs_hash(&[&read.finish()], &options)?;
    let dir = run_stage(console, run, "target", &["execute."], &hash, |stage, _| {
        let (scene, truth) = (load_scene(scene_dir)?, read_truth(recording)?);
        landing::execute(&*target, &plan, &scene, &truth, stage.dir(), &options)
    })?;
    for line in landing::execution_summary(&dir)? {
        console.say(line);
    }
    console.print_metrics(run)
}
