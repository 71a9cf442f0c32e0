//! Frames and masks → labelled Gaussians.

use crate::Error;
use sms_core::{Labels, StageContext, process};
use sms_frames::Sequence;
use sms_gaussians::{ScanConfig, ScanObserver, ScanResult, Trainer, scan};
use std::path::Path;

/// Settings and folder of a training.
#[derive(Debug, Clone, Copy)]
pub struct GaussiansRequest<'a> {
    /// Settings of the scan.
    pub config: &'a ScanConfig,
    /// Folder for the result and the checkpoints; a checkpoint of the same inputs is resumed.
    pub work_dir: &'a Path,
}

/// Trains the Gaussians on the frames that are not held out. The metrics of the result include time and memory.
///
/// # Errors
/// As [`scan`].
pub fn gaussians(
    sequence: &Sequence,
    labels: &Labels,
    request: &GaussiansRequest<'_>,
    trainer: &mut dyn Trainer,
    observer: &mut dyn ScanObserver,
    context: StageContext<'_>,
) -> Result<ScanResult, Error> {
    let GaussiansRequest { config, work_dir } = *request;
    let mut result = scan(sequence, labels, config, work_dir, trainer, observer, context)?;
    result.metrics.set("scan.seconds", result.seconds);
    if let Some(bytes) = process::peak_bytes() {
        result.metrics.set("scan.peak_bytes", bytes);
    }
    Ok(result)
}

/// Returns the training frames and their label maps: later stages must not use held-out frames either.
pub fn trained_only(sequence: Sequence, labels: Labels, holdout: usize) -> (Sequence, Labels) {
    let is_trained = |index: usize| !Sequence::is_held_out(index, holdout);
    let maps = kept(labels.maps, is_trained);
    (Sequence { frames: kept(sequence.frames, is_trained), ..sequence }, Labels { maps, ..labels })
}

fn kept<T>(items: Vec<T>, is_kept: impl Fn(usize) -> bool) -> Vec<T> {
    items.into_iter().enumerate().filter(|(i, _)| is_kept(*i)).map(|(_, item)| item).collect()
}
