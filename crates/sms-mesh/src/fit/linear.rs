//! Small dense linear systems, and weights of robust least squares.

/// Weight of a residual under Tukey's biweight.
pub(super) fn tukey(residual: f64, scale: f64) -> f64 {
    let x = residual / scale;
    if x.abs() >= 1.0 { 0.0 } else { (1.0 - x * x).powi(2) }
}

/// Returns the normal equations `a`, `b` of Σ w (r + J x)² from rows `(J, r, w)`.
pub(super) fn normal_equations<const N: usize>(
    rows: impl Iterator<Item = ([f64; N], f64, f64)>,
) -> ([[f64; N]; N], [f64; N]) {
    let (mut a, mut b) = ([[0.0; N]; N], [0.0; N]);
    for (j, r, w) in rows {
        for m in 0..N {
            for n in 0..N {
                a[m][n] += w * j[m] * j[n];
            }
            b[m] -= w * j[m] * r;
        }
    }
    (a, b)
}

/// Solves `a x = b` by Gauss-Jordan elimination with row pivots; `None` if a pivot is at most `least` or the solution
/// is not finite.
pub(super) fn solve<const N: usize>(mut a: [[f64; N]; N], mut b: [f64; N], least: f64) -> Option<[f64; N]> {
    for k in 0..N {
        let pivot = (k..N).max_by(|&i, &j| a[i][k].abs().total_cmp(&a[j][k].abs()))?;
        a.swap(k, pivot);
        b.swap(k, pivot);
        if a[k][k].abs() <= least {
            return None;
        }
        for i in 0..N {
            if i != k {
                let f = a[i][k] / a[k][k];
                for c in k..N {
                    a[i][c] -= f * a[k][c];
                }
                b[i] -= f * b[k];
            }
        }
    }
    let x: [f64; N] = std::array::from_fn(|k| b[k] / a[k][k]);
    x.iter().all(|v| v.is_finite()).then_some(x)
}
