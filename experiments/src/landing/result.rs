//! Kept results of a flight.

use super::{LandingBench, LandingPart};
use crate::{BenchError, MaterialPrior};
use serde::{Deserialize, Serialize};
use sms_core::{Hash, atomic};
use sms_landing::LandingAction;
use std::collections::BTreeMap;

/// One planner's landing and its outcome in the target.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LandingPlanned {
    /// The landing flown; `None` if the planner found none, which is a failure.
    pub action: Option<LandingAction>,
    /// Reason for which no landing was planned.
    pub problem: Option<String>,
    /// Variant of the chooser (the model that was asked); empty if there is only one.
    #[serde(default)]
    pub variant: String,
    /// Share of the planner's worlds in which it succeeds, if it has any.
    pub predicted_share: Option<f64>,
    /// Objective in the planner's own world, if it has one.
    pub predicted: Option<f64>,
    /// Whether it succeeds in the target.
    pub success: bool,
    /// Reason for the failure, in words.
    pub failure: Option<String>,
    /// The kind of failure.
    pub failure_kind: Option<String>,
    /// Whether the air toppled the structure before anything was touched.
    pub in_the_air: bool,
    /// Objective in the target (large ones are cut short).
    pub realised: Option<f64>,
    /// Whether it succeeds with a turbulent jet as the target's wash.
    pub jet_success: Option<bool>,
    /// CPU seconds of planning.
    pub plan_cpu_s: f64,
    /// CPU seconds of both flights in the target: the mean of those that were flown side by side.
    pub target_cpu_s: f64,
}

/// All planners' landings from one start.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LandingFlight {
    /// Hash of its inputs.
    pub key: Hash,
    /// Number of the scene.
    pub scene: usize,
    /// Whether scanned models replace shapes made in code, if they are present.
    pub scanned: bool,
    /// Engine of the target, with its label.
    pub engine: String,
    /// Number of the start.
    pub start: usize,
    /// The planner's knowledge of materials.
    #[serde(rename = "told")]
    pub material_prior: MaterialPrior,
    /// Which draw of the noise.
    pub draw: usize,
    /// True objects of the structure, and those of them that have a body in the planner's scene.
    pub objects: usize,
    /// The latter.
    pub matched: usize,
    /// Wall-clock seconds of one evaluation with `sph`, alone on all cores.
    pub evaluation_s: Option<f64>,
    /// Ours, by the name `sms`, and baselines.
    pub planned: BTreeMap<String, LandingPlanned>,
}

impl LandingFlight {
    /// Which flight of the experiment it is.
    pub fn part(&self) -> LandingPart {
        LandingPart {
            scene: self.scene,
            start: self.start,
            material_prior: self.material_prior,
            draw: self.draw,
        }
    }

    /// Unique name of the flight in parts of a run.
    pub fn item(&self) -> String {
        format!("{} {} draw {} start {}", self.material_prior.as_str(), self.scene, self.draw, self.start)
    }
}

/// Name of our planner's row.
pub(super) const OURS: &str = "sms";

/// Reads the kept result of a flight; `None` if there is none, or of other inputs.
pub(super) fn kept(bench: &LandingBench<'_>, part: LandingPart) -> Result<Option<LandingFlight>, BenchError> {
    let path = bench.file(part);
    if !path.is_file() {
        return Ok(None);
    }
    let key = bench.key(part)?;
    // A file of an earlier version is made again.
    let Ok(found) = atomic::read_json::<LandingFlight>(&path) else { return Ok(None) };
    Ok(Some(found).filter(|f| f.key == key))
}

/// All results in the folder that were made with the settings of `bench`, of all its parts.
///
/// # Errors
/// [`BenchError`] of a file that cannot be read.
pub fn read_landings(bench: &LandingBench<'_>) -> Result<Vec<LandingFlight>, BenchError> {
    let mut all = Vec::new();
    for part in bench.flights() {
        all.extend(kept(bench, part)?);
    }
    Ok(all)
}
