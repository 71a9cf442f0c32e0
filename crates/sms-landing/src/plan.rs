//! The plan of a landing and its files.

use crate::{LandingAction, LandingOutcome, LandingSurface, LandingTask, ResolvedLanding};
use serde::{Deserialize, Serialize};
use sms_core::{CoreError, MassProperties, Material, atomic};
use sms_plan::Trial;
use sms_robots::Quadrotor;
use sms_scene::{Body, BodyKind, Scene};
use sms_task::{Parameter, json};
use sms_wash::{WashModel, WashSettings};
use std::path::Path;

/// Name of the plan's file in the stage's folder of a run.
pub const LANDING_PLAN_FILE: &str = "landing.json";

/// Predicted outcome of an action over perturbed worlds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LandingPrediction {
    /// Wash model.
    pub wash: WashModel,
    /// Number of worlds.
    pub worlds: usize,
    /// Number of invalid rollouts; they count as failures, and the mean and the quantiles omit them.
    pub invalid: usize,
    /// Share of the worlds in which the landing succeeds.
    pub success_share: f64,
    /// Mean of the objective, capped at [`crate::LandingSettings::toppled`].
    pub mean: f64,
    /// 10 % quantile of the objective.
    pub q10: f64,
    /// Median of the objective.
    pub q50: f64,
    /// 90 % quantile of the objective.
    pub q90: f64,
    /// Kinds of failure ([`crate::LandingFailure::as_str`]) with their numbers of worlds.
    pub failures: Vec<(String, usize)>,
}

/// Another action that reached the last phase of the search.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LandingAlternative {
    /// The action.
    pub action: LandingAction,
    /// Its objective in the scanned world with `sph`; `None` if that rollout is invalid.
    pub objective: Option<f64>,
    /// Its outcome in the hard worlds in which it was compared with the others: a pessimistic prediction.
    pub prediction: Option<LandingPrediction>,
}

/// Number of rollouts of a plan per wash model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct LandingEvaluations {
    /// Rollouts with `jet`.
    pub jet: usize,
    /// Rollouts with `sph`.
    pub sph: usize,
    /// Invalid rollouts of both models.
    pub invalid: usize,
}

/// Mass and material of a body in the planner's scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlannedBody {
    /// Name of the body.
    pub name: String,
    /// Its mass properties; `None` for a fixed body.
    pub mass: Option<MassProperties>,
    /// Its material.
    pub material: Material,
}

impl PlannedBody {
    /// Lists the bodies of a scene.
    pub fn all_of(scene: &Scene) -> Vec<Self> {
        let of = |b: &Body| Self {
            name: b.name.clone(),
            mass: b.mass.filter(|_| b.kind == BodyKind::Dynamic),
            material: b.material.clone(),
        };
        scene.bodies.iter().map(of).collect()
    }
}

/// The chosen landing and its predicted outcome.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LandingPlan {
    /// The task with all its settings, defaults included.
    pub task: LandingTask,
    /// Engine of the planner's rollouts.
    pub engine: String,
    /// The vehicle.
    pub vehicle: Quadrotor,
    /// The surface to land on.
    pub surface: LandingSurface,
    /// Names of the bodies that must stay in place.
    pub structure: Vec<String>,
    /// Ranges of the action's values, in the order of [`LandingAction::values`].
    pub parameters: Vec<Parameter>,
    /// The chosen action.
    pub action: LandingAction,
    /// The bodies of the world in which it was planned. They differ from the scene's if the planner freed fixed bodies
    /// or needed other masses than the most likely ones. Empty in older plans.
    #[serde(default)]
    pub bodies: Vec<PlannedBody>,
    /// Its outcome in the scanned world, with the recorded motion.
    pub nominal: LandingOutcome,
    /// Wash settings of the nominal rollout.
    #[serde(default = "particles")]
    pub wash: WashSettings,
    /// Predicted outcome in worlds that were not used for the choice; `None` for a plan in the scanned world alone.
    pub predicted: Option<LandingPrediction>,
    /// The other finalists, best first.
    pub alternatives: Vec<LandingAlternative>,
    /// Numbers of rollouts.
    pub evaluations: LandingEvaluations,
}

/// Wash settings of plans that have none.
fn particles() -> WashSettings {
    WashSettings { model: WashModel::Sph, ..WashSettings::default() }
}

/// A plan and its trial log.
#[derive(Debug, Clone, PartialEq)]
pub struct LandingPlanOutcome {
    /// The plan.
    pub plan: LandingPlan,
    /// Every rollout, in an order that does not depend on threads.
    pub trials: Vec<Trial>,
}

impl LandingPlan {
    /// Writes [`LANDING_PLAN_FILE`] into a folder.
    ///
    /// # Errors
    /// [`CoreError::Write`].
    pub fn save(&self, dir: &Path) -> Result<(), CoreError> {
        json::write(&dir.join(LANDING_PLAN_FILE), self)
    }

    /// Reads [`LANDING_PLAN_FILE`] from a folder.
    ///
    /// # Errors
    /// [`CoreError::Read`] or [`CoreError::Input`] that names the file.
    pub fn load(dir: &Path) -> Result<Self, CoreError> {
        atomic::read_json(&dir.join(LANDING_PLAN_FILE))
    }

    /// Returns the scene with the masses, materials and body kinds with which it was planned.
    pub fn world(&self, scene: &Scene) -> Scene {
        let mut world = scene.clone();
        for planned in &self.bodies {
            if let Some(i) = world.body_index(&planned.name) {
                let body = &mut world.bodies[i];
                body.kind = if planned.mass.is_some() { BodyKind::Dynamic } else { BodyKind::Static };
                body.mass = planned.mass;
                body.material = planned.material.clone();
            }
        }
        world
    }

    /// Returns the resolved task with the planned surface, independently of the current scene.
    pub fn landing(&self) -> ResolvedLanding {
        ResolvedLanding::of(
            self.task.clone(),
            self.vehicle.clone(),
            self.surface.clone(),
            self.structure.clone(),
        )
    }
}
