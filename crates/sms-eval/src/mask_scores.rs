//! Scores of masks: label images of a source, compared with the true ones over all frames.
//!
//! Labels and true objects are matched one to one ([`match_labels`]). An object counts as found when its matched label
//! overlaps it by at least [`FOUND_IOU`], and a label counts as false when it has no such object.

use crate::label_matching::{Overlaps, UNMATCHED, match_labels};
use serde::{Deserialize, Serialize};
use sms_core::Labels;

/// Smallest intersection over union of a found object.
pub const FOUND_IOU: f64 = 0.5;

/// Scores of one true object.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MaskedObject {
    /// The object's name.
    pub name: String,
    /// Intersection over union with the matched label, pooled over all frames; 0 without a label.
    pub iou: f64,
    /// Largest share of the object within one label.
    pub held_share: f64,
}

/// Masks of one scene against the truth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MaskScores {
    /// Objects that are visible in any frame.
    pub objects: Vec<MaskedObject>,
    /// Labels that occur.
    pub labels: usize,
    /// Labels that match no object.
    pub false_labels: usize,
    /// Whether the truth marks every object. If not, labels outside its marks are not false.
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

/// Scores `found` against `truth`, label maps of the same frames. If `whole_truth` is false, the truth marks only some
/// of the objects.
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
        // If some objects are unmarked, a label outside all marks may be correct.
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

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::{Image, LabelInfo, MaskSource};

    fn labels(data: &[u16], count: u16) -> Labels {
        let info = |id| LabelInfo { id, name: format!("o{id}"), description: String::new() };
        Labels {
            maps: vec![Image::from_vec(data.len(), 1, data.to_vec())],
            objects: (1..=count).map(info).collect(),
            source: MaskSource::Files,
        }
    }

    #[test]
    fn found_false_and_split_objects_are_counted() {
        let truth = labels(&[0, 1, 1, 1, 1, 2, 2, 2, 2, 0, 0, 3, 3], 4);
        // Object 1 whole, object 2 in halves, object 3 missed, a label on the background. Object 4 is not visible.
        let found = labels(&[0, 5, 5, 5, 5, 1, 1, 2, 2, 3, 3, 0, 0], 5);
        let s = score_masks(&truth, &found, true);
        assert_eq!((s.objects.len(), s.labels), (3, 4));
        assert_eq!(s.objects.iter().map(|o| o.iou).collect::<Vec<_>>(), [1.0, 0.5, 0.0]);
        assert_eq!((s.found(), s.false_labels), (2, 2));
        assert!((s.mean_iou() - 0.5).abs() < 1e-12 && (s.objects[1].held_share - 0.5).abs() < 1e-12);
        // Without the whole truth, the label on the background may be correct; the second half of object 2 is not.
        assert_eq!(score_masks(&truth, &found, false).false_labels, 1);
    }
}
