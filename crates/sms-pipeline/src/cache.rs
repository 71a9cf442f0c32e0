//! The stage cache of a run: a stage is recomputed only if its inputs or settings have changed.

use crate::origin::{Sources, is_edited, keep_later_origins, staleness_of};
use crate::stage_list::{CHECKS, STAGES, prefixes};
use crate::{Context, Error, Event};
use sms_core::metrics::Metrics;
use sms_core::{Hash, Hasher, RunFolder, Stage, StageState, Warnings};
use std::path::PathBuf;

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
/// which are saved with the warnings. The earlier result stays until the new one is complete, and longer, under another
/// name, if a user has edited it; later results stay, too, and are stale then.
pub(crate) fn run_stage(
    context: &Context,
    run: &RunFolder,
    name: &str,
    hash: &Hash,
    work: impl FnOnce(&Stage, &Warnings) -> Result<Metrics, Error>,
) -> Result<PathBuf, Error> {
    let state = run.begin(name, hash, context.force)?;
    let is_cached = matches!(state, StageState::Done(_));
    let sources = Sources::of(run, name);
    let dir = match state {
        StageState::Done(dir) => {
            sources.confirm(run, name)?;
            dir
        }
        StageState::Todo(stage) => {
            tell_reason(context, run, name, hash);
            let warnings = Warnings::new();
            let metrics = work(&stage, &warnings)?;
            sources.write(stage.dir())?;
            keep_later_origins(run, name)?;
            drop_checks(run, name)?;
            // Before the warnings are saved; the new result is complete.
            if is_edited(run, name)
                && let Some(aside) = run.set_aside(name)?
            {
                let what = format!("`{name}` was edited by hand and is made again without these edits");
                let cure = format!("the edited files are in {}; copy the edits from there", aside.display());
                warnings.add(name, "edits_set_aside", what, cure);
            }
            // Metrics are written before the rename: if the process is killed in between, the stage runs again and
            // rewrites them.
            record(context, run, name, prefixes(name), metrics, &warnings)?;
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

/// Reports why a stage with an earlier result is made again.
fn tell_reason(context: &Context, run: &RunFolder, name: &str, hash: &Hash) {
    let Some(before) = run.stage_hash(name) else { return };
    let reasons = staleness_of(run, name).reasons();
    let reason = match (reasons.is_empty(), before == *hash) {
        (false, _) => reasons.join("; "),
        (true, false) => "its inputs or settings have changed".to_owned(),
        (true, true) if context.force => "--force".to_owned(),
        (true, true) => "another version of the program made it".to_owned(),
    };
    context.message(format!("{name}: made again ({reason})"));
}

/// Removes the figures of checks of the earlier result of `stage`; a check has no folder that could be stale.
fn drop_checks(run: &RunFolder, stage: &str) -> Result<(), Error> {
    let Some(at) = STAGES.iter().position(|s| s.0 == stage) else { return Ok(()) };
    let mut metrics = Metrics::load(&run.metrics_path())?;
    for (name, checked) in CHECKS {
        if STAGES[at..].iter().any(|s| s.0 == checked) {
            Warnings::new().save_as(&run.warnings_path(), name)?;
            metrics.remove_prefix(&format!("{name}."));
        }
    }
    Ok(metrics.save(&run.metrics_path())?)
}
