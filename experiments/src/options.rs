//! Settings of a measurement.

use crate::disturb::Disturbance;
use crate::scenes::HOLDOUT;
use serde_json::{Value, json};
use sms_entities::EntitiesConfig;
use sms_frames::{LoadSettings, ReadOptions};
use sms_gaussians::{Preset, ScanConfig};
use sms_masks::GeometryConfig;
use sms_poses::{PosesConfig, PosesMode};
use sms_synth::CameraPath;
use std::path::PathBuf;

/// Everything that a measurement depends on, besides the scene.
#[derive(Debug, Clone)]
pub struct BenchOptions {
    /// Named preset; its settings are in `load` and `scan` and may have been changed there.
    pub preset: Preset,
    /// Options for reading recordings.
    pub read: ReadOptions,
    /// Settings for loading frames.
    pub load: LoadSettings,
    /// Masks from geometry.
    pub masks: GeometryConfig,
    /// Whether generated scenes get the true masks instead; for ablations.
    pub true_masks: bool,
    /// Pose refinement between loading and masks; off by default.
    pub poses: PosesConfig,
    /// The scan.
    pub scan: ScanConfig,
    /// Meshes.
    pub entities: EntitiesConfig,
    /// Recorded frames of a generated scene.
    pub frames: usize,
    /// Camera path in generated billiards scenes.
    pub path: CameraPath,
    /// Disturbance of the frames.
    pub disturbance: Disturbance,
    /// Folder of the recordings.
    pub cache: PathBuf,
    /// Whether meshes are made and measured.
    pub meshes: bool,
    /// Whether quality is measured: views, surfaces and meshes. Else only time and memory are.
    pub quality: bool,
    /// Whether steps of a fixed scene are timed.
    pub steps: bool,
}

impl BenchOptions {
    /// A preset with everything else at its default, every eighth frame held out; recordings lie in `cache`.
    pub fn new(preset: Preset, cache: impl Into<PathBuf>) -> Self {
        Self {
            preset,
            read: ReadOptions::default(),
            load: LoadSettings { long_side: preset.long_side(), ..LoadSettings::default() },
            masks: GeometryConfig::default(),
            true_masks: false,
            poses: PosesConfig { mode: PosesMode::Given, ..PosesConfig::default() },
            scan: ScanConfig { holdout: HOLDOUT, ..ScanConfig::preset(preset) },
            entities: EntitiesConfig::default(),
            frames: crate::scenes::FRAMES,
            path: CameraPath::default(),
            disturbance: Disturbance::default(),
            cache: cache.into(),
            meshes: true,
            quality: true,
            steps: true,
        }
    }

    /// Returns the name of the preset.
    pub fn preset_name(&self) -> &'static str {
        match self.preset {
            Preset::Draft => "draft",
            Preset::Standard => "standard",
            Preset::Fine => "fine",
        }
    }

    /// Returns the part of a cache key for a recording: the frames, and the path unless it is the default.
    pub(crate) fn recorded(&self) -> Value {
        if self.path == CameraPath::default() { json!(self.frames) } else { json!([self.frames, self.path]) }
    }

    /// Returns the settings of a scan and its bodies by name, without scene and masks, to compare parts of a run.
    pub fn settings(&self) -> [(&'static str, Value); 7] {
        [
            ("preset", json!(self.preset_name())),
            ("frames", self.recorded()),
            ("read", json!(self.read)),
            ("load", json!(self.load)),
            ("masks", json!(self.masks)),
            ("scan", json!(self.scan)),
            ("entities", json!(self.entities)),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_path_is_another_recording_and_the_usual_one_goes_without_saying() {
        let usual = BenchOptions::new(Preset::Draft, "cache");
        assert_eq!(usual.recorded(), json!(usual.frames));
        let paper = BenchOptions { path: CameraPath::paper(), ..usual.clone() };
        assert_ne!(paper.recorded(), usual.recorded());
        assert_eq!(paper.settings()[1], ("frames", paper.recorded()));
    }
}
