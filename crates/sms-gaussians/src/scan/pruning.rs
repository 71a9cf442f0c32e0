//! Removal of Gaussians: transparent ones, and floaters in front of the measured surface.

use super::config::ScanConfig;
use crate::Trainer;
use glamx::Vec3;
use sms_frames::Frame;
use sms_surface::standing;

/// Removes Gaussians below the opacity threshold. Returns which ones were kept.
pub(crate) fn prune_transparent(trainer: &mut dyn Trainer, config: &ScanConfig) -> Vec<bool> {
    let keep: Vec<bool> = trainer.opacities().iter().map(|&o| o >= config.pruning.opacity_below).collect();
    if keep.contains(&false) {
        trainer.retain(&keep);
    }
    keep
}

/// Removes Gaussians below the opacity threshold and, if enabled, floaters. A floater has more `frames` that see
/// through it than frames that measure a surface near it, or fewer than `least` of the latter. Returns the centres of
/// the remaining Gaussians.
pub(crate) fn prune_all(
    trainer: &mut dyn Trainer,
    frames: &[&Frame],
    least: usize,
    config: &ScanConfig,
) -> Vec<Vec3> {
    let (positions_w, opacities) = trainer.places();
    let stands = if config.pruning.floaters {
        standing(&positions_w, frames, least, &config.surface().tolerance)
    } else {
        Vec::new()
    };
    let stands = |i: usize| stands.get(i).is_none_or(|stands| *stands);
    let opaque = |o: f32| o >= config.pruning.opacity_below;
    let keep: Vec<bool> = opacities.iter().enumerate().map(|(i, o)| opaque(*o) && stands(i)).collect();
    if keep.contains(&false) {
        trainer.retain(&keep);
    }
    positions_w.into_iter().zip(keep).filter_map(|(p, keep)| keep.then_some(p)).collect()
}
