//! What planning gives.

use crate::{LandingAction, LandingOutcome, LandingSurface, LandingTask, ResolvedLanding};
use serde::{Deserialize, Serialize};
use sms_core::{CoreError, MassProperties, Material, atomic};
use sms_plan::Trial;
use sms_robots::Quadrotor;
use sms_scene::{Body, BodyKind, Scene};
use sms_task::{Parameter, json};
use sms_wash::{WashModel, WashSettings};
use std::path::Path;

/// Where the plan lies in a run's folder of the stage.
pub const LANDING_PLAN_FILE: &str = "landing.json";

/// What is predicted of an action over worlds that differ within what is known.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LandingPrediction {
    /// Model of wash.
    pub wash: WashModel,
    /// Number of worlds.
    pub worlds: usize,
    /// Rollouts among them that cannot be believed; they are failures and in none of the figures below.
    pub invalid: usize,
    /// Share of the worlds in which the landing succeeds.
    pub success_share: f64,
    /// Mean of the objective (what has toppled counts as [`crate::LandingSettings::toppled`]).
    pub mean: f64,
    /// 10 % quantile.
    pub q10: f64,
    /// Median.
    pub q50: f64,
    /// 90 % quantile.
    pub q90: f64,
    /// Why it fails where it does: the kind of failure ([`crate::LandingFailure::as_str`]) with the number of worlds.
    pub failures: Vec<(String, usize)>,
}

/// Another action that was looked at to the end.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LandingAlternative {
    /// The action.
    pub action: LandingAction,
    /// Its objective in the scanned world, by the better model of wash; `None` where that rollout cannot be believed.
    pub objective: Option<f64>,
    /// What becomes of it in the worlds in which it was chosen or dropped, which are hard ones: less than what is to be expected.
    pub prediction: Option<LandingPrediction>,
}

/// How many rollouts of each model a plan took.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct LandingEvaluations {
    /// With `jet`.
    pub jet: usize,
    /// With `sph`.
    pub sph: usize,
    /// Of all, those that cannot be believed.
    pub invalid: usize,
}

/// A body as the planner had it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlannedBody {
    /// Its name.
    pub name: String,
    /// Its mass properties; `None` of what could not move.
    pub mass: Option<MassProperties>,
    /// What it is made of.
    pub material: Material,
}

impl PlannedBody {
    /// The bodies of a scene.
    pub fn all_of(scene: &Scene) -> Vec<Self> {
        let of = |b: &Body| Self {
            name: b.name.clone(),
            mass: b.mass.filter(|_| b.kind == BodyKind::Dynamic),
            material: b.material.clone(),
        };
        scene.bodies.iter().map(of).collect()
    }
}

/// The chosen landing with what it is predicted to do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LandingPlan {
    /// The task, with every setting that was in force.
    pub task: LandingTask,
    /// Engine that predicted.
    pub engine: String,
    /// The vehicle.
    pub vehicle: Quadrotor,
    /// Where it lands.
    pub surface: LandingSurface,
    /// The bodies that must stay.
    pub structure: Vec<String>,
    /// Ranges of the action's values, in the order of [`LandingAction::values`].
    pub parameters: Vec<Parameter>,
    /// The chosen action.
    pub action: LandingAction,
    /// The bodies of the world that it was planned in: of what was fixed and freed, or stands only with other masses than the most
    /// likely ones, the scene says otherwise. Empty in plans that do not say.
    #[serde(default)]
    pub bodies: Vec<PlannedBody>,
    /// What it does in the scanned world, with the recorded motion.
    pub nominal: LandingOutcome,
    /// The air that this was simulated in, to do so again.
    #[serde(default = "particles")]
    pub wash: WashSettings,
    /// What it is predicted to do in worlds that played no part in choosing it; `None` for a plan for the scanned world alone.
    pub predicted: Option<LandingPrediction>,
    /// Other actions that came far, best first.
    pub alternatives: Vec<LandingAlternative>,
    /// Rollouts.
    pub evaluations: LandingEvaluations,
}

/// Of plans that do not say.
fn particles() -> WashSettings {
    WashSettings { model: WashModel::Sph, ..WashSettings::default() }
}

/// A plan with its trial log.
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

    /// Reads it.
    ///
    /// # Errors
    /// [`CoreError::Read`] or [`CoreError::Input`] that names the file.
    pub fn load(dir: &Path) -> Result<Self, CoreError> {
        atomic::read_json(&dir.join(LANDING_PLAN_FILE))
    }

    /// The world that it was planned in: the scene with masses and materials, and what could move, as they were there.
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

    /// The task as it was planned, to fly it again: the same surface, whatever the scene looks like now.
    pub fn landing(&self) -> ResolvedLanding {
        ResolvedLanding::of(
            self.task.clone(),
            self.vehicle.clone(),
            self.surface.clone(),
            self.structure.clone(),
        )
    }
}
