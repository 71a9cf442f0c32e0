//! A run on disk: the stages with the cache.

mod ask_names;
mod evaluate;
mod execute;
mod export;
mod follow;
mod masks;
mod materialize;
mod names;
mod plan;
mod poses;
mod recorded;
mod report;
mod robot;
mod scan;
mod settings;
mod simulate;
mod status;

pub use ask_names::NamedObjects;
pub use evaluate::{EvaluateOutcome, RecordedAgreement};
pub use execute::{ExecuteOutcome, ExecuteRequest};
pub use materialize::{MaterializeOutcome, MaterializeRequest};
pub use plan::{PlanRequest, PlannedTask};
pub use robot::{RobotOutcome, RobotRequest};
pub use scan::{ScanOutcome, ScanRequest};
pub use settings::RunSettings;
pub use simulate::is_at_rest;
pub use status::{RunStatus, StageCondition, StageStatus};

use crate::cache::record;
use crate::origin::{Staleness, staleness, staleness_of};
use crate::stage_list::{command_of, prefixes};
use crate::{Context, Error};
use serde::de::DeserializeOwned;
use sms_core::metrics::Metrics;
use sms_core::{CoreError, RunFolder, StageError, Warnings, atomic, shell_argument};
use std::path::{Path, PathBuf};

/// The pipeline on a folder: each method runs one command, reuses stages with unchanged inputs, and stores its result
/// for the next command.
///
/// Methods that write lock the folder.
pub struct Run<'c> {
    folder: PathBuf,
    context: &'c Context,
}

impl<'c> Run<'c> {
    /// Returns a run in `folder` without reading it; [`Run::scan`] creates the folder if it is missing.
    pub fn new(folder: impl Into<PathBuf>, context: &'c Context) -> Self {
        Self { folder: folder.into(), context }
    }

    /// Returns the run's folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Reads all metrics of the run. Those of a stale result are included; `stale.STAGE` has the reason.
    ///
    /// # Errors
    /// [`Error::Core`] if they cannot be read.
    pub fn metrics(&self) -> Result<Metrics, Error> {
        let mut metrics = Metrics::load(&self.folder.join("metrics.json"))?;
        if let Ok(run) = self.open_to_read() {
            for (stage, stale) in staleness(&run).iter().filter(|s| !s.1.is_empty()) {
                metrics.set(format!("stale.{stage}"), stale.reasons().join("; "));
            }
        }
        Ok(metrics)
    }

    /// Reads the settings of the scan.
    ///
    /// # Errors
    /// [`Error::Input`] or [`Error::Core`] if there is no scan.
    pub fn settings(&self) -> Result<RunSettings, Error> {
        RunSettings::of(&self.open_to_read()?)
    }

    fn open(&self) -> Result<RunFolder, Error> {
        Ok(RunFolder::open(&self.folder)?)
    }

    fn open_to_read(&self) -> Result<RunFolder, Error> {
        Ok(RunFolder::open_to_read(&self.folder)?)
    }

    /// Reports the results that are stale now, with the reason and the command that makes the first of them again.
    fn tell_stale(&self, run: &RunFolder) {
        let all = staleness(run);
        let stale: Vec<_> = all.iter().filter(|s| !s.1.replaced.is_empty()).collect();
        let Some((first, why)) = stale.first() else { return };
        let names: Vec<&str> = stale.iter().map(|s| s.0).collect();
        self.context.message(format!(
            "stale, kept until made again: {} ({}); next: {}",
            names.join(", "),
            why.replaced.join("; "),
            command_of(run, first)
        ));
    }

    /// Sets the earlier results of a request that is bad input aside, and saves the reason as a warning for the report.
    /// Returns the error of the request, or that of a file.
    fn refused(&self, run: &RunFolder, refusal: &Refusal, error: Error) -> Error {
        let Some(reason) = error.input() else { return error };
        let Refusal { code, what, stages } = *refusal;
        let warnings = Warnings::new();
        warnings.add(stages[0], code, format!("{what}: {}", reason.what), reason.cure.clone());
        let set_aside = || -> Result<(), Error> {
            for stage in stages {
                if let Some(aside) = run.set_aside(stage)? {
                    self.context.message(format!("the earlier `{stage}` is kept in {}", aside.display()));
                }
            }
            let prefixes: Vec<&str> = stages.iter().flat_map(|stage| prefixes(stage)).copied().collect();
            record(self.context, run, stages[0], &prefixes, Metrics::new(), &warnings)
        };
        set_aside().err().unwrap_or(error)
    }

    /// Reports that a result is stale, with the reason and the command that makes it again.
    fn warn_stale(&self, run: &RunFolder, stage: &str) {
        self.context.warn(&stale_warning(run, stage, &staleness_of(run, stage)));
    }
}

/// A request that is refused, although an earlier one has a result.
struct Refusal {
    /// Code of the warning.
    code: &'static str,
    /// First words of the warning.
    what: &'static str,
    /// The stage and those made from it.
    stages: &'static [&'static str],
}

/// Returns a warning with the code `stale` if a result is stale.
fn stale_warning(run: &RunFolder, stage: &str, stale: &Staleness) -> Warnings {
    let warnings = Warnings::new();
    if !stale.is_empty() {
        let what = format!("the result `{stage}` is stale: {}", stale.reasons().join("; "));
        warnings.add(
            stage,
            "stale",
            what,
            format!("`sms status {}` lists the commands", shell_argument(run.root())),
        );
    }
    warnings
}

/// Reads JSON that may be absent; a damaged file is an error.
fn read_optional<T: DeserializeOwned>(path: &Path) -> Result<Option<T>, Error> {
    if !path.exists() {
        return Ok(None);
    }
    atomic::read_json(path).map(Some).map_err(|e| match e {
        CoreError::Input(e) => e.with_cure("restore it, or delete it to write the report without it").into(),
        other => other.into(),
    })
}
