//! Messages about results of an earlier attempt.

use crate::Context;
use sms_gaussians::{BatchDone, ScanObserver, ScanResumed, SlotDone};

/// Tells the user where a scan is resumed, and passes every report on.
pub(crate) struct AnnouncedScan<'a> {
    /// The observer of the caller.
    pub inner: &'a mut dyn ScanObserver,
    /// Receives the message.
    pub context: &'a Context,
}

impl ScanObserver for AnnouncedScan<'_> {
    fn resumed(&mut self, resumed: &ScanResumed) {
        self.context.message(resumed_text(resumed));
        self.inner.resumed(resumed);
    }

    fn batch(&mut self, batch: &BatchDone) {
        self.inner.batch(batch);
    }

    fn slot(&mut self, slot: &SlotDone<'_>) {
        self.inner.slot(slot);
    }
}

fn resumed_text(resumed: &ScanResumed) -> String {
    let ScanResumed { slot, frames, steps } = *resumed;
    if slot < frames {
        return format!("gaussians: resumed at frame {} of {frames}, after {steps} steps", slot + 1);
    }
    format!("gaussians: resumed after all {frames} frames and {steps} steps")
}
