//! Sums of products of the components of many rows.

/// Sums over rows x of all products x xᵀ: the Gram matrix of the columns.
///
/// Rows are collected by column, and multiplied a batch at a time: the processor then multiplies several rows at once, and reads
/// each sum once a batch. The order of additions depends only on the order of the rows.
#[derive(Debug, Clone)]
pub(crate) struct Gram<const K: usize> {
    /// Components of the rows that wait.
    columns: [[f64; BATCH]; K],
    waiting: usize,
    /// Upper triangle over all batches before.
    sums: [[f64; K]; K],
}

const BATCH: usize = 32;
const LANES: usize = 4;

impl<const K: usize> Default for Gram<K> {
    fn default() -> Self {
        Self { columns: [[0.0; BATCH]; K], waiting: 0, sums: [[0.0; K]; K] }
    }
}

impl<const K: usize> Gram<K> {
    /// Adds a row.
    pub(crate) fn add(&mut self, row: &[f64; K]) {
        for (column, value) in self.columns.iter_mut().zip(row) {
            column[self.waiting] = *value;
        }
        self.waiting += 1;
        if self.waiting == BATCH {
            self.multiply();
        }
    }

    fn multiply(&mut self) {
        for a in 0..K {
            for b in a..K {
                self.sums[a][b] += dot(&self.columns[a], &self.columns[b]);
            }
        }
        self.waiting = 0;
    }

    /// Returns the whole symmetric matrix.
    pub(crate) fn sums(mut self) -> [[f64; K]; K] {
        for column in &mut self.columns {
            column[self.waiting..].fill(0.0);
        }
        self.multiply();
        std::array::from_fn(|a| std::array::from_fn(|b| self.sums[a.min(b)][a.max(b)]))
    }
}

fn dot(a: &[f64; BATCH], b: &[f64; BATCH]) -> f64 {
    let mut lanes = [0.0; LANES];
    for (a, b) in a.as_chunks::<LANES>().0.iter().zip(b.as_chunks::<LANES>().0) {
        for l in 0..LANES {
            lanes[l] += a[l] * b[l];
        }
    }
    (lanes[0] + lanes[1]) + (lanes[2] + lanes[3])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn sums_are_those_of_one_row_after_the_other(
            rows in prop::collection::vec(prop::array::uniform3(-2.0..2.0f64), 0..100)
        ) {
            let mut gram = Gram::<3>::default();
            rows.iter().for_each(|row| gram.add(row));
            let found = gram.sums();
            for a in 0..3 {
                for b in 0..3 {
                    let expected: f64 = rows.iter().map(|row| row[a] * row[b]).sum();
                    prop_assert!((found[a][b] - expected).abs() < 1e-12 * (1.0 + rows.len() as f64));
                }
            }
        }
    }
}
