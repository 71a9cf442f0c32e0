//! `sms plan`: the best action for a task.

use super::materialize::run_settings;
use super::{inputs_hash, length_text, run_stage, shown, timed};
use crate::cli::Plan;
use crate::context::Context;
use sms_core::{Hasher, RunFolder, Seed};
use sms_plan::{PlanConfig, load_plan, plan, save_plan};
use sms_scene::load_scene;
use sms_sim::RapierFactory;
use sms_task::Task;

pub(crate) fn run(context: &Context, a: &Plan) -> anyhow::Result<()> {
    let task = Task::read(&a.task)?;
    let config = context.settings.section("plan", PlanConfig::default())?;
    run_with(context, a, &task, &config)
}

/// The same with the planner's settings given (the demo's presets).
pub(crate) fn run_with(context: &Context, a: &Plan, task: &Task, config: &PlanConfig) -> anyhow::Result<()> {
    let run = RunFolder::open(&a.run)?;
    let scene_dir = run.stage_dir("scene", "materialize")?;
    let scene = load_scene(&scene_dir)?;
    let seed = Seed(a.seed.map_or_else(|| run_settings(&run).map(|s| s.seed), Ok)?);
    let resolved = task.resolve(&scene)?;
    run.record_settings("plan", config)?;
    // What the manifest says now: a user may have edited a mass or a friction.
    let mut manifest = Hasher::new();
    manifest.file(&scene_dir.join("scene.json"))?;
    let hash = inputs_hash(&[&manifest.finish()], &(task, config, seed))?;
    let dir = run_stage(context, &run, "plan", &["plan."], &hash, |stage, warnings| {
        timed("plan.seconds", || {
            let outcome = plan(
                &resolved,
                &scene,
                &RapierFactory,
                config,
                seed,
                context.progress.as_ref(),
                &context.cancel,
                warnings,
            )?;
            save_plan(stage.dir(), &outcome)?;
            task.write(&stage.dir().join("task.toml"))?;
            Ok(outcome.metrics())
        })
    })?;
    let plan = load_plan(&dir)?;
    let values: Vec<String> = plan
        .parameters
        .iter()
        .zip(&plan.action.0)
        .map(|(p, v)| format!("{} {v:.4} {}", p.name, p.unit))
        .collect();
    context.say(format!("plan: {} → {}", resolved.cue().name, resolved.target().name));
    context.say(format!("  {}", values.join(", ")));
    context.say(format!(
        "  predicted {}{} ({} in 90 % of disturbed worlds), {} rollouts",
        length_text(plan.objective),
        if plan.task == "billiards" { " from the goal" } else { " in all terms" },
        length_text(plan.objective_q90),
        plan.evaluations
    ));
    context.say(format!("  in {}", shown(&dir.join("plan.json"))));
    context.print_metrics(&run)
}
