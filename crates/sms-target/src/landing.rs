//! Executes a landing in a target world.

use crate::scene::carried;
use crate::{Target, TargetError, match_bodies, scene_from_truth};
use serde::{Deserialize, Serialize};
use sms_core::{CoreError, atomic};
use sms_landing::{
    LandingAction, LandingOutcome, LandingRecording, LandingWorld, ResolvedLanding, RolloutOptions,
};
use sms_scene::{BodyKind, Scene};
use sms_synth::TruthScene;
use sms_task::json;
use sms_wash::{SphSettings, WashModel, WashSettings};
use std::path::Path;

/// Name of an executed landing's file.
pub const LANDING_EXECUTION_FILE: &str = "landing_execution.json";

/// Settings of an executed landing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LandingTargetOptions {
    /// The planner's particle settings; the target uses [`SphSettings::independent`] ones.
    pub planner_sph: SphSettings,
    /// Whether to repeat the landing with the wash model `jet` in place of particles.
    pub second_opinion: bool,
    /// Recording of the motion; `None` keeps tables small.
    pub recording: Option<LandingRecording>,
    /// Ends the run as soon as the structure alone makes the objective this large: for tables of successes.
    pub enough: Option<f64>,
}

impl Default for LandingTargetOptions {
    fn default() -> Self {
        Self {
            planner_sph: SphSettings::default(),
            second_opinion: true,
            recording: Some(LandingRecording { every_s: 1.0 / 60.0, particles: false }),
            enough: None,
        }
    }
}

/// A landing executed in a target world.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LandingExecution {
    /// Engine of the target, with its label.
    pub engine: String,
    /// The executed action.
    pub action: LandingAction,
    /// Outcome with the wash of particles that are half the size of the planner's and differ in kernel, sound speed and
    /// pattern.
    pub outcome: LandingOutcome,
    /// Outcome with the wash of a turbulent jet.
    pub second_opinion: Option<LandingOutcome>,
    /// Planner's body name → target's body name, for the matched bodies.
    pub matches: Vec<(String, String)>,
}

impl LandingExecution {
    /// Writes [`LANDING_EXECUTION_FILE`] and `trajectory.parquet` into a folder.
    ///
    /// # Errors
    /// [`CoreError::Write`].
    pub fn save(&self, dir: &Path) -> Result<(), CoreError> {
        json::write(&dir.join(LANDING_EXECUTION_FILE), self)?;
        self.outcome.trajectory.write_parquet(&dir.join("trajectory.parquet"))
    }

    /// Reads [`LANDING_EXECUTION_FILE`] from a folder.
    ///
    /// # Errors
    /// [`CoreError::Read`] or [`CoreError::Input`] that names the file.
    pub fn load(dir: &Path) -> Result<Self, CoreError> {
        atomic::read_json(&dir.join(LANDING_EXECUTION_FILE))
    }
}

/// Flies a planned landing in the true scene: true shapes, masses and materials, the target's engine, and different
/// wash particles. The flight is fixed by the planner's scene, regardless of the true one. Every dynamic body of the
/// true scene must stay in place.
pub fn execute_landing(
    target: &dyn Target,
    landing: &ResolvedLanding,
    action: &LandingAction,
    planned_scene: &Scene,
    truth: &TruthScene,
    options: &LandingTargetOptions,
) -> Result<LandingExecution, TargetError> {
    let scene = carried(scene_from_truth(truth)?, &planned_scene.x_world_recording);
    let is_dynamic = |b: &&sms_scene::Body| b.kind == BodyKind::Dynamic;
    let structure: Vec<String> = scene.bodies.iter().filter(is_dynamic).map(|b| b.name.clone()).collect();
    let world_options = target.world_options(&landing.world_options());
    let rollout =
        RolloutOptions { recording: options.recording, enough: options.enough, ..RolloutOptions::default() };
    let fly = |wash: &WashSettings, rollout: &RolloutOptions| -> Result<LandingOutcome, TargetError> {
        let mut world =
            LandingWorld::new(target.factory(), &world_options, &scene, landing, &structure, wash)?;
        Ok(world.fly(action, rollout)?)
    };
    let particles = WashSettings {
        model: WashModel::Sph,
        sph: options.planner_sph.independent(),
        ..WashSettings::default()
    };
    let jet = WashSettings { model: WashModel::Jet, ..WashSettings::default() };
    Ok(LandingExecution {
        engine: target.label().to_owned(),
        action: *action,
        outcome: fly(&particles, &rollout)?,
        second_opinion: options
            .second_opinion
            .then(|| fly(&jet, &RolloutOptions { recording: None, ..rollout }))
            .transpose()?,
        matches: match_bodies(planned_scene, &scene),
    })
}
