//! Finding good actions in the nominal world: screening, then local searches from the best points.

use crate::space::{Space, is_near};
use crate::{Halton, Method, Optimiser, Phase, PlanConfig, PlanError, StartSummary, Trial};
use rand::RngExt;
use rayon::prelude::*;
use sms_core::Seed;

/// The objective of a unit point; called from many threads.
pub(crate) type Objective<'a> = &'a (dyn Fn(&[f64]) -> Result<f64, PlanError> + Sync);

/// A unit point with its objective.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Scored {
    pub(crate) x: Vec<f64>,
    pub(crate) objective: f64,
}

/// Everything that was tried, in an order that does not depend on threads.
#[derive(Debug, Default)]
pub(crate) struct Found {
    pub(crate) scored: Vec<Scored>,
    pub(crate) starts: Vec<StartSummary>,
    pub(crate) trials: Vec<Trial>,
}

struct Start {
    /// The point, or a simplex.
    points: Vec<Vec<f64>>,
    steps: Vec<f64>,
    /// The first point's objective, where it is known.
    known: Option<f64>,
    /// Rollouts that the search may use.
    budget: usize,
}

/// Searches as `config` says.
pub(crate) fn search(
    space: &Space,
    config: &PlanConfig,
    seed: Seed,
    objective: Objective<'_>,
) -> Result<Found, PlanError> {
    let mut found = Found::default();
    let starts = match config.method {
        Method::Screen => screen(space, config, seed, objective, &mut found)?,
        Method::MultiStart => random_simplexes(space, config, seed),
    };
    let searched: Vec<(StartSummary, Vec<Scored>)> = starts
        .par_iter()
        .enumerate()
        .map(|(index, start)| descend(space, &config.nelder_mead, index, start, objective))
        .collect::<Result<_, _>>()?;
    for (summary, scored) in searched {
        found.log(space, Phase::Search, summary.start as i32, &scored);
        found.scored.extend(scored);
        found.starts.push(summary);
    }
    Ok(found)
}

/// Evaluates suggestions and Halton points, and returns the best ones as starts.
fn screen(
    space: &Space,
    config: &PlanConfig,
    seed: Seed,
    objective: Objective<'_>,
    found: &mut Found,
) -> Result<Vec<Start>, PlanError> {
    let n = space.dimensions();
    let budget = ((config.evaluations as f64 * config.screening_share).round() as usize).max(1);
    let (everywhere, direct) = (Halton::new(n, seed.derive("box")), Halton::new(n, seed.derive("promising")));
    // (point, whether its search should take the smaller steps of the promising ranges).
    let points: Vec<(Vec<f64>, bool)> = space
        .suggestions
        .iter()
        .filter(|_| config.suggestions)
        .map(|x| (x.clone(), true))
        .chain((0..).map(|i: u64| {
            if space.has_promising() && i.is_multiple_of(2) {
                (space.in_promising(&direct.point(i / 2)), true)
            } else {
                (everywhere.point(i), false)
            }
        }))
        .take(budget)
        .collect();
    let values: Vec<f64> = points.par_iter().map(|(x, _)| objective(x)).collect::<Result<_, _>>()?;
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]).then(a.cmp(&b)));
    let left = config.evaluations.saturating_sub(points.len());
    let mut starts: Vec<Start> = Vec::new();
    for i in order {
        let (x, promising) = &points[i];
        let steps = space.steps(config.initial_step, *promising);
        let half: Vec<f64> = steps.iter().map(|s| 0.5 * s).collect();
        if starts.len() < config.starts && !starts.iter().any(|s| is_near(&s.points[0], x, &half)) {
            starts.push(Start { points: vec![x.clone()], steps, known: Some(values[i]), budget: 0 });
        }
    }
    let count = starts.len().max(1);
    for (i, start) in starts.iter_mut().enumerate() {
        start.budget = left / count + usize::from(i < left % count);
    }
    let scored: Vec<Scored> =
        points.into_iter().zip(values).map(|((x, _), objective)| Scored { x, objective }).collect();
    found.log(space, Phase::Screen, -1, &scored);
    found.scored.extend(scored);
    Ok(starts)
}

/// The paper's starts: simplexes of random points in the promising ranges.
fn random_simplexes(space: &Space, config: &PlanConfig, seed: Seed) -> Vec<Start> {
    let n = space.dimensions();
    (0..config.starts)
        .map(|i| {
            let mut rng = seed.derive_index("simplex", i as u64).rng();
            let vertex = |_| space.in_promising(&(0..n).map(|_| rng.random()).collect::<Vec<f64>>());
            Start {
                points: (0..=n).map(vertex).collect(),
                steps: space.steps(config.initial_step, true),
                known: None,
                budget: usize::MAX,
            }
        })
        .collect()
}

/// One local search.
fn descend(
    space: &Space,
    optimiser: &dyn Optimiser,
    index: usize,
    start: &Start,
    objective: Objective<'_>,
) -> Result<(StartSummary, Vec<Scored>), PlanError> {
    let mut scored: Vec<Scored> = Vec::new();
    let mut failure = None;
    let mut initial = start.known;
    let minimum = optimiser.minimise(&start.points, &start.steps, &mut |x| {
        if let Some(known) = start.known.filter(|_| x == start.points[0]) {
            return Some(known);
        }
        if scored.len() >= start.budget {
            return None;
        }
        match objective(x) {
            Ok(value) => {
                initial = initial.or(Some(value));
                scored.push(Scored { x: x.to_vec(), objective: value });
                Some(value)
            }
            Err(e) => {
                failure = Some(e);
                None
            }
        }
    });
    if let Some(e) = failure {
        return Err(e);
    }
    let summary = StartSummary {
        start: index,
        initial: space.action(&start.points[0]),
        initial_objective: initial.unwrap_or(minimum.objective),
        action: space.action(&minimum.x),
        objective: minimum.objective,
        evaluations: scored.len(),
        iterations: minimum.iterations,
        objective_q90: None,
    };
    Ok((summary, scored))
}

impl Found {
    fn log(&mut self, space: &Space, phase: Phase, start: i32, scored: &[Scored]) {
        self.trials.extend(scored.iter().enumerate().map(|(i, s)| Trial {
            phase,
            start,
            iteration: i as i32,
            action: space.action(&s.x),
            objective: s.objective,
        }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_task::Parameter;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// A narrow valley of good directions inside a wide box, like direct shots among all angles.
    fn valley(x: &[f64]) -> Result<f64, PlanError> {
        let angle = 120.0 * (x[1] - 0.47);
        let spin = 0.3 * (x[2] - 0.5);
        Ok(((angle * 0.05 + spin).powi(2) + (0.3 - x[0]).max(0.0).powi(2)).sqrt().min(0.4))
    }

    fn space() -> Space {
        let parameter = |name: &str| Parameter { name: name.into(), unit: "1".into(), low: 0.0, high: 1.0 };
        let names = ["speed", "angle", "contact_along", "contact_across"];
        Space::of(names.map(parameter).to_vec(), vec![[0.0, 1.0], [0.4, 0.6], [0.0, 1.0], [0.0, 1.0]])
    }

    #[test]
    fn screening_finds_a_narrow_valley_within_its_budget() {
        for (method, limit) in [(Method::Screen, 400), (Method::MultiStart, 30 * 5 * 30)] {
            let config = PlanConfig { method, evaluations: 400, ..PlanConfig::draft() };
            let count = AtomicUsize::new(0);
            let found = search(&space(), &config, Seed(3), &|x| {
                assert!(x.iter().all(|v| (0.0..=1.0).contains(v)));
                count.fetch_add(1, Ordering::SeqCst);
                valley(x)
            })
            .unwrap();
            let best = found.scored.iter().map(|s| s.objective).fold(f64::INFINITY, f64::min);
            assert!(best < 1e-3, "{method:?}: {best}");
            let count = count.into_inner();
            assert!(count <= limit && count > limit / 4, "{method:?} used {count}");
            assert_eq!(found.trials.len(), count);
            assert_eq!(found.starts.len(), config.starts);
            for start in &found.starts {
                assert!(start.objective <= start.initial_objective, "{start:?}");
            }
        }
    }

    #[test]
    fn the_order_of_trials_does_not_depend_on_threads() {
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| search(&space(), &PlanConfig::draft(), Seed(1), &valley)).unwrap().trials
        };
        assert_eq!(run(1), run(4));
    }

    #[test]
    fn the_first_error_ends_the_search() {
        let result = search(&space(), &PlanConfig::draft(), Seed(1), &|_| {
            Err(PlanError::Core(sms_core::CoreError::Interrupted))
        });
        assert!(matches!(result, Err(PlanError::Core(sms_core::CoreError::Interrupted))));
    }
}
