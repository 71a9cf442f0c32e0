//! Pools of perturbed worlds, the same for every action.

use crate::hard::PerturbedWorld;
use crate::{
    LandingAction, LandingError, LandingOutcome, LandingPrediction, LandingSettings, LandingWorld,
    ResolvedLanding, RolloutOptions,
};
use rayon::prelude::*;
use sms_core::{Cancel, Progress};
use sms_plan::quantile;
use sms_sim::WorldFactory;
use sms_wash::{WashModel, WashSettings};
use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// Score and failure of a rollout.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Flown {
    /// The capped objective; infinite if the simulation is invalid.
    pub(crate) score: f64,
    /// Kind of failure.
    pub(crate) failure: Option<&'static str>,
}

/// One perturbed world and its idle copies. Each thread that needs the world at the same time gets its own identical
/// copy.
struct WorldCopies {
    world: PerturbedWorld,
    idle: Mutex<Vec<LandingWorld>>,
}

/// Perturbed worlds with one wash model.
pub(crate) struct PerturbedLandings<'a> {
    landing: &'a ResolvedLanding,
    factory: &'a dyn WorldFactory,
    wash: WashSettings,
    enough: f64,
    worlds: Vec<WorldCopies>,
    progress: &'a dyn Progress,
    cancel: &'a Cancel,
    done: AtomicU64,
}

impl<'a> PerturbedLandings<'a> {
    pub(crate) fn new(
        landing: &'a ResolvedLanding,
        factory: &'a dyn WorldFactory,
        settings: &LandingSettings,
        wash: WashSettings,
        worlds: Vec<PerturbedWorld>,
        progress: &'a dyn Progress,
        cancel: &'a Cancel,
    ) -> Self {
        let shared = |world: PerturbedWorld| WorldCopies { world, idle: Mutex::default() };
        Self {
            landing,
            factory,
            wash,
            enough: settings.toppled,
            worlds: worlds.into_iter().map(shared).collect(),
            progress,
            cancel,
            done: AtomicU64::new(0),
        }
    }

    /// Returns the number of worlds.
    pub(crate) fn len(&self) -> usize {
        self.worlds.len()
    }

    pub(crate) fn model(&self) -> WashModel {
        self.wash.model
    }

    /// Flies actions in worlds in parallel. The results are in the order of the jobs.
    pub(crate) fn fly_all(&self, jobs: &[(LandingAction, usize)]) -> Result<Vec<Flown>, LandingError> {
        jobs.par_iter()
            .map(|(action, world)| {
                self.cancel.check()?;
                let options = RolloutOptions { enough: Some(self.enough), ..RolloutOptions::default() };
                let outcome = self.fly_in(*world, action, &options)?;
                let done = self.done.fetch_add(1, Ordering::SeqCst) + 1;
                self.progress.update(done, "landings simulated");
                Ok(Flown {
                    score: outcome.score(self.enough),
                    failure: outcome.failure.as_ref().map(|f| f.as_str()),
                })
            })
            .collect()
    }

    /// Flies one action in one of the worlds, with that world's execution errors.
    pub(crate) fn fly_in(
        &self,
        world: usize,
        action: &LandingAction,
        options: &RolloutOptions,
    ) -> Result<LandingOutcome, LandingError> {
        let shared = &self.worlds[world];
        let idle = shared.idle.lock().ok().and_then(|mut idle| idle.pop());
        let mut own = match idle {
            Some(own) => own,
            None => LandingWorld::new(
                self.factory,
                &self.landing.world_options(),
                &shared.world.scene,
                self.landing,
                self.landing.structure(),
                &self.wash,
            )?,
        };
        let options = RolloutOptions { carried_out: shared.world.carried_out, ..*options };
        let outcome = own.fly(action, &options)?;
        if own.is_reusable()
            && let Ok(mut idle) = shared.idle.lock()
        {
            idle.push(own);
        }
        Ok(outcome)
    }
}

impl LandingPrediction {
    /// Summarises the outcomes of one action in several worlds.
    pub(crate) fn of(wash: WashModel, row: &[Flown]) -> Self {
        let scores: Vec<f64> = row.iter().map(|f| f.score).filter(|s| s.is_finite()).collect();
        let mut failures: BTreeMap<&'static str, usize> = BTreeMap::new();
        for kind in row.iter().filter_map(|f| f.failure) {
            *failures.entry(kind).or_default() += 1;
        }
        let mut failures: Vec<(String, usize)> =
            failures.into_iter().map(|(kind, n)| (kind.to_owned(), n)).collect();
        failures.sort_by(|a, b| b.1.cmp(&a.1).then_with(|| a.0.cmp(&b.0)));
        let mean =
            if scores.is_empty() { f64::INFINITY } else { scores.iter().sum::<f64>() / scores.len() as f64 };
        Self {
            wash,
            worlds: row.len(),
            invalid: row.len() - scores.len(),
            success_share: row.iter().filter(|f| f.failure.is_none()).count() as f64
                / row.len().max(1) as f64,
            mean,
            q10: quantile(&scores, 0.1),
            q50: quantile(&scores, 0.5),
            q90: quantile(&scores, 0.9),
            failures,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn predictions_count_failures_and_leave_out_what_cannot_be_believed() {
        let flown = |score: f64, failure| Flown { score, failure };
        let row = [
            flown(0.01, None),
            flown(0.03, None),
            flown(1.0, Some("moved")),
            flown(f64::INFINITY, Some("invalid")),
            flown(1.0, Some("moved")),
        ];
        let p = LandingPrediction::of(WashModel::Jet, &row);
        assert_eq!((p.worlds, p.invalid, p.success_share), (5, 1, 0.4));
        assert!((p.mean - 0.51).abs() < 1e-12);
        assert_eq!(p.failures, [("moved".to_owned(), 2), ("invalid".to_owned(), 1)]);
    }
}
