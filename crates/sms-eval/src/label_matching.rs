//! Matching of mask labels with true objects.

use crate::assignment::least_cost_assignment;
use sms_core::LabelMap;

/// A mask label that matches no true object.
pub const UNMATCHED: u16 = u16::MAX;

/// Pixel counts of two label maps of the same views.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Overlaps {
    rows: usize,
    columns: usize,
    counts: Vec<u64>,
}

impl Overlaps {
    /// Creates empty counts for labels below `rows` and below `columns`.
    pub fn new(rows: usize, columns: usize) -> Self {
        Self { rows, columns, counts: vec![0; rows * columns] }
    }

    /// Counts one pixel; labels out of range are not counted.
    pub fn add(&mut self, row: u16, column: u16) {
        let (r, c) = (usize::from(row), usize::from(column));
        if r < self.rows && c < self.columns {
            self.counts[r * self.columns + c] += 1;
        }
    }

    /// Counts a pair of maps of the same size.
    pub fn add_maps(&mut self, rows: &LabelMap, columns: &LabelMap) {
        rows.data.iter().zip(&columns.data).for_each(|(&r, &c)| self.add(r, c));
    }

    /// Intersection over union of row `r` and column `c`; 0 where neither occurs.
    pub fn iou(&self, r: usize, c: usize) -> f64 {
        let both = self.counts[r * self.columns + c];
        let row: u64 = self.counts[r * self.columns..(r + 1) * self.columns].iter().sum();
        let column: u64 = (0..self.rows).map(|i| self.counts[i * self.columns + c]).sum();
        let union = row + column - both;
        if union > 0 { both as f64 / union as f64 } else { 0.0 }
    }
}

/// Returns the true label of each mask label. Label 0, the background, is matched with itself. Objects are matched one
/// to one so that the sum of their intersections over union is largest. A label without an overlapping free object is
/// [`UNMATCHED`]. `overlaps` has mask labels as rows and true labels as columns.
pub fn match_labels(overlaps: &Overlaps) -> Vec<u16> {
    let (masks, truths) = (overlaps.rows.saturating_sub(1), overlaps.columns.saturating_sub(1));
    let size = masks.max(truths);
    let cost: Vec<Vec<f64>> = (0..size)
        .map(|m| {
            (0..size)
                .map(|t| if m < masks && t < truths { -overlaps.iou(m + 1, t + 1) } else { 0.0 })
                .collect()
        })
        .collect();
    let assigned = least_cost_assignment(&cost);
    let mut truth_of = vec![0];
    truth_of.extend((0..masks).map(|m| {
        let t = assigned[m];
        if t < truths && cost[m][t] < 0.0 { t as u16 + 1 } else { UNMATCHED }
    }));
    truth_of
}

#[cfg(test)]
mod tests {
    use super::*;

    fn overlaps(rows: &[&[u64]]) -> Overlaps {
        Overlaps { rows: rows.len(), columns: rows[0].len(), counts: rows.concat() }
    }

    #[test]
    fn labels_are_matched_one_to_one_by_best_overlap() {
        // Labels 1 and 2 both overlap most with object 1. Label 2 has the larger overlap, so label 1 gets object 2.
        let o = overlaps(&[&[100, 5, 5], &[0, 40, 30], &[0, 60, 0]]);
        assert_eq!(match_labels(&o), [0, 2, 1]);
        // More labels than objects: the worst label is unmatched. More objects than labels: one object has no label.
        let o = overlaps(&[&[100, 0], &[0, 10], &[0, 50]]);
        assert_eq!(match_labels(&o), [0, UNMATCHED, 1]);
        let o = overlaps(&[&[100, 5, 90], &[0, 2, 10]]);
        assert_eq!(match_labels(&o), [0, 1]);
        // A label without overlap is unmatched.
        let o = overlaps(&[&[100, 30], &[10, 0]]);
        assert_eq!(match_labels(&o), [0, UNMATCHED]);
    }
}
