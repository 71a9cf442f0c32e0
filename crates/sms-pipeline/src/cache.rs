//! The stage cache of a run: a stage is recomputed only if its inputs or settings have changed.

use crate::{Context, Error, Event};
use sms_core::metrics::Metrics;
use sms_core::{CoreError, Hash, Hasher, RunFolder, Stage, StageState, Warnings};
use std::path::PathBuf;

/// The stages in the order of the data flow, with the metrics that each writes.
const STAGES: [(&str, &[&str]); 8] = [
    ("frames", &["check.", "poses."]),
    ("masks", &["masks."]),
    ("gaussians", &["scan."]),
    ("entities", &["entities.", "materialize."]),
    ("scene", &["scene."]),
    ("plan", &["plan."]),
    ("target", &["execute."]),
    // Depends only on the plan, like `target`.
    ("robot", &["robot."]),
];

/// Checks without a folder, with the stage that they check.
const CHECKS: [(&str, &str); 2] = [("evaluate", "entities"), ("simulate", "scene")];

/// Returns the hash of a stage from the hashes of its inputs and its settings.
pub(crate) fn inputs_hash<T: serde::Serialize>(inputs: &[&Hash], settings: &T) -> Result<Hash, Error> {
    let mut hasher = Hasher::new();
    for hash in inputs {
        hasher.text(&hash.0);
    }
    hasher.text(&serde_json::to_string(settings)?);
    Ok(hasher.finish())
}

/// Runs a stage unless it is up to date and returns its folder. `work` fills the stage's folder and returns metrics,
/// which are saved with the warnings.
pub(crate) fn run_stage(
    context: &Context,
    run: &RunFolder,
    name: &str,
    hash: &Hash,
    work: impl FnOnce(&Stage, &Warnings) -> Result<Metrics, Error>,
) -> Result<PathBuf, Error> {
    let state = run.begin(name, hash, context.force)?;
    let is_cached = matches!(state, StageState::Done(_));
    let dir = match state {
        StageState::Done(dir) => dir,
        StageState::Todo(stage) => {
            let warnings = Warnings::new();
            let metrics = work(&stage, &warnings)?;
            drop_dependents(run, name)?;
            let prefixes = STAGES.iter().find(|s| s.0 == name).map_or(&[][..], |s| s.1);
            // Metrics are written before the rename: if the process is killed in between, the stage runs again and
            // rewrites them.
            record(context, run, name, prefixes, metrics, &warnings)?;
            stage.commit()?
        }
    };
    context.events.event(&Event::Stage { name, is_cached });
    Ok(dir)
}

/// Replaces the run's metrics that start with `prefixes` and the warnings of `name`, and reports the warnings.
pub(crate) fn record(
    context: &Context,
    run: &RunFolder,
    name: &str,
    prefixes: &[&str],
    metrics: Metrics,
    warnings: &Warnings,
) -> Result<(), Error> {
    let path = run.metrics_path();
    let mut all = Metrics::load(&path)?;
    prefixes.iter().for_each(|prefix| all.remove_prefix(prefix));
    all.merge(metrics);
    all.save(&path)?;
    warnings.save_as(&run.warnings_path(), name)?;
    context.warn(warnings);
    Ok(())
}

/// Removes all results computed from the earlier result of `stage`, such as a plan for another scene or objects of
/// another scan.
fn drop_dependents(run: &RunFolder, stage: &str) -> Result<(), Error> {
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
    for (name, checked) in CHECKS {
        if STAGES[at..].iter().any(|s| s.0 == checked) {
            Warnings::new().save_as(&run.warnings_path(), name)?;
            metrics.remove_prefix(&format!("{name}."));
        }
    }
    Ok(metrics.save(&run.metrics_path())?)
}
