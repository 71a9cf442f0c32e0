//! The two phases of training on all frames together with the schedule `fused`: learning rates stay constant, and fall at the end.
//!
//! Rates that fall from the first step on have to know the last one. Constant ones may go on for as long as they help (Hu et al. 2024,
//! "MiniCPM", warmup-stable-decay): until the errors of a few frames that are not trained on so far stall. While rates fall, all frames
//! are trained on.

use super::config::FusedConfig;
use super::evaluate::COVERED;
use crate::{LossWeights, RenderedMaps};
use sms_frames::{Frame, evenly_spread};

/// Share of the steps in which rates fall. From the first step on, rates that fall have 1.0 dB less on a real recording and 0.2 to 0.3 dB
/// less on a generated scene with as many steps (experiments/studies/scan/fused.md).
const FALLING: f64 = 1.0 / 3.0;
/// Steps between two looks at the frames that are not trained on.
const EVERY: usize = 100;
/// Number of looks without a gain after which rates fall: at constant rates, errors scatter from look to look.
const PATIENCE: usize = 2;
/// One of so many frames is not trained on while rates are constant, and no more than [`MOST_VALIDATION`].
const VALIDATION: usize = 8;
const MOST_VALIDATION: usize = 4;

/// Steps of the two phases.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Phases {
    /// Greatest number of steps.
    limit: usize,
    /// Least gain.
    min_gain: f32,
}

impl Phases {
    pub(super) fn new(config: &FusedConfig) -> Self {
        Self { limit: config.steps, min_gain: config.min_gain }
    }

    /// Returns the slots of the frames that are not trained on while rates are constant: none if these steps end before errors can stall.
    pub(super) fn validation(&self, frames: usize) -> Vec<usize> {
        let count = (frames / VALIDATION).min(MOST_VALIDATION);
        if self.min_gain == 0.0 || self.latest_fall() < (PATIENCE + 1) * EVERY {
            return Vec::new();
        }
        // Between the first frame and the last.
        evenly_spread(frames, count).into_iter().map(|slot| slot + frames / (2 * count)).collect()
    }

    /// Returns the step at which rates begin to fall if errors do not stall before.
    fn latest_fall(&self) -> usize {
        (self.limit as f64 * (1.0 - FALLING)) as usize
    }

    /// Returns the next step at which the phase may end.
    pub(super) fn next_look(&self, step: usize, validates: bool) -> usize {
        let latest = self.latest_fall();
        if validates { latest.min((step / EVERY + 1) * EVERY) } else { latest }
    }

    /// Returns whether it is time to look at the frames that are not trained on, `looks` times so far.
    pub(super) fn is_look(&self, step: usize, looks: usize) -> bool {
        step >= (looks + 1) * EVERY && step < self.latest_fall()
    }

    /// Returns whether rates fall from this step on, after these errors of the frames that are not trained on.
    pub(super) fn falls(&self, step: usize, errors: &[f32]) -> bool {
        step >= self.latest_fall() || has_stalled(errors, self.min_gain)
    }

    /// Returns the number of steps if rates fall from this one on.
    pub(super) fn end(&self, fall: usize) -> usize {
        let falling = (fall as f64 * FALLING / (1.0 - FALLING)).ceil() as usize;
        (fall + falling).min(self.limit)
    }
}

/// Returns whether none of the last errors is lower than the best before by the share `min_gain`.
fn has_stalled(errors: &[f32], min_gain: f32) -> bool {
    let Some(split) = errors.len().checked_sub(PATIENCE).filter(|split| *split > 0) else { return false };
    let best = |errors: &[f32]| errors.iter().copied().fold(f32::INFINITY, f32::min);
    best(&errors[split..]) > (1.0 - min_gain) * best(&errors[..split])
}

/// Returns the mean absolute errors of colour and depth of a view, weighted as the losses weigh theirs.
pub(super) fn view_error(frame: &Frame, maps: &RenderedMaps, weights: &LossWeights) -> f32 {
    let (mut color, mut depth) = ((0.0f64, 0usize), (0.0f64, 0usize));
    let pixels = maps.color.iter().zip(&frame.color.data).enumerate();
    for (i, (shown, observed)) in pixels.filter(|(i, _)| frame.shows_scene(*i)) {
        let difference = |c: usize| f64::from((shown[c] - f32::from(observed[c]) / 255.0).abs());
        color = (color.0 + (0..3).map(difference).sum::<f64>() / 3.0, color.1 + 1);
        let measured = frame.depth.data[i];
        if measured > 0.0 && maps.alpha[i] >= COVERED {
            depth = (depth.0 + f64::from((maps.depth[i] - measured).abs()), depth.1 + 1);
        }
    }
    let mean = |(sum, count): (f64, usize)| (sum / count.max(1) as f64) as f32;
    weights.color * mean(color) + weights.depth * mean(depth)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn phases(steps: usize) -> Phases {
        Phases::new(&FusedConfig { steps, min_gain: 0.01, ..FusedConfig::default() })
    }

    #[test]
    fn rates_fall_in_the_last_third_at_the_latest() {
        assert_eq!((phases(600).latest_fall(), phases(600).end(400)), (400, 600));
        assert!(!phases(600).falls(390, &[]) && phases(600).falls(400, &[]));
        // A batch may end beyond the step.
        assert_eq!((phases(2000).end(1340), phases(2000).end(500)), (2000, 750));
        assert_eq!((phases(0).latest_fall(), phases(0).end(0)), (0, 0));
    }

    #[test]
    fn rates_fall_when_errors_stall() {
        let falls = |errors: &[f32]| phases(2000).falls(100 * errors.len(), errors);
        assert!(!falls(&[1.0, 2.0]), "too few to tell");
        assert!(falls(&[1.0, 1.0, 0.995]));
        assert!(!falls(&[1.0, 1.2, 0.98]));
        // The best of all looks before counts, not the last.
        assert!(falls(&[0.9, 1.0, 0.95, 0.92]));
        assert!(!falls(&[1.0, 0.9, 0.8, 0.7, 0.71]));
    }

    #[test]
    fn frames_are_left_out_only_where_errors_can_stall() {
        assert_eq!(phases(2000).validation(60), [7, 22, 37, 52]);
        assert_eq!(phases(2000).validation(13), [6]);
        assert!(phases(2000).validation(7).is_empty() && phases(400).validation(60).is_empty());
        let all = Phases::new(&FusedConfig { steps: 2000, min_gain: 0.0, ..FusedConfig::default() });
        assert!(all.validation(60).is_empty());
        assert_eq!((phases(2000).next_look(100, true), phases(2000).next_look(100, false)), (200, 1333));
        let is_look = |step: usize, looks: usize| phases(2000).is_look(step, looks);
        assert!(!is_look(90, 0) && is_look(100, 0) && !is_look(100, 1) && !is_look(1340, 12));
    }
}
