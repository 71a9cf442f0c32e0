//! Small dense linear systems.

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
