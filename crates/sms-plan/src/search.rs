//! Search of the nominal world.

use crate::batch::drive;
use crate::descents::{DescentSettings, Descents, Sharing};
use crate::screening::{Feasible, points};
use crate::space::Space;
use crate::{BatchOptimiser, Method, PlanConfig, PlanError, StartSummary, Trial, TrialPhase};
use sms_core::Seed;
use std::collections::BTreeMap;

/// The objective of a unit point; called from many threads. Infinite where the rollout is invalid.
pub(crate) type ObjectiveFn<'a> = &'a (dyn Fn(&[f64]) -> Result<f64, PlanError> + Sync);

/// A unit point with its objective.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ScoredPoint {
    pub(crate) x: Vec<f64>,
    pub(crate) objective: f64,
}

/// All evaluations of a search, in an order that does not depend on threads.
#[derive(Debug, Default)]
pub struct SearchLog {
    pub(crate) scored: Vec<ScoredPoint>,
    /// The local searches.
    pub starts: Vec<StartSummary>,
    /// Every rollout: the screening, then the local searches in order of their starts.
    pub trials: Vec<Trial>,
}

impl SearchLog {
    /// The best objective; infinite without a valid evaluation.
    pub fn best(&self) -> f64 {
        self.scored.iter().map(|s| s.objective).fold(f64::INFINITY, f64::min)
    }

    /// Appends the results of another search. Its starts and screened points are renumbered to follow the present ones.
    pub(crate) fn append(&mut self, other: Self) {
        let before = self.starts.len();
        let screened = self.trials.iter().filter(|t| t.phase == TrialPhase::Screen).count();
        self.scored.extend(other.scored);
        self.starts.extend(other.starts.into_iter().map(|s| StartSummary { start: before + s.start, ..s }));
        let renumbered = |t: Trial| match t.phase {
            TrialPhase::Search => Trial { start: t.start + before as i32, ..t },
            _ => Trial { iteration: t.iteration + screened as i32, ..t },
        };
        self.trials.extend(other.trials.into_iter().map(renumbered));
    }
}

/// Creates the configured optimiser, with screened points and random simplexes of feasible strikes.
///
/// # Errors
/// The first error of `feasible`.
pub fn optimiser(
    space: &Space,
    config: &PlanConfig,
    seed: Seed,
    feasible: Feasible<'_>,
) -> Result<Box<dyn BatchOptimiser>, PlanError> {
    let screening = (config.evaluations as f64 * config.screening_share).round() as usize;
    let descents = |sharing| DescentSettings {
        nelder_mead: config.nelder_mead,
        initial_step: config.initial_step,
        starts: config.starts,
        sharing,
    };
    Ok(Box::new(match config.method {
        Method::Halving => {
            let screen = points(space, config.suggestions, seed, screening.max(1), feasible)?;
            Descents::screened(space, descents(Sharing::Halving(config.survivors)), screen)
        }
        Method::MultiStart => Descents::random(space, descents(Sharing::Even), seed, feasible)?,
    }))
}

/// Searches with at most `budget` evaluations. Infeasible strikes do not count: screening and populations draw other
/// strikes, and a simplex retreats towards its best point.
pub(crate) fn search(
    optimiser: &mut dyn BatchOptimiser,
    space: &Space,
    budget: usize,
    feasible: Feasible<'_>,
    objective: ObjectiveFn<'_>,
) -> Result<SearchLog, PlanError> {
    let mut log = drive(optimiser, budget, &|x| Ok(if feasible(x)? { Some(objective(x)?) } else { None }))?;
    // Stable: within a search, points keep the order in which they were proposed.
    log.sort_by_key(|(p, _)| (p.phase != TrialPhase::Screen, p.start));
    let mut found = SearchLog::default();
    let mut counts: BTreeMap<i32, i32> = BTreeMap::new();
    for (proposal, objective) in log {
        let count = counts.entry(proposal.start).or_default();
        let action = space.action(&proposal.x);
        found.trials.push(Trial::new(proposal.phase, proposal.start, *count, action, objective));
        *count += 1;
        found.scored.push(ScoredPoint { x: proposal.x, objective });
    }
    found.starts = optimiser
        .starts()
        .into_iter()
        .enumerate()
        .map(|(start, s)| StartSummary {
            start,
            initial: space.action(&s.initial),
            initial_objective: s.initial_objective,
            action: space.action(&s.found.x),
            objective: s.found.objective,
            evaluations: s.found.evaluations,
            iterations: s.found.iterations,
            refused: s.refused,
            objective_q90: None,
        })
        .collect();
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_task::Parameter;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// A narrow valley of good directions in a wide box, like direct shots among all angles.
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

    fn search_as(
        config: &PlanConfig,
        seed: Seed,
        budget: usize,
        feasible: Feasible<'_>,
        objective: ObjectiveFn<'_>,
    ) -> Result<SearchLog, PlanError> {
        let mut optimiser = optimiser(&space(), config, seed, feasible)?;
        search(optimiser.as_mut(), &space(), budget, feasible, objective)
    }

    #[test]
    fn screening_finds_a_narrow_valley_within_its_budget() {
        for (method, limit) in [(Method::MultiStart, 30 * 5 * 30), (Method::Halving, 400)] {
            let config = PlanConfig { method, evaluations: 400, ..PlanConfig::draft() };
            let count = AtomicUsize::new(0);
            let found = search_as(&config, Seed(3), limit, &|_| Ok(true), &|x| {
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

    /// Infeasible in three quarters of the box, on both sides of an oblique strip around the valley.
    fn strip(x: &[f64]) -> bool {
        (x[1] - 0.47 - 0.1 * (x[3] - 0.5)).abs() < 0.125
    }

    #[test]
    fn infeasible_points_cost_nothing_and_stop_no_search() {
        for method in Method::ALL {
            let config = PlanConfig { method, evaluations: 400, starts: 8, ..PlanConfig::draft() };
            let feasible = |x: &[f64]| Ok(strip(x));
            let found = search_as(&config, Seed(3), 400, &feasible, &|x| {
                assert!(strip(x), "{method:?} evaluates an infeasible point");
                valley(x)
            })
            .unwrap();
            let best = found.scored.iter().map(|s| s.objective).fold(f64::INFINITY, f64::min);
            assert!(best < 1e-3, "{method:?}: {best}");
            assert!(found.trials.iter().all(|t| t.valid));
            assert!(found.starts.iter().all(|s| s.objective.is_finite() && !s.is_out_of_reach()));
            if method != Method::MultiStart {
                assert!(found.trials.len() > 390, "{method:?} had {}", found.trials.len());
            }
        }
    }

    #[test]
    fn searches_continue_after_refusals() {
        // The minimum lies on the border of the feasible region, so that searches often reach this border.
        let can = |x: &[f64]| Ok(x[0] + x[1] > 1.1);
        let value = |x: &[f64]| Ok((x[0] - 0.2).hypot(x[1] - 0.8) + 0.1 * (x[2] - 0.3).hypot(x[3] - 0.6));
        for method in Method::ALL {
            let config = PlanConfig { method, evaluations: 600, starts: 6, ..PlanConfig::draft() };
            let found = search_as(&config, Seed(5), 600, &can, &value).unwrap();
            let refused: usize = found.starts.iter().map(|s| s.refused).sum();
            assert!(refused > 5, "{method:?}: {refused}");
            // On the border the distance is (0.1)/√2.
            let best = found.scored.iter().map(|s| s.objective).fold(f64::INFINITY, f64::min);
            assert!(best < 0.1 / 2f64.sqrt() + 0.01, "{method:?}: {best}");
        }
    }

    #[test]
    fn a_start_without_a_feasible_point_says_so() {
        let config = PlanConfig { method: Method::MultiStart, starts: 3, ..PlanConfig::paper() };
        let found = search_as(&config, Seed(5), 600, &|_| Ok(false), &valley).unwrap();
        assert!(found.trials.is_empty() && found.starts.len() == 3);
        for start in &found.starts {
            assert!(
                start.is_out_of_reach() && start.refused == 2 * 64 && start.evaluations == 0,
                "{start:?}"
            );
        }
    }

    #[test]
    fn the_order_of_trials_does_not_depend_on_threads() {
        for method in Method::ALL {
            let config = PlanConfig { method, ..PlanConfig::draft() };
            for feasible in [&|_: &[f64]| Ok(true), &|x: &[f64]| Ok(strip(x))] as [Feasible<'_>; 2] {
                let run = |threads: usize| {
                    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                    let run = || search_as(&config, Seed(1), 480, feasible, &valley);
                    let found = pool.install(run).unwrap();
                    (found.trials, found.starts)
                };
                assert_eq!(run(1), run(4), "{method:?}");
            }
        }
    }

    #[test]
    fn appended_searches_are_numbered_after_the_first() {
        let config = PlanConfig { evaluations: 100, starts: 4, ..PlanConfig::draft() };
        let run = |seed| search_as(&config, Seed(seed), 100, &|_| Ok(true), &valley).unwrap();
        let (mut both, second) = (run(1), run(2));
        let (trials, starts) = (both.trials.clone(), both.starts.len());
        let best = both.best().min(second.best());
        both.append(second);
        assert_eq!(both.trials[..trials.len()], trials);
        assert_eq!((both.scored.len(), both.best()), (200, best));
        assert!(both.starts.iter().enumerate().all(|(i, s)| s.start == i) && both.starts.len() > starts);
        let mut names: Vec<(&str, i32, i32)> =
            both.trials.iter().map(|t| (t.phase.as_str(), t.start, t.iteration)).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), 200, "two rollouts share a number");
    }

    #[test]
    fn the_first_error_ends_the_search() {
        let result = search_as(&PlanConfig::draft(), Seed(1), 100, &|_| Ok(true), &|_| {
            Err(PlanError::Core(sms_core::CoreError::Interrupted))
        });
        assert!(matches!(result, Err(PlanError::Core(sms_core::CoreError::Interrupted))));
    }
}
