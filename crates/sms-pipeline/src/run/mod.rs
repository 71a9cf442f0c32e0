//! A run on disk: the stages with the cache.

mod evaluate;
mod execute;
mod export;
mod masks;
mod materialize;
mod plan;
mod report;
mod robot;
mod scan;
mod settings;
mod simulate;

pub use evaluate::EvaluateOutcome;
pub use execute::{ExecuteOutcome, ExecuteRequest};
pub use materialize::{MaterializeOutcome, MaterializeRequest};
pub use plan::{PlanRequest, PlannedTask};
pub use robot::{RobotOutcome, RobotRequest};
pub use scan::{ScanOutcome, ScanRequest};
pub use settings::RunSettings;

use crate::{Context, Error};
use serde::de::DeserializeOwned;
use sms_core::metrics::Metrics;
use sms_core::{CoreError, RunFolder, atomic};
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

    /// Reads all metrics of the run.
    ///
    /// # Errors
    /// [`Error::Core`] if they cannot be read.
    pub fn metrics(&self) -> Result<Metrics, Error> {
        Ok(Metrics::load(&self.folder.join("metrics.json"))?)
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
