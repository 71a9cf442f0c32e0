//! The downhill simplex method (Nelder and Mead 1965), bounded and with restarts: the paper's optimiser.
//!
//! Without restarts it visits the same points as `scipy.optimize.minimize(method="Nelder-Mead")`, in the same order.
//! The acceptance rules, the stopping test, the adaptive coefficients (Gao and Han 2012) and the treatment of bounds
//! are the same: the initial simplex is reflected into the bounds, later points are clipped.

use serde::{Deserialize, Serialize};

/// Settings of the method. The planner applies it to the unit box.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NelderMead {
    /// ρ: reflection coefficient.
    pub reflection: f64,
    /// χ: expansion coefficient.
    pub expansion: f64,
    /// ψ: contraction coefficient.
    pub contraction: f64,
    /// σ: shrink coefficient.
    pub shrink: f64,
    /// Uses coefficients by dimension n instead: 1, 1 + 2/n, 3/4 − 1/(2n), 1 − 1/n.
    pub adaptive: bool,
    /// Largest number of iterations over all restarts; the paper uses 30.
    pub max_iterations: usize,
    /// The search stops when all points are this close to the best in every coordinate, and their objectives are within
    /// `f_tolerance`.
    pub x_tolerance: f64,
    /// Largest difference from the best objective for the stopping test.
    pub f_tolerance: f64,
    /// Number of restarts from the best point, with a simplex of half the size that points the other way. A restart
    /// frees a simplex that has collapsed, for example onto a bound.
    pub restarts: usize,
}

impl Default for NelderMead {
    fn default() -> Self {
        Self {
            reflection: 1.0,
            expansion: 2.0,
            contraction: 0.5,
            shrink: 0.5,
            adaptive: false,
            max_iterations: 60,
            x_tolerance: 1e-3,
            f_tolerance: 2e-4,
            restarts: 1,
        }
    }
}

/// Bounds per coordinate.
#[derive(Debug, Clone, PartialEq)]
pub struct BoxBounds {
    /// Smallest values.
    pub low: Vec<f64>,
    /// Largest values.
    pub high: Vec<f64>,
}

impl BoxBounds {
    /// The unit box of n dimensions.
    pub fn unit(n: usize) -> Self {
        Self { low: vec![0.0; n], high: vec![1.0; n] }
    }

    pub(crate) fn clip(&self, x: &mut [f64]) {
        for ((v, &low), &high) in x.iter_mut().zip(&self.low).zip(&self.high) {
            *v = v.max(low).min(high);
        }
    }

    /// Reflects coordinates beyond an upper bound back inside, so that a simplex at the bound keeps its volume.
    pub(crate) fn reflect(&self, x: &mut [f64]) {
        for (v, &high) in x.iter_mut().zip(&self.high) {
            if *v > high {
                *v = 2.0 * high - *v;
            }
        }
        self.clip(x);
    }
}

impl NelderMead {
    /// The paper's preset: 30 iterations, coefficients 1, 2, 0.5 and 0.5, no restart, and SciPy's tolerances on
    /// values in metres.
    pub fn paper() -> Self {
        Self { max_iterations: 30, x_tolerance: 1e-4, f_tolerance: 1e-4, restarts: 0, ..Self::default() }
    }

    /// A simplex around a point with a step per coordinate; a step that would leave the bounds changes its sign.
    pub(crate) fn simplex_around(x0: &[f64], steps: &[f64], bounds: &BoxBounds) -> Vec<Vec<f64>> {
        let mut simplex = vec![x0.to_vec()];
        for (k, &step) in steps.iter().enumerate() {
            let mut x = x0.to_vec();
            let inside = |v: f64| (bounds.low[k]..=bounds.high[k]).contains(&v);
            x[k] += if inside(x0[k] + step) || !inside(x0[k] - step) { step } else { -step };
            simplex.push(x);
        }
        simplex
    }

    /// ρ, χ, ψ and σ in n dimensions.
    pub(crate) fn coefficients(&self, n: usize) -> [f64; 4] {
        if self.adaptive {
            let d = n as f64;
            return [1.0, 1.0 + 2.0 / d, 0.75 - 1.0 / (2.0 * d), 1.0 - 1.0 / d];
        }
        [self.reflection, self.expansion, self.contraction, self.shrink]
    }
}
