//! `sms plan`: the best action for a task.

use super::materialize::run_settings;
use super::{inputs_hash, length_text, of_what, run_stage, shown, timed};
use super::{landing, robot};
use crate::cli::{ChooserName, Plan};
use sms_cli::front::Console;
use sms_core::{Hasher, InputError, RunFolder, Seed, StageContext};
use sms_frames::{FloorAt, floor_at, load_depths};
use sms_landing::{LandingSettings, LandingTask};
use sms_plan::{Plan as Planned, PlanConfig, PlanError, load_plan, plan, save_plan};
use sms_scene::load_scene;
use sms_sim::RapierFactory;
use sms_task::{ResolvedTask, Task};
use std::path::Path;

pub(crate) fn run(console: &Console, a: &Plan) -> anyhow::Result<()> {
    if LandingTask::is_landing(&a.task) {
        return landing::plan(console, a, LandingSettings::default());
    }
    if a.chooser != ChooserName::Ours {
        let what = "only landings have other choosers";
        return Err(InputError::new(what, "--chooser", "leave `--chooser` out").into());
    }
    let task = Task::read(&a.task)?;
    let config = console.context.settings.section("plan", PlanConfig::default())?;
    let is_evaluations_set = config.evaluations != PlanConfig::default().evaluations;
    carry_out(console, a, &task, &config, is_evaluations_set)
}

/// Frames in which the floor is looked for at the task's places.
const FLOOR_FRAMES: usize = 24;

/// Refuses places through which the recording's cameras saw something lower: in the simulation the floor has no end. Returns
/// those that no frame shows.
fn refuse_places_off_the_floor(
    run: &RunFolder,
    task: &ResolvedTask,
    file: &Path,
) -> anyhow::Result<Vec<String>> {
    let places = task.floor_places();
    let Some(frames) = run.stage_dir("frames", "scan DIR --out").ok().filter(|_| !places.is_empty()) else {
        return Ok(Vec::new());
    };
    let frames = load_depths(&frames, FLOOR_FRAMES)?;
    let mut out_of_view = Vec::new();
    for (what, place_w) in places {
        let what = format!("{what}, at [{:.3}, {:.3}]", place_w.x, place_w.y);
        match floor_at(frames.iter().map(|(camera, depth)| (camera, depth)), place_w) {
            FloorAt::Missing => {
                return Err(InputError::new(
                    format!("{what}, is off the floor: the recording shows nothing at its height there"),
                    file,
                    "choose a place on what was recorded (the report's 3-D view shows it, and prints the line to paste)",
                )
                .into());
            }
            FloorAt::OutOfView => out_of_view.push(what),
            FloorAt::Seen | FloorAt::Hidden => {}
        }
    }
    Ok(out_of_view)
}

/// The same with the planner's settings given (the demo's presets).
pub(crate) fn run_with(console: &Console, a: &Plan, task: &Task, config: &PlanConfig) -> anyhow::Result<()> {
    carry_out(console, a, task, config, false)
}

fn carry_out(
    console: &Console,
    a: &Plan,
    task: &Task,
    config: &PlanConfig,
    is_evaluations_set: bool,
) -> anyhow::Result<()> {
    let mut config = config.clone();
    if let Some(worlds) = a.robust {
        config.perturbation.worlds = worlds;
    }
    let config = &config;
    let run = RunFolder::open(&a.run)?;
    let scene_dir = run.stage_dir("scene", "materialize")?;
    let scene = load_scene(&scene_dir)?;
    let seed = Seed(a.seed.map_or_else(|| run_settings(&run).map(|s| s.seed), Ok)?);
    let resolved = task.resolve(&scene)?;
    let out_of_view = refuse_places_off_the_floor(&run, &resolved, &a.task)?;
    let robot = robot::place(console, &run)?;
    let with_arm = resolved.clone().with_robot(&robot.config, &scene)?;
    run.record_settings("plan", config)?;
    // What the manifest says now: a user may have edited a mass or a friction.
    let mut manifest = Hasher::new();
    manifest.file(&scene_dir.join("scene.json"))?;
    if let Some(urdf) = &robot.config.urdf {
        manifest.file(urdf)?;
    }
    let hash = inputs_hash(&[&manifest.finish()], &(task, config, seed, &robot.config))?;
    let dir = run_stage(console, &run, "plan", &["plan."], &hash, |stage, warnings| {
        for what in &out_of_view {
            warnings.add(
                "plan",
                "place_not_recorded",
                format!("no frame of the recording shows {what}; the floor is taken to go on there"),
                "make sure that it does, or choose a place that was recorded",
            );
        }
        if config.perturbation.worlds > 0 && is_evaluations_set {
            warnings.add(
                "plan",
                "evaluations_unused",
                "`plan.evaluations` says nothing where disturbed worlds are looked at",
                "set `plan.robust_evaluations`, or plan with --robust 0",
            );
        }
        timed("plan.seconds", || {
            let search = |task| {
                let progress = console.context.progress.as_ref();
                plan(
                    task,
                    &scene,
                    &RapierFactory,
                    config,
                    StageContext::new(progress, &console.context.cancel, warnings).with_seed(seed),
                )
            };
            let outcome = match search(&with_arm) {
                // Nobody asked for the generator's robot.
                Err(PlanError::OutOfReach(e)) if robot.is_the_recordings => {
                    warnings.add(
                        "plan",
                        "no_strike_in_reach",
                        e.what,
                        "this plan is for a finger that gives no way; place the robot with [robot] in the settings",
                    );
                    search(&resolved)?
                }
                other => other?,
            };
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
    console.say(format!("plan: {} → {}", resolved.cue().name, resolved.target().name));
    console.say(format!("  {}, by {}", values.join(", "), plan.striker));
    for line in summary(&plan) {
        console.say(line);
    }
    console.say(format!("  in {}", shown(&dir.join("plan.json"))));
    console.print_metrics(&run)
}

/// What the plan is predicted to do, which other ways there are, and what matters most.
pub(crate) fn summary(plan: &Planned) -> Vec<String> {
    let mut lines = Vec::new();
    let of_what = of_what(&plan.task);
    match &plan.predicted {
        Some(p) => lines.push(format!(
            "  predicted {} {of_what} on average ({} in 9 of 10 worlds), {} in the scanned world; success in {:.0} % of {} \
             worlds",
            length_text(p.mean),
            length_text(p.q90),
            length_text(plan.objective),
            100.0 * p.success_share,
            p.worlds
        )),
        None => {
            let unbelievable = plan.strategies.first().and_then(|s| s.failure_text());
            let elsewhere = unbelievable.map_or_else(
                || "other worlds were not looked at".to_owned(),
                |text| format!("in disturbed ones it {text}"),
            );
            lines.push(format!(
                "  predicted {} {of_what} in the scanned world; {elsewhere}",
                length_text(plan.objective)
            ));
        }
    }
    let width = plan.strategies.iter().map(|s| s.name.chars().count()).max().unwrap_or(0).max(10);
    let columns = ["scanned", "mean", "10 %", "50 %", "90 %", "success"].map(|c| format!("{c:>9}")).concat();
    lines.push(format!("  {:<width$}  {columns}", "strategies"));
    for s in &plan.strategies {
        let mut line = format!("    {:<width$}{:>9}", s.name, length_text(s.objective));
        if let Some(p) = &s.prediction {
            for v in [p.mean, p.q10, p.q50, p.q90] {
                line.push_str(&format!("{:>9}", length_text(v)));
            }
            line.push_str(&format!("{:>7.0} %", 100.0 * p.success_share));
            if let Some(missing) = p.missing_text() {
                line.push_str(&format!("  ({missing})"));
            }
        } else if let Some(text) = s.failure_text() {
            line.push_str(&format!("  {text}"));
        }
        lines.push(line);
    }
    for (i, reason) in plan.reasons.iter().enumerate() {
        lines.push(format!("  {} {}", if i == 0 { "why:" } else { "    " }, reason.text));
    }
    let matters: Vec<String> = plan
        .sensitivities
        .iter()
        .filter(|s| s.share >= 0.05)
        .take(4)
        .map(|s| format!("{s} ({:.0} %, {})", 100.0 * s.share, length_text(s.change)))
        .collect();
    if !matters.is_empty() {
        lines.push(format!("  what matters most, each alone: {}", matters.join(", ")));
    }
    let invalid =
        if plan.invalid > 0 { format!(", {} of them not valid", plan.invalid) } else { String::new() };
    lines.extend(plan.refused_text().map(|text| format!("  {text}")));
    lines.push(format!("  {} rollouts{invalid}", plan.evaluations));
    lines.extend(plan.failure_text().map(|text| format!("    not valid: {text}")));
    lines
}
