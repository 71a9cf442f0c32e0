//! Settings of a measurement.

use crate::disturb::Disturbance;
use crate::scenes::HOLDOUT;
use serde_json::{Value, json};
use sms_entities::EntitiesConfig;
use sms_frames::{LoadSettings, ReadOptions};
use sms_gaussians::{Preset, ScanConfig};
use sms_masks::GeometryConfig;
use sms_poses::{PosesConfig, PosesMode};
use sms_synth::{CameraPath, RecordingSettings, Sensor};
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
    /// Whether a map that grows frame by frame ([`sms_gaussians::GrowingScan`]) is measured, too.
    pub follow: bool,
    /// Meshes.
    pub entities: EntitiesConfig,
    /// Recorded frames of a generated scene.
    pub frames: usize,
    /// Camera path in generated billiards scenes.
    pub path: CameraPath,
    /// Sensor of generated recordings.
    pub sensor: Sensor,
    /// Width of generated recordings, pixels; 0 for the sensor's own.
    pub width: usize,
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
            follow: false,
            entities: EntitiesConfig::default(),
            frames: crate::scenes::FRAMES,
            path: CameraPath::default(),
            sensor: Sensor::Gemini2,
            width: 0,
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

    /// Returns the settings of a generated recording, but for its seed.
    pub(crate) fn recording(&self) -> RecordingSettings {
        let own = self.sensor.recording();
        let width = if self.width == 0 { own.width } else { self.width };
        let scaled = self.sensor.recording_at(width);
        // Fewer frames on the same path are fewer of the same walk: the camera is as fast.
        let frame_rate_hz = scaled.frame_rate_hz * self.frames as f64 / scaled.frames as f64;
        RecordingSettings { frames: self.frames, frame_rate_hz, path: self.path.clone(), ..scaled }
    }

    /// Returns the part of a cache key for a recording: the frames, and path, sensor and width unless they are the defaults.
    pub(crate) fn recorded(&self) -> Value {
        let is_usual = self.sensor == Sensor::Gemini2 && self.width == 0;
        match (is_usual, self.path == CameraPath::default()) {
            (true, true) => json!(self.frames),
            (true, false) => json!([self.frames, self.path]),
            // The settings themselves, so that a changed preset is another recording.
            (false, _) => json!(self.recording()),
        }
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
        let phone = BenchOptions { sensor: Sensor::PhoneLidar, ..usual.clone() };
        let small = BenchOptions { width: 320, ..phone.clone() };
        assert!(phone.recorded() != usual.recorded() && phone.recorded() != small.recorded());
        assert_eq!((small.recording().width, small.recording().height), (320, 240));
    }
}
