//! Which mask label stands for which true object.

use crate::surface::UNMATCHED;
use sms_core::LabelMap;

/// Pixel counts of two label maps of the same views.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Overlaps {
    rows: usize,
    columns: usize,
    counts: Vec<u64>,
}

impl Overlaps {
    /// Nothing counted, for labels below `rows` of the one kind and below `columns` of the other.
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

/// For each mask label the true label that it stands for: label 0, the background, stands for itself; objects are
/// assigned one to one so that the sum of their intersections over union is largest; a label that overlaps with no free
/// object is [`UNMATCHED`]. `overlaps` has mask labels as rows and true labels as columns.
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
    let assigned = assignment(&cost);
    let mut truth_of = vec![0];
    truth_of.extend((0..masks).map(|m| {
        let t = assigned[m];
        if t < truths && cost[m][t] < 0.0 { t as u16 + 1 } else { UNMATCHED }
    }));
    truth_of
}

/// The column of each row of a square cost matrix in an assignment of least cost (Kuhn's "Hungarian method", with
/// shortest augmenting paths).
fn assignment(cost: &[Vec<f64>]) -> Vec<usize> {
    let n = cost.len();
    let (mut u, mut v) = (vec![0.0; n + 1], vec![0.0; n + 1]);
    // Row of each column, counted from 1; column 0 is the start of the path.
    let mut row_of = vec![0; n + 1];
    for i in 1..=n {
        row_of[0] = i;
        let mut at = 0;
        let (mut least, mut from, mut done) =
            (vec![f64::INFINITY; n + 1], vec![0; n + 1], vec![false; n + 1]);
        loop {
            done[at] = true;
            let row = row_of[at];
            let (mut step, mut next) = (f64::INFINITY, 0);
            for j in 1..=n {
                if done[j] {
                    continue;
                }
                let reduced = cost[row - 1][j - 1] - u[row] - v[j];
                if reduced < least[j] {
                    (least[j], from[j]) = (reduced, at);
                }
                if least[j] < step {
                    (step, next) = (least[j], j);
                }
            }
            for j in 0..=n {
                if done[j] {
                    u[row_of[j]] += step;
                    v[j] -= step;
                } else {
                    least[j] -= step;
                }
            }
            at = next;
            if row_of[at] == 0 {
                break;
            }
        }
        while at != 0 {
            row_of[at] = row_of[from[at]];
            at = from[at];
        }
    }
    let mut column_of = vec![0; n];
    (1..=n).for_each(|j| column_of[row_of[j] - 1] = j - 1);
    column_of
}

#[cfg(test)]
mod tests {
    use super::*;

    fn overlaps(rows: &[&[u64]]) -> Overlaps {
        Overlaps { rows: rows.len(), columns: rows[0].len(), counts: rows.concat() }
    }

    #[test]
    fn labels_are_matched_one_to_one_by_best_overlap() {
        // Labels 1 and 2 both overlap most with object 1; label 2 does so better, so label 1 takes object 2.
        let o = overlaps(&[&[100, 5, 5], &[0, 40, 30], &[0, 60, 0]]);
        assert_eq!(match_labels(&o), [0, 2, 1]);
        // More labels than objects: the worst stands for nothing. More objects than labels: one stays without.
        let o = overlaps(&[&[100, 0], &[0, 10], &[0, 50]]);
        assert_eq!(match_labels(&o), [0, UNMATCHED, 1]);
        let o = overlaps(&[&[100, 5, 90], &[0, 2, 10]]);
        assert_eq!(match_labels(&o), [0, 1]);
        // A label that touches no object stands for none.
        let o = overlaps(&[&[100, 30], &[10, 0]]);
        assert_eq!(match_labels(&o), [0, UNMATCHED]);
    }

    #[test]
    fn the_assignment_is_the_best_of_all() {
        let value =
            |seed: usize, i: usize, j: usize| ((i * 7 + j * 13 + seed * 29) * 7919 % 101) as f64 / 101.0;
        for seed in 0..20 {
            let cost: Vec<Vec<f64>> = (0..4).map(|i| (0..4).map(|j| value(seed, i, j)).collect()).collect();
            let found = assignment(&cost);
            let total: f64 = found.iter().enumerate().map(|(i, &j)| cost[i][j]).sum();
            let mut best = f64::INFINITY;
            for code in 0..256usize {
                let p = [code & 3, code >> 2 & 3, code >> 4 & 3, code >> 6 & 3];
                if (0..4).all(|k| p.contains(&k)) {
                    best = best.min((0..4).map(|i| cost[i][p[i]]).sum());
                }
            }
            assert!((total - best).abs() < 1e-12);
        }
    }
}
