//! Scan of the perturbed worlds, and simplex searches over them.

use crate::candidate::RobustCandidate;
use crate::robust::RobustChoice;
use crate::screening::points;
use crate::space::is_near;
use crate::worlds::PerturbedWorlds;
use crate::{LocalSearch, NelderMead, PlanError, Trial, TrialPhase};
use rayon::prelude::*;
use sms_core::Seed;

/// Settings of parallel simplex searches.
pub(crate) struct Searches {
    /// Searches of the first round.
    pub(crate) starts: usize,
    /// Searches of the last round.
    pub(crate) survivors: usize,
    /// Points per search and round; the worse half of the searches ends after a round.
    pub(crate) points: usize,
    /// Number of worlds in the objective.
    pub(crate) worlds: usize,
}

impl RobustChoice<'_> {
    /// Tries feasible points spread over all actions, each in one of the perturbed worlds in turn. Returns the best
    /// distinct ones, half the number of candidates, without their outcomes, which are biased by the selection.
    pub(crate) fn scan(
        &self,
        worlds: &PerturbedWorlds<'_>,
        seed: Seed,
        trials: &mut Vec<Trial>,
    ) -> Result<Vec<RobustCandidate>, PlanError> {
        let config = self.session.config;
        let scanned = points(&self.session.space, config.suggestions, seed, config.scan, &|x| {
            self.session.is_feasible(x)
        })?;
        let jobs: Vec<_> = scanned
            .iter()
            .enumerate()
            .map(|(i, s)| (i % worlds.len(), self.session.space.action(&s.x)))
            .collect();
        let values = worlds.each(&jobs)?;
        let mut order: Vec<usize> = (0..scanned.len()).filter(|&i| values[i].is_finite()).collect();
        order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
        for ((world, action), &objective) in jobs.into_iter().zip(&values) {
            trials.push(Trial::new(TrialPhase::Perturbed, -1, world as i32, action, objective));
        }
        let mut chosen: Vec<RobustCandidate> = Vec::new();
        for i in order {
            if chosen.len() == config.candidates.div_ceil(2)
                || values[i] >= self.session.task.initial_objective()
            {
                break;
            }
            let steps = self.steps(&scanned[i].x, 0.5 * config.initial_step);
            if !chosen.iter().any(|c| is_near(&c.x, &scanned[i].x, &steps)) {
                chosen.push(self.candidate(scanned[i].x.clone(), f64::INFINITY));
            }
        }
        Ok(chosen)
    }

    /// Runs simplex searches over the first worlds from the best distinct candidates. The worse half of the searches
    /// ends after each round. All points become candidates; their indices are returned.
    pub(crate) fn descend(
        &self,
        all: &mut Vec<RobustCandidate>,
        ranked: &[usize],
        worlds: &PerturbedWorlds<'_>,
        searches: &Searches,
        trials: &mut Vec<Trial>,
    ) -> Result<Vec<usize>, PlanError> {
        let config = self.session.config;
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
                    .map(|search| self.session.next_feasible(search))
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

    /// The first `count` ranked candidates that differ by more than a small step, and the nominally best of all.
    pub(crate) fn apart(&self, all: &[RobustCandidate], ranked: &[usize], count: usize) -> Vec<usize> {
        let mut chosen: Vec<usize> = Vec::new();
        for &i in ranked {
            let steps = self.steps(&all[i].x, 0.1 * self.session.config.initial_step);
            let is_new = || !chosen.iter().any(|&c| is_near(&all[c].x, &all[i].x, &steps));
            if i == 0 || (chosen.len() < count && is_new()) {
                chosen.push(i);
            }
        }
        chosen
    }

    fn steps(&self, x: &[f64], share: f64) -> Vec<f64> {
        self.session.space.steps(share, self.session.space.is_promising(x))
    }

    /// The objective of the simplex searches; infinite if any rollout is invalid.
    fn statistic(&self, c: &RobustCandidate) -> f64 {
        let (invalid, value) = self.session.config.objective.rank(&c.outcomes);
        if invalid == 0 { value } else { f64::INFINITY }
    }
}
