//! The linear system of all corrections: 6 × 6 blocks and a few values common to all frames, solved by conjugate
//! gradients.

use crate::pair::CameraSums;
use rayon::prelude::*;
use sms_core::Cholesky;

/// A symmetric 6 × 6 block.
pub(crate) type Block = [[f64; 6]; 6];
/// A correction (turn, shift) or its gradient.
pub(crate) type Six = [f64; 6];

/// Values common to all frames: those of the cameras, then the correction of the hand-eye pose (turn, shift) and the time offset of
/// the given poses.
pub(crate) const COMMON: usize = 10;
/// Number of the values of the cameras, which pairs of frames measure: the colour shift (x, y), then the focal length.
pub(crate) const CAMERA: usize = 3;
/// The logarithm of the factor of the focal length.
pub(crate) const FOCAL: usize = 2;
/// First of the values of the hand-eye pose.
pub(crate) const HAND_EYE: usize = 3;
/// The time offset, seconds.
pub(crate) const TIME: usize = 9;
/// The common values or their gradient.
pub(crate) type Common = [f64; COMMON];

/// Σ over pairs of ½ (δᵢ − δⱼ)ᵀ H (δᵢ − δⱼ) + gᵀ (δᵢ − δⱼ), over frames of ½ δᵢᵀ P δᵢ + qᵀ δᵢ, and over rows of
/// ½ w (r + Σ Jᵢ δᵢ + Kᵀ c)², where c are the common values.
#[derive(Debug)]
pub(crate) struct System {
    pairs: Vec<(usize, usize, Block)>,
    own: Vec<Block>,
    /// Coupling of two frames by rows.
    cross: Vec<(usize, usize, Block)>,
    pub(crate) gradient: Vec<Six>,
    /// Coupling of each common value with each frame, and the block of the common values.
    by_common: [Vec<Six>; COMMON],
    common_h: [Common; COMMON],
    common_g: Common,
}

impl System {
    pub(crate) fn new(frames: usize) -> Self {
        let zeros = vec![[0.0; 6]; frames];
        Self {
            pairs: Vec::new(),
            own: vec![[[0.0; 6]; 6]; frames],
            cross: Vec::new(),
            gradient: zeros.clone(),
            by_common: std::array::from_fn(|_| zeros.clone()),
            common_h: [[0.0; COMMON]; COMMON],
            common_g: [0.0; COMMON],
        }
    }

    /// Adds the terms of a pair: δᵢ − δⱼ and the values of the cameras.
    pub(crate) fn add_pair(&mut self, i: usize, j: usize, h: &Block, g: &Six, camera: &CameraSums) {
        for a in 0..6 {
            self.gradient[i][a] += g[a];
            self.gradient[j][a] -= g[a];
        }
        for k in 0..CAMERA {
            for a in 0..6 {
                self.by_common[k][i][a] += camera.by[k][a];
                self.by_common[k][j][a] -= camera.by[k][a];
            }
            self.common_g[k] += camera.g[k];
            for l in 0..CAMERA {
                self.common_h[k][l] += camera.h[k][l];
            }
        }
        self.pairs.push((i, j, *h));
    }

    /// Adds a weighted linear residual of at most two frames and the common values.
    pub(crate) fn add_row(&mut self, row: &Row, residual: f64, weight: f64) {
        for (k, (i, ji)) in row.frames.iter().enumerate() {
            for a in 0..6 {
                let wj = weight * ji[a];
                self.gradient[*i][a] += wj * residual;
                for b in 0..6 {
                    self.own[*i][a][b] += wj * ji[b];
                }
                for (c, value) in row.common.iter().enumerate() {
                    self.by_common[c][*i][a] += wj * value;
                }
            }
            for (j, jj) in &row.frames[k + 1..] {
                let block = std::array::from_fn(|a| std::array::from_fn(|b| weight * ji[a] * jj[b]));
                match self.cross.last_mut().filter(|last| (last.0, last.1) == (*i, *j)) {
                    Some((_, _, sum)) => add(sum, &block),
                    None => self.cross.push((*i, *j, block)),
                }
            }
        }
        for (c, value) in row.common.iter().enumerate() {
            self.common_g[c] += weight * value * residual;
            for (d, other) in row.common.iter().enumerate() {
                self.common_h[c][d] += weight * value * other;
            }
        }
    }

    /// Adds the prior of one common value.
    pub(crate) fn add_common(&mut self, at: usize, value: f64, weight: f64) {
        self.common_h[at][at] += weight;
        self.common_g[at] += weight * value;
    }

    fn times(&self, x: &[Six]) -> Vec<Six> {
        let mut y: Vec<Six> = self.own.iter().zip(x).map(|(p, x)| product(p, x)).collect();
        for (i, j, h) in &self.pairs {
            let difference: Six = std::array::from_fn(|a| x[*i][a] - x[*j][a]);
            let hx = product(h, &difference);
            for a in 0..6 {
                y[*i][a] += hx[a];
                y[*j][a] -= hx[a];
            }
        }
        for (i, j, h) in &self.cross {
            for a in 0..6 {
                for b in 0..6 {
                    y[*i][a] += h[a][b] * x[*j][b];
                    y[*j][b] += h[a][b] * x[*i][a];
                }
            }
        }
        y
    }

    /// Returns xᵀ A x.
    pub(crate) fn quadratic(&self, x: &[Six], common: &Common) -> f64 {
        let frames = dot(x, &self.times(x));
        let mut sum = frames;
        for k in 0..COMMON {
            sum += 2.0 * common[k] * dot(&self.by_common[k], x);
            sum += common[k] * (0..COMMON).map(|l| self.common_h[k][l] * common[l]).sum::<f64>();
        }
        sum
    }

    /// Prepares solutions. `None` if a block is not positive definite.
    pub(crate) fn inverse(&self) -> Option<Inverse<'_>> {
        let mut diagonal = self.own.clone();
        for (i, j, h) in &self.pairs {
            [*i, *j].iter().for_each(|&k| add(&mut diagonal[k], h));
        }
        let factors: Vec<Cholesky<6>> =
            diagonal.iter().map(|h| Cholesky::new(h, 6)).collect::<Option<_>>()?;
        let columns: Vec<Vec<Six>> =
            self.by_common.par_iter().map(|right| self.conjugate_gradients(&factors, right)).collect();
        let mut schur = self.common_h;
        for (k, row) in schur.iter_mut().enumerate() {
            for (l, value) in row.iter_mut().enumerate() {
                *value -= dot(&self.by_common[k], &columns[l]);
            }
        }
        let schur = Cholesky::new(&schur, COMMON)?;
        Some(Inverse { system: self, factors, columns, schur })
    }

    /// Returns the minimiser: corrections of the poses and of the common values. `None` if it is not determined.
    pub(crate) fn solve(&self) -> Option<(Vec<Six>, Common)> {
        let (mut steps, mut common) = self.inverse()?.times(&self.gradient, &self.common_g);
        steps.as_flattened_mut().iter_mut().chain(&mut common).for_each(|v| *v = -*v);
        let finite = steps.as_flattened().iter().chain(&common).all(|v| v.is_finite());
        finite.then_some((steps, common))
    }

    /// Solves for one right side by conjugate gradients, preconditioned with the diagonal blocks. Memory and time grow
    /// with the number of pairs instead of the square of the number of frames.
    fn conjugate_gradients(&self, factors: &[Cholesky<6>], right: &[Six]) -> Vec<Six> {
        const RELATIVE: f64 = 1e-9;
        let n = self.own.len();
        let precondition = |r: &[Six]| -> Vec<Six> {
            let solved = |(l, r): (&Cholesky<6>, &Six)| {
                let mut x = *r;
                l.solve(&mut x);
                x
            };
            factors.iter().zip(r).map(solved).collect()
        };
        let mut x = vec![[0.0; 6]; n];
        let mut r: Vec<Six> = right.to_vec();
        let mut z = precondition(&r);
        let mut p = z.clone();
        let mut rz = dot(&r, &z);
        let enough = RELATIVE * RELATIVE * rz;
        for _ in 0..20 * 6 * n.max(1) {
            if !(rz > enough && rz > 0.0) {
                break;
            }
            let ap = self.times(&p);
            let alpha = rz / dot(&p, &ap);
            for k in 0..n {
                for a in 0..6 {
                    x[k][a] += alpha * p[k][a];
                    r[k][a] -= alpha * ap[k][a];
                }
            }
            z = precondition(&r);
            let next = dot(&r, &z);
            let beta = next / rz;
            rz = next;
            for k in 0..n {
                for a in 0..6 {
                    p[k][a] = z[k][a] + beta * p[k][a];
                }
            }
        }
        x
    }
}

/// A linear function of the corrections of some frames and of the common values.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Row {
    /// Derivatives with respect to the corrections of frames.
    pub(crate) frames: Vec<(usize, Six)>,
    /// Derivatives with respect to the common values.
    pub(crate) common: Common,
}

impl Row {
    /// Returns the value of the function.
    pub(crate) fn of(&self, steps: &[Six], common: &Common) -> f64 {
        let frames = self.frames.iter().map(|(i, j)| (0..6).map(|a| j[a] * steps[*i][a]).sum::<f64>());
        frames.sum::<f64>() + (0..COMMON).map(|c| self.common[c] * common[c]).sum::<f64>()
    }

    /// Adds the function to a right side, `by` times.
    pub(crate) fn add_to(&self, right: &mut [Six], common: &mut Common, by: f64) {
        for (i, j) in &self.frames {
            (0..6).for_each(|a| right[*i][a] += by * j[a]);
        }
        (0..COMMON).for_each(|c| common[c] += by * self.common[c]);
    }
}

/// Solutions of a system: the covariance of its unknowns.
pub(crate) struct Inverse<'a> {
    system: &'a System,
    factors: Vec<Cholesky<6>>,
    /// Solutions for the coupling with each common value.
    columns: Vec<Vec<Six>>,
    /// The block of the common values with the frames eliminated.
    schur: Cholesky<COMMON>,
}

impl Inverse<'_> {
    /// Multiplies a vector by the inverse.
    pub(crate) fn times(&self, right: &[Six], common: &Common) -> (Vec<Six>, Common) {
        let mut steps = self.system.conjugate_gradients(&self.factors, right);
        let mut values: Common = std::array::from_fn(|k| common[k] - dot(&self.system.by_common[k], &steps));
        self.schur.solve(&mut values);
        for (column, value) in self.columns.iter().zip(&values) {
            for (step, c) in steps.iter_mut().zip(column) {
                (0..6).for_each(|a| step[a] -= c[a] * value);
            }
        }
        (steps, values)
    }

    /// Returns the number of frames.
    pub(crate) fn frames(&self) -> usize {
        self.factors.len()
    }

    /// Returns the variance of a linear function of the unknowns.
    #[cfg(test)]
    pub(crate) fn variance(&self, of: &Row) -> f64 {
        let (mut right, mut common) = (vec![[0.0; 6]; self.factors.len()], [0.0; COMMON]);
        of.add_to(&mut right, &mut common, 1.0);
        let (steps, values) = self.times(&right, &common);
        of.of(&steps, &values)
    }
}

fn add(sum: &mut Block, block: &Block) {
    for a in 0..6 {
        (0..6).for_each(|b| sum[a][b] += block[a][b]);
    }
}

fn dot(a: &[Six], b: &[Six]) -> f64 {
    a.as_flattened().iter().zip(b.as_flattened()).map(|(a, b)| a * b).sum()
}

pub(crate) fn product(h: &Block, x: &Six) -> Six {
    std::array::from_fn(|a| (0..6).map(|b| h[a][b] * x[b]).sum())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;
    use sms_core::Seed;

    fn random_block(rng: &mut sms_core::StageRng, rank: usize) -> Block {
        let mut h = [[0.0; 6]; 6];
        for _ in 0..rank {
            let v: Six = std::array::from_fn(|_| rng.random::<f64>() - 0.5);
            for a in 0..6 {
                for b in 0..6 {
                    h[a][b] += v[a] * v[b];
                }
            }
        }
        h
    }

    /// Gaussian elimination with pivoting, as the reference.
    fn dense_solve(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Vec<f64> {
        let n = b.len();
        for c in 0..n {
            let pivot = (c..n).max_by(|&i, &j| a[i][c].abs().total_cmp(&a[j][c].abs())).unwrap();
            a.swap(c, pivot);
            b.swap(c, pivot);
            for r in c + 1..n {
                let f = a[r][c] / a[c][c];
                for k in c..n {
                    a[r][k] -= f * a[c][k];
                }
                b[r] -= f * b[c];
            }
        }
        for c in (0..n).rev() {
            b[c] = (b[c] - (c + 1..n).map(|k| a[c][k] * b[k]).sum::<f64>()) / a[c][c];
        }
        b
    }

    #[test]
    fn agrees_with_a_dense_solver_although_the_pairs_alone_are_singular() {
        let mut rng = Seed(3).rng();
        let n = 9;
        let mut system = System::new(n);
        let mut dense = vec![vec![0.0; 6 * n]; 6 * n];
        let scale = 1e6;
        for i in 0..n {
            for j in [i + 1, i + 3] {
                if j >= n {
                    continue;
                }
                let h = random_block(&mut rng, 4).map(|r| r.map(|v| scale * v));
                let g: Six = std::array::from_fn(|_| 1e3 * (rng.random::<f64>() - 0.5));
                system.add_pair(i, j, &h, &g, &CameraSums::default());
                for a in 0..6 {
                    for b in 0..6 {
                        for (r, c, sign) in [(i, i, 1.0), (j, j, 1.0), (i, j, -1.0), (j, i, -1.0)] {
                            dense[6 * r + a][6 * c + b] += sign * h[a][b];
                        }
                    }
                }
            }
            let mut own = random_block(&mut rng, 6);
            (0..6).for_each(|a| own[a][a] += 1.0);
            add(&mut system.own[i], &own);
            (0..6).for_each(|a| system.gradient[i][a] += 0.1);
            for a in 0..6 {
                for b in 0..6 {
                    dense[6 * i + a][6 * i + b] += own[a][b];
                }
            }
        }
        (0..COMMON).for_each(|k| system.add_common(k, 0.0, 1.0));
        let right: Vec<f64> = system.gradient.as_flattened().iter().map(|g| -g).collect();
        let expected = dense_solve(dense, right);
        let (found, _) = system.solve().unwrap();
        let size = expected.iter().map(|v| v * v).sum::<f64>().sqrt();
        let off: f64 = found.as_flattened().iter().zip(&expected).map(|(a, b)| (a - b).powi(2)).sum();
        assert!(off.sqrt() < 1e-6 * size, "{} of {size}", off.sqrt());
    }

    #[test]
    fn a_frame_about_which_nothing_is_known_is_refused() {
        assert!(System::new(1).solve().is_none());
    }

    #[test]
    fn rows_couple_frames_and_common_values_and_the_inverse_is_their_covariance() {
        let mut rng = Seed(8).rng();
        let mut draw = || rng.random::<f64>() - 0.5;
        let n = 4;
        let mut system = System::new(n);
        // Frames first, then the common values.
        let size = 6 * n + COMMON;
        let (mut dense, mut right) = (vec![vec![0.0; size]; size], vec![0.0; size]);
        let mut add_dense = |row: &Row, residual: f64, weight: f64| {
            let mut all = vec![0.0; size];
            row.frames.iter().for_each(|(i, j)| (0..6).for_each(|a| all[6 * i + a] += j[a]));
            (0..COMMON).for_each(|c| all[6 * n + c] += row.common[c]);
            for a in 0..size {
                right[a] -= weight * all[a] * residual;
                (0..size).for_each(|b| dense[a][b] += weight * all[a] * all[b]);
            }
        };
        for i in 0..n {
            for _ in 0..14 {
                let j = (i + 1) % n;
                let frames = vec![(i, std::array::from_fn(|_| draw())), (j, std::array::from_fn(|_| draw()))];
                let row = Row { frames, common: std::array::from_fn(|_| draw()) };
                let residual = draw();
                system.add_row(&row, residual, 3.0);
                add_dense(&row, residual, 3.0);
            }
        }
        let expected = dense_solve(dense.clone(), right);
        let (steps, common) = system.solve().unwrap();
        let found: Vec<f64> = steps.as_flattened().iter().chain(&common).copied().collect();
        for (a, b) in found.iter().zip(&expected) {
            assert!((a - b).abs() < 1e-6, "{found:?} {expected:?}");
        }
        let of = Row {
            frames: vec![(1, std::array::from_fn(|_| draw()))],
            common: std::array::from_fn(|_| draw()),
        };
        let mut unit = vec![0.0; size];
        (0..6).for_each(|a| unit[6 + a] = of.frames[0].1[a]);
        (0..COMMON).for_each(|c| unit[6 * n + c] = of.common[c]);
        let solved = dense_solve(dense, unit.clone());
        let expected: f64 = solved.iter().zip(&unit).map(|(a, b)| a * b).sum();
        let inverse = system.inverse().unwrap();
        assert!((inverse.variance(&of) / expected - 1.0).abs() < 1e-6);
        let (x, c) = inverse.times(&system.gradient, &[0.0; COMMON]);
        let product: f64 = dot(&x, &system.gradient);
        assert!((system.quadratic(&x, &c) / product - 1.0).abs() < 1e-6);
    }
}
