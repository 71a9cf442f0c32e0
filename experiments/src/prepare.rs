//! Preparation of a scene's frames and masks for a reconstruction.

use crate::error::BenchError;
use crate::options::BenchOptions;
use crate::recordings::locate;
use crate::scenes::{BenchScene, generated};
use crate::timer::Timer;
use glamx::DPose3;
use sms_core::{Camera, InputError, Labels, Seed, StageContext};
use sms_frames::{Recording, Sequence};
use sms_masks::{FileMasks, GeometryMasks, Segmenter, TruthMasks};
use sms_pipeline::stages::{self, FramesRequest};
use sms_poses::{PosesConfig, PosesMode};
use sms_synth::TruthScene;
use std::path::PathBuf;

/// Frames and masks, ready for a scan.
#[derive(Debug)]
pub struct Prepared {
    /// Frames, with the requested disturbance and pose refinement.
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

    /// The frames trained on with their label maps: entities must not use held-out frames either.
    pub fn trained_only(&self, holdout: usize) -> (Sequence, Labels) {
        stages::trained_only(self.sequence.clone(), self.labels.clone(), holdout)
    }

    /// Indices of the frames trained on.
    pub fn trained(&self, holdout: usize) -> Vec<usize> {
        (0..self.sequence.len()).filter(|&i| !Sequence::is_held_out(i, holdout)).collect()
    }
}

/// Loads a scene's frames, disturbs them and makes masks: `geometry` for generated scenes, those that came with the
/// recording for real ones. `None` for a real recording that is not there.
///
/// # Errors
/// [`BenchError`] of the stage that failed.
pub fn prepare(
    scene: &BenchScene,
    options: &BenchOptions,
    context: StageContext<'_>,
) -> Result<Option<Prepared>, BenchError> {
    let StageContext { progress, cancel, .. } = context;
    let Some(dir) = locate(scene, options, progress, cancel)? else { return Ok(None) };
    let timer = Timer::start();
    let recording = Recording::open(&dir, &options.read)?;
    let as_recorded = FramesRequest {
        load: options.load.clone(),
        poses: PosesConfig { mode: PosesMode::Given, ..options.poses.clone() },
        accept_faults: true,
    };
    let mut sequence = stages::frames(&recording, &as_recorded, context)?.sequence;
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
        | BenchScene::DrawnStacked(..)
        | BenchScene::Landing(_)
        | BenchScene::ScannedLanding(_) => Seed(0),
    };
    options.disturbance.apply(&mut sequence, &options.load, seed);
    let timer = Timer::start();
    let disturbed = FramesRequest { poses: options.poses.clone(), ..as_recorded };
    let sequence = stages::refined(sequence, &disturbed, context)?.sequence;
    let poses_seconds = timer.seconds();
    let timer = Timer::start();
    let truth = generated(scene)?.map(|made| made.scene);
    let geometry = GeometryMasks { config: options.masks.clone() };
    let masks: &dyn Segmenter = match &truth {
        None => &FileMasks::default(),
        Some(_) if options.true_masks => &TruthMasks,
        Some(_) => &geometry,
    };
    let labels = stages::masks(&sequence, masks, &options.masks, context)?.labels;
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
