//! Inputs of a baseline planner: those of ours, and the recording.

use crate::BenchError;
use crate::options::BenchOptions;
use crate::recordings::locate;
use crate::scenes::{BenchScene, no_scene};
use sms_core::{Cancel, Progress, Seed, StageContext, Warnings};
use sms_eval::carried;
use sms_frames::{Frame, Recording, load};
use sms_landing::ResolvedLanding;
use sms_scene::Scene;
use std::cell::OnceCell;

/// One landing to choose.
pub struct LandingSight<'a> {
    /// The task in the planner's scene.
    pub landing: &'a ResolvedLanding,
    /// The planner's scene.
    pub scene: &'a Scene,
    /// Seed of the choice.
    pub seed: Seed,
    pub(super) recorded: &'a Recorded<'a>,
}

impl LandingSight<'_> {
    /// The recording's frames, with cameras in the world of [`Self::scene`]; they are rendered where the recording is not kept.
    ///
    /// # Errors
    /// [`BenchError`] of rendering and reading them.
    pub fn frames(&self) -> Result<&[Frame], BenchError> {
        self.recorded.frames(self.scene)
    }
}

/// A scene's recording, read when it is first asked for.
pub(super) struct Recorded<'a> {
    options: &'a BenchOptions,
    scene: BenchScene,
    number: usize,
    pub(super) progress: &'a dyn Progress,
    pub(super) cancel: &'a Cancel,
    frames: OnceCell<Vec<Frame>>,
}

impl<'a> Recorded<'a> {
    pub(super) fn new(
        options: &'a BenchOptions,
        scene: BenchScene,
        number: usize,
        progress: &'a dyn Progress,
        cancel: &'a Cancel,
    ) -> Self {
        Self { options, scene, number, progress, cancel, frames: OnceCell::new() }
    }

    /// Number of the scene.
    pub(super) fn number(&self) -> usize {
        self.number
    }

    fn frames(&self, scene: &Scene) -> Result<&[Frame], BenchError> {
        if let Some(frames) = self.frames.get() {
            return Ok(frames);
        }
        let options = self.options;
        let dir =
            locate(&self.scene, options, self.progress, self.cancel)?.ok_or_else(|| no_scene(&self.scene))?;
        let recording = Recording::open(&dir, &options.read)?;
        let mut sequence =
            load(&recording, &options.load, StageContext::new(self.progress, self.cancel, &Warnings::new()))?;
        // The planner's scene may be the truth itself, which lies as the recording has it.
        let x_scene_sequence = scene.x_world_recording * sequence.x_world_recording.inverse();
        for frame in &mut sequence.frames {
            frame.camera = carried(&frame.camera, &x_scene_sequence);
        }
        Ok(self.frames.get_or_init(|| sequence.frames))
    }
}
