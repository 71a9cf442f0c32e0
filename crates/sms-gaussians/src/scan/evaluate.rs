//! Agreement of rendered views with the observations.

use crate::RenderedMaps;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sms_core::metrics::Metrics;
use sms_core::{LabelMap, QuantileRule, quantile};
use sms_frames::Frame;

/// Smallest accumulated opacity of a pixel covered by Gaussians.
pub(super) const COVERED: f32 = 0.5;

/// Agreement of one rendered view with its frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ViewScore {
    /// The frame's index in the sequence.
    pub frame_index: usize,
    /// Whether the frame was excluded from training.
    pub held_out: bool,
    /// Peak signal-to-noise ratio of the colour over all pixels that show the scene, decibels.
    pub psnr_db: f64,
    /// PSNR over pixels with measured depth: Gaussians are seeded only at these pixels.
    pub psnr_measured_db: f64,
    /// PSNR over all pixels that show the scene against the photograph at its own exposure, which the rendered view does not know
    /// (apart from colours that were cut off at the common exposure).
    pub psnr_recorded_db: f64,
    /// Mean absolute depth error over pixels with measured depth that are covered by Gaussians, metres.
    pub depth_mae_m: f64,
    /// Median absolute depth error over the same pixels, insensitive to silhouettes.
    pub depth_median_m: f64,
    /// Share of the pixels with measured depth that Gaussians cover.
    pub coverage: f64,
}

pub(crate) fn score_view(frame: &Frame, maps: &RenderedMaps, held_out: bool) -> ViewScore {
    // Errors are computed in parallel and summed in the pixels' order.
    let squared: Vec<[f64; 2]> = maps
        .color
        .par_iter()
        .zip(&frame.color.data)
        .map(|(shown, observed)| {
            let square = |c: usize, gain: f32| {
                let recorded = (f64::from(observed[c]) / 255.0 * f64::from(gain)).min(1.0);
                (f64::from(shown[c].clamp(0.0, 1.0)) - recorded).powi(2)
            };
            [(0..3).map(|c| square(c, 1.0)).sum(), (0..3).map(|c| square(c, frame.gain[c])).sum()]
        })
        .collect();
    let depths = maps.depth.par_iter().zip(&frame.depth.data).zip(&maps.alpha);
    let mut errors: Vec<f64> = depths
        .filter(|((_, measured), alpha)| **measured > 0.0 && **alpha >= COVERED)
        .map(|((shown, measured), _)| f64::from((shown - measured).abs()))
        .collect();
    let depth_mae_m = errors.iter().sum::<f64>() / errors.len() as f64;
    let (depth_median_m, (all, at_depth, recorded)) = rayon::join(
        || median(&mut errors),
        || {
            let (mut all, mut at_depth, mut recorded) = ((0.0, 0usize), (0.0, 0usize), 0.0);
            let pixels = squared.iter().zip(&frame.depth.data).enumerate();
            for (_, (&[squared, as_recorded], &measured)) in pixels.filter(|(i, _)| frame.shows_scene(*i)) {
                all = (all.0 + squared, all.1 + 3);
                recorded += as_recorded;
                if measured > 0.0 {
                    at_depth = (at_depth.0 + squared, at_depth.1 + 3);
                }
            }
            (all, at_depth, (recorded, all.1))
        },
    );
    let psnr = |(sum, count): (f64, usize)| -10.0 * (sum / count.max(1) as f64).max(1e-10).log10();
    let coverage = errors.len() as f64 / (at_depth.1 / 3).max(1) as f64;
    ViewScore {
        frame_index: frame.index,
        held_out,
        psnr_db: psnr(all),
        psnr_measured_db: psnr(at_depth),
        psnr_recorded_db: psnr(recorded),
        depth_mae_m,
        depth_median_m,
        coverage,
    }
}

/// Returns the upper median; NaN for no values.
fn median(values: &mut [f64]) -> f64 {
    quantile(values, 0.5, QuantileRule::Nearest).unwrap_or(f64::NAN)
}

/// Confusion matrix of rendered and observed labels.
#[derive(Debug, Clone, Default)]
pub(crate) struct Confusion {
    classes: usize,
    counts: Vec<u64>,
}

impl Confusion {
    pub(crate) fn new(classes: usize) -> Self {
        Self { classes, counts: vec![0; classes * classes] }
    }

    /// Adds the counts of another one.
    pub(crate) fn merge(&mut self, other: &Self) {
        for (sum, count) in self.counts.iter_mut().zip(&other.counts) {
            *sum += count;
        }
    }

    /// Counts one view. Pixels without any Gaussian count as background.
    pub(crate) fn add(&mut self, frame: &Frame, maps: &RenderedMaps, observed: &LabelMap) {
        for (i, &truth) in observed.data.iter().enumerate().filter(|(i, _)| frame.shows_scene(*i)) {
            let rendered = if maps.alpha[i] >= COVERED { usize::from(maps.label[i]) } else { 0 };
            if usize::from(truth) < self.classes && rendered < self.classes {
                self.counts[usize::from(truth) * self.classes + rendered] += 1;
            }
        }
    }

    /// Returns the intersection over union, averaged over the classes that occur; `None` when nothing was counted.
    pub(crate) fn mean_iou(&self) -> Option<f64> {
        let n = self.classes;
        let ious: Vec<f64> = (0..n)
            .filter_map(|k| {
                let both = self.counts[k * n + k];
                let truth: u64 = (0..n).map(|j| self.counts[k * n + j]).sum();
                let rendered: u64 = (0..n).map(|j| self.counts[j * n + k]).sum();
                let union = truth + rendered - both;
                (union > 0).then(|| both as f64 / union as f64)
            })
            .collect();
        (!ious.is_empty()).then(|| ious.iter().sum::<f64>() / ious.len() as f64)
    }
}

/// Adds the means of a group of views under `scan.<group>_…`; nothing for an empty group.
pub(crate) fn add_metrics(metrics: &mut Metrics, group: &str, views: &[ViewScore], miou: Option<f64>) {
    if views.is_empty() {
        return;
    }
    let mean = |value: fn(&ViewScore) -> f64| {
        let finite: Vec<f64> = views.iter().map(value).filter(|v| v.is_finite()).collect();
        finite.iter().sum::<f64>() / finite.len() as f64
    };
    metrics
        .set(format!("scan.{group}_psnr_db"), mean(|v| v.psnr_db))
        .set(format!("scan.{group}_psnr_measured_db"), mean(|v| v.psnr_measured_db))
        .set(format!("scan.{group}_psnr_recorded_db"), mean(|v| v.psnr_recorded_db))
        .set(format!("scan.{group}_depth_mae_m"), mean(|v| v.depth_mae_m))
        .set(format!("scan.{group}_depth_median_m"), mean(|v| v.depth_median_m))
        .set(format!("scan.{group}_coverage"), mean(|v| v.coverage));
    if let Some(miou) = miou {
        metrics.set(format!("scan.{group}_miou"), miou);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DPose3;
    use sms_core::{Camera, Image, Intrinsics};

    #[test]
    fn closed_forms_of_psnr_depth_error_and_coverage() {
        let k = Intrinsics::from_fov(4, 2, 1.0);
        let mut depth = Image::filled(4, 2, 1.0f32);
        depth[(0, 0)] = 0.0;
        let frame = Frame {
            index: 5,
            ..Frame::new(
                Camera::new(k, DPose3::identity()),
                Image::filled(4, 2, [51, 51, 51]),
                depth,
                Image::filled(4, 2, [0.0, 0.0, -1.0]),
            )
        };
        let mut maps = RenderedMaps {
            width: 4,
            height: 2,
            color: vec![[0.3; 3]; 8],
            alpha: vec![1.0; 8],
            depth: vec![1.002; 8],
            normal_w: vec![[0.0; 3]; 8],
            label: vec![1; 8],
        };
        maps.alpha[1] = 0.2;
        maps.depth[2] = 1.1;
        let score = score_view(&frame, &maps, true);
        assert!((score.psnr_db - 20.0).abs() < 1e-5 && (score.psnr_measured_db - 20.0).abs() < 1e-5);
        assert!((score.depth_median_m - 0.002).abs() < 1e-6);
        assert!((score.depth_mae_m - (0.1 + 5.0 * 0.002) / 6.0).abs() < 1e-6);
        assert!((score.coverage - 6.0 / 7.0).abs() < 1e-12);

        // At a gain of a half, the photograph has 0.1 instead of 0.2.
        let dark = Frame { gain: [0.5; 3], ..frame.clone() };
        let of_dark = score_view(&dark, &maps, true);
        assert!(of_dark.psnr_db == score.psnr_db && score.psnr_recorded_db == score.psnr_db);
        assert!((of_dark.psnr_recorded_db + 20.0 * 0.2f64.log10()).abs() < 1e-5);

        // What is attached to the camera counts for nothing.
        let attached = Image::from_vec(4, 2, vec![false, false, false, false, false, false, false, true]);
        let with = Frame { attached: Some(std::sync::Arc::new(attached)), ..frame.clone() };
        let mut wrong = maps.clone();
        wrong.color[7] = [1.0; 3];
        assert!((score_view(&with, &wrong, true).psnr_db - 20.0).abs() < 1e-5);
        assert!(score_view(&frame, &wrong, true).psnr_db < 15.0);

        let mut confusion = Confusion::new(2);
        assert_eq!(confusion.mean_iou(), None);
        let truth = Image::from_vec(4, 2, vec![1, 0, 1, 1, 1, 1, 0, 0]);
        confusion.add(&frame, &maps, &truth);
        // Class 1: 5 of the 7 pixels rendered or observed as class 1; class 0: 1 of 3.
        assert!((confusion.mean_iou().unwrap() - 0.5 * (5.0 / 7.0 + 1.0 / 3.0)).abs() < 1e-12);
        // Without the last pixel, 5 of 6 and 1 of 2.
        let mut confusion = Confusion::new(2);
        confusion.add(&with, &maps, &truth);
        assert!((confusion.mean_iou().unwrap() - 0.5 * (5.0 / 6.0 + 1.0 / 2.0)).abs() < 1e-12);
    }
}
