//! Which unknown matters most for the chosen action.

use crate::robust::Candidate;
use crate::worlds::{Counter, DisturbedWorlds, Worlds};
use crate::{BodyProperty, Phase, PlanConfig, PlanError, Trial, Unknown};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sms_core::Seed;
use sms_scene::{BodyKind, Scene};
use sms_sim::{BodyId, WorldFactory};
use sms_task::{ResolvedTask, Rollout};
use std::borrow::Cow;
use std::collections::BTreeSet;

/// Most worlds per unknown.
const MOST_WORLDS: usize = 16;
/// Fewer worlds per unknown say nothing.
const LEAST_WORLDS: usize = 4;
/// Materials whose properties are told apart: at most so many, from this share on, in at most so many worlds.
const MOST_REFINED: usize = 2;
const REFINED_SHARE: f64 = 0.1;
const REFINED_WORLDS: usize = 8;

/// How much one unknown matters for the chosen action.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sensitivity {
    /// The unknown.
    pub unknown: Unknown,
    /// Root mean square of how much the objective changes when it alone is disturbed, in the task's unit.
    pub change: f64,
    /// Its share of the sum of the mean squares over all unknowns.
    pub share: f64,
    /// Of a material that matters much, the property that matters most when it alone is disturbed.
    #[serde(default)]
    pub property: Option<BodyProperty>,
}

impl std::fmt::Display for Sensitivity {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.unknown)?;
        self.property.map_or(Ok(()), |p| write!(f, ", mostly its {}", p.as_str()))
    }
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
                property: None,
            })
            .collect();
        found.sort_by(|a, b| b.share.total_cmp(&a.share));
        let mut start = found.len() as i32;
        let materials = found.iter_mut().filter(|s| s.share >= REFINED_SHARE);
        let materials = materials.filter_map(|s| match s.unknown.clone() {
            Unknown::Material { body } => Some((body, s)),
            _ => None,
        });
        for (body, s) in materials.take(MOST_REFINED) {
            s.property = self.property_of(&body, each.min(REFINED_WORLDS), nominal, start, trials)?;
            start += BodyProperty::ALL.len() as i32;
        }
        Ok(found)
    }

    /// The property of a body that matters most. Each is disturbed as it is together with the others.
    fn property_of(
        &self,
        name: &str,
        each: usize,
        nominal: &Rollout,
        start: i32,
        trials: &mut Vec<Trial>,
    ) -> Result<Option<BodyProperty>, PlanError> {
        let d = &self.config.disturbances;
        let (seed, action) = (self.seed.derive("sensitivity"), &self.winner.action);
        let Some(index) = self.scene.body_index(name) else { return Ok(None) };
        let material = |u: &Unknown| matches!(u, Unknown::Material { body } if body == name);
        let bare = self.scene.without_pictures();
        let mut most: Option<(f64, BodyProperty)> = None;
        for (k, property) in BodyProperty::ALL.into_iter().enumerate() {
            let row: Vec<f64> = (0..each)
                .into_par_iter()
                .map(|w| {
                    let all = d.scene_of(&bare, seed, w, &material);
                    let mut scene = bare.clone();
                    property.copy(&all.bodies[index], &mut scene.bodies[index]);
                    let world = Worlds::new(self.task, Cow::Owned(scene), self.factory)?;
                    self.counter.count(|| world.objective(&self.task.strike(action)))
                })
                .collect::<Result<_, PlanError>>()?;
            for (w, &objective) in row.iter().enumerate() {
                let start = start + k as i32;
                trials.push(Trial::new(Phase::Sensitivity, start, w as i32, action.clone(), objective));
            }
            let valid = row.iter().filter(|v| v.is_finite());
            let square: f64 = valid.map(|v| (v - nominal.objective).powi(2)).sum();
            if square > most.map_or(0.0, |m| m.0) {
                most = Some((square, property));
            }
        }
        Ok(most.map(|m| m.1))
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
