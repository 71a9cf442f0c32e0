//! A recording that is followed while its folder grows.

use super::Run;
use super::scan::{ScanRequest, ScanSettings};
use crate::stages::grow;
use crate::{Error, Event, device};
use sms_core::{ErrorKind, Progress, StageError, Warnings, length_text};
use sms_frames::{FollowedFrames, Frame};
use sms_gaussians::{BatchDone, GROWING_CLASSES, ScanObserver, ScanResumed, SlotDone};
use std::path::Path;
use std::time::Duration;

impl Run<'_> {
    /// Shows a map that grows from the frames of a recording as they arrive, until none has arrived for `patience`. Writes nothing, and tells
    /// nothing of what is wrong with the recording: the scan does. Returns the number of training steps that the observer was told of.
    pub(super) fn follow(
        &self,
        recording: &Path,
        patience: Duration,
        (request, settings): (&ScanRequest, &ScanSettings),
        observer: &mut dyn ScanObserver,
    ) -> Result<u64, Error> {
        let warnings = Warnings::new();
        let context = self.context.stage(&warnings, request.seed());
        let load = &settings.frames.load;
        if settings.read.ignore_poses {
            self.context.message("follow: no map is shown without recorded poses");
        }
        let (train, events) = (&settings.scan.train, self.context.events.as_ref());
        let (mut trainer, _) = device::trainer(request.device, train, GROWING_CLASSES, events, context)?;
        context.progress.begin("follow", 0);
        let frames = FollowedFrames::new(recording, &settings.read, load, patience, context.cancel)?;
        let mut frames = frames.map(|frame| Ok(frame?));
        let mut told = Told { inner: observer, progress: context.progress, steps: 0 };
        match grow(&mut frames, &settings.scan, trainer.as_mut(), &mut told, context) {
            Ok(count) => {
                context.progress.end(&format!("{count} frames shown, {} Gaussians", trainer.len()));
            }
            Err(error) if matches!(error.kind(), ErrorKind::Other) => {
                // The result does not depend on the map.
                events.event(&Event::Alert(&format!("the map is not shown any more: {error}")));
                frames.try_for_each(|frame: Result<Frame, Error>| frame.map(drop))?;
                context.progress.end("the map was not shown to the end");
            }
            Err(error) => return Err(error),
        }
        let steps = told.steps;
        observer.completed();
        Ok(steps)
    }
}

/// Tells the user of every frame, and passes every report on.
struct Told<'a> {
    inner: &'a mut dyn ScanObserver,
    progress: &'a dyn Progress,
    /// Steps so far.
    steps: u64,
}

impl ScanObserver for Told<'_> {
    fn batch(&mut self, batch: &BatchDone) {
        self.steps = batch.sample.step;
        self.inner.batch(batch);
    }

    fn slot(&mut self, slot: &SlotDone<'_>) {
        let error = length_text(slot.score.depth_mae_m);
        let state = format!("frame {}: {:.1} dB, depth error {error}", slot.slot + 1, slot.score.psnr_db);
        self.progress.update(slot.frames as u64, &state);
        self.inner.slot(slot);
    }
}

/// Passes the reports of the scan on, its steps after those of the growing map.
pub(super) struct Afterwards<'a> {
    /// The observer of the caller.
    pub(super) inner: &'a mut dyn ScanObserver,
    /// Steps of the growing map.
    pub(super) steps: u64,
}

impl ScanObserver for Afterwards<'_> {
    fn resumed(&mut self, resumed: &ScanResumed) {
        self.inner.resumed(&ScanResumed { steps: resumed.steps + self.steps, ..*resumed });
    }

    fn batch(&mut self, batch: &BatchDone) {
        let mut batch = *batch;
        batch.sample.step += self.steps;
        self.inner.batch(&batch);
    }

    fn slot(&mut self, slot: &SlotDone<'_>) {
        let step = slot.step + self.steps;
        self.inner.slot(&SlotDone { step, ..*slot });
    }
}
