//! Sensitivity analysis of the chosen action.

use crate::candidate::RobustCandidate;
use crate::session::Session;
use crate::worlds::{PerturbedWorlds, Worlds};
use crate::{BodyProperty, PlanError, Sensitivity, Trial, TrialPhase, Unknown};
use rayon::prelude::*;
use sms_scene::BodyKind;
use sms_sim::BodyId;
use sms_task::Rollout;
use std::borrow::Cow;
use std::collections::BTreeSet;

/// Largest number of worlds per unknown.
const MOST_WORLDS: usize = 16;
/// Smallest number of worlds per unknown that gives an estimate.
const LEAST_WORLDS: usize = 4;
/// Limits for separating material properties: largest number of materials, smallest share of a material, and largest
/// number of worlds.
const MOST_REFINED: usize = 2;
const REFINED_SHARE: f64 = 0.1;
const REFINED_WORLDS: usize = 8;

/// The analysis of one chosen action.
pub(crate) struct SensitivityAnalysis<'a> {
    pub(crate) session: &'a Session<'a>,
    pub(crate) winner: &'a RobustCandidate,
    /// Bodies that the shot touches in the scanned world or in a forecast world.
    pub(crate) touched: &'a BTreeSet<BodyId>,
}

impl SensitivityAnalysis<'_> {
    /// Perturbs one unknown at a time and measures the change of the objective (one-at-a-time analysis, without
    /// interactions). Skips unknowns of bodies that the shot never touches. Returns the most important first.
    pub(crate) fn sense(
        &self,
        nominal: &Rollout,
        trials: &mut Vec<Trial>,
    ) -> Result<Vec<Sensitivity>, PlanError> {
        let d = &self.session.config.perturbation;
        let mut unknowns = d.unknowns(self.session.scene);
        unknowns.retain(|u| match u {
            Unknown::Material { body } | Unknown::Pose { body } | Unknown::Radius { body } => {
                self.is_involved(body)
            }
            Unknown::Scale | Unknown::Execution => true,
        });
        let each = (self.session.config.sensitivity_rollouts / unknowns.len().max(1)).min(MOST_WORLDS);
        if each < LEAST_WORLDS {
            return Ok(Vec::new());
        }
        let mut squares = Vec::new();
        for (k, unknown) in unknowns.iter().enumerate() {
            let seed = self.session.seed.derive("sensitivity");
            let which = |u: &Unknown| u == unknown;
            let worlds = PerturbedWorlds::new(self.session, seed, 0..each, &which)?;
            let action = std::slice::from_ref(&self.winner.action);
            let row = worlds.objectives(action, 0..each)?.remove(0);
            trials.extend(Trial::row(TrialPhase::Sensitivity, k, 0, &self.winner.action, &row));
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
        let mut start = found.len();
        let materials = found.iter_mut().filter(|s| s.share >= REFINED_SHARE);
        let materials = materials.filter_map(|s| match s.unknown.clone() {
            Unknown::Material { body } => Some((body, s)),
            _ => None,
        });
        for (body, s) in materials.take(MOST_REFINED) {
            s.property = self.property_of(&body, each.min(REFINED_WORLDS), nominal, start, trials)?;
            start += BodyProperty::ALL.len();
        }
        Ok(found)
    }

    /// The property of a body with the largest effect, each perturbed as in the analysis of the whole material.
    fn property_of(
        &self,
        name: &str,
        each: usize,
        nominal: &Rollout,
        start: usize,
        trials: &mut Vec<Trial>,
    ) -> Result<Option<BodyProperty>, PlanError> {
        let d = &self.session.config.perturbation;
        let (seed, action) = (self.session.seed.derive("sensitivity"), &self.winner.action);
        let Some(index) = self.session.scene.body_index(name) else { return Ok(None) };
        let material = |u: &Unknown| matches!(u, Unknown::Material { body } if body == name);
        let bare = self.session.scene.without_pictures();
        let mut most: Option<(f64, BodyProperty)> = None;
        for (k, property) in BodyProperty::ALL.into_iter().enumerate() {
            let row: Vec<f64> = (0..each)
                .into_par_iter()
                .map(|w| {
                    let all = d.scene_of(&bare, seed, w, &material);
                    let mut scene = bare.clone();
                    property.copy(&all.bodies[index], &mut scene.bodies[index]);
                    let world = Worlds::new(self.session.task, Cow::Owned(scene), self.session.factory)?;
                    self.session.counter.count(|| world.objective(&self.session.task.strike(action)))
                })
                .collect::<Result<_, PlanError>>()?;
            trials.extend(Trial::row(TrialPhase::Sensitivity, start + k, 0, action, &row));
            let valid = row.iter().filter(|v| v.is_finite());
            let square: f64 = valid.map(|v| (v - nominal.objective).powi(2)).sum();
            if square > most.map_or(0.0, |m| m.0) {
                most = Some((square, property));
            }
        }
        Ok(most.map(|m| m.1))
    }

    /// Returns whether a body is the struck or the target body, is static, or has contacts in the shot.
    fn is_involved(&self, name: &str) -> bool {
        let Some(index) = self.session.scene.body_index(name) else { return false };
        let is_fixed = self.session.scene.bodies[index].kind == BodyKind::Static;
        is_fixed
            || self.touched.contains(&index)
            || index == self.session.task.cue().index
            || index == self.session.task.target().index
    }
}
