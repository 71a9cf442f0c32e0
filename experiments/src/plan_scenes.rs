//! The scenes on which the planner is measured.

use crate::{BenchError, MaterialPrior, apply_material_prior};
use serde::{Deserialize, Serialize};
use sms_core::{InputError, Seed};
use sms_plan::PlanError;
use sms_robots::RobotConfig;
use sms_scene::Scene;
use sms_synth::{BilliardsSettings, FIXED_SCENES, FixedScene, TruthScene, generate_billiards};
use sms_target::{robot_of, scene_from_truth};
use sms_task::{Billiards, ResolvedTask, Selector, Task};

/// Seeds for tuning the planner; seeds below 1000 are held back for the final tables.
pub const TUNING_SEEDS: std::ops::RangeInclusive<u64> = 1001..=1012;

/// Family of the generated scenes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SceneFamily {
    /// The paper's: both corridors free, cut of at most 35°.
    Open,
    /// Nine obstacles, corridors not kept free, cut of up to 75°.
    Crowded,
    /// The eighteen of the billiards experiment, by their numbers.
    Fixed,
}

impl SceneFamily {
    /// The scene of a seed; of the fixed ones, of a number.
    ///
    /// # Errors
    /// [`InputError`] where no fixed scene has the number.
    pub fn generate(self, seed: u64) -> Result<TruthScene, InputError> {
        let settings = match self {
            Self::Open => BilliardsSettings::default(),
            Self::Crowded => BilliardsSettings {
                objects: 9,
                corridor_half_width_m: 0.0,
                max_cut_angle: 75f64.to_radians(),
                ..BilliardsSettings::default()
            },
            Self::Fixed => {
                let fixed = seed.checked_sub(1).and_then(|i| FIXED_SCENES.get(usize::try_from(i).ok()?));
                return fixed.map(FixedScene::generate).ok_or_else(|| {
                    InputError::new(
                        format!("there is no fixed scene {seed}"),
                        "--seeds",
                        format!("give numbers from 1 to {}", FIXED_SCENES.len()),
                    )
                });
            }
        };
        Ok(generate_billiards(Seed(seed), &settings))
    }
}

/// A task in the true geometry of a generated scene, as from a perfect scan.
#[derive(Debug, Clone)]
pub struct PlanScene {
    /// Seed of the scene.
    pub seed: u64,
    /// The planner's scene.
    pub scene: Scene,
    /// The truth; the planner never reads it.
    pub truth: TruthScene,
    /// Its task, executed by a kinematic finger.
    pub task: ResolvedTask,
    /// The robot in front of it.
    pub robot: RobotConfig,
}

impl PlanScene {
    /// Generates the scene of a seed, with the true materials.
    ///
    /// # Errors
    /// [`BenchError`] when the generator's masses or task are impossible.
    pub fn new(family: SceneFamily, seed: u64) -> Result<Self, BenchError> {
        Self::with_prior(family, seed, MaterialPrior::Truth)
    }

    /// Generates the scene of a seed, with a material prior.
    ///
    /// # Errors
    /// As [`PlanScene::new`].
    pub fn with_prior(
        family: SceneFamily,
        seed: u64,
        material_prior: MaterialPrior,
    ) -> Result<Self, BenchError> {
        let truth = family.generate(seed)?;
        let mut scene = true_scene(&truth, seed)?;
        apply_material_prior(&mut scene, &truth, material_prior, Seed(seed));
        let (cue, target) = (Selector::by_name(&truth.cue), Selector::by_name(&truth.target));
        let task = Task::Billiards(Billiards::new(cue, target, truth.goal_w));
        let task = task.resolve(&scene).map_err(PlanError::from)?;
        Ok(Self { seed, robot: robot_of(&truth), scene, truth, task })
    }

    /// The task, executed by the arm.
    ///
    /// # Errors
    /// [`BenchError`] of the robot's description.
    pub fn arm_task(&self) -> Result<ResolvedTask, BenchError> {
        Ok(self.task.clone().with_robot(&self.robot, &self.scene)?)
    }
}

/// The truth as a scene.
pub(crate) fn true_scene(truth: &TruthScene, seed: u64) -> Result<Scene, BenchError> {
    Ok(scene_from_truth(truth).map_err(|e| {
        InputError::new(
            format!("the scene cannot be simulated: {e}"),
            format!("seed {seed}"),
            "use another seed",
        )
    })?)
}
