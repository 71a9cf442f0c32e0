//! Executes a plan in a target world.

use crate::scene::carried;
use crate::{Target, match_bodies, scene_from_truth};
use glamx::DVec3;
use rand::RngExt;
use serde::{Deserialize, Serialize};
use sms_core::{ErrorKind, InertiaError, Seed, StageError};
use sms_robots::RobotConfig;
use sms_scene::{BodyKind, Scene};
use sms_sim::{ArmKind, SimError, Striker, WorldOptions};
use sms_synth::TruthScene;
use sms_task::{Action, Execution, MotionRecording, ResolvedTask, Rollout, Task, TaskError};

/// Settings of an execution.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TargetOptions {
    /// Number of reruns with perturbed start positions, for the chaos floor.
    pub chaos_runs: usize,
    /// Half width of these perturbations in x and y of every body, metres.
    pub chaos_m: f64,
    /// Time between recorded states, seconds.
    pub record_every_s: f64,
    /// Seed of the perturbations.
    pub seed: Seed,
    /// The striking robot and its base pose; without a base pose, a kinematic finger of infinite mass.
    pub robot: RobotConfig,
    /// Who simulates the arm's joints: our model, the same in every engine, or the engine.
    pub arm: ArmKind,
}

impl Default for TargetOptions {
    fn default() -> Self {
        Self {
            chaos_runs: 4,
            chaos_m: 1e-6,
            record_every_s: 1.0 / 120.0,
            seed: Seed(0),
            robot: RobotConfig::default(),
            arm: ArmKind::default(),
        }
    }
}

/// Errors of an execution.
#[derive(Debug, thiserror::Error)]
pub enum TargetError {
    /// The task does not fit the planner's scene.
    #[error(transparent)]
    Task(#[from] TaskError),
    /// The target's world could not be built, or it diverged.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// The landing cannot be flown.
    #[error(transparent)]
    Landing(#[from] sms_landing::LandingError),
    /// The ground truth has an impossible mass or inertia.
    #[error("the ground truth cannot be simulated: {0}")]
    Truth(#[from] InertiaError),
}

impl StageError for TargetError {
    fn kind(&self) -> ErrorKind<'_> {
        match self {
            Self::Task(e) => e.kind(),
            Self::Landing(e) => e.kind(),
            Self::Sim(_) | Self::Truth(_) => ErrorKind::Other,
        }
    }
}

/// Executes a planned action in the true scene, on a target.
///
/// The task is resolved in the *planner's* scene, which fixes the robot's motion in world coordinates. The robot
/// repeats this motion regardless of the true scene. The objective is measured on the true bodies that match the
/// planner's; without a match, on the true target ball or on the body of the same name.
pub fn execute(
    target: &dyn Target,
    task: &Task,
    action: &Action,
    planned_scene: &Scene,
    truth: &TruthScene,
    options: &TargetOptions,
) -> Result<Execution, TargetError> {
    let task =
        task.resolve(planned_scene)?.with_robot(&options.robot, planned_scene).map_err(TaskError::from)?;
    let striker = task.striker(&task.strike(action))?;
    // The ground truth is in the world of the recording, the plan in the aligned world.
    let true_scene = carried(scene_from_truth(truth)?, &planned_scene.x_world_recording);
    let matches = match_bodies(planned_scene, &true_scene);
    // Without a match, the target ball is the scene's target ball; other bodies keep their names.
    let called = |name: &str| match matches.iter().find(|(planned, _)| *planned == name) {
        Some((_, there)) => there.clone(),
        None if task.kind() == "billiards" => truth.target.clone(),
        None => name.to_owned(),
    };

    let run =
        |scene: &Scene, recording| rollout(target, &task, &striker, options.arm, scene, &called, recording);
    let recording = MotionRecording { every_s: options.record_every_s };
    let realised = run(&true_scene, Some(recording))?;
    let mut chaos_floor = 0.0f64;
    for index in 0..options.chaos_runs {
        let moved = run(&disturbed(&true_scene, options, index), None)?;
        chaos_floor = chaos_floor.max((moved.objective - realised.objective).abs());
    }
    Ok(Execution {
        engine: target.label().to_owned(),
        objective: realised.objective,
        objective_unit: task.objective_unit().to_owned(),
        success: task.is_success(realised.objective),
        chaos_floor,
        predicted: None,
        trajectory: realised.trajectory.unwrap_or_default(),
        matches,
    })
}

fn rollout(
    target: &dyn Target,
    task: &ResolvedTask,
    striker: &Striker,
    arm: ArmKind,
    scene: &Scene,
    called: &dyn Fn(&str) -> String,
    recording: Option<MotionRecording>,
) -> Result<Rollout, TargetError> {
    let bodies = task.bodies_called(scene, called)?;
    let mut simulation = target.simulation(scene, &WorldOptions { arm, ..task.world_options() })?;
    Ok(task.rollout(&mut simulation, striker, &bodies, recording)?)
}

/// Returns the scene of the chaos floor's run `index`: every dynamic body is moved by up to [`TargetOptions::chaos_m`]
/// along x and y.
pub fn disturbed(scene: &Scene, options: &TargetOptions, index: usize) -> Scene {
    let mut rng = options.seed.derive_index("chaos floor", index as u64).rng();
    let mut offset = || options.chaos_m * rng.random_range(-1.0..=1.0f64);
    let mut scene = scene.clone();
    for body in scene.bodies.iter_mut().filter(|b| b.kind == BodyKind::Dynamic) {
        body.x_wb.translation += DVec3::new(offset(), offset(), 0.0);
    }
    scene
}
