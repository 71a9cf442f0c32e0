//! Which unknown matters most for the chosen action.

use crate::robust::Candidate;
use crate::worlds::{Counter, DisturbedWorlds};
use crate::{Phase, PlanConfig, PlanError, Trial, Unknown};
use serde::{Deserialize, Serialize};
use sms_core::Seed;
use sms_scene::{BodyKind, Scene};
use sms_sim::{BodyId, WorldFactory};
use sms_task::{ResolvedTask, Rollout};
use std::collections::BTreeSet;

/// Most worlds per unknown.
const MOST_WORLDS: usize = 16;
/// Fewer worlds per unknown say nothing.
const LEAST_WORLDS: usize = 4;

/// How much one unknown matters for the chosen action.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sensitivity {
    /// The unknown.
    pub unknown: Unknown,
    /// Root mean square of how much the objective changes when it alone is disturbed, in the task's unit.
    pub change: f64,
    /// Its share of the sum of the mean squares over all unknowns.
    pub share: f64,
}

/// What finding it out needs.
pub(crate) struct Sensing<'a> {
    pub(crate) task: &'a ResolvedTask,
    pub(crate) scene: &'a Scene,
    pub(crate) factory: &'a dyn WorldFactory,
    pub(crate) config: &'a PlanConfig,
    pub(crate) seed: Seed,
    pub(crate) counter: &'a Counter<'a>,
    pub(crate) winner: &'a Candidate,
    /// Bodies that the shot touches, in the scanned world or in one of those of the forecast.
    pub(crate) touched: &'a BTreeSet<BodyId>,
}

impl Sensing<'_> {
    /// Disturbs one unknown at a time, and looks at how the objective changes (one-at-a-time analysis: interactions are
    /// left out). Unknowns of bodies that the shot touches neither in the scanned world nor in one of those of the
    /// forecast are taken not to matter. Most important first.
    pub(crate) fn sense(
        &self,
        nominal: &Rollout,
        trials: &mut Vec<Trial>,
    ) -> Result<Vec<Sensitivity>, PlanError> {
        let d = &self.config.disturbances;
        let mut unknowns = d.unknowns(self.scene);
        unknowns.retain(|u| match u {
            Unknown::Material { body } | Unknown::Pose { body } | Unknown::Radius { body } => {
                self.is_involved(body)
            }
            Unknown::Execution => true,
        });
        let each = (self.config.sensitivity_rollouts / unknowns.len().max(1)).min(MOST_WORLDS);
        if each < LEAST_WORLDS {
            return Ok(Vec::new());
        }
        let mut squares = Vec::new();
        for (k, unknown) in unknowns.iter().enumerate() {
            let seed = self.seed.derive("sensitivity");
            let which = |u: &Unknown| u == unknown;
            let worlds = DisturbedWorlds::new(self.task, self.scene, self.factory, d, seed, 0..each, &which)?;
            let action = std::slice::from_ref(&self.winner.action);
            let row = worlds.objectives(action, 0..each, self.counter)?.remove(0);
            for (w, &objective) in row.iter().enumerate() {
                let action = self.winner.action.clone();
                trials.push(Trial::new(Phase::Sensitivity, k as i32, w as i32, action, objective));
            }
            let valid: Vec<f64> = row.into_iter().filter(|v| v.is_finite()).collect();
            let sum: f64 = valid.iter().map(|v| (v - nominal.objective).powi(2)).sum();
            squares.push(sum / valid.len().max(1) as f64);
        }
        let all: f64 = squares.iter().sum();
        let mut found: Vec<Sensitivity> = unknowns
            .into_iter()
            .zip(squares)
            .map(|(unknown, square)| Sensitivity {
                unknown,
                change: square.sqrt(),
                share: if all > 0.0 { square / all } else { 0.0 },
            })
            .collect();
        found.sort_by(|a, b| b.share.total_cmp(&a.share));
        Ok(found)
    }

    /// Whether the shot has to do with a body: struck and target body, what is fixed, and what touches something.
    fn is_involved(&self, name: &str) -> bool {
        let Some(index) = self.scene.body_index(name) else { return false };
        let is_fixed = self.scene.bodies[index].kind == BodyKind::Static;
        is_fixed
            || self.touched.contains(&index)
            || index == self.task.cue().index
            || index == self.task.target().index
    }
}
