//! The stages of a run: which are complete, stale or absent, and the commands that come next.

use super::Run;
use crate::Error;
use crate::origin::{is_page_current, staleness};
use crate::stage_list::{STAGES, command_of, scan_option};
use serde::Serialize;
use sms_core::metrics::Metrics;
use sms_core::{RunFolder, shell_argument};
use std::path::{Path, PathBuf};

/// Condition of a stage's result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StageCondition {
    /// The result fits its inputs and the user's edits.
    Complete,
    /// The result was made from earlier inputs or before the user's last edits.
    Stale,
    /// There is no result.
    Absent,
}

impl StageCondition {
    /// Returns the name in metrics.
    pub fn name(self) -> &'static str {
        match self {
            Self::Complete => "complete",
            Self::Stale => "stale",
            Self::Absent => "absent",
        }
    }
}

/// A stage of a run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct StageStatus {
    /// Name of the stage and of its folder.
    pub name: &'static str,
    /// Condition of its result.
    pub condition: StageCondition,
    /// The reasons why it is stale.
    pub reasons: Vec<String>,
    /// Whether unfinished work is kept, which the command resumes if its inputs are the same.
    pub is_interrupted: bool,
    /// Command that makes the stage.
    pub command: String,
}

/// State of a run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct RunStatus {
    /// Folder of the recording, if it is known.
    pub recording: Option<PathBuf>,
    /// The stages in the order of the data flow, and the report page.
    pub stages: Vec<StageStatus>,
    /// The commands that come next, the most useful one first.
    pub next: Vec<String>,
}

impl RunStatus {
    /// Returns the metrics `status.*`: the condition of each stage, the reasons of stale ones, and the next commands.
    pub fn metrics(&self) -> Metrics {
        let mut m = Metrics::new();
        for stage in &self.stages {
            let name = stage.name;
            m.set(format!("status.{name}"), stage.condition.name());
            m.set(format!("status.{name}.interrupted"), stage.is_interrupted);
            if !stage.reasons.is_empty() {
                m.set(format!("status.{name}.reasons"), stage.reasons.clone());
            }
        }
        m.set("status.next", self.next.clone());
        m
    }

    /// Returns the condition of a stage.
    pub fn condition(&self, stage: &str) -> StageCondition {
        self.stages.iter().find(|s| s.name == stage).map_or(StageCondition::Absent, |s| s.condition)
    }
}

impl Run<'_> {
    /// Returns the state of the run. Reads only, also while another process writes to it.
    ///
    /// # Errors
    /// [`Error::Input`] if the folder has no run.
    pub fn status(&self) -> Result<RunStatus, Error> {
        let run = self.open_to_read()?;
        let known = staleness(&run);
        let mut stages: Vec<StageStatus> = STAGES
            .iter()
            .map(|(name, _)| {
                let found = known.iter().find(|s| s.0 == *name).map(|s| &s.1);
                StageStatus {
                    name,
                    condition: match found {
                        None => StageCondition::Absent,
                        Some(stale) if stale.is_empty() => StageCondition::Complete,
                        Some(_) => StageCondition::Stale,
                    },
                    reasons: found.map(|s| s.reasons()).unwrap_or_default(),
                    is_interrupted: run.root().join(format!(".{name}.partial")).is_dir(),
                    command: command_of(&run, name),
                }
            })
            .collect();
        stages.push(report_status(&run));
        let recording = scan_option::<String>(&run, "recording").map(PathBuf::from);
        let next = next_commands(&run, &stages, recording.as_deref());
        Ok(RunStatus { recording, stages, next })
    }

    /// Returns whether the recording of this run has the ground truth that an execution needs.
    pub fn has_truth(&self) -> bool {
        self.settings().is_ok_and(|s| is_generated(Path::new(&s.recording)))
    }
}

/// Returns whether the recording has the ground truth of a generated scene.
pub(crate) fn is_generated(recording: &Path) -> bool {
    recording.join("truth").join("truth.json").is_file()
}

fn report_status(run: &RunFolder) -> StageStatus {
    let has_page = run.root().join("report").join("index.html").is_file();
    let (condition, reasons) = match is_page_current(run) {
        _ if !has_page => (StageCondition::Absent, Vec::new()),
        Some(true) => (StageCondition::Complete, Vec::new()),
        Some(false) => (StageCondition::Stale, vec!["it shows earlier results".to_owned()]),
        None => (StageCondition::Stale, vec!["the results that it shows are not known".to_owned()]),
    };
    let command = format!("sms report {}", shell_argument(run.root()));
    StageStatus { name: "report", condition, reasons, is_interrupted: false, command }
}

/// Returns the commands that come next: the first stage that the others need, then those that are possible already.
fn next_commands(run: &RunFolder, stages: &[StageStatus], recording: Option<&Path>) -> Vec<String> {
    let is = |name: &str, condition: StageCondition| {
        stages.iter().any(|s| s.name == name && s.condition == condition)
    };
    let needed = ["frames", "masks", "gaussians", "entities", "scene"];
    if let Some(first) =
        stages.iter().find(|s| needed.contains(&s.name) && s.condition != StageCondition::Complete)
    {
        return vec![first.command.clone()];
    }
    let mut next = Vec::new();
    if !is("plan", StageCondition::Complete) {
        next.push(command_of(run, "plan"));
    } else if !is("target", StageCondition::Complete) && recording.is_some_and(is_generated) {
        next.push(command_of(run, "target"));
    }
    if is("robot", StageCondition::Stale) && is("plan", StageCondition::Complete) {
        next.push(command_of(run, "robot"));
    }
    let root = shell_argument(run.root());
    next.push(format!("sms view {root}"));
    next.push(format!("sms export {root} --format all"));
    next
}
