//! How good masks are: label images of a source against the true ones, over all frames.
//!
//! Labels and true objects are matched one to one ([`match_labels`]). An object counts as found when the label that it
//! is matched with overlaps it by at least [`FOUND_IOU`], and a label counts as false when it has no such object.

use crate::matching::{Overlaps, match_labels};
use crate::surface::UNMATCHED;
use crate::{BenchError, BenchOptions, BenchScene, locate};
use serde::{Deserialize, Serialize};
use sms_core::metrics::Metrics;
use sms_core::{Cancel, ColorImage, Image, Labels, Progress, Warnings, write_png_color};
use sms_frames::{Recording, Sequence, load};
use sms_masks::{FileMasks, GeometryMasks, Segmenter, TruthMasks, complete, label_color};
use std::fmt::Write as _;
use std::path::Path;
use std::time::Instant;

/// Intersection over union from which an object counts as found.
pub const FOUND_IOU: f64 = 0.5;

/// What became of one true object.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MaskedObject {
    /// The object's name.
    pub name: String,
    /// Intersection over union, pooled over all frames, with the label that it is matched with; 0 without one.
    pub iou: f64,
    /// The largest share of the object that one label holds.
    pub held_share: f64,
}

/// Masks of one scene against the truth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MaskScores {
    /// Objects that any frame shows.
    pub objects: Vec<MaskedObject>,
    /// Labels that occur.
    pub labels: usize,
    /// Labels that match no object.
    pub false_labels: usize,
    /// Whether every object is marked: labels of what the truth leaves unmarked are not false.
    pub whole_truth: bool,
}

impl MaskScores {
    /// Objects that were found.
    pub fn found(&self) -> usize {
        self.objects.iter().filter(|o| o.iou >= FOUND_IOU).count()
    }

    /// Share of the objects that were found; 1 without objects.
    pub fn found_share(&self) -> f64 {
        if self.objects.is_empty() { 1.0 } else { self.found() as f64 / self.objects.len() as f64 }
    }

    /// Share of the labels that match no object; 0 without labels.
    pub fn false_share(&self) -> f64 {
        self.false_labels as f64 / self.labels.max(1) as f64
    }

    /// Mean over the objects of their intersection over union; 1 without objects.
    pub fn mean_iou(&self) -> f64 {
        let sum: f64 = self.objects.iter().map(|o| o.iou).sum();
        if self.objects.is_empty() { 1.0 } else { sum / self.objects.len() as f64 }
    }
}

/// Measures `found` against `truth`, label maps of the same frames. With `whole_truth` false, the truth marks some of the
/// objects only.
pub fn score_masks(truth: &Labels, found: &Labels, whole_truth: bool) -> MaskScores {
    let (rows, columns) = (found.class_count(), truth.class_count());
    let mut overlaps = Overlaps::new(rows, columns);
    let mut counts = vec![vec![0u64; columns]; rows];
    for (f, t) in found.maps.iter().zip(&truth.maps) {
        overlaps.add_maps(f, t);
        f.data.iter().zip(&t.data).for_each(|(&f, &t)| counts[usize::from(f)][usize::from(t)] += 1);
    }
    let matched = match_labels(&overlaps);
    let pixels_of = |t: usize| counts.iter().map(|row| row[t]).sum::<u64>();
    let objects: Vec<MaskedObject> = truth
        .objects
        .iter()
        .filter(|o| pixels_of(usize::from(o.id)) > 0)
        .map(|o| {
            let t = usize::from(o.id);
            let label = (1..rows).find(|&r| matched[r] == o.id);
            let most = (1..rows).map(|r| counts[r][t]).max().unwrap_or(0);
            MaskedObject {
                name: o.name.clone(),
                iou: label.map_or(0.0, |r| overlaps.iou(r, t)),
                held_share: most as f64 / pixels_of(t) as f64,
            }
        })
        .collect();
    let occurs = |r: usize| counts[r].iter().any(|&n| n > 0);
    let is_false = |r: usize| {
        let hit = matched[r] != UNMATCHED && overlaps.iou(r, usize::from(matched[r])) >= FOUND_IOU;
        // Where not all is marked, a label that lies outside of all marks may be right.
        let marked: u64 = counts[r][1..].iter().sum();
        !hit && (whole_truth || 2 * marked > counts[r].iter().sum::<u64>())
    };
    MaskScores {
        objects,
        labels: (1..rows).filter(|&r| occurs(r)).count(),
        false_labels: (1..rows).filter(|&r| occurs(r) && is_false(r)).count(),
        whole_truth,
    }
}

/// Masks from geometry of one scene, as `sms scan` makes them, and what they are worth. Real recordings are
/// measured against the masks that came with them. `None` for a recording that is not there. With `dir`, a picture of four
/// frames is written there: colour, true labels, found labels.
///
/// # Errors
/// [`BenchError`] of the stage that failed.
pub fn run_masks(
    scene: &BenchScene,
    options: &BenchOptions,
    dir: Option<&Path>,
    progress: &dyn Progress,
    cancel: &Cancel,
    warnings: &Warnings,
) -> Result<Option<(MaskScores, f64)>, BenchError> {
    let Some(folder) = locate(scene, options, progress, cancel)? else { return Ok(None) };
    let recording = Recording::open(&folder, &options.read)?;
    let sequence = load(&recording, &options.load, progress, cancel, warnings)?;
    let is_real = matches!(scene, BenchScene::Real(_));
    let given = FileMasks::default();
    let truth: &dyn Segmenter = if is_real { &given } else { &TruthMasks };
    let truth = truth.segment(&sequence, progress, cancel, warnings)?;
    let began = Instant::now();
    let geometry = GeometryMasks { config: options.masks.clone() };
    let found = geometry.segment(&sequence, progress, cancel, warnings)?;
    let (found, _) = complete(found, &sequence, &options.masks, progress, cancel)?;
    let seconds = began.elapsed().as_secs_f64();
    if let Some(dir) = dir {
        write_masks_panel(&dir.join(format!("{scene}.png")), &sequence, &truth, &found)?;
    }
    Ok(Some((score_masks(&truth, &found, !is_real), seconds)))
}

/// Four frames side by side: colour, true labels over it, found labels over it.
fn write_masks_panel(
    path: &Path,
    sequence: &Sequence,
    truth: &Labels,
    found: &Labels,
) -> Result<(), BenchError> {
    let Some(first) = sequence.frames.first() else { return Ok(()) };
    let ((w, h), n) = (first.color.size(), sequence.len());
    let shown = [0, n / 3, 2 * n / 3, n - 1];
    let mut panel: ColorImage = Image::filled(w * shown.len(), 3 * h, [0; 3]);
    for (k, &i) in shown.iter().enumerate() {
        for (x, y) in (0..w * h).map(|p| (p % w, p / w)) {
            let color = sequence.frames[i].color[(x, y)];
            panel[(k * w + x, y)] = color;
            for (row, map) in [(1, &truth.maps[i]), (2, &found.maps[i])] {
                let label = map[(x, y)];
                let mixed = |c: usize| {
                    let own = u16::from(color[c]);
                    let sum = if label == 0 { own } else { own + 2 * u16::from(label_color(label)[c]) };
                    (sum / 3) as u8
                };
                panel[(k * w + x, row * h + y)] = std::array::from_fn(mixed);
            }
        }
    }
    Ok(write_png_color(path, &panel)?)
}

/// `bench.masks.{scene}.…`, and `bench.masks.mean.…` over the generated scenes: shares of all their objects and labels.
pub fn masks_metrics(scores: &[(BenchScene, MaskScores, f64)]) -> Metrics {
    let mut metrics = Metrics::new();
    for (scene, s, seconds) in scores {
        let key = |name: &str| format!("bench.masks.{scene}.{name}");
        metrics.set(key("found_share"), s.found_share()).set(key("mean_iou"), s.mean_iou());
        metrics.set(key("false_share"), s.false_share());
        metrics
            .set(key("objects"), s.objects.len())
            .set(key("labels"), s.labels)
            .set(key("seconds"), *seconds);
        for o in &s.objects {
            metrics.set(key(&format!("{}.iou", o.name)), o.iou);
        }
    }
    let whole: Vec<&MaskScores> = scores.iter().map(|s| &s.1).filter(|s| s.whole_truth).collect();
    let sum = |of: &dyn Fn(&MaskScores) -> f64| whole.iter().map(|s| of(s)).sum::<f64>();
    let (objects, labels) = (sum(&|s| s.objects.len() as f64), sum(&|s| s.labels as f64));
    if objects > 0.0 {
        let mean = |name: &str| format!("bench.masks.mean.{name}");
        metrics.set(mean("found_share"), sum(&|s| s.found() as f64) / objects);
        metrics.set(mean("false_share"), sum(&|s| s.false_labels as f64) / labels.max(1.0));
        metrics.set(mean("mean_iou"), sum(&|s| s.objects.iter().map(|o| o.iou).sum()) / objects);
    }
    metrics
}

/// The table for people; objects below 0.8 are named.
pub fn masks_table(scores: &[(BenchScene, MaskScores, f64)]) -> String {
    let mut text = String::from(
        "masks from geometry   found   false   mean IoU   seconds   objects below an IoU of 0.8\n",
    );
    for (scene, s, seconds) in scores {
        let weak = s.objects.iter().filter(|o| o.iou < 0.8 || !s.whole_truth);
        let weak: Vec<String> = weak.map(|o| format!("{} {:.2}", o.name, o.iou)).collect();
        let _ = writeln!(
            text,
            "{:<20} {:>3}/{:<3} {:>3}/{:<3}  {:>7.3}  {seconds:>8.1}   {}",
            scene.to_string(),
            s.found(),
            s.objects.len(),
            s.false_labels,
            s.labels,
            s.mean_iou(),
            weak.join(", ")
        );
    }
    let metrics = masks_metrics(scores);
    let mean = |name: &str| metrics.number(&format!("bench.masks.mean.{name}"));
    if let (Some(found), Some(wrong), Some(iou)) =
        (mean("found_share"), mean("false_share"), mean("mean_iou"))
    {
        let _ = writeln!(
            text,
            "generated scenes: {:.1} % found (target 98), {:.1} % false (target 2), mean IoU {iou:.3} (target 0.9)",
            100.0 * found,
            100.0 * wrong
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::{LabelInfo, MaskSource};

    fn labels(data: &[u16], count: u16) -> Labels {
        let info = |id| LabelInfo { id, name: format!("o{id}"), description: String::new() };
        Labels {
            maps: vec![Image::from_vec(data.len(), 1, data.to_vec())],
            objects: (1..=count).map(info).collect(),
            source: MaskSource::Files,
        }
    }

    #[test]
    fn what_is_found_false_and_split_is_counted() {
        let truth = labels(&[0, 1, 1, 1, 1, 2, 2, 2, 2, 0, 0, 3, 3], 4);
        // Object 1 whole, object 2 in halves, object 3 missed, a label on the background. Object 4 is never seen.
        let found = labels(&[0, 5, 5, 5, 5, 1, 1, 2, 2, 3, 3, 0, 0], 5);
        let s = score_masks(&truth, &found, true);
        assert_eq!((s.objects.len(), s.labels), (3, 4));
        assert_eq!(s.objects.iter().map(|o| o.iou).collect::<Vec<_>>(), [1.0, 0.5, 0.0]);
        assert_eq!((s.found(), s.false_labels), (2, 2));
        assert!((s.mean_iou() - 0.5).abs() < 1e-12 && (s.objects[1].held_share - 0.5).abs() < 1e-12);
        // Without a whole truth, the label on the background may be right; the second half of object 2 is not.
        assert_eq!(score_masks(&truth, &found, false).false_labels, 1);
        let metrics = masks_metrics(&[(BenchScene::Fixed(1), s, 0.0)]);
        assert_eq!(metrics.number("bench.masks.fixed_01.o1.iou"), Some(1.0));
        assert!((metrics.number("bench.masks.mean.found_share").unwrap() - 2.0 / 3.0).abs() < 1e-12);
        assert_eq!(metrics.number("bench.masks.mean.false_share"), Some(0.5));
    }
}
