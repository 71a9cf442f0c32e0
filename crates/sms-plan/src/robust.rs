//! Which action to choose: the one that fares best when the world is a little different.

use crate::beaten::until_beaten;
use crate::prediction::compare;
use crate::robust_search::Searches;
use crate::search::{Found, Scored};
use crate::space::{Space, is_near};
use crate::strategy::strategy_of;
use crate::worlds::{Counter, DisturbedWorlds, Worlds};
use crate::{Phase, PlanConfig, PlanError, Trial};
use rayon::prelude::*;
use sms_core::Seed;
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

impl Candidate {
    /// What it is ranked by over the worlds seen so far, the world as scanned among them where that is known, and `more` in which its
    /// objective is 0.
    pub(crate) fn rank(&self, config: &PlanConfig, more: usize) -> (usize, f64) {
        let nominal = if self.objective.is_finite() { config.nominal_worlds } else { 0 };
        let mut values = self.outcomes.clone();
        values.extend(std::iter::repeat_n(self.objective, nominal));
        values.extend(std::iter::repeat_n(0.0, more));
        config.objective.rank(&values)
    }
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
    /// The best action of each strategy that the robot can carry out from home to its end, best strategy first; empty where
    /// there is none. With disturbed worlds:
    ///
    /// 1. Candidates are the nominally best actions and the best of a scan, each point of which is tried in one
    ///    disturbed world: what works in the world as told alone does not get through.
    /// 2. They are tried in few worlds; from the best that differ, simplex searches go on over these worlds, fewer and
    ///    fewer of them.
    /// 3. The best are tried in more worlds, the better half of them in twice as many, and so on; from the best of these
    ///    the search goes on once more, over the first half of all worlds.
    /// 4. In those worlds the survivors look better than they are, and those that were searched for there more so: the
    ///    best few and the best of each strategy are tried in the other half too, as long as they may still become the best of
    ///    their strategy, and both halves decide.
    pub(crate) fn choose(
        &self,
        found: &mut Found,
        worlds: &DisturbedWorlds<'_>,
        seed: Seed,
    ) -> Result<Vec<Candidate>, PlanError> {
        let config = self.config;
        let mut all = self.candidates(&found.scored);
        let mut alive: Vec<usize> = (0..all.len()).collect();
        if worlds.len() > 0 {
            let half = worlds.len().div_ceil(2);
            let few = FIRST_WORLDS.min(half);
            let trials = &mut found.trials;
            all.extend(self.scan(worlds, seed, trials)?);
            alive.extend(alive.len()..all.len());
            alive = self.counted(&mut all, alive, trials)?;
            self.run(&mut all, &alive, worlds, 0..few, trials)?;
            alive = self.ranked(&all, &alive);
            let searches =
                Searches { starts: config.descents, survivors: 4, points: config.descent, worlds: few };
            let added = self.descend(&mut all, &alive, worlds, &searches, trials)?;
            alive.extend(added);
            alive = self.counted(&mut all, alive, trials)?;
            alive = self.ranked(&all, &alive);
            alive = self.apart(&all, &alive, config.candidates.div_ceil(2).max(config.finalists));
            alive = self.looked_at(&mut all, &alive, trials)?;
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
            // Only the best of them can be chosen: the others are not looked at more closely.
            let polished: Vec<usize> =
                self.ranked(&all, &polished).into_iter().take(2 * STRATEGIES).collect();
            alive.extend(self.looked_at(&mut all, &polished, trials)?);
            alive = self.ranked(&all, &alive);
            alive = self.executable(&all, &alive)?;
            alive = self.best_with_strategies(&all, &alive, config.finalists);
            let last = half..worlds.len();
            alive = until_beaten(&mut all, &alive, last, config, &mut |all, who, range| {
                self.run(all, who, worlds, range, trials)
            })?;
            alive = self.ranked(&all, &alive);
        }
        let is_checked = worlds.len() > 0;
        let mut best: Vec<Candidate> = Vec::new();
        for i in alive {
            let is_new = best.len() < STRATEGIES && !best.iter().any(|b| b.strategy == all[i].strategy);
            if is_new && (is_checked || self.counter.executable(self.task, &all[i].action)?) {
                best.push(all[i].clone());
            }
        }
        if best.is_empty() {
            best.extend(self.best_executable(&found.scored)?);
        }
        Ok(best)
    }

    /// Those whose whole motion, from home to strike, passes every check of the robot.
    fn executable(&self, all: &[Candidate], who: &[usize]) -> Result<Vec<usize>, PlanError> {
        let can: Vec<bool> = who
            .par_iter()
            .map(|&i| self.counter.executable(self.task, &all[i].action))
            .collect::<Result<_, _>>()?;
        Ok(who.iter().zip(can).filter_map(|(&i, can)| can.then_some(i)).collect())
    }

    /// The nominally best action of the search that the robot can carry out from home to its end.
    fn best_executable(&self, scored: &[Scored]) -> Result<Option<Candidate>, PlanError> {
        let mut order: Vec<&Scored> = scored.iter().filter(|s| s.objective.is_finite()).collect();
        order.sort_by(|a, b| a.objective.total_cmp(&b.objective));
        for s in order {
            let candidate = self.candidate(s.x.clone(), s.objective);
            if self.counter.executable(self.task, &candidate.action)? {
                return Ok(Some(candidate));
            }
        }
        Ok(None)
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

    pub(crate) fn candidate(&self, x: Vec<f64>, objective: f64) -> Candidate {
        let action = self.space.action(&x);
        let strategy = self.known.get(&key(&x)).cloned().unwrap_or_default();
        Candidate { x, action, objective, strategy, outcomes: Vec::new() }
    }

    /// Carries out the shots that have not been in the nominal world there, and looks at what touches what. Without those
    /// that cannot be believed there: what is invalid in the scanned world is no plan, however it fares in others.
    fn looked_at(
        &self,
        all: &mut [Candidate],
        who: &[usize],
        trials: &mut Vec<Trial>,
    ) -> Result<Vec<usize>, PlanError> {
        let unknown: Vec<usize> = who.iter().copied().filter(|&i| !all[i].objective.is_finite()).collect();
        let seen: Vec<(String, f64)> = unknown
            .par_iter()
            .map(|&i| {
                let strike = self.task.strike(&all[i].action);
                let mut name = String::new();
                let objective = self.counter.count(|| {
                    let rollout = self.nominal.rollout(&strike, None)?;
                    name = strategy_of(&rollout, self.scene, self.task);
                    Ok(rollout.objective)
                })?;
                Ok((name, objective))
            })
            .collect::<Result<_, PlanError>>()?;
        for (&i, (name, objective)) in unknown.iter().zip(seen) {
            (all[i].strategy, all[i].objective) = (name, objective);
            trials.push(Trial::new(Phase::Disturbed, i as i32, -1, all[i].action.clone(), objective));
        }
        Ok(who.iter().copied().filter(|&i| all[i].objective.is_finite()).collect())
    }

    /// Where the scanned world is among those that candidates are ranked by, they are [`Choice::looked_at`] before.
    fn counted(
        &self,
        all: &mut [Candidate],
        who: Vec<usize>,
        trials: &mut Vec<Trial>,
    ) -> Result<Vec<usize>, PlanError> {
        if self.config.nominal_worlds == 0 { Ok(who) } else { self.looked_at(all, &who, trials) }
    }

    /// Tries the candidates `who` in the given worlds; outcomes are appended in the worlds' order.
    pub(crate) fn run(
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
    pub(crate) fn ranked(&self, all: &[Candidate], who: &[usize]) -> Vec<usize> {
        let mut order = who.to_vec();
        order.sort_by(|&a, &b| {
            compare(all[a].rank(self.config, 0), all[b].rank(self.config, 0))
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
    fn the_scanned_world_counts_for_as_many_worlds_as_is_asked() {
        let with = |objective: f64, outcomes: &[f64]| Candidate {
            outcomes: outcomes.to_vec(),
            ..candidate(objective, "direct")
        };
        let config = |nominal_worlds| PlanConfig { nominal_worlds, ..PlanConfig::default() };
        let (here, there) = (with(0.0625, &[0.25, 0.5]), with(0.5, &[0.125, 0.375]));
        assert!(here.rank(&config(0), 0) > there.rank(&config(0), 0));
        assert!(here.rank(&config(1), 0) < there.rank(&config(1), 0));
        assert_eq!(there.rank(&config(2), 0), (0, 0.375));
        // Worlds to come, in which nothing can be better than 0.
        assert_eq!(there.rank(&config(2), 4), (0, 0.1875));
        // What a shot of a simplex search does in the scanned world is not known before it is looked at.
        let unknown = with(f64::INFINITY, &[0.125, 0.375]);
        assert_eq!(unknown.rank(&config(2), 0), (0, 0.25));
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
