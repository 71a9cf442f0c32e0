//! `sms-experiments masks`: masks from geometry against the true ones.

use crate::{BenchError, BenchOptions, BenchScene, locate};
use sms_core::metrics::Metrics;
use sms_core::{ColorImage, Image, Labels, StageContext, write_png_color};
use sms_eval::{MaskScores, score_masks};
use sms_frames::{Recording, Sequence};
use sms_masks::{FileMasks, GeometryMasks, Segmenter, TruthMasks, label_color};
use sms_pipeline::stages::{self, FramesRequest};
use sms_poses::{PosesConfig, PosesMode};
use std::fmt::Write as _;
use std::path::Path;
use std::time::Instant;

/// Scores masks from geometry of one scene, as `sms scan` makes them. Real recordings are
/// measured against the masks that came with them. `None` for a recording that is not there. With `dir`, a picture of four
/// frames is written there: colour, true labels, found labels.
///
/// # Errors
/// [`BenchError`] of the stage that failed.
pub fn run_masks(
    scene: &BenchScene,
    options: &BenchOptions,
    dir: Option<&Path>,
    context: StageContext<'_>,
) -> Result<Option<(MaskScores, f64)>, BenchError> {
    let StageContext { progress, cancel, .. } = context;
    let Some(folder) = locate(scene, options, progress, cancel)? else { return Ok(None) };
    let recording = Recording::open(&folder, &options.read)?;
    let request = FramesRequest {
        load: options.load.clone(),
        poses: PosesConfig { mode: PosesMode::Given, ..PosesConfig::default() },
        accept_faults: true,
    };
    let sequence = stages::frames(&recording, &request, context)?.sequence;
    let is_real = matches!(scene, BenchScene::Real(_));
    let given = FileMasks::default();
    let truth: &dyn Segmenter = if is_real { &given } else { &TruthMasks };
    let truth = truth.segment(&sequence, context)?;
    let began = Instant::now();
    let geometry = GeometryMasks { config: options.masks.clone() };
    let found = stages::masks(&sequence, &geometry, &options.masks, context)?.labels;
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
    use sms_eval::MaskedObject;

    #[test]
    fn means_are_over_objects_and_labels() {
        let object = |name: &str, iou| MaskedObject { name: name.to_owned(), iou, held_share: iou };
        let objects = vec![object("o1", 1.0), object("o2", 0.5), object("o3", 0.0)];
        let s = MaskScores { objects, labels: 4, false_labels: 2, whole_truth: true };
        let metrics = masks_metrics(&[(BenchScene::Fixed(1), s, 0.0)]);
        assert_eq!(metrics.number("bench.masks.fixed_01.o1.iou"), Some(1.0));
        assert!((metrics.number("bench.masks.mean.found_share").unwrap() - 2.0 / 3.0).abs() < 1e-12);
        assert_eq!(metrics.number("bench.masks.mean.false_share"), Some(0.5));
    }
}
