//! Particles sorted into rows of cells. Rows are as wide as the kernel's support, so that neighbours are in three by
//! three rows. Cells are shorter along the rows, so that runs are only slightly longer than the support.

/// Largest number of cells; for widely spread particles, cells grow.
const MAX_CELLS: usize = 1 << 20;
/// Number of cells along a row per length of the support.
const SHORTER: f32 = 4.0;
/// Largest displacement of a particle by rounding, as a share of a cell.
const ROUNDING: f32 = 1e-4;

/// The nine runs of particles around a cell.
pub(super) type Runs = [(u32, u32); 9];

/// The grid over the particles.
#[derive(Debug, Clone, Default)]
pub(super) struct CellGrid {
    min: [f32; 3],
    support: f32,
    /// Size of a cell across the rows.
    size: f32,
    /// 1 / size of a cell along each axis.
    inverse: [f32; 3],
    count: [usize; 3],
    /// First particle of each cell, and the end of the last.
    start: Vec<u32>,
    key: Vec<u32>,
    /// New index of each particle.
    place: Vec<u32>,
}

impl CellGrid {
    /// Computes the index of each of `len` particles in the order of cells; the order within a cell is kept.
    pub(super) fn sort(&mut self, x: &[Vec<f32>; 3], len: usize, support: f32) -> &[u32] {
        let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for axis in 0..3 {
            for &p in &x[axis][..len] {
                min[axis] = min[axis].min(p);
                max[axis] = max[axis].max(p);
            }
        }
        let mut size = support * (1.0 + ROUNDING);
        let cells_along = |a: usize, size: f32| (max[a] - min[a]) * if a == 0 { SHORTER } else { 1.0 } / size;
        // In floating point, because diverged particles may be anywhere.
        while (0..3).map(|a| f64::from(cells_along(a, size)).max(0.0) + 1.0).product::<f64>()
            > MAX_CELLS as f64
        {
            size *= 1.25;
        }
        self.count = std::array::from_fn(|a| cells_along(a, size).max(0.0) as usize + 1);
        (self.min, self.support, self.size) = (min, support, size);
        self.inverse = [SHORTER / size, 1.0 / size, 1.0 / size];
        let cells = self.count.iter().product::<usize>();
        self.start.clear();
        self.start.resize(cells + 2, 0);
        self.key.clear();
        for i in 0..len {
            let [a, b, c] = self.cell([x[0][i], x[1][i], x[2][i]]);
            let key = (c * self.count[1] + b) * self.count[0] + a;
            self.key.push(key as u32);
            self.start[key + 2] += 1;
        }
        let mut sum = 0;
        for count in &mut self.start {
            sum += *count;
            *count = sum;
        }
        // `start[i + 1]` is the beginning of cell i. Placing the particles of the cell moves it to the end of the cell.
        self.place.clear();
        for &key in &self.key {
            let next = &mut self.start[key as usize + 1];
            self.place.push(*next);
            *next += 1;
        }
        &self.place
    }

    #[inline(always)]
    fn cell(&self, x: [f32; 3]) -> [usize; 3] {
        std::array::from_fn(|a| {
            (((x[a] - self.min[a]) * self.inverse[a]) as i32 as usize).min(self.count[a] - 1)
        })
    }

    /// Returns the sorted particles that may be within the support around `x`.
    #[inline(always)]
    pub(super) fn around(&self, x: [f32; 3]) -> Runs {
        let [_, b, c] = self.cell(x);
        let wide = 2.0 * ROUNDING * self.size;
        // Squared distances from the adjacent rows and the particle's own row.
        let gaps = |axis: usize, row: usize| {
            let before = x[axis] - self.min[axis] - row as f32 * self.size;
            let gap = |d: f32| (d - wide).max(0.0) * (d - wide).max(0.0);
            [gap(before), 0.0, gap(self.size - before)]
        };
        let (gaps_y, gaps_z) = (gaps(1, b), gaps(2, c));
        let along = x[0] - self.min[0];
        let first = ((along - self.support - wide).max(0.0) * self.inverse[0]) as i32 as usize;
        let last = (((along + self.support + wide) * self.inverse[0]) as i32 as usize).min(self.count[0] - 1);
        let squared = self.support * self.support;
        let mut runs = [(0, 0); 9];
        for (k, run) in runs.iter_mut().enumerate() {
            let (y, z) = ((b + k % 3).wrapping_sub(1), (c + k / 3).wrapping_sub(1));
            if y < self.count[1] && z < self.count[2] && gaps_y[k % 3] + gaps_z[k / 3] < squared {
                let row = (z * self.count[1] + y) * self.count[0];
                *run = (self.start[row + first.min(last)], self.start[row + last + 1]);
            }
        }
        runs
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compares with all pairs.
    #[test]
    fn every_neighbour_is_in_the_runs() {
        let n = 500usize;
        let wave = |i: usize, k: f64, s: f64| ((i as f64 * k).fract() * s) as f32;
        let x: [Vec<f32>; 3] = [
            (0..n).map(|i| wave(i, 0.618_034, 0.9)).collect(),
            (0..n).map(|i| wave(i, 0.414_214, 0.5)).collect(),
            (0..n).map(|i| wave(i, 0.732_051, 0.3)).collect(),
        ];
        let support = 0.07f32;
        let mut cells = CellGrid::default();
        let place = cells.sort(&x, n, support).to_vec();
        let mut seen = vec![false; n];
        for &p in &place {
            assert!(!std::mem::replace(&mut seen[p as usize], true));
        }
        for i in 0..n {
            let runs = cells.around([x[0][i], x[1][i], x[2][i]]);
            for j in 0..n {
                let d2: f32 = (0..3).map(|a| (x[a][i] - x[a][j]).powi(2)).sum();
                if d2 <= support * support {
                    let p = place[j];
                    assert_eq!(runs.iter().filter(|(b, e)| (*b..*e).contains(&p)).count(), 1);
                }
            }
        }
    }
}
