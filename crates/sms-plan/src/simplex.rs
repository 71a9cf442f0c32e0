//! The downhill simplex method as a state machine in ask-and-tell form. Searches can be stopped and continued, and
//! many of them can be evaluated in parallel.

use crate::{BoxBounds, NelderMead};

/// The result of a search.
#[derive(Debug, Clone, PartialEq)]
pub struct Minimum {
    /// The best point.
    pub x: Vec<f64>,
    /// Its objective; infinite if nothing could be evaluated.
    pub objective: f64,
    /// Points evaluated.
    pub evaluations: usize,
    /// Iterations of the method.
    pub iterations: usize,
}

#[derive(Debug, Clone)]
struct Vertex {
    x: Vec<f64>,
    f: f64,
}

/// Purpose of the requested point.
#[derive(Debug, Clone)]
enum SimplexStep {
    /// A vertex of the first simplex.
    First(usize),
    Reflect,
    Expand {
        reflected: Vec<f64>,
        f_reflected: f64,
    },
    ContractOutside {
        f_reflected: f64,
    },
    ContractInside,
    Shrink(usize),
    Done,
}

/// One descent of [`NelderMead`] from a simplex, without restarts. Requests the points of SciPy's method in its order.
#[derive(Debug, Clone)]
pub struct SimplexSearch {
    settings: NelderMead,
    bounds: Option<BoxBounds>,
    vertices: Vec<Vertex>,
    step: SimplexStep,
    asked: Vec<f64>,
    iterations: usize,
    evaluations: usize,
    /// ρ, χ, ψ, σ.
    coefficients: [f64; 4],
}

impl SimplexSearch {
    /// Starts with a simplex of n + 1 points in n dimensions.
    ///
    /// # Panics
    /// If the simplex is empty.
    pub fn new(settings: &NelderMead, simplex: Vec<Vec<f64>>, bounds: Option<BoxBounds>) -> Self {
        let vertices: Vec<Vertex> = simplex
            .into_iter()
            .map(|mut x| {
                if let Some(b) = &bounds {
                    b.reflect(&mut x);
                }
                Vertex { x, f: f64::INFINITY }
            })
            .collect();
        let asked = vertices[0].x.clone();
        Self {
            coefficients: settings.coefficients(vertices.len() - 1),
            settings: *settings,
            bounds,
            vertices,
            step: SimplexStep::First(0),
            asked,
            iterations: 0,
            evaluations: 0,
        }
    }

    /// The point to evaluate next; `None` when the search has ended.
    pub fn next_point(&self) -> Option<&[f64]> {
        (!matches!(self.step, SimplexStep::Done)).then_some(self.asked.as_slice())
    }

    /// The best point and its value so far; the value is infinite before the first evaluation.
    pub fn best(&self) -> (&[f64], f64) {
        let mut best = &self.vertices[0];
        for v in &self.vertices[1..] {
            if v.f.total_cmp(&best.f).is_lt() {
                best = v;
            }
        }
        (&best.x, best.f)
    }

    /// Completed iterations.
    pub fn iterations(&self) -> usize {
        self.iterations
    }

    /// Values received.
    pub fn evaluations(&self) -> usize {
        self.evaluations
    }

    /// Receives the value of [`SimplexSearch::next_point`]; NaN is infinite. Returns whether an iteration is complete.
    pub fn tell(&mut self, value: f64) -> bool {
        let f = if value.is_nan() { f64::INFINITY } else { value };
        self.evaluations += 1;
        let n = self.vertices.len() - 1;
        let [rho, chi, psi, _] = self.coefficients;
        let x = std::mem::take(&mut self.asked);
        match std::mem::replace(&mut self.step, SimplexStep::Done) {
            SimplexStep::First(k) => {
                // The point may have been moved since the creation of the simplex.
                self.vertices[k] = Vertex { x, f };
                if k < n {
                    self.asked = self.vertices[k + 1].x.clone();
                    self.step = SimplexStep::First(k + 1);
                } else {
                    self.sort();
                    self.begin_iteration();
                }
                false
            }
            SimplexStep::Reflect => {
                let (f_best, f_worst) = (self.vertices[0].f, self.vertices[n].f);
                let f_second = self.vertices[n.saturating_sub(1)].f;
                if f < f_best {
                    self.asked = self.along(1.0 + rho * chi, -(rho * chi));
                    // Stored first, so that a stop during the expansion does not lose it.
                    self.vertices[n] = Vertex { x: x.clone(), f };
                    self.step = SimplexStep::Expand { reflected: x, f_reflected: f };
                    false
                } else if f < f_second {
                    self.replace_worst(x, f)
                } else if f < f_worst {
                    self.asked = self.along(1.0 + psi * rho, -(psi * rho));
                    self.step = SimplexStep::ContractOutside { f_reflected: f };
                    false
                } else {
                    self.asked = self.along(1.0 - psi, psi);
                    self.step = SimplexStep::ContractInside;
                    false
                }
            }
            SimplexStep::Expand { reflected, f_reflected } => {
                if f < f_reflected {
                    self.replace_worst(x, f)
                } else {
                    self.replace_worst(reflected, f_reflected)
                }
            }
            SimplexStep::ContractOutside { f_reflected } => {
                if f <= f_reflected {
                    self.replace_worst(x, f)
                } else {
                    self.begin_shrink()
                }
            }
            SimplexStep::ContractInside => {
                if f < self.vertices[n].f {
                    self.replace_worst(x, f)
                } else {
                    self.begin_shrink()
                }
            }
            SimplexStep::Shrink(k) => {
                self.vertices[k] = Vertex { x, f };
                if k < n {
                    self.ask_shrunk(k + 1);
                    false
                } else {
                    self.end_iteration()
                }
            }
            SimplexStep::Done => false,
        }
    }

    fn replace_worst(&mut self, x: Vec<f64>, f: f64) -> bool {
        if let Some(worst) = self.vertices.last_mut() {
            *worst = Vertex { x, f };
        }
        self.end_iteration()
    }

    fn end_iteration(&mut self) -> bool {
        self.iterations += 1;
        self.sort();
        self.begin_iteration();
        true
    }

    fn begin_iteration(&mut self) {
        if self.iterations >= self.settings.max_iterations || self.has_converged() {
            self.step = SimplexStep::Done;
            return;
        }
        let rho = self.coefficients[0];
        self.asked = self.along(1.0 + rho, -rho);
        self.step = SimplexStep::Reflect;
    }

    fn begin_shrink(&mut self) -> bool {
        if self.vertices.len() == 1 {
            return self.end_iteration();
        }
        self.ask_shrunk(1);
        false
    }

    fn ask_shrunk(&mut self, k: usize) {
        let sigma = self.coefficients[3];
        let best = &self.vertices[0].x;
        let mut x: Vec<f64> =
            best.iter().zip(&self.vertices[k].x).map(|(b, x)| b + sigma * (x - b)).collect();
        if let Some(bounds) = &self.bounds {
            bounds.clip(&mut x);
        }
        self.asked = x;
        self.step = SimplexStep::Shrink(k);
    }

    /// Returns the point a·centroid + b·worst, with the centroid of all vertices except the worst.
    fn along(&self, a: f64, b: f64) -> Vec<f64> {
        let n = self.vertices.len() - 1;
        let mut centroid = vec![0.0; n];
        for v in &self.vertices[..n] {
            centroid.iter_mut().zip(&v.x).for_each(|(c, x)| *c += x);
        }
        centroid.iter_mut().for_each(|c| *c /= n as f64);
        let mut x: Vec<f64> = centroid.iter().zip(&self.vertices[n].x).map(|(c, w)| a * c + b * w).collect();
        if let Some(bounds) = &self.bounds {
            bounds.clip(&mut x);
        }
        x
    }

    fn sort(&mut self) {
        self.vertices.sort_by(|a, b| a.f.total_cmp(&b.f));
    }

    fn has_converged(&self) -> bool {
        let best = &self.vertices[0];
        self.vertices[1..].iter().all(|v| {
            (v.f - best.f).abs() <= self.settings.f_tolerance
                && v.x.iter().zip(&best.x).all(|(a, b)| (a - b).abs() <= self.settings.x_tolerance)
        })
    }
}

/// Retreats of an infeasible point: its new distance from the best point as a share of the old one. In an initial
/// simplex, the opposite side of the best point is equally good.
const RETREATS: [f64; 3] = [0.5, 0.25, 0.125];
const FIRST_RETREATS: [f64; 5] = [-1.0, 0.5, -0.5, 0.25, -0.25];

/// Number of consecutive refusals that ends a search: over two simplexes with all retreats in four dimensions.
const MOST_REFUSED: usize = 64;

/// A descent in the unit box with the restarts of [`NelderMead::restarts`]; it can be stopped and continued.
#[derive(Debug, Clone)]
pub struct LocalSearch {
    settings: NelderMead,
    steps: Vec<f64>,
    simplex: SimplexSearch,
    restarts_left: usize,
    scale: f64,
    /// Result of the descents before the current one.
    finished: Minimum,
    /// The first point, if its value was known before the search.
    known: Option<(Vec<f64>, f64)>,
    /// The original request if the current point is a retreat from it, and the number of retreats.
    retreat: Option<(Vec<f64>, usize)>,
    /// Number of refused points in total, and since the last value.
    refused: usize,
    refused_in_a_row: usize,
}

impl LocalSearch {
    /// Starts at a point, or at a simplex of n + 1 points. `steps` are the initial steps per coordinate. If the value
    /// of the first point is known, it is not requested.
    pub fn new(settings: &NelderMead, start: &[Vec<f64>], steps: &[f64], known: Option<f64>) -> Self {
        let bounds = BoxBounds::unit(steps.len());
        let simplex = if start.len() == steps.len() + 1 {
            start.to_vec()
        } else {
            NelderMead::simplex_around(&start[0], steps, &bounds)
        };
        let finished =
            Minimum { x: start[0].clone(), objective: f64::INFINITY, evaluations: 0, iterations: 0 };
        let mut search = Self {
            settings: *settings,
            steps: steps.to_vec(),
            simplex: SimplexSearch::new(settings, simplex, Some(bounds)),
            restarts_left: settings.restarts,
            scale: 1.0,
            finished,
            known: known.map(|f| (start[0].clone(), f)),
            retreat: None,
            refused: 0,
            refused_in_a_row: 0,
        };
        search.tell_known();
        search
    }

    /// The point to evaluate next; `None` when the search has ended.
    pub fn next_point(&self) -> Option<&[f64]> {
        self.simplex.next_point()
    }

    /// Receives the value of [`LocalSearch::next_point`].
    pub fn tell(&mut self, value: f64) {
        self.finished.evaluations += 1;
        self.refused_in_a_row = 0;
        self.settle(value);
    }

    /// Reports that [`LocalSearch::next_point`] is infeasible. This is not an evaluation.
    ///
    /// The search then requests a point closer to its best one, up to three times. This resembles the complex method
    /// (Box 1965), which moves infeasible points towards the centroid of the others; here the centroid may be
    /// infeasible, but the best point is not. After three retreats the point counts as infinitely bad, and the simplex
    /// contracts. After 64 refusals in a row the search ends.
    pub fn refuse(&mut self) {
        self.refused += 1;
        self.refused_in_a_row += 1;
        if self.refused_in_a_row >= MOST_REFUSED {
            self.end();
            return;
        }
        let Some(asked) = self.simplex.next_point().map(<[f64]>::to_vec) else { return };
        let best = self.minimum().x;
        let (from, count) = self.retreat.take().unwrap_or((asked, 0));
        let shares: &[f64] =
            if matches!(self.simplex.step, SimplexStep::First(_)) { &FIRST_RETREATS } else { &RETREATS };
        let inside = |x: &Vec<f64>| x.iter().all(|v| (0.0..=1.0).contains(v));
        for (k, share) in shares.iter().enumerate().skip(count) {
            let x: Vec<f64> = best.iter().zip(&from).map(|(b, x)| b + share * (x - b)).collect();
            if inside(&x) && x != best {
                self.simplex.asked = x;
                self.retreat = Some((from, k + 1));
                return;
            }
        }
        self.settle(f64::INFINITY);
    }

    /// Points refused so far.
    pub fn refused(&self) -> usize {
        self.refused
    }

    /// Ends the search.
    pub(crate) fn end(&mut self) {
        self.simplex.step = SimplexStep::Done;
        self.restarts_left = 0;
    }

    fn settle(&mut self, value: f64) {
        self.retreat = None;
        self.simplex.tell(value);
        self.continue_or_restart();
    }

    /// The best point so far.
    pub fn minimum(&self) -> Minimum {
        let (x, f) = self.simplex.best();
        let iterations = self.finished.iterations + self.simplex.iterations();
        if f < self.finished.objective || self.finished.objective.is_infinite() {
            return Minimum {
                x: x.to_vec(),
                objective: f,
                evaluations: self.finished.evaluations,
                iterations,
            };
        }
        Minimum { iterations, ..self.finished.clone() }
    }

    fn tell_known(&mut self) {
        while let Some(value) = self.known_value() {
            self.simplex.tell(value);
        }
    }

    fn known_value(&self) -> Option<f64> {
        let (x, f) = self.known.as_ref()?;
        (self.simplex.next_point()? == x.as_slice()).then_some(*f)
    }

    fn continue_or_restart(&mut self) {
        loop {
            self.tell_known();
            if self.simplex.next_point().is_some() || self.restarts_left == 0 {
                return;
            }
            self.restarts_left -= 1;
            let best = self.minimum();
            let left = self.settings.max_iterations.saturating_sub(best.iterations);
            if left == 0 {
                self.restarts_left = 0;
                return;
            }
            self.finished = best;
            self.scale *= -0.5;
            let steps: Vec<f64> = self.steps.iter().map(|s| s * self.scale).collect();
            let bounds = BoxBounds::unit(steps.len());
            let simplex = NelderMead::simplex_around(&self.finished.x, &steps, &bounds);
            let settings = NelderMead { max_iterations: left, ..self.settings };
            self.simplex = SimplexSearch::new(&settings, simplex, Some(bounds));
            // The simulation is deterministic: known values are not requested again.
            self.known = Some((self.finished.x.clone(), self.finished.objective));
        }
    }
}
