//! From a scene to the frames and masks that a reconstruction is given.

use crate::BenchError;
use crate::disturb::Disturbance;
use crate::scenes::{BenchScene, HOLDOUT, generated, real_data_dir, recording};
use glamx::DPose3;
use serde_json::{Value, json};
use sms_core::process;
use sms_core::{Camera, Cancel, InputError, Labels, Progress, Seed, Warnings};
use sms_entities::EntitiesConfig;
use sms_frames::{LoadSettings, ReadOptions, Recording, Sequence, load};
use sms_gaussians::{Preset, ScanConfig};
use sms_masks::{FileMasks, GeometryConfig, GeometryMasks, Segmenter, TruthMasks, complete};
use sms_poses::{PosesConfig, PosesMode, refine_poses};
use sms_synth::{CameraPath, TruthScene};
use std::path::PathBuf;
use std::time::Instant;

/// Everything that a measurement depends on, besides the scene.
#[derive(Debug, Clone)]
pub struct BenchOptions {
    /// Named preset; its settings are in `load` and `scan` and may have been changed there.
    pub preset: Preset,
    /// How recordings are read.
    pub read: ReadOptions,
    /// How frames are loaded.
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
    /// Frames that are recorded of a generated scene.
    pub frames: usize,
    /// Where the camera goes in generated billiards scenes.
    pub path: CameraPath,
    /// What is done to the frames.
    pub disturbance: Disturbance,
    /// Where recordings are kept.
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
            poses: PosesConfig::default(),
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

    /// The preset's name.
    pub fn preset_name(&self) -> &'static str {
        match self.preset {
            Preset::Draft => "draft",
            Preset::Standard => "standard",
            Preset::Fine => "fine",
        }
    }

    /// What names a recording of a generated scene in keys: the frames, with the path where it is not the usual one.
    pub(crate) fn recorded(&self) -> Value {
        if self.path == CameraPath::default() { json!(self.frames) } else { json!([self.frames, self.path]) }
    }

    /// What a scan and the bodies made of it depend on, by name, besides scene and masks; for comparing parts of a run.
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

/// Frames and masks, ready for a scan.
#[derive(Debug)]
pub struct Prepared {
    /// Frames, disturbed and with refined poses if that was asked for.
    pub sequence: Sequence,
    /// Masks made of them.
    pub labels: Labels,
    /// The cameras before they were disturbed, in the sequence's world.
    pub true_cameras: Vec<Camera>,
    /// The truth of a generated scene.
    pub truth: Option<TruthScene>,
    /// The real recording's folder.
    pub real: Option<PathBuf>,
    /// Seconds and CPU seconds of loading.
    pub load_seconds: (f64, f64),
    /// Seconds and CPU seconds of the pose refinement.
    pub poses_seconds: (f64, f64),
    /// Seconds and CPU seconds of the masks.
    pub masks_seconds: (f64, f64),
}

impl Prepared {
    /// `X_TW`: carries the sequence's world to the truth's (undisturbed poses).
    pub fn x_tw(&self) -> DPose3 {
        self.sequence.x_world_recording.inverse()
    }

    /// Indices of the frames kept out of training.
    pub fn held_out(&self, holdout: usize) -> Vec<usize> {
        (1..self.sequence.len()).filter(|&i| Sequence::is_held_out(i, holdout)).collect()
    }

    /// The frames trained on with their label maps: objects must not see what was kept out either.
    pub fn trained_only(&self, holdout: usize) -> (Sequence, Labels) {
        let trained = self.trained(holdout);
        let sequence = Sequence {
            frames: trained.iter().map(|&i| self.sequence.frames[i].clone()).collect(),
            x_world_recording: self.sequence.x_world_recording,
            source: self.sequence.source.clone(),
        };
        let maps = trained.iter().map(|&i| self.labels.maps[i].clone()).collect();
        (sequence, Labels { maps, ..self.labels.clone() })
    }

    /// Indices of the frames trained on.
    pub fn trained(&self, holdout: usize) -> Vec<usize> {
        (0..self.sequence.len()).filter(|&i| i == 0 || !Sequence::is_held_out(i, holdout)).collect()
    }
}

/// Where the recording of a scene lies, rendering it first if need be; `None` for a real recording
/// or a model that is not there.
///
/// # Errors
/// As [`generated`] and [`recording`].
pub fn locate(
    scene: &BenchScene,
    options: &BenchOptions,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<Option<PathBuf>, BenchError> {
    Ok(match scene {
        BenchScene::Real(name) => {
            Some(real_data_dir().join(name)).filter(|d| d.join("transforms.json").is_file())
        }
        _ => match generated(scene)? {
            Some(made) => Some(recording(scene, &made, options, progress, cancel)?),
            None => None,
        },
    })
}

/// Loads a scene's frames, disturbs them and makes masks: `geometry` for generated scenes, those that came with the
/// recording for real ones. `None` for a real recording that is not there.
///
/// # Errors
/// [`BenchError`] of the stage that failed.
pub fn prepare(
    scene: &BenchScene,
    options: &BenchOptions,
    progress: &dyn Progress,
    cancel: &Cancel,
    warnings: &Warnings,
) -> Result<Option<Prepared>, BenchError> {
    let Some(dir) = locate(scene, options, progress, cancel)? else { return Ok(None) };
    let timer = Timer::start();
    let mut sequence =
        load(&Recording::open(&dir, &options.read)?, &options.load, progress, cancel, warnings)?;
    let load_seconds = timer.seconds();
    if !(1..sequence.len()).any(|i| Sequence::is_held_out(i, options.scan.holdout)) {
        return Err(InputError::new(
            format!("no frame of {} is held out: there is nothing to measure views on", sequence.len()),
            "[scan] holdout",
            "give at least 2, such as --set scan.holdout=8, and enough --frames",
        )
        .into());
    }
    let true_cameras = sequence.frames.iter().map(|f| f.camera).collect();
    let seed = match scene {
        BenchScene::Billiards(seed) | BenchScene::Ten(seed) => Seed(*seed),
        BenchScene::Real(_)
        | BenchScene::Model(_)
        | BenchScene::Fixed(_)
        | BenchScene::Stacked(_)
        | BenchScene::Landing(_)
        | BenchScene::ScannedLanding(_) => Seed(0),
    };
    options.disturbance.apply(&mut sequence, &options.load, seed);
    let timer = Timer::start();
    if options.poses.mode != PosesMode::Off {
        sequence = refine_poses(&sequence, &options.poses, progress, cancel, warnings)?.sequence;
    }
    let poses_seconds = timer.seconds();
    let timer = Timer::start();
    let truth = generated(scene)?.map(|made| made.scene);
    let geometry = GeometryMasks { config: options.masks.clone() };
    let masks: &dyn Segmenter = match &truth {
        None => &FileMasks::default(),
        Some(_) if options.true_masks => &TruthMasks,
        Some(_) => &geometry,
    };
    let labels = masks.segment(&sequence, progress, cancel, warnings)?;
    let (labels, _) = complete(labels, &sequence, &options.masks, progress, cancel)?;
    let masks_seconds = timer.seconds();
    let real = truth.is_none().then_some(dir);
    Ok(Some(Prepared {
        sequence,
        labels,
        true_cameras,
        truth,
        real,
        load_seconds,
        poses_seconds,
        masks_seconds,
    }))
}

/// Time on the wall and on the processors since it was started.
pub(crate) struct Timer(Instant, Option<f64>);

impl Timer {
    pub(crate) fn start() -> Self {
        Self(Instant::now(), process::cpu_seconds())
    }

    /// Seconds and CPU seconds (not a number where the system does not tell).
    pub(crate) fn seconds(&self) -> (f64, f64) {
        let cpu = self.1.zip(process::cpu_seconds()).map_or(f64::NAN, |(from, to)| to - from);
        (self.0.elapsed().as_secs_f64(), cpu)
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
