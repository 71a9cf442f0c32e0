//! One file a command. Each opens the run, runs its stages where something has changed, and prints what was made.

pub(crate) mod check;
pub(crate) mod demo;
pub(crate) mod devices;
pub(crate) mod evaluate;
pub(crate) mod execute;
pub(crate) mod export;
pub(crate) mod landing;
pub(crate) mod masks;
pub(crate) mod materialize;
pub(crate) mod materials;
pub(crate) mod models;
pub(crate) mod plan;
pub(crate) mod report;
pub(crate) mod robot;
pub(crate) mod sample;
pub(crate) mod scan;
pub(crate) mod settings;
pub(crate) mod simulate;
pub(crate) mod synth;
pub(crate) mod view;
pub(crate) mod vlm;

use sms_cli::front::Console;
pub(crate) use sms_core::length_text;
use sms_core::metrics::Metrics;
use sms_core::{CoreError, Hash, Hasher, RunFolder, Stage, StageState, Warnings};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The hash of a stage: the stage before it and the settings.
pub(crate) fn inputs_hash<T: serde::Serialize>(before: &[&Hash], settings: &T) -> anyhow::Result<Hash> {
    let mut hasher = Hasher::new();
    for hash in before {
        hasher.text(&hash.0);
    }
    hasher.text(&serde_json::to_string(settings)?);
    Ok(hasher.finish())
}

/// Runs a stage unless it is up to date. `work` fills the stage's folder and returns metrics, which are saved with
/// the warnings of the stage. Returns the stage's folder.
pub(crate) fn run_stage(
    console: &Console,
    run: &RunFolder,
    name: &str,
    prefixes: &[&str],
    hash: &Hash,
    work: impl FnOnce(&Stage, &Warnings) -> anyhow::Result<Metrics>,
) -> anyhow::Result<PathBuf> {
    match run.begin(name, hash, console.context.force)? {
        StageState::Done(dir) => Ok(dir),
        StageState::Todo(stage) => {
            let warnings = Warnings::new();
            let metrics = work(&stage, &warnings)?;
            drop_dependents(run, name)?;
            // Metrics before the rename: a kill in between redoes the stage and writes them again.
            console.finish(run, name, prefixes, metrics, &warnings)?;
            Ok(stage.commit()?)
        }
    }
}

/// The stages in order, with the metrics that each writes.
const STAGES: [(&str, &[&str]); 8] = [
    ("frames", &["check.", "poses."]),
    ("masks", &["masks."]),
    ("gaussians", &["scan."]),
    ("entities", &["entities.", "materialize."]),
    ("scene", &["scene."]),
    ("plan", &["plan."]),
    ("target", &["execute."]),
    // Made from the plan, as the target's is.
    ("robot", &["robot."]),
];

/// Removes what was made from an earlier result of `stage`: a plan for another scene, or objects of another scan, must
/// not be taken for this run's.
fn drop_dependents(run: &RunFolder, stage: &str) -> anyhow::Result<()> {
    let Some(at) = STAGES.iter().position(|s| s.0 == stage) else { return Ok(()) };
    let mut metrics = Metrics::load(&run.metrics_path())?;
    let after = if stage == "target" { STAGES.len() } else { at + 1 };
    for (name, prefixes) in &STAGES[after..] {
        let dir = run.root().join(name);
        if dir.exists() {
            std::fs::remove_dir_all(&dir).map_err(CoreError::write(&dir))?;
        }
        prefixes.iter().for_each(|p| metrics.remove_prefix(p));
        Warnings::new().save_as(&run.warnings_path(), name)?;
    }
    // These look at a stage and have no folder of their own.
    for (name, own) in [("evaluate", "entities"), ("simulate", "scene")] {
        if STAGES[at..].iter().any(|s| s.0 == own) {
            Warnings::new().save_as(&run.warnings_path(), name)?;
            metrics.remove_prefix(&format!("{name}."));
        }
    }
    Ok(metrics.save(&run.metrics_path())?)
}

/// Runs `f` and adds its seconds to the metric.
pub(crate) fn timed(key: &str, f: impl FnOnce() -> anyhow::Result<Metrics>) -> anyhow::Result<Metrics> {
    let began = Instant::now();
    let mut metrics = f()?;
    metrics.set(key, began.elapsed().as_secs_f64());
    Ok(metrics)
}

/// A path for people.
pub(crate) fn shown(path: &Path) -> String {
    path.display().to_string()
}

/// What the metres of an objective are of, by the kind of task.
pub(crate) fn of_what(task: &str) -> &'static str {
    if task == "billiards" { "from the goal" } else { "in all terms" }
}
