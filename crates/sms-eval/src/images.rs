//! Rendered held-out views, compared with the observed frames and with the truth.

use crate::label_matching::{Overlaps, UNMATCHED};
use crate::statistics::{mean, rank};
use crate::truth::TrueView;
use serde::{Deserialize, Serialize};
use sms_core::{ColorImage, DepthImage, Image, LabelMap};

/// Peak signal-to-noise ratio over all pixels and channels, decibels.
pub fn psnr_db(shown: &Image<[f32; 3]>, observed: &ColorImage) -> f64 {
    let squared: f64 = shown
        .data
        .iter()
        .zip(&observed.data)
        .map(|(a, b)| {
            let off = |c: usize| f64::from(a[c].clamp(0.0, 1.0)) - f64::from(b[c]) / 255.0;
            off(0).powi(2) + off(1).powi(2) + off(2).powi(2)
        })
        .sum();
    let mean = squared / (3 * observed.data.len()).max(1) as f64;
    -10.0 * mean.max(1e-10).log10()
}

/// Depth errors collected over views.
///
/// A pixel counts if its true depth lies within the range of depths that the camera measured anywhere in the frame,
/// which excludes the distant floor. Counted pixels with a rendered depth (accumulated opacity of at least one half)
/// have an error; the others lower the coverage.
#[derive(Debug, Clone, Default)]
pub struct DepthErrors {
    errors: Vec<f64>,
    inner: Vec<f64>,
    measured: Vec<f64>,
    countable: usize,
}

/// Summary of [`DepthErrors`]; metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DepthScores {
    /// Mean absolute error.
    pub mae_m: f64,
    /// Median absolute error.
    pub median_m: f64,
    /// Mean absolute error away from silhouettes: where the true 5 × 5 neighbourhood has one label and no depth edge.
    pub inner_mae_m: f64,
    /// Mean absolute error at pixels with a measured depth.
    pub measured_mae_m: f64,
    /// Share of the counted pixels with a rendered depth.
    pub coverage: f64,
}

impl DepthErrors {
    /// Adds a view. `measured` is the frame's depth image, 0 where there is none.
    pub fn add(&mut self, shown: &DepthImage, truth: &TrueView, measured: &DepthImage) {
        let valid = || measured.data.iter().copied().filter(|z| *z > 0.0);
        let near = valid().fold(f32::INFINITY, f32::min);
        let far = valid().fold(0.0, f32::max);
        let edge = silhouettes(truth);
        for i in 0..shown.data.len() {
            let z = truth.depth.data[i];
            if !(z > 0.0 && z >= near && z <= far) {
                continue;
            }
            self.countable += 1;
            if shown.data[i] <= 0.0 || !shown.data[i].is_finite() {
                continue;
            }
            let error = f64::from((shown.data[i] - z).abs());
            self.errors.push(error);
            if !edge[i] {
                self.inner.push(error);
            }
            if measured.data[i] > 0.0 {
                self.measured.push(error);
            }
        }
    }

    /// Returns the scores over all added views.
    pub fn scores(&self) -> DepthScores {
        DepthScores {
            mae_m: mean(&self.errors),
            median_m: rank(&mut self.errors.clone(), 0.5),
            inner_mae_m: mean(&self.inner),
            measured_mae_m: mean(&self.measured),
            coverage: self.errors.len() as f64 / self.countable.max(1) as f64,
        }
    }
}

/// Marks pixels within two pixels of a change of label or a depth edge. Inverse depth is linear over the image of a
/// plane, so its second difference distinguishes an edge from a slanted surface.
fn silhouettes(view: &TrueView) -> Vec<bool> {
    const REACH: usize = 2;
    const RELATIVE: f32 = 0.02;
    let (w, h) = view.depth.size();
    let inverse = |x: usize, y: usize| 1.0 / view.depth[(x, y)].max(1e-3);
    let bends = |a: f32, b: f32, c: f32| (a - 2.0 * b + c).abs() > RELATIVE * b;
    let mut edge = vec![false; w * h];
    for y in 0..h {
        for x in 0..w {
            let own = view.label[(x, y)];
            let b = inverse(x, y);
            edge[y * w + x] = (x > 0 && x + 1 < w && bends(inverse(x - 1, y), b, inverse(x + 1, y)))
                || (y > 0 && y + 1 < h && bends(inverse(x, y - 1), b, inverse(x, y + 1)))
                || (x + 1 < w && view.label[(x + 1, y)] != own)
                || (y + 1 < h && view.label[(x, y + 1)] != own);
        }
    }
    let near = |x: usize, y: usize| {
        let columns = x.saturating_sub(REACH)..=(x + REACH).min(w - 1);
        (y.saturating_sub(REACH)..=(y + REACH).min(h - 1)).any(|v| columns.clone().any(|u| edge[v * w + u]))
    };
    (0..w * h).map(|i| near(i % w, i / w)).collect()
}

/// Returns the mean intersection over union of rendered and true labels over the classes that occur in the true views,
/// including the background. `pairs` are rendered labels (of the masks) with true views; `truth_of` maps mask labels to
/// true labels. Every pixel of an unmatched label is wrong; an object without a label has IoU 0.
pub fn mean_iou(pairs: &[(&LabelMap, &TrueView)], truth_of: &[u16], classes: usize) -> f64 {
    // One additional row for unmatched labels.
    let mut overlaps = Overlaps::new(classes + 1, classes);
    let mut occurs = vec![false; classes];
    for (shown, truth) in pairs {
        for (&s, &t) in shown.data.iter().zip(&truth.label.data) {
            let class = truth_of.get(usize::from(s)).copied().unwrap_or(UNMATCHED);
            overlaps.add(if class == UNMATCHED { classes as u16 } else { class }, t);
            if let Some(occurs) = occurs.get_mut(usize::from(t)) {
                *occurs = true;
            }
        }
    }
    let ious: Vec<f64> = (0..classes).filter(|&k| occurs[k]).map(|k| overlaps.iou(k, k)).collect();
    mean(&ious)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(depth: Vec<f32>, label: Vec<u16>) -> TrueView {
        let n = depth.len();
        TrueView { depth: Image::from_vec(n, 1, depth), label: Image::from_vec(n, 1, label) }
    }

    #[test]
    fn psnr_of_a_constant_error_is_its_closed_form() {
        let shown = Image::filled(4, 2, [0.3f32; 3]);
        assert!((psnr_db(&shown, &Image::filled(4, 2, [51; 3])) - 20.0).abs() < 1e-5);
    }

    #[test]
    fn depth_counts_where_the_camera_can_measure_and_something_is_shown() {
        let truth = view(vec![1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.2, 3.0], vec![0, 0, 0, 0, 0, 0, 1, 0]);
        let measured = Image::from_vec(8, 1, vec![0.9, 0.0, 1.0, 1.0, 1.0, 1.0, 1.25, 0.0]);
        let shown = Image::from_vec(8, 1, vec![1.001, 1.001, 1.001, 1.001, 0.0, 1.001, 1.3, 1.0]);
        let mut errors = DepthErrors::default();
        errors.add(&shown, &truth, &measured);
        let s = errors.scores();
        // The last pixel is beyond the measured range, the fifth is empty.
        assert!((s.coverage - 6.0 / 7.0).abs() < 1e-12);
        assert!((s.mae_m - (5.0 * 0.001 + 0.1) / 6.0).abs() < 1e-6 && (s.median_m - 0.001).abs() < 1e-6);
        assert!((s.inner_mae_m - 0.001).abs() < 1e-6, "the object's border is left out");
        assert!((s.measured_mae_m - (4.0 * 0.001 + 0.1) / 5.0).abs() < 1e-6);
    }

    #[test]
    fn iou_counts_objects_that_are_missing_and_labels_that_stand_for_nothing() {
        let truth = view(vec![1.0; 10], vec![0, 0, 0, 0, 1, 1, 1, 2, 2, 2]);
        let right = Image::from_vec(10, 1, vec![0, 0, 0, 0, 2, 2, 2, 1, 1, 1]);
        assert_eq!(mean_iou(&[(&right, &truth)], &[0, 2, 1], 3), 1.0);
        // Object 2 is not found; label 2 is unmatched and covers one pixel of the background.
        let shown = Image::from_vec(10, 1, vec![0, 0, 0, 2, 1, 1, 1, 0, 0, 0]);
        let iou = mean_iou(&[(&shown, &truth)], &[0, 1, UNMATCHED], 3);
        assert!((iou - (3.0 / 7.0 + 1.0 + 0.0) / 3.0).abs() < 1e-12, "{iou}");
    }
}
