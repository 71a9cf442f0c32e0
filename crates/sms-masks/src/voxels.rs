//! Sparse grid: integer keys of cells, and walks over the neighbours of sorted cells.

use glamx::DVec3;

/// Largest index of a cell along each axis, on both sides of the origin.
const HALF: i64 = 1 << 20;

/// Returns the key of the cell of size `cell_m` that contains a point, or `None` for points that are not finite or
/// too far away. Keys sort by z, then y, then x.
pub(crate) fn key_of(p_w: DVec3, cell_m: f64) -> Option<u64> {
    let c = (p_w / cell_m).floor();
    let inside = c.is_finite() && c.abs().max_element() < (HALF - 64) as f64;
    inside.then(|| pack([c.x as i64, c.y as i64, c.z as i64]))
}

fn pack([x, y, z]: [i64; 3]) -> u64 {
    ((z + HALF) as u64) << 42 | ((y + HALF) as u64) << 21 | (x + HALF) as u64
}

/// A walk over the cells around each cell of a sorted list, row by row of the grid. In a list sorted by key, the row
/// cells near cell `i` come after those near cell `i - 1`.
#[derive(Debug)]
pub(crate) struct RowWalk<'a> {
    keys: &'a [u64],
    /// For each row, the key offset of its first cell and the number of cells after that one.
    rows: Vec<(i64, u64)>,
    cursors: Vec<usize>,
}

impl<'a> RowWalk<'a> {
    /// Starts a walk at position `first`. It visits all cells that can contain a point within `radius_cells` (at most
    /// 60) of a point of the central cell, which is included.
    pub(crate) fn new(keys: &'a [u64], radius_cells: f64, first: usize) -> Self {
        let r = radius_cells.ceil() as i64;
        let gap2 = |d: i64| ((d.abs() - 1).max(0) as f64).powi(2);
        let mut rows = Vec::new();
        for dz in -r..=r {
            for dy in -r..=r {
                let left = radius_cells * radius_cells - gap2(dz) - gap2(dy);
                if left > 0.0 {
                    let half = (left.sqrt() + 1.0).ceil() as i64 - 1;
                    let half = half.min(r);
                    rows.push(((dz << 42) + (dy << 21) - half, 2 * half as u64));
                }
            }
        }
        let from = keys.get(first).copied().unwrap_or(u64::MAX);
        let cursors =
            rows.iter().map(|row| keys.partition_point(|&k| k < from.wrapping_add_signed(row.0))).collect();
        Self { keys, rows, cursors }
    }

    /// Visits the positions of the cells around position `i`, which must not decrease between calls.
    pub(crate) fn visit(&mut self, i: usize, mut each: impl FnMut(usize)) {
        for (row, cursor) in self.rows.iter().zip(&mut self.cursors) {
            let low = self.keys[i].wrapping_add_signed(row.0);
            while *cursor < self.keys.len() && self.keys[*cursor] < low {
                *cursor += 1;
            }
            self.keys[*cursor..]
                .iter()
                .take_while(|&&k| k <= low + row.1)
                .enumerate()
                .for_each(|(n, _)| each(*cursor + n));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_walk_agrees_with_all_pairs(
            points in proptest::collection::vec(proptest::array::uniform3(-0.06f64..0.06), 1..60), first in 0usize..60,
        ) {
            let (cell, radius) = (0.01, 2.3);
            let mut points: Vec<(u64, DVec3)> =
                points.into_iter().map(DVec3::from_array).map(|p| (key_of(p, cell).unwrap(), p)).collect();
            points.sort_by_key(|p| p.0);
            let first = first % points.len();
            let keys: Vec<u64> = points.iter().map(|p| p.0).collect();
            let mut walk = RowWalk::new(&keys, radius, first);
            for i in first..points.len() {
                let near = |j: usize| points[i].1.distance(points[j].1) < radius * cell;
                let mut found = Vec::new();
                walk.visit(i, |j| if near(j) { found.push(j) });
                let expect: Vec<usize> = (0..points.len()).filter(|&j| near(j)).collect();
                prop_assert_eq!(found, expect);
            }
        }
    }

    #[test]
    fn points_that_no_key_can_hold_have_none() {
        assert_eq!(key_of(DVec3::new(f64::NAN, 0.0, 0.0), 0.01), None);
        assert_eq!(key_of(DVec3::new(1e9, 0.0, 0.0), 0.01), None);
    }
}
