//! Cholesky factorisation of small symmetric matrices of fixed capacity, without heap allocation.

/// A symmetric positive definite matrix factored as L Lᵀ, `n` ≤ `N` rows.
#[derive(Debug, Clone, Copy)]
pub struct Cholesky<const N: usize> {
    n: usize,
    l: [[f64; N]; N],
}

impl<const N: usize> Cholesky<N> {
    /// Factors the leading `n` × `n` block; only the lower triangle is read. `None` unless positive definite.
    pub fn new(a: &[[f64; N]; N], n: usize) -> Option<Self> {
        let mut l = [[0.0; N]; N];
        for i in 0..n {
            for j in 0..=i {
                let mut sum = a[i][j];
                for k in 0..j {
                    sum -= l[i][k] * l[j][k];
                }
                if i == j {
                    if !(sum > 0.0 && sum.is_finite()) {
                        return None;
                    }
                    l[i][i] = sum.sqrt();
                } else {
                    l[i][j] = sum / l[j][j];
                }
            }
        }
        Some(Self { n, l })
    }

    /// Solves A x = b in place.
    pub fn solve(&self, b: &mut [f64]) {
        self.solve_each(b.as_chunks_mut::<1>().0);
    }

    /// Solves A X = B in place for `M` right sides at once; row i of B holds entry i of each. The result equals that of
    /// [`Self::solve`] bit for bit, but divisions overlap.
    pub fn solve_each<const M: usize>(&self, b: &mut [[f64; M]]) {
        let b = &mut b[..self.n];
        for i in 0..self.n {
            let mut sum = b[i];
            for k in 0..i {
                let (l, row) = (self.l[i][k], b[k]);
                (0..M).for_each(|m| sum[m] -= l * row[m]);
            }
            let l = self.l[i][i];
            b[i] = sum.map(|s| s / l);
        }
        for i in (0..self.n).rev() {
            let mut sum = b[i];
            for k in i + 1..self.n {
                let (l, row) = (self.l[k][i], b[k]);
                (0..M).for_each(|m| sum[m] -= l * row[m]);
            }
            let l = self.l[i][i];
            b[i] = sum.map(|s| s / l);
        }
    }

    /// Returns the product of the diagonal of L: the square root of the determinant.
    pub fn sqrt_determinant(&self) -> f64 {
        (0..self.n).map(|i| self.l[i][i]).product()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cholesky_solves_and_refuses_what_is_not_positive() {
        let a = [[4.0, 2.0, 0.6], [2.0, 5.0, 1.0], [0.6, 1.0, 3.0]];
        let factor = Cholesky::<3>::new(&a, 3).unwrap();
        let x = [1.0, -2.0, 0.5];
        let mut b: Vec<f64> = (0..3).map(|i| (0..3).map(|j| a[i][j] * x[j]).sum()).collect();
        factor.solve(&mut b);
        assert!(b.iter().zip(x).all(|(b, x)| (b - x).abs() < 1e-14));
        let sides = [[1.0, 0.3], [-2.0, 1e-3], [0.5, 7.0]];
        let mut together = sides;
        factor.solve_each(&mut together);
        for m in 0..2 {
            let mut alone = sides.map(|row| row[m]);
            factor.solve(&mut alone);
            assert_eq!(together.map(|row| row[m]), alone);
        }
        let determinant = 4.0 * (15.0 - 1.0) - 2.0 * (6.0 - 0.6) + 0.6 * (2.0 - 3.0);
        assert!((factor.sqrt_determinant().powi(2) - determinant).abs() < 1e-12);
        assert!(Cholesky::<2>::new(&[[1.0, 2.0], [2.0, 1.0]], 2).is_none());
        assert!(Cholesky::<1>::new(&[[f64::NAN]], 1).is_none());
    }
}
