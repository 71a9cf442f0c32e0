//! Which action to choose: the one that fares best when the world is a little different.

use crate::prediction::compare;
use crate::search::{Found, Scored};
use crate::space::{Space, is_near};
use crate::strategy::strategy_of;
use crate::worlds::{Counter, DisturbedWorlds, Worlds};
use crate::{LocalSearch, NelderMead, Phase, PlanConfig, PlanError, Trial};
use rayon::prelude::*;
use sms_scene::Scene;
use sms_task::{Action, ResolvedTask};
use std::collections::BTreeMap;

/// Ways of reaching the goal that are followed through all worlds.
pub(crate) const STRATEGIES: usize = 4;

/// Worlds in which all candidates are tried.
pub(crate) const FIRST_WORLDS: usize = 4;

/// An action on its way through the disturbed worlds.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Candidate {
    pub(crate) x: Vec<f64>,
    pub(crate) action: Action,
    /// Objective in the nominal world.
    pub(crate) objective: f64,
    /// What happens, in words.
    pub(crate) strategy: String,
    /// Objectives in the worlds seen so far.
    pub(crate) outcomes: Vec<f64>,
}

/// What the choice needs.
pub(crate) struct Choice<'a> {
    pub(crate) task: &'a ResolvedTask,
    pub(crate) scene: &'a Scene,
    pub(crate) config: &'a PlanConfig,
    pub(crate) space: &'a Space,
    pub(crate) nominal: &'a Worlds<'a>,
    pub(crate) counter: &'a Counter<'a>,
    /// What the shots of the search do, by [`key`].
    pub(crate) known: &'a BTreeMap<Vec<u64>, String>,
}

/// What a point is noted by.
pub(crate) fn key(x: &[f64]) -> Vec<u64> {
    x.iter().map(|v| v.to_bits()).collect()
}

impl Choice<'_> {
    /// The best action of each strategy, best strategy first. With disturbed worlds: many candidates are tried in few
    /// worlds, the better half in twice as many, and so on; then the search goes on over the first half of all worlds
    /// from the best of them. In those worlds the survivors look better than they are, and those that were searched for
    /// there more so: the best few and the best of each strategy are tried in the other half too, and both halves decide.
    pub(crate) fn choose(
        &self,
        found: &mut Found,
        worlds: &DisturbedWorlds<'_>,
    ) -> Result<Vec<Candidate>, PlanError> {
        let mut all = self.candidates(&found.scored);
        let mut alive: Vec<usize> = (0..all.len()).collect();
        if worlds.len() > 0 {
            let half = worlds.len().div_ceil(2);
            let (mut seen, mut next) = (0, FIRST_WORLDS.min(half));
            loop {
                self.run(&mut all, &alive, worlds, seen..next, &mut found.trials)?;
                seen = next;
                alive = self.ranked(&all, &alive);
                if seen == half {
                    break;
                }
                let count = alive.len().div_ceil(2).max(self.config.finalists);
                alive = self.best_with_strategies(&all, &alive, count);
                next = (2 * seen).min(half);
            }
            let polished = self.polish(&mut all, &alive, worlds, half, &mut found.trials)?;
            // What cannot be believed in the scanned world is no plan, however it fares in others.
            alive.extend(polished.into_iter().filter(|&i| all[i].objective.is_finite()));
            alive = self.ranked(&all, &alive);
            alive = self.best_with_strategies(&all, &alive, self.config.finalists);
            self.run(&mut all, &alive, worlds, half..worlds.len(), &mut found.trials)?;
            alive = self.ranked(&all, &alive);
        }
        let mut best: Vec<Candidate> = Vec::new();
        for i in alive {
            if !best.iter().any(|b| b.strategy == all[i].strategy) {
                best.push(all[i].clone());
            }
        }
        best.truncate(STRATEGIES);
        Ok(best)
    }

    /// Distinct actions that do better than nothing, best first: half of them the nominally best ones, half from every
    /// strategy in turn.
    fn candidates(&self, scored: &[Scored]) -> Vec<Candidate> {
        let count = self.config.candidates;
        let steps = self.space.steps(self.config.initial_step, true);
        let pool = distinct(scored, self.task.initial_objective(), &steps, 2 * count);
        let pool = pool.into_iter().map(|s| self.candidate(s.x, s.objective)).collect();
        spread(pool, count)
    }

    fn candidate(&self, x: Vec<f64>, objective: f64) -> Candidate {
        let action = self.space.action(&x);
        let strategy = self.known.get(&key(&x)).cloned().unwrap_or_default();
        Candidate { x, action, objective, strategy, outcomes: Vec::new() }
    }

    /// Carries out each shot in the nominal world and looks at what touches what. Not counted: a handful.
    fn name_strategies(&self, candidates: &mut [Candidate]) -> Result<(), PlanError> {
        let names: Vec<(String, f64)> = candidates
            .par_iter()
            .map(|c| {
                let strike = self.task.strike(&c.action);
                Ok(match self.nominal.rollout(&strike, None) {
                    Ok(rollout) => (strategy_of(&rollout, self.scene, self.task), rollout.objective),
                    Err(e) if e.is_invalid_rollout() => ("not valid".to_owned(), f64::INFINITY),
                    Err(e) => return Err(e.into()),
                })
            })
            .collect::<Result<_, PlanError>>()?;
        for (c, (name, objective)) in candidates.iter_mut().zip(names) {
            (c.strategy, c.objective) = (name, objective);
        }
        Ok(())
    }

    /// Tries the candidates `who` in the given worlds; outcomes are appended in the worlds' order.
    fn run(
        &self,
        all: &mut [Candidate],
        who: &[usize],
        worlds: &DisturbedWorlds<'_>,
        range: std::ops::Range<usize>,
        trials: &mut Vec<Trial>,
    ) -> Result<(), PlanError> {
        let actions: Vec<Action> = who.iter().map(|&i| all[i].action.clone()).collect();
        let rows = worlds.objectives(&actions, range.clone(), self.counter)?;
        for (&i, row) in who.iter().zip(rows) {
            for (w, &objective) in range.clone().zip(&row) {
                let action = all[i].action.clone();
                trials.push(Trial::new(Phase::Disturbed, i as i32, w as i32, action, objective));
            }
            all[i].outcomes.extend(row);
        }
        Ok(())
    }

    /// In order of the stated objective over the worlds; ties keep the nominally better one first.
    fn ranked(&self, all: &[Candidate], who: &[usize]) -> Vec<usize> {
        let objective = self.config.objective;
        let mut order = who.to_vec();
        order.sort_by(|&a, &b| {
            compare(objective.rank(&all[a].outcomes), objective.rank(&all[b].outcomes))
                .then(all[a].objective.total_cmp(&all[b].objective))
        });
        order
    }

    /// The first `count` of ranked candidates, with the best one of each of the first few strategies and the nominally
    /// best of all (the first candidate), so that the choice is never worse than that one over all worlds.
    fn best_with_strategies(&self, all: &[Candidate], ranked: &[usize], count: usize) -> Vec<usize> {
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

    /// Simplex searches over the first `count` worlds from the best candidates that differ; the points that were tried
    /// become candidates. Returns the best of them.
    fn polish(
        &self,
        all: &mut Vec<Candidate>,
        ranked: &[usize],
        worlds: &DisturbedWorlds<'_>,
        count: usize,
        trials: &mut Vec<Trial>,
    ) -> Result<Vec<usize>, PlanError> {
        let config = self.config;
        let settings = NelderMead { restarts: 0, ..config.nelder_mead };
        let statistic = |c: &Candidate| {
            let (invalid, value) = config.objective.rank(&c.outcomes);
            if invalid == 0 { value } else { f64::INFINITY }
        };
        let mut searches: Vec<LocalSearch> = Vec::new();
        let mut begun: Vec<usize> = Vec::new();
        for &i in ranked {
            let steps = self.space.steps(0.5 * config.initial_step, self.space.is_promising(&all[i].x));
            if searches.len() == config.polish_starts {
                break;
            }
            if begun.iter().all(|&b| !is_near(&all[b].x, &all[i].x, &steps)) {
                begun.push(i);
                let start = [all[i].x.clone()];
                searches.push(LocalSearch::new(&settings, &start, &steps, Some(statistic(&all[i]))));
            }
        }
        let first = all.len();
        for _ in 0..config.polish {
            let mut asked: Vec<(usize, usize)> = Vec::new();
            for (s, search) in searches.iter().enumerate() {
                if let Some(x) = search.next_point() {
                    asked.push((s, all.len()));
                    all.push(self.candidate(x.to_vec(), f64::INFINITY));
                }
            }
            if asked.is_empty() {
                break;
            }
            let who: Vec<usize> = asked.iter().map(|a| a.1).collect();
            self.run(all, &who, worlds, 0..count, trials)?;
            for (s, i) in asked {
                searches[s].tell(statistic(&all[i]));
            }
        }
        let added: Vec<usize> = (first..all.len()).collect();
        // Only the best of them can be chosen: the others are not looked at more closely.
        let kept: Vec<usize> = self.ranked(all, &added).into_iter().take(2 * STRATEGIES).collect();
        let mut looked: Vec<Candidate> = kept.iter().map(|&i| all[i].clone()).collect();
        self.name_strategies(&mut looked)?;
        for (&i, c) in kept.iter().zip(looked) {
            all[i] = c;
        }
        Ok(kept)
    }
}

/// Up to `count` actions better than `limit`, best first, that differ from each other by more than the steps in some
/// coordinate; the best one whatever the limit.
fn distinct(scored: &[Scored], limit: f64, steps: &[f64], count: usize) -> Vec<Scored> {
    let mut order: Vec<&Scored> = scored.iter().filter(|s| s.objective.is_finite()).collect();
    // Stable: what was tried first comes first among equals.
    order.sort_by(|a, b| a.objective.total_cmp(&b.objective));
    let mut chosen: Vec<Scored> = Vec::new();
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

/// Up to `count` of the candidates, which come best first, in their order: the first half of them, then one from each
/// strategy in turn.
fn spread(pool: Vec<Candidate>, count: usize) -> Vec<Candidate> {
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
    let mut pool: Vec<Option<Candidate>> = pool.into_iter().map(Some).collect();
    chosen.into_iter().filter_map(|i| pool[i].take()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scored(x: f64, objective: f64) -> Scored {
        Scored { x: vec![x], objective }
    }

    fn candidate(objective: f64, strategy: &str) -> Candidate {
        Candidate {
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
    fn every_strategy_has_a_candidate() {
        let mut pool: Vec<Candidate> = (0..20).map(|i| candidate(0.001 * f64::from(i), "direct")).collect();
        pool.push(candidate(0.05, "off a"));
        pool.push(candidate(0.06, "off b"));
        let names: Vec<String> = spread(pool, 8).into_iter().map(|c| c.strategy).collect();
        assert_eq!(names.len(), 8);
        assert!(names.contains(&"off a".to_owned()) && names.contains(&"off b".to_owned()));
        assert_eq!(spread(vec![candidate(0.1, "a")], 8).len(), 1);
    }
}
