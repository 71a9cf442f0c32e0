//! Arriving frames → a map that grows.

use crate::Error;
use sms_core::StageContext;
use sms_frames::Frame;
use sms_gaussians::{GrowingScan, ScanConfig, ScanObserver, Trainer};
use std::borrow::Borrow;

/// Grows a map from frames while they arrive, and shows it to the observer: `frames` may wait for each of them. `trainer` is fresh, for
/// [`sms_gaussians::GROWING_CLASSES`], and holds the map afterwards. Returns the number of frames.
///
/// # Errors
/// That of `frames`; otherwise as [`GrowingScan::add`].
pub fn grow<F: Borrow<Frame>>(
    frames: impl IntoIterator<Item = Result<F, Error>>,
    config: &ScanConfig,
    trainer: &mut dyn Trainer,
    observer: &mut dyn ScanObserver,
    context: StageContext<'_>,
) -> Result<usize, Error> {
    let mut growing = GrowingScan::new(config, trainer, context)?;
    for frame in frames {
        growing.add(frame?.borrow(), observer)?;
    }
    Ok(growing.frames())
}
