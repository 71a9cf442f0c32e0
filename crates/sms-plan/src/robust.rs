//! Robust choice: the action with the best outcomes over perturbed worlds.

use crate::candidate::{RobustCandidate, STRATEGIES, key};
use crate::config::FIRST_WORLDS;
use crate::prediction::compare;
use crate::racing::race;
use crate::robust_search::Searches;
use crate::search::{ScoredPoint, SearchLog};
use crate::session::Session;
use crate::space::is_near;
use crate::worlds::PerturbedWorlds;
use crate::{PlanError, Trial, TrialPhase};
use rayon::prelude::*;
use sms_core::Seed;
use sms_task::Action;
use std::collections::BTreeMap;

/// The choice among actions.
pub(crate) struct RobustChoice<'a> {
    pub(crate) session: &'a Session<'a>,
    /// Strategies of the rollouts in the nominal world, by [`key`].
    pub(crate) known: &'a BTreeMap<Vec<u64>, String>,
}

impl RobustChoice<'_> {
    /// Returns the best action of each strategy whose whole motion the robot can carry out, best strategy first; empty
    /// if there is none.
    ///
    /// With perturbed worlds the choice has four steps.
    ///
    /// 1. Candidates are the nominally best actions and the best of a scan. Each point of the scan is tried in one
    ///    perturbed world, so that it does not select actions that work only in the scanned world.
    /// 2. The candidates are tried in a few worlds. Simplex searches over these worlds start from the best distinct
    ///    ones; their number halves after each round.
    /// 3. The best are tried in more worlds, the better half in twice as many, and so on through the first half of the
    ///    worlds. Simplex searches over that half start from the best of these.
    /// 4. The outcomes of the survivors in these worlds are biased, most of all for points of the searches. The best
    ///    few and the best of each strategy race through the second half, and both halves decide.
    pub(crate) fn choose(
        &self,
        found: &mut SearchLog,
        worlds: &PerturbedWorlds<'_>,
        seed: Seed,
    ) -> Result<Vec<RobustCandidate>, PlanError> {
        let config = self.session.config;
        let mut all = self.candidates(&found.scored);
        let mut alive: Vec<usize> = (0..all.len()).collect();
        if worlds.len() > 0 {
            let half = worlds.len().div_ceil(2);
            let few = FIRST_WORLDS.min(half);
            let trials = &mut found.trials;
            all.extend(self.scan(worlds, seed, trials)?);
            alive.extend(alive.len()..all.len());
            alive = self.with_nominal_if_ranked(&mut all, alive, trials)?;
            self.run(&mut all, &alive, worlds, 0..few, trials)?;
            alive = self.ranked(&all, &alive);
            let searches =
                Searches { starts: config.descents, survivors: 4, points: config.descent, worlds: few };
            let added = self.descend(&mut all, &alive, worlds, &searches, trials)?;
            alive.extend(added);
            alive = self.with_nominal_if_ranked(&mut all, alive, trials)?;
            alive = self.ranked(&all, &alive);
            alive = self.apart(&all, &alive, config.candidates.div_ceil(2).max(config.finalists));
            alive = self.with_nominal(&mut all, &alive, trials)?;
            let mut seen = few;
            while seen < half {
                let next = (2 * seen).min(half);
                self.run(&mut all, &alive, worlds, seen..next, trials)?;
                seen = next;
                alive = self.ranked(&all, &alive);
                let count = alive.len().div_ceil(2).max(config.finalists);
                alive = self.best_with_strategies(&all, &alive, count);
            }
            let searches = Searches {
                starts: config.polish_starts,
                survivors: config.polish_starts,
                points: config.polish,
                worlds: half,
            };
            let polished = self.descend(&mut all, &alive, worlds, &searches, trials)?;
            // Only the best can be chosen; the others are not simulated in the scanned world.
            let polished: Vec<usize> =
                self.ranked(&all, &polished).into_iter().take(2 * STRATEGIES).collect();
            alive.extend(self.with_nominal(&mut all, &polished, trials)?);
            alive = self.ranked(&all, &alive);
            alive = self.executable(&all, &alive)?;
            alive = self.best_with_strategies(&all, &alive, config.finalists);
            let last = half..worlds.len();
            alive = race(&mut all, &alive, last, config, &mut |all, who, range| {
                self.run(all, who, worlds, range, trials)
            })?;
            alive = self.ranked(&all, &alive);
        }
        let is_checked = worlds.len() > 0;
        let mut best: Vec<RobustCandidate> = Vec::new();
        for i in alive {
            let is_new = best.len() < STRATEGIES && !best.iter().any(|b| b.strategy == all[i].strategy);
            if is_new && (is_checked || self.session.is_executable(&all[i].action)?) {
                best.push(all[i].clone());
            }
        }
        if best.is_empty() {
            best.extend(self.best_executable(&found.scored)?);
        }
        Ok(best)
    }

    /// Returns the candidates with a motion, from home to strike, that passes every check of the robot.
    fn executable(&self, all: &[RobustCandidate], who: &[usize]) -> Result<Vec<usize>, PlanError> {
        let can: Vec<bool> =
            who.par_iter().map(|&i| self.session.is_executable(&all[i].action)).collect::<Result<_, _>>()?;
        Ok(who.iter().zip(can).filter_map(|(&i, can)| can.then_some(i)).collect())
    }

    /// The nominally best action of the search that the robot can carry out from home to its end.
    fn best_executable(&self, scored: &[ScoredPoint]) -> Result<Option<RobustCandidate>, PlanError> {
        let mut order: Vec<&ScoredPoint> = scored.iter().filter(|s| s.objective.is_finite()).collect();
        order.sort_by(|a, b| a.objective.total_cmp(&b.objective));
        for s in order {
            let candidate = self.candidate(s.x.clone(), s.objective);
            if self.session.is_executable(&candidate.action)? {
                return Ok(Some(candidate));
            }
        }
        Ok(None)
    }

    /// Distinct actions that improve on doing nothing: half the nominally best ones, half from each strategy in turn.
    fn candidates(&self, scored: &[ScoredPoint]) -> Vec<RobustCandidate> {
        let count = self.session.config.candidates;
        let steps = self.session.space.steps(self.session.config.initial_step, true);
        let pool = distinct(scored, self.session.task.initial_objective(), &steps, 2 * count);
        let pool = pool.into_iter().map(|s| self.candidate(s.x, s.objective)).collect();
        spread(pool, count)
    }

    pub(crate) fn candidate(&self, x: Vec<f64>, objective: f64) -> RobustCandidate {
        let action = self.session.space.action(&x);
        let strategy = self.known.get(&key(&x)).cloned().unwrap_or_default();
        RobustCandidate { x, action, objective, strategy, outcomes: Vec::new() }
    }

    /// Tries candidates without a nominal rollout in the nominal world and names their strategies. Drops candidates
    /// that are invalid in the scanned world, because they cannot be the plan.
    fn with_nominal(
        &self,
        all: &mut [RobustCandidate],
        who: &[usize],
        trials: &mut Vec<Trial>,
    ) -> Result<Vec<usize>, PlanError> {
        let unknown: Vec<usize> = who.iter().copied().filter(|&i| !all[i].objective.is_finite()).collect();
        let seen: Vec<(String, f64)> = unknown
            .par_iter()
            .map(|&i| {
                let strike = self.session.task.strike(&all[i].action);
                let mut name = String::new();
                let objective = self.session.counter.count(|| {
                    let rollout = self.session.nominal.rollout(&strike, None)?;
                    name = self.session.strategy_of(&rollout);
                    Ok(rollout.objective)
                })?;
                Ok((name, objective))
            })
            .collect::<Result<_, PlanError>>()?;
        for (&i, (name, objective)) in unknown.iter().zip(seen) {
            (all[i].strategy, all[i].objective) = (name, objective);
            trials.push(Trial::new(TrialPhase::Perturbed, i as i32, -1, all[i].action.clone(), objective));
        }
        Ok(who.iter().copied().filter(|&i| all[i].objective.is_finite()).collect())
    }

    /// Applies [`RobustChoice::with_nominal`] if the scanned world takes part in the ranking.
    fn with_nominal_if_ranked(
        &self,
        all: &mut [RobustCandidate],
        who: Vec<usize>,
        trials: &mut Vec<Trial>,
    ) -> Result<Vec<usize>, PlanError> {
        if self.session.config.nominal_worlds == 0 { Ok(who) } else { self.with_nominal(all, &who, trials) }
    }

    /// Tries the candidates `who` in the given worlds and appends the outcomes in the order of the worlds.
    pub(crate) fn run(
        &self,
        all: &mut [RobustCandidate],
        who: &[usize],
        worlds: &PerturbedWorlds<'_>,
        range: std::ops::Range<usize>,
        trials: &mut Vec<Trial>,
    ) -> Result<(), PlanError> {
        let actions: Vec<Action> = who.iter().map(|&i| all[i].action.clone()).collect();
        let rows = worlds.objectives(&actions, range.clone())?;
        for (&i, row) in who.iter().zip(rows) {
            trials.extend(Trial::row(TrialPhase::Perturbed, i, range.start, &all[i].action, &row));
            all[i].outcomes.extend(row);
        }
        Ok(())
    }

    /// Sorts candidates by the robust objective; ties keep the nominally better one first.
    pub(crate) fn ranked(&self, all: &[RobustCandidate], who: &[usize]) -> Vec<usize> {
        let mut order = who.to_vec();
        order.sort_by(|&a, &b| {
            compare(all[a].rank(self.session.config, 0), all[b].rank(self.session.config, 0))
                .then(all[a].objective.total_cmp(&all[b].objective))
        });
        order
    }

    /// Returns the first `count` of ranked candidates, the best of each of the first few strategies, and the nominally
    /// best of all (candidate 0). So the choice is never worse than candidate 0 over all worlds.
    fn best_with_strategies(&self, all: &[RobustCandidate], ranked: &[usize], count: usize) -> Vec<usize> {
        let mut strategies: Vec<&str> = Vec::new();
        ranked
            .iter()
            .enumerate()
            .filter(|&(place, &i)| {
                let strategy = all[i].strategy.as_str();
                let is_first = !strategies.contains(&strategy) && strategies.len() < STRATEGIES;
                if is_first {
                    strategies.push(strategy);
                }
                place < count || is_first || i == 0
            })
            .map(|(_, &i)| i)
            .collect()
    }
}

/// Up to `count` actions better than `limit`, best first, that differ by more than the steps in some coordinate. The
/// best action is always included.
fn distinct(scored: &[ScoredPoint], limit: f64, steps: &[f64], count: usize) -> Vec<ScoredPoint> {
    let mut order: Vec<&ScoredPoint> = scored.iter().filter(|s| s.objective.is_finite()).collect();
    // Stable: equal points keep the order of their evaluation.
    order.sort_by(|a, b| a.objective.total_cmp(&b.objective));
    let mut chosen: Vec<ScoredPoint> = Vec::new();
    for s in order {
        if chosen.len() == count || (s.objective >= limit && !chosen.is_empty()) {
            break;
        }
        if !chosen.iter().any(|c| is_near(&c.x, &s.x, steps)) {
            chosen.push(s.clone());
        }
    }
    chosen
}

/// Up to `count` candidates of a list that is sorted best first, in order: the first half of them, then one from each
/// strategy in turn.
fn spread(pool: Vec<RobustCandidate>, count: usize) -> Vec<RobustCandidate> {
    let mut chosen: Vec<usize> = (0..pool.len().min(count.div_ceil(2))).collect();
    let mut rest: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (i, c) in pool.iter().enumerate().skip(chosen.len()) {
        rest.entry(&c.strategy).or_default().push(i);
    }
    let mut groups: Vec<std::vec::IntoIter<usize>> = {
        let mut groups: Vec<Vec<usize>> = rest.into_values().collect();
        groups.sort();
        groups.into_iter().map(IntoIterator::into_iter).collect()
    };
    while chosen.len() < count {
        let round: Vec<usize> = groups.iter_mut().filter_map(Iterator::next).collect();
        if round.is_empty() {
            break;
        }
        chosen.extend(round.into_iter().take(count - chosen.len()));
    }
    chosen.sort_unstable();
    let mut pool: Vec<Option<RobustCandidate>> = pool.into_iter().map(Some).collect();
    chosen.into_iter().filter_map(|i| pool[i].take()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::PlanConfig;

    fn scored(x: f64, objective: f64) -> ScoredPoint {
        ScoredPoint { x: vec![x], objective }
    }

    fn candidate(objective: f64, strategy: &str) -> RobustCandidate {
        RobustCandidate {
            x: vec![objective],
            action: Action(vec![objective]),
            objective,
            strategy: strategy.into(),
            outcomes: Vec::new(),
        }
    }

    #[test]
    fn distinct_actions_that_help_are_candidates_however_much_worse_than_the_best() {
        let all = [
            scored(0.1, 0.001),
            scored(0.5, 0.09),
            scored(0.9, 0.4),
            scored(0.11, 0.002),
            scored(0.7, f64::INFINITY),
        ];
        let places = |limit, count| -> Vec<f64> {
            distinct(&all, limit, &[0.05], count).iter().map(|c| c.x[0]).collect()
        };
        assert_eq!(places(0.3, 8), [0.1, 0.5]);
        assert_eq!(places(0.3, 1), [0.1]);
        assert_eq!(places(0.0, 8), [0.1]);
    }

    #[test]
    fn the_scanned_world_counts_for_as_many_worlds_as_is_asked() {
        let with = |objective: f64, outcomes: &[f64]| RobustCandidate {
            outcomes: outcomes.to_vec(),
            ..candidate(objective, "direct")
        };
        let config = |nominal_worlds| PlanConfig { nominal_worlds, ..PlanConfig::default() };
        let (here, there) = (with(0.0625, &[0.25, 0.5]), with(0.5, &[0.125, 0.375]));
        assert!(here.rank(&config(0), 0) > there.rank(&config(0), 0));
        assert!(here.rank(&config(1), 0) < there.rank(&config(1), 0));
        assert_eq!(there.rank(&config(2), 0), (0, 0.375));
        // Untried worlds count as 0, the best possible objective.
        assert_eq!(there.rank(&config(2), 4), (0, 0.1875));
        // A point of a simplex search has no nominal objective before it is tried in the scanned world.
        let unknown = with(f64::INFINITY, &[0.125, 0.375]);
        assert_eq!(unknown.rank(&config(2), 0), (0, 0.25));
    }

    #[test]
    fn every_strategy_has_a_candidate() {
        let mut pool: Vec<RobustCandidate> =
            (0..20).map(|i| candidate(0.001 * f64::from(i), "direct")).collect();
        pool.push(candidate(0.05, "off a"));
        pool.push(candidate(0.06, "off b"));
        let names: Vec<String> = spread(pool, 8).into_iter().map(|c| c.strategy).collect();
        assert_eq!(names.len(), 8);
        assert!(names.contains(&"off a".to_owned()) && names.contains(&"off b".to_owned()));
        assert_eq!(spread(vec![candidate(0.1, "a")], 8).len(), 1);
    }
}
