//! The linear system of all corrections: 6 × 6 blocks, solved by conjugate gradients.

use crate::residual::ShiftSums;
use sms_core::Cholesky;

/// A symmetric 6 × 6 block.
pub(crate) type Block = [[f64; 6]; 6];
/// A correction (turn, shift) or its gradient.
pub(crate) type Six = [f64; 6];

/// Σ over pairs of ½ (δᵢ − δⱼ)ᵀ H (δᵢ − δⱼ) + gᵀ (δᵢ − δⱼ), and over frames of ½ δᵢᵀ P δᵢ + qᵀ δᵢ.
#[derive(Debug)]
pub(crate) struct System {
    pub(crate) pairs: Vec<(usize, usize, Block)>,
    pub(crate) own: Vec<Block>,
    pub(crate) gradient: Vec<Six>,
    /// Coupling of the colour shift with each frame, and the block of the colour shift.
    by_shift: [Vec<Six>; 2],
    shift_h: [[f64; 2]; 2],
    shift_g: [f64; 2],
}

impl System {
    pub(crate) fn new(frames: usize) -> Self {
        let zeros = vec![[0.0; 6]; frames];
        Self {
            pairs: Vec::new(),
            own: vec![[[0.0; 6]; 6]; frames],
            gradient: zeros.clone(),
            by_shift: [zeros.clone(), zeros],
            shift_h: [[0.0; 2]; 2],
            shift_g: [0.0; 2],
        }
    }

    /// Adds the terms of a pair: δᵢ − δⱼ and the colour shift.
    pub(crate) fn add_pair(&mut self, i: usize, j: usize, h: &Block, g: &Six, shift: &ShiftSums) {
        for a in 0..6 {
            self.gradient[i][a] += g[a];
            self.gradient[j][a] -= g[a];
        }
        for k in 0..2 {
            for a in 0..6 {
                self.by_shift[k][i][a] += shift.by[k][a];
                self.by_shift[k][j][a] -= shift.by[k][a];
            }
        }
        self.add_shift(&shift.h, &shift.g);
        self.pairs.push((i, j, *h));
    }

    /// Adds the prior of the colour shift.
    pub(crate) fn add_shift(&mut self, h: &[[f64; 2]; 2], g: &[f64; 2]) {
        for k in 0..2 {
            self.shift_g[k] += g[k];
            for l in 0..2 {
                self.shift_h[k][l] += h[k][l];
            }
        }
    }

    /// Adds the prior of one frame.
    pub(crate) fn add_own(&mut self, i: usize, h: &Block, g: &Six) {
        for a in 0..6 {
            self.gradient[i][a] += g[a];
            for b in 0..6 {
                self.own[i][a][b] += h[a][b];
            }
        }
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
        y
    }

    /// Returns the minimiser: corrections of the poses and of the colour shift. The two columns of the shift are
    /// eliminated by separate solutions, and used only if the shift is determined. `None` if a diagonal block is not
    /// positive definite.
    pub(crate) fn solve(&self) -> Option<(Vec<Six>, [f64; 2])> {
        let factors = self.diagonal_factors()?;
        let without = self.conjugate_gradients(&factors, &self.gradient);
        let columns: [Vec<Six>; 2] =
            std::array::from_fn(|k| self.conjugate_gradients(&factors, &self.by_shift[k]));
        let s: [[f64; 2]; 2] = std::array::from_fn(|k| {
            std::array::from_fn(|l| self.shift_h[k][l] - dot(&self.by_shift[k], &columns[l]))
        });
        let r: [f64; 2] = std::array::from_fn(|k| self.shift_g[k] - dot(&self.by_shift[k], &without));
        let det = s[0][0] * s[1][1] - s[0][1] * s[1][0];
        let known = det > 1e-12 * (s[0][0] * s[1][1]).abs() && s[0][0] > 0.0;
        let shift = if known {
            [(s[0][1] * r[1] - s[1][1] * r[0]) / det, (s[1][0] * r[0] - s[0][0] * r[1]) / det]
        } else {
            [0.0; 2]
        };
        let steps: Vec<Six> = (0..self.own.len())
            .map(|i| {
                std::array::from_fn(|a| {
                    -(without[i][a] + columns[0][i][a] * shift[0] + columns[1][i][a] * shift[1])
                })
            })
            .collect();
        let finite = steps.as_flattened().iter().chain(&shift).all(|v| v.is_finite());
        finite.then_some((steps, shift))
    }

    fn diagonal_factors(&self) -> Option<Vec<Cholesky<6>>> {
        let mut diagonal = self.own.clone();
        for (i, j, h) in &self.pairs {
            for k in [*i, *j] {
                for a in 0..6 {
                    for b in 0..6 {
                        diagonal[k][a][b] += h[a][b];
                    }
                }
            }
        }
        diagonal.iter().map(|h| Cholesky::new(h, 6)).collect()
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

fn dot(a: &[Six], b: &[Six]) -> f64 {
    a.as_flattened().iter().zip(b.as_flattened()).map(|(a, b)| a * b).sum()
}

fn product(h: &Block, x: &Six) -> Six {
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
                system.add_pair(i, j, &h, &g, &ShiftSums::default());
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
            system.add_own(i, &own, &[0.1; 6]);
            for a in 0..6 {
                for b in 0..6 {
                    dense[6 * i + a][6 * i + b] += own[a][b];
                }
            }
        }
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
}
