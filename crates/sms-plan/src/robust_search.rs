//! Searches over disturbed worlds: where good actions may lie, and from there to better ones.

use crate::robust::{Candidate, Choice};
use crate::screening::points;
use crate::space::is_near;
use crate::worlds::DisturbedWorlds;
use crate::{LocalSearch, NelderMead, Phase, PlanError, Trial};
use rayon::prelude::*;
use sms_core::Seed;

/// Simplex searches side by side.
pub(crate) struct Searches {
    /// How many at first.
    pub(crate) starts: usize,
    /// How many at least.
    pub(crate) survivors: usize,
    /// Points that each may try before the worse half of them ends.
    pub(crate) points: usize,
    /// Worlds over which they search.
    pub(crate) worlds: usize,
}

impl Choice<'_> {
    /// Points spread over all actions that the robot can make, each tried in one of the disturbed worlds in turn; the best that differ, half as
    /// many as there are candidates. What they did in that world is not kept: they were chosen for it.
    pub(crate) fn scan(
        &self,
        worlds: &DisturbedWorlds<'_>,
        seed: Seed,
        trials: &mut Vec<Trial>,
    ) -> Result<Vec<Candidate>, PlanError> {
        let config = self.config;
        let scanned = points(self.space, config.suggestions, seed, config.scan, &|x| {
            self.counter.draw(self.task, &self.space.action(x))
        })?;
        let jobs: Vec<_> =
            scanned.iter().enumerate().map(|(i, s)| (i % worlds.len(), self.space.action(&s.x))).collect();
        let values = worlds.each(&jobs, self.counter)?;
        let mut order: Vec<usize> = (0..scanned.len()).filter(|&i| values[i].is_finite()).collect();
        order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
        for ((world, action), &objective) in jobs.into_iter().zip(&values) {
            trials.push(Trial::new(Phase::Disturbed, -1, world as i32, action, objective));
        }
        let mut chosen: Vec<Candidate> = Vec::new();
        for i in order {
            if chosen.len() == config.candidates.div_ceil(2) || values[i] >= self.task.initial_objective() {
                break;
            }
            let steps = self.steps(&scanned[i].x, 0.5 * config.initial_step);
            if !chosen.iter().any(|c| is_near(&c.x, &scanned[i].x, &steps)) {
                chosen.push(self.candidate(scanned[i].x.clone(), f64::INFINITY));
            }
        }
        Ok(chosen)
    }

    /// Simplex searches over the first worlds from the best of the ranked candidates that differ; the worse half of the
    /// searches ends after each round. The points that were tried become candidates; their indices are returned.
    pub(crate) fn descend(
        &self,
        all: &mut Vec<Candidate>,
        ranked: &[usize],
        worlds: &DisturbedWorlds<'_>,
        searches: &Searches,
        trials: &mut Vec<Trial>,
    ) -> Result<Vec<usize>, PlanError> {
        let config = self.config;
        let settings = NelderMead { restarts: 0, ..config.nelder_mead };
        let mut begun: Vec<usize> = Vec::new();
        let mut running: Vec<LocalSearch> = Vec::new();
        for &i in ranked {
            let steps = self.steps(&all[i].x, 0.5 * config.initial_step);
            if running.len() == searches.starts {
                break;
            }
            if begun.iter().all(|&b| !is_near(&all[b].x, &all[i].x, &steps)) {
                begun.push(i);
                let start = [all[i].x.clone()];
                running.push(LocalSearch::new(&settings, &start, &steps, Some(self.statistic(&all[i]))));
            }
        }
        let first = all.len();
        let mut is_last = searches.starts <= searches.survivors;
        loop {
            for _ in 0..searches.points {
                let next: Vec<Option<Vec<f64>>> = running
                    .par_iter_mut()
                    .map(|search| self.counter.next_feasible(self.task, self.space, search))
                    .collect::<Result<_, _>>()?;
                let mut asked: Vec<(usize, usize)> = Vec::new();
                for (s, x) in next.into_iter().enumerate() {
                    if let Some(x) = x {
                        asked.push((s, all.len()));
                        all.push(self.candidate(x, f64::INFINITY));
                    }
                }
                if asked.is_empty() {
                    break;
                }
                let who: Vec<usize> = asked.iter().map(|a| a.1).collect();
                self.run(all, &who, worlds, 0..searches.worlds, trials)?;
                for (s, i) in asked {
                    running[s].tell(self.statistic(&all[i]));
                }
            }
            if is_last || running.is_empty() {
                break;
            }
            running.sort_by(|a, b| a.minimum().objective.total_cmp(&b.minimum().objective));
            running.truncate(running.len().div_ceil(2).max(searches.survivors));
            is_last = running.len() <= searches.survivors;
        }
        Ok((first..all.len()).collect())
    }

    /// The first `count` of ranked candidates that differ by more than a small step, and the nominally best of all.
    pub(crate) fn apart(&self, all: &[Candidate], ranked: &[usize], count: usize) -> Vec<usize> {
        let mut chosen: Vec<usize> = Vec::new();
        for &i in ranked {
            let steps = self.steps(&all[i].x, 0.1 * self.config.initial_step);
            let is_new = || !chosen.iter().any(|&c| is_near(&all[c].x, &all[i].x, &steps));
            if i == 0 || (chosen.len() < count && is_new()) {
                chosen.push(i);
            }
        }
        chosen
    }

    fn steps(&self, x: &[f64], share: f64) -> Vec<f64> {
        self.space.steps(share, self.space.is_promising(x))
    }

    /// What simplex searches minimise: infinite where a rollout is invalid.
    fn statistic(&self, c: &Candidate) -> f64 {
        let (invalid, value) = self.config.objective.rank(&c.outcomes);
        if invalid == 0 { value } else { f64::INFINITY }
    }
}
