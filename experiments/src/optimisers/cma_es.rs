//! Covariance matrix adaptation (CMA-ES; Hansen and Ostermeier 2001, constants of Hansen's tutorial of 2016), begun at
//! the best points of a scan and restarted with twice the population (IPOP; Auger and Hansen 2005).

use super::jacobi::symmetric_eigen;
use rand::Rng;
use sms_core::{Seed, StageRng, standard_normal};
use sms_plan::screening::{self, Screened};
use sms_plan::{BatchOptimiser, Minimum, Proposal, Space, StartRecord, TrialPhase};

/// A search distribution N(m, σ²C) over ℝⁿ and its adaptation.
#[derive(Debug, Clone)]
pub(super) struct CmaEs {
    n: usize,
    lambda: usize,
    /// Recombination weights of the best μ; they add to 1.
    weights: Vec<f64>,
    mu_eff: f64,
    c_sigma: f64,
    d_sigma: f64,
    c_c: f64,
    c_1: f64,
    c_mu: f64,
    /// E‖N(0, I)‖.
    chi_n: f64,
    mean: Vec<f64>,
    sigma: f64,
    /// Covariance, row by row.
    c: Vec<f64>,
    /// Eigenvectors of `c`, one per column, row by row; and the roots of its eigenvalues.
    b: Vec<f64>,
    d: Vec<f64>,
    path_sigma: Vec<f64>,
    path_c: Vec<f64>,
    generation: usize,
}

impl CmaEs {
    /// Begins at a mean with the standard deviation `sigma` in every coordinate; `lambda` points per generation
    /// (4 + 3 ln n where it is smaller).
    pub(super) fn new(mean: &[f64], sigma: f64, lambda: usize) -> Self {
        let n = mean.len();
        let nf = n as f64;
        let lambda = lambda.max(4 + (3.0 * nf.ln()).floor() as usize);
        let mu = lambda / 2;
        let raw: Vec<f64> = (1..=mu).map(|i| ((lambda as f64 + 1.0) / 2.0).ln() - (i as f64).ln()).collect();
        let sum: f64 = raw.iter().sum();
        let weights: Vec<f64> = raw.iter().map(|w| w / sum).collect();
        let mu_eff = 1.0 / weights.iter().map(|w| w * w).sum::<f64>();
        let c_sigma = (mu_eff + 2.0) / (nf + mu_eff + 5.0);
        let c_1 = 2.0 / ((nf + 1.3).powi(2) + mu_eff);
        let identity: Vec<f64> = (0..n * n).map(|i| if i % (n + 1) == 0 { 1.0 } else { 0.0 }).collect();
        Self {
            n,
            lambda,
            mu_eff,
            c_sigma,
            d_sigma: 1.0 + 2.0 * (((mu_eff - 1.0) / (nf + 1.0)).sqrt() - 1.0).max(0.0) + c_sigma,
            c_c: (4.0 + mu_eff / nf) / (nf + 4.0 + 2.0 * mu_eff / nf),
            c_1,
            c_mu: (1.0 - c_1).min(2.0 * (mu_eff - 2.0 + 1.0 / mu_eff) / ((nf + 2.0).powi(2) + mu_eff)),
            chi_n: nf.sqrt() * (1.0 - 1.0 / (4.0 * nf) + 1.0 / (21.0 * nf * nf)),
            mean: mean.to_vec(),
            sigma,
            c: identity.clone(),
            b: identity,
            d: vec![1.0; n],
            path_sigma: vec![0.0; n],
            path_c: vec![0.0; n],
            generation: 0,
            weights,
        }
    }

    /// Points per generation.
    pub(super) fn population(&self) -> usize {
        self.lambda
    }

    /// Generations so far.
    pub(super) fn generation(&self) -> usize {
        self.generation
    }

    /// The largest standard deviation along an axis of the distribution.
    pub(super) fn spread(&self) -> f64 {
        self.sigma * self.d.iter().copied().fold(0.0, f64::max)
    }

    /// A point of the distribution.
    pub(super) fn sample(&self, rng: &mut impl Rng) -> Vec<f64> {
        let z: Vec<f64> = (0..self.n).map(|k| self.d[k] * standard_normal(rng)).collect();
        (0..self.n)
            .map(|i| {
                let y: f64 = (0..self.n).map(|k| self.b[i * self.n + k] * z[k]).sum();
                self.mean[i] + self.sigma * y
            })
            .collect()
    }

    /// Adapts to a generation: its points, best first. Fewer than the population may be given; then nothing is
    /// learned from them.
    pub(super) fn adapt(&mut self, best_first: &[Vec<f64>]) {
        let (n, mu) = (self.n, self.weights.len());
        if best_first.len() < self.lambda {
            return;
        }
        self.generation += 1;
        let steps: Vec<Vec<f64>> = best_first[..mu]
            .iter()
            .map(|x| x.iter().zip(&self.mean).map(|(x, m)| (x - m) / self.sigma).collect())
            .collect();
        let step: Vec<f64> =
            (0..n).map(|i| self.weights.iter().zip(&steps).map(|(w, y)| w * y[i]).sum()).collect();
        for (m, y) in self.mean.iter_mut().zip(&step) {
            *m += self.sigma * y;
        }
        // C^(-1/2)·step.
        let along: Vec<f64> =
            (0..n).map(|k| (0..n).map(|i| self.b[i * n + k] * step[i]).sum::<f64>() / self.d[k]).collect();
        let keep = (self.c_sigma * (2.0 - self.c_sigma) * self.mu_eff).sqrt();
        for i in 0..n {
            let white: f64 = (0..n).map(|k| self.b[i * n + k] * along[k]).sum();
            self.path_sigma[i] = (1.0 - self.c_sigma) * self.path_sigma[i] + keep * white;
        }
        let length = self.path_sigma.iter().map(|p| p * p).sum::<f64>().sqrt();
        let decay = 1.0 - (1.0 - self.c_sigma).powi(2 * self.generation as i32);
        let is_steady = length / decay.sqrt() < (1.4 + 2.0 / (n as f64 + 1.0)) * self.chi_n;
        let h = if is_steady { 1.0 } else { 0.0 };
        let keep = h * (self.c_c * (2.0 - self.c_c) * self.mu_eff).sqrt();
        for (p, y) in self.path_c.iter_mut().zip(&step) {
            *p = (1.0 - self.c_c) * *p + keep * y;
        }
        let lost = (1.0 - h) * self.c_c * (2.0 - self.c_c);
        for i in 0..n {
            for j in 0..n {
                let rank_mu: f64 = self.weights.iter().zip(&steps).map(|(w, y)| w * y[i] * y[j]).sum();
                let c = &mut self.c[i * n + j];
                *c = (1.0 - self.c_1 - self.c_mu + self.c_1 * lost) * *c
                    + self.c_1 * self.path_c[i] * self.path_c[j]
                    + self.c_mu * rank_mu;
            }
        }
        self.sigma *= ((self.c_sigma / self.d_sigma) * (length / self.chi_n - 1.0)).min(1.0).exp();
        let (values, vectors) = symmetric_eigen(&self.c, n);
        let largest = values.iter().copied().fold(0.0, f64::max);
        // A direction without any spread would never get any again.
        self.d = values.iter().map(|v| v.max(1e-14 * largest).sqrt()).collect();
        self.b = vectors;
    }
}

/// A number mirrored into [0, 1] as often as it takes.
fn mirrored(v: f64) -> f64 {
    let t = v.rem_euclid(2.0);
    if t > 1.0 { 2.0 - t } else { t }
}

/// Settings of [`CmaSearch`].
#[derive(Debug, Clone)]
pub(super) struct CmaSettings {
    pub(super) initial_step: f64,
    pub(super) starts: usize,
    /// Least population.
    pub(super) population: usize,
    pub(super) x_tolerance: f64,
    pub(super) f_tolerance: f64,
}

struct CmaRun {
    /// In coordinates divided by `steps`.
    cma: CmaEs,
    steps: Vec<f64>,
    record: StartRecord,
    /// Best values of the last generations.
    history: Vec<f64>,
    /// Unmirrored points that were asked for, in the distribution's coordinates.
    asked: Vec<Vec<f64>>,
    /// Evaluated points of this generation, and the number of points that could not be tried.
    known: Vec<(Vec<f64>, f64)>,
    refused: usize,
}

/// Points that a generation draws at most, for each that it has: others are drawn in the place of those that cannot be
/// tried, from the same distribution.
const MOST_DRAWS: usize = 8;

/// A scan, then CMA-ES from its best points, one after another, each with twice the population of the one before.
pub(super) struct CmaSearch {
    settings: CmaSettings,
    space: Space,
    rng: StageRng,
    screen: Vec<Screened>,
    screened: bool,
    begins: Vec<(Screened, Vec<f64>)>,
    runs: Vec<CmaRun>,
    population: usize,
}

impl CmaSearch {
    pub(super) fn new(space: &Space, settings: CmaSettings, screen: Vec<Screened>, seed: Seed) -> Self {
        Self {
            population: settings.population,
            settings,
            screen,
            space: space.clone(),
            rng: seed.derive("cma").rng(),
            screened: false,
            begins: Vec::new(),
            runs: Vec::new(),
        }
    }

    fn begin_next(&mut self) -> bool {
        let Some((from, steps)) = self.begins.get(self.runs.len()) else { return false };
        // A parameter with a range of one value has no step.
        let steps: Vec<f64> = steps.iter().map(|s| s.max(1e-9)).collect();
        let scaled: Vec<f64> = from.x.iter().zip(&steps).map(|(x, s)| x / s).collect();
        let cma = CmaEs::new(&scaled, 1.0, self.population);
        self.population = 2 * cma.population();
        self.runs.push(CmaRun {
            cma,
            steps,
            record: StartRecord {
                initial: from.x.clone(),
                initial_objective: from.objective,
                found: Minimum {
                    x: from.x.clone(),
                    objective: from.objective,
                    evaluations: 0,
                    iterations: 0,
                },
                refused: 0,
            },
            history: Vec::new(),
            asked: Vec::new(),
            known: Vec::new(),
            refused: 0,
        });
        true
    }

    fn is_over(&self, run: &CmaRun) -> bool {
        let window = 10 + 30 * self.space.dimensions() / run.cma.population();
        let recent = &run.history[run.history.len().saturating_sub(window)..];
        let range = recent.iter().copied().fold(f64::NEG_INFINITY, f64::max)
            - recent.iter().copied().fold(f64::INFINITY, f64::min);
        let largest_step = run.steps.iter().copied().fold(0.0, f64::max);
        run.cma.spread() * largest_step < self.settings.x_tolerance
            || (recent.len() == window && range <= self.settings.f_tolerance)
    }
}

impl BatchOptimiser for CmaSearch {
    fn ask(&mut self, room: usize) -> Vec<Proposal> {
        if !self.screened {
            self.screen.truncate(room);
            return self
                .screen
                .iter()
                .map(|s| Proposal { x: s.x.clone(), phase: TrialPhase::Screen, start: -1 })
                .collect();
        }
        if self.runs.last().is_none_or(|r| self.is_over(r)) && !self.begin_next() {
            return Vec::new();
        }
        let start = self.runs.len() as i32 - 1;
        let Some(run) = self.runs.last_mut() else { return Vec::new() };
        let missing = run.cma.population() - run.known.len();
        run.asked = (0..missing.min(room)).map(|_| run.cma.sample(&mut self.rng)).collect();
        run.asked
            .iter()
            .map(|y| Proposal {
                x: y.iter().zip(&run.steps).map(|(y, s)| mirrored(y * s)).collect(),
                phase: TrialPhase::Search,
                start,
            })
            .collect()
    }

    fn tell(&mut self, values: &[Option<f64>]) {
        if !self.screened {
            self.screen.iter_mut().zip(values).for_each(|(s, f)| s.objective = f.unwrap_or(f64::INFINITY));
            self.screened = true;
            self.begins = screening::distinct(
                &self.space,
                &self.screen,
                self.settings.initial_step,
                self.settings.starts,
            );
            return;
        }
        let Some(run) = self.runs.last_mut() else { return };
        let mut cannot = Vec::new();
        for (y, value) in std::mem::take(&mut run.asked).into_iter().zip(values) {
            match value {
                Some(f) => run.known.push((y, *f)),
                None => cannot.push(y),
            }
        }
        run.record.found.evaluations += values.len() - cannot.len();
        run.record.refused += cannot.len();
        run.refused += cannot.len();
        let population = run.cma.population();
        if run.refused + population >= MOST_DRAWS * population {
            // Too few can be tried: the others count as the worst.
            run.known.extend(cannot.into_iter().map(|y| (y, f64::INFINITY)));
        }
        if run.known.len() < population {
            return;
        }
        run.refused = 0;
        let mut generation = std::mem::take(&mut run.known);
        // Stable: among equals, the first draw comes first.
        generation.sort_by(|a, b| a.1.total_cmp(&b.1));
        let (best, value) = &generation[0];
        if *value < run.record.found.objective {
            run.record.found.objective = *value;
            run.record.found.x = best.iter().zip(&run.steps).map(|(y, s)| mirrored(y * s)).collect();
        }
        run.history.push(*value);
        let sorted: Vec<Vec<f64>> = generation.into_iter().map(|(y, _)| y).collect();
        run.cma.adapt(&sorted);
        run.record.found.iterations = run.cma.generation();
    }

    fn starts(&self) -> Vec<StartRecord> {
        let record = |r: &CmaRun| {
            let mut record = r.record.clone();
            // A generation that the budget cut short.
            for (y, f) in &r.known {
                if *f < record.found.objective {
                    record.found.objective = *f;
                    record.found.x = y.iter().zip(&r.steps).map(|(y, s)| mirrored(y * s)).collect();
                }
            }
            record
        };
        self.runs.iter().map(record).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn minimise(f: impl Fn(&[f64]) -> f64, mean: &[f64], generations: usize) -> (CmaEs, f64) {
        let mut rng = Seed(4).rng();
        let mut cma = CmaEs::new(mean, 0.5, 0);
        let mut best = f64::INFINITY;
        for _ in 0..generations {
            let mut points: Vec<Vec<f64>> = (0..cma.population()).map(|_| cma.sample(&mut rng)).collect();
            points.sort_by(|a, b| f(a).total_cmp(&f(b)));
            best = best.min(f(&points[0]));
            cma.adapt(&points);
        }
        (cma, best)
    }

    #[test]
    fn a_turned_narrow_ellipsoid_and_a_curved_valley_are_minimised() {
        let ellipsoid = |x: &[f64]| {
            let (u, v) = (x[0] + x[1], x[0] - x[1]);
            u * u + 1e4 * v * v + (x[2] - 1.0).powi(2)
        };
        let (cma, best) = minimise(ellipsoid, &[3.0, -2.0, 0.0], 150);
        assert!(best < 1e-9, "{best}");
        assert!((cma.mean[2] - 1.0).abs() < 1e-3);
        let rosenbrock = |x: &[f64]| 100.0 * (x[1] - x[0] * x[0]).powi(2) + (1.0 - x[0]).powi(2);
        let (_, best) = minimise(rosenbrock, &[-1.2, 1.0], 250);
        assert!(best < 1e-9, "{best}");
    }

    #[test]
    fn on_a_random_objective_the_step_neither_grows_nor_shrinks_much() {
        // Selection without information must leave log σ unbiased (Hansen's tutorial, section 5).
        let mut rng = Seed(9).rng();
        let mut cma = CmaEs::new(&[0.0; 4], 1.0, 0);
        for _ in 0..100 {
            let points: Vec<Vec<f64>> = (0..cma.population()).map(|_| cma.sample(&mut rng)).collect();
            cma.adapt(&points);
        }
        assert!((0.1..10.0).contains(&cma.sigma), "{}", cma.sigma);
    }

    #[test]
    fn the_constants_are_those_of_the_tutorial() {
        let cma = CmaEs::new(&[0.0; 10], 1.0, 0);
        // λ = 4 + ⌊3 ln 10⌋ = 10, μ_eff = 3.167 for the five weights ln 5.5 − ln i.
        assert_eq!(cma.population(), 10);
        assert!((cma.mu_eff - 3.167).abs() < 2e-3, "{}", cma.mu_eff);
        assert!((cma.weights.iter().sum::<f64>() - 1.0).abs() < 1e-15);
        assert!((cma.chi_n - 3.0847).abs() < 1e-3, "{}", cma.chi_n);
    }

    #[test]
    fn mirroring_keeps_what_is_inside() {
        for (v, m) in [(0.3, 0.3), (-0.2, 0.2), (1.2, 0.8), (2.3, 0.3), (-1.4, 0.6)] {
            assert!((mirrored(v) - m).abs() < 1e-12);
        }
    }
}
