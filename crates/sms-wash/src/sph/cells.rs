//! Particles sorted into cells as large as the kernel's support, so that neighbours lie in three by three runs of three cells.

/// No more cells than this; where particles are spread wider, cells grow.
const MAX_CELLS: usize = 1 << 16;

/// The runs of particles around one cell: nine of them.
pub(super) type Runs = [(u32, u32); 9];

/// The grid over the particles of one moment.
#[derive(Debug, Clone, Default)]
pub(super) struct Cells {
    min: [f32; 3],
    inverse: f32,
    count: [usize; 3],
    /// First particle of each cell, and the end of the last.
    start: Vec<u32>,
    next: Vec<u32>,
    key: Vec<u32>,
    /// Where each particle goes.
    place: Vec<u32>,
}

impl Cells {
    /// Finds the place of each of `len` particles in the order of cells; within a cell the order stays.
    pub(super) fn sort(&mut self, x: &[Vec<f32>; 3], len: usize, support: f32) -> &[u32] {
        let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for axis in 0..3 {
            for &p in &x[axis][..len] {
                min[axis] = min[axis].min(p);
                max[axis] = max[axis].max(p);
            }
        }
        let mut size = support * 1.0001;
        // In floating point: what blew up may be anywhere.
        while (0..3).map(|a| f64::from((max[a] - min[a]) / size).max(0.0) + 1.0).product::<f64>()
            > MAX_CELLS as f64
        {
            size *= 1.25;
        }
        self.count = std::array::from_fn(|a| ((max[a] - min[a]).max(0.0) / size) as usize + 1);
        self.min = min;
        self.inverse = 1.0 / size;
        let cells = self.count.iter().product::<usize>();
        self.start.clear();
        self.start.resize(cells + 1, 0);
        self.key.clear();
        for i in 0..len {
            let [a, b, c] = self.cell([x[0][i], x[1][i], x[2][i]]);
            let key = (c * self.count[1] + b) * self.count[0] + a;
            self.key.push(key as u32);
            self.start[key + 1] += 1;
        }
        for c in 0..cells {
            self.start[c + 1] += self.start[c];
        }
        self.next.clear();
        self.next.extend_from_slice(&self.start[..cells]);
        self.place.clear();
        for &key in &self.key {
            let next = &mut self.next[key as usize];
            self.place.push(*next);
            *next += 1;
        }
        &self.place
    }

    #[inline(always)]
    fn cell(&self, x: [f32; 3]) -> [usize; 3] {
        std::array::from_fn(|a| (((x[a] - self.min[a]) * self.inverse) as usize).min(self.count[a] - 1))
    }

    /// Particles (of the sorted order) that may lie within the support around `x`.
    #[inline(always)]
    pub(super) fn around(&self, x: [f32; 3]) -> Runs {
        let [a, b, c] = self.cell(x);
        let (a0, a1) = (a.saturating_sub(1), (a + 1).min(self.count[0] - 1));
        let mut runs = [(0, 0); 9];
        for (k, run) in runs.iter_mut().enumerate() {
            let (y, z) = ((b + k % 3).wrapping_sub(1), (c + k / 3).wrapping_sub(1));
            if y < self.count[1] && z < self.count[2] {
                let row = (z * self.count[1] + y) * self.count[0];
                *run = (self.start[row + a0], self.start[row + a1 + 1]);
            }
        }
        runs
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against all pairs.
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
        let mut cells = Cells::default();
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
