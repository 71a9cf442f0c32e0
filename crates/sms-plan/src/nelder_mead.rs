//! The downhill simplex method (Nelder and Mead 1965, the paper's optimiser), bounded and with restarts.
//!
//! Without restarts it visits the same points as `scipy.optimize.minimize(method="Nelder-Mead")`, in the same
//! order: the same acceptance rules, stopping test, adaptive coefficients (Gao and Han 2012) and treatment of
//! bounds (the initial simplex is reflected into them, later points are clipped).

use crate::{Minimum, Optimiser};
use serde::{Deserialize, Serialize};

/// Settings of the method. Coordinates are those of the unit box when it plans.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NelderMead {
    /// ρ: how far the worst point is reflected.
    pub reflection: f64,
    /// χ: how much further when that was the best so far.
    pub expansion: f64,
    /// ψ: share of the way kept when it was not good.
    pub contraction: f64,
    /// σ: how much the simplex shrinks towards its best point when nothing helps.
    pub shrink: f64,
    /// Coefficients by dimension n instead (1, 1 + 2/n, 3/4 − 1/(2n), 1 − 1/n).
    pub adaptive: bool,
    /// Most iterations over all restarts; the paper uses 30.
    pub max_iterations: usize,
    /// Stops when all points are this near to the best in every coordinate, and ...
    pub x_tolerance: f64,
    /// ... their objectives are this near to the best.
    pub f_tolerance: f64,
    /// How often to begin again at the best point, with a simplex of half the size that points the other way. It
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
pub struct Bounds {
    /// Smallest values.
    pub low: Vec<f64>,
    /// Largest values.
    pub high: Vec<f64>,
}

impl Bounds {
    /// The unit box of n dimensions.
    pub fn unit(n: usize) -> Self {
        Self { low: vec![0.0; n], high: vec![1.0; n] }
    }

    fn clip(&self, x: &mut [f64]) {
        for ((v, &low), &high) in x.iter_mut().zip(&self.low).zip(&self.high) {
            *v = v.max(low).min(high);
        }
    }

    /// Reflects what lies beyond an upper bound, so that a simplex started at the bound keeps its volume.
    fn reflect(&self, x: &mut [f64]) {
        for (v, &high) in x.iter_mut().zip(&self.high) {
            if *v > high {
                *v = 2.0 * high - *v;
            }
        }
        self.clip(x);
    }
}

struct Coefficients {
    rho: f64,
    chi: f64,
    psi: f64,
    sigma: f64,
}

#[derive(Debug, Clone)]
struct Vertex {
    x: Vec<f64>,
    f: f64,
}

/// The objective asked for a stop.
struct Stopped;

impl NelderMead {
    /// The paper's preset: 30 iterations, coefficients 1, 2, 0.5 and 0.5, no restart, no early stop but SciPy's
    /// tolerances on values in metres.
    pub fn paper() -> Self {
        Self { max_iterations: 30, x_tolerance: 1e-4, f_tolerance: 1e-4, restarts: 0, ..Self::default() }
    }

    /// SciPy's first simplex around a point: each coordinate 5 % larger in turn (0.00025 where it is zero).
    pub fn scipy_simplex(x0: &[f64]) -> Vec<Vec<f64>> {
        let mut simplex = vec![x0.to_vec()];
        for k in 0..x0.len() {
            let mut x = x0.to_vec();
            x[k] = if x[k] != 0.0 { 1.05 * x[k] } else { 0.00025 };
            simplex.push(x);
        }
        simplex
    }

    /// A simplex around a point with the given step per coordinate; steps that would leave the bounds are turned.
    fn simplex_around(x0: &[f64], steps: &[f64], bounds: &Bounds) -> Vec<Vec<f64>> {
        let mut simplex = vec![x0.to_vec()];
        for (k, &step) in steps.iter().enumerate() {
            let mut x = x0.to_vec();
            let inside = |v: f64| (bounds.low[k]..=bounds.high[k]).contains(&v);
            x[k] += if inside(x0[k] + step) || !inside(x0[k] - step) { step } else { -step };
            simplex.push(x);
        }
        simplex
    }

    /// Minimises from a simplex of n + 1 points in n dimensions, without restarts. After each iteration
    /// `on_iteration` sees the best point. Values that are not numbers count as infinite.
    pub fn descend(
        &self,
        simplex: Vec<Vec<f64>>,
        bounds: Option<&Bounds>,
        objective: &mut dyn FnMut(&[f64]) -> Option<f64>,
        on_iteration: &mut dyn FnMut(&[f64], f64),
    ) -> Minimum {
        let mut evaluations = 0;
        let mut evaluate = |x: &[f64]| -> Result<f64, Stopped> {
            let f = objective(x).ok_or(Stopped)?;
            evaluations += 1;
            Ok(if f.is_nan() { f64::INFINITY } else { f })
        };
        let mut vertices: Vec<Vertex> = simplex
            .into_iter()
            .map(|mut x| {
                if let Some(b) = bounds {
                    b.reflect(&mut x);
                }
                Vertex { x, f: f64::INFINITY }
            })
            .collect();
        let mut iterations = 0;
        // Whatever stopped the search, the vertices hold every point that was worth keeping.
        let _ = self.iterate(&mut vertices, bounds, &mut evaluate, &mut iterations, on_iteration);
        vertices.sort_by(|a, b| a.f.total_cmp(&b.f));
        let best = vertices.swap_remove(0);
        Minimum { x: best.x, objective: best.f, evaluations, iterations }
    }

    fn iterate(
        &self,
        vertices: &mut [Vertex],
        bounds: Option<&Bounds>,
        evaluate: &mut dyn FnMut(&[f64]) -> Result<f64, Stopped>,
        iterations: &mut usize,
        on_iteration: &mut dyn FnMut(&[f64], f64),
    ) -> Result<(), Stopped> {
        let n = vertices.len() - 1;
        let Coefficients { rho, chi, psi, sigma } = self.coefficients(n);
        for v in vertices.iter_mut() {
            v.f = evaluate(&v.x)?;
        }
        vertices.sort_by(|a, b| a.f.total_cmp(&b.f));
        while *iterations < self.max_iterations && !self.has_converged(vertices) {
            // Centroid of all but the worst; `along` gives the point a·centroid + b·worst.
            let mut centroid = vec![0.0; n];
            for v in &vertices[..n] {
                centroid.iter_mut().zip(&v.x).for_each(|(c, x)| *c += x);
            }
            centroid.iter_mut().for_each(|c| *c /= n as f64);
            let worst = vertices[n].x.clone();
            let along = |a: f64, b: f64| {
                let mut x: Vec<f64> = centroid.iter().zip(&worst).map(|(c, w)| a * c + b * w).collect();
                if let Some(bounds) = bounds {
                    bounds.clip(&mut x);
                }
                x
            };
            let reflected = along(1.0 + rho, -rho);
            let f_reflected = evaluate(&reflected)?;
            let (f_best, f_second, f_worst) = (vertices[0].f, vertices[n - 1].f, vertices[n].f);
            let mut replacement = None;
            if f_reflected < f_best {
                // Kept first, so that a stop during the expansion does not lose it.
                vertices[n] = Vertex { x: reflected.clone(), f: f_reflected };
                let expanded = along(1.0 + rho * chi, -(rho * chi));
                let f_expanded = evaluate(&expanded)?;
                replacement = Some(if f_expanded < f_reflected {
                    (expanded, f_expanded)
                } else {
                    (reflected, f_reflected)
                });
            } else if f_reflected < f_second {
                replacement = Some((reflected, f_reflected));
            } else if f_reflected < f_worst {
                let outside = along(1.0 + psi * rho, -(psi * rho));
                let f_outside = evaluate(&outside)?;
                if f_outside <= f_reflected {
                    replacement = Some((outside, f_outside));
                }
            } else {
                let inside = along(1.0 - psi, psi);
                let f_inside = evaluate(&inside)?;
                if f_inside < f_worst {
                    replacement = Some((inside, f_inside));
                }
            }
            match replacement {
                Some((x, f)) => vertices[n] = Vertex { x, f },
                None => {
                    let best = vertices[0].x.clone();
                    for v in &mut vertices[1..] {
                        let mut x: Vec<f64> =
                            best.iter().zip(&v.x).map(|(b, x)| b + sigma * (x - b)).collect();
                        if let Some(bounds) = bounds {
                            bounds.clip(&mut x);
                        }
                        let f = evaluate(&x)?;
                        *v = Vertex { x, f };
                    }
                }
            }
            *iterations += 1;
            vertices.sort_by(|a, b| a.f.total_cmp(&b.f));
            on_iteration(&vertices[0].x, vertices[0].f);
        }
        Ok(())
    }

    fn coefficients(&self, n: usize) -> Coefficients {
        if self.adaptive {
            let d = n as f64;
            return Coefficients {
                rho: 1.0,
                chi: 1.0 + 2.0 / d,
                psi: 0.75 - 1.0 / (2.0 * d),
                sigma: 1.0 - 1.0 / d,
            };
        }
        Coefficients { rho: self.reflection, chi: self.expansion, psi: self.contraction, sigma: self.shrink }
    }

    fn has_converged(&self, sorted: &[Vertex]) -> bool {
        let best = &sorted[0];
        sorted[1..].iter().all(|v| {
            (v.f - best.f).abs() <= self.f_tolerance
                && v.x.iter().zip(&best.x).all(|(a, b)| (a - b).abs() <= self.x_tolerance)
        })
    }
}

impl Optimiser for NelderMead {
    fn name(&self) -> &'static str {
        "nelder_mead"
    }

    fn minimise(
        &self,
        start: &[Vec<f64>],
        steps: &[f64],
        objective: &mut dyn FnMut(&[f64]) -> Option<f64>,
    ) -> Minimum {
        let bounds = Bounds::unit(steps.len());
        let simplex = if start.len() == steps.len() + 1 {
            start.to_vec()
        } else {
            Self::simplex_around(&start[0], steps, &bounds)
        };
        // Shared with the closure that sets it.
        let stopped = std::cell::Cell::new(false);
        let mut objective = |x: &[f64]| {
            let f = objective(x);
            stopped.set(f.is_none());
            f
        };
        let mut found = self.descend(simplex, Some(&bounds), &mut objective, &mut |_, _| {});
        let mut scale = 1.0;
        for _ in 0..self.restarts {
            let left = self.max_iterations.saturating_sub(found.iterations);
            if left == 0 || stopped.get() {
                break;
            }
            scale *= -0.5;
            let steps: Vec<f64> = steps.iter().map(|s| s * scale).collect();
            let simplex = Self::simplex_around(&found.x, &steps, &bounds);
            let settings = Self { max_iterations: left, ..*self };
            let again = settings.descend(simplex, Some(&bounds), &mut objective, &mut |_, _| {});
            found.evaluations += again.evaluations;
            found.iterations += again.iterations;
            if again.objective < found.objective {
                (found.x, found.objective) = (again.x, again.objective);
            }
        }
        found
    }
}
