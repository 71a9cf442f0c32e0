//! Settings of a measurement of materialize.

use crate::options::BenchOptions;
use crate::trainer::TrainerMaker;
use serde::Serialize;
use serde_json::{Map, Value, json};
use sms_gaussians::Preset;
use std::path::{Path, PathBuf};

/// Which masks a scan is given.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum MaskChoice {
    /// By geometry; the true ones for models longer than the largest object of masks by geometry
    /// (`max_object_m`), as a user would label them.
    #[default]
    Auto,
    /// By geometry.
    Geometry,
    /// The true ones.
    Truth,
}

/// Settings that a measurement of materialize depends on, besides the scene.
#[derive(Debug, Clone)]
pub struct MaterializeOptions {
    /// Preset, frames, masks, scan and entities. Disturbances and pose refinement are not used.
    pub bench: BenchOptions,
    /// Masks; decides instead of `bench.true_masks`.
    pub masks: MaskChoice,
    /// Folder of scans and their meshes.
    pub keep: PathBuf,
    /// Whether scans are made again even if they are there.
    pub rescan: bool,
    /// Back end of scans. A kept scan is used whatever its device, which its `scan.json` names.
    pub trainer: TrainerMaker,
}

impl MaterializeOptions {
    /// Scans of preset `standard` with masks by geometry, on the CPU, kept in `keep`.
    pub fn standard(keep: &Path) -> Self {
        Self {
            bench: BenchOptions::new(Preset::Standard, keep.join("recordings")),
            masks: MaskChoice::Geometry,
            keep: keep.to_owned(),
            rescan: false,
            trainer: TrainerMaker::default(),
        }
    }

    /// Settings that scans and bodies depend on, besides scenes and code, by name; for comparing parts of a run.
    pub fn settings(&self) -> Map<String, Value> {
        let scan = self.bench.settings().into_iter();
        scan.chain([("choice_of_masks", json!(self.masks))]).map(|(k, v)| (k.to_owned(), v)).collect()
    }

    /// Inputs of a scan, besides scene, seed and code, for naming its products.
    pub(crate) fn made_from(&self) -> impl Serialize {
        let (bench, true_masks) = (&self.bench, self.masks == MaskChoice::Truth);
        (&bench.read, &bench.load, &bench.masks, true_masks, &bench.scan, bench.recorded())
    }
}
