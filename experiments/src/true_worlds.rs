//! Worlds in which a plan may really have to work.

use crate::plan_scenes::true_scene;
use crate::redrawn::redraw_materials;
use crate::{BenchError, PlanScene};
use rayon::prelude::*;
use sms_core::{Cancel, Seed};
use sms_plan::{Perturbation, PlanError};
use sms_scene::Scene;
use sms_sim::{RapierFactory, SimError, StrikerMotion, WorldFactory, WorldOptions};
use sms_task::{Action, ResolvedTask};

/// Half width of the perturbations that measure chaos, metres.
const CHAOS_M: f64 = 1e-6;

/// True worlds of a scene, simulated by the planner's engine or another. Materials are drawn from the ranges of each object's
/// class; bodies and strike differ from the planner's scene by the errors of scan and robot.
pub struct TrueWorlds<'a> {
    task: &'a ResolvedTask,
    factory: &'a dyn WorldFactory,
    options: WorldOptions,
    errors: Perturbation,
    seed: Seed,
    scenes: Vec<Scene>,
}

impl<'a> TrueWorlds<'a> {
    /// The first `count` worlds of a scene. `errors` says how far poses, radii and strikes are off; they are drawn from
    /// other seeds than the planner's.
    ///
    /// # Errors
    /// [`BenchError`] when the drawn masses are impossible.
    pub fn new(scene: &'a PlanScene, errors: &Perturbation, count: usize) -> Result<Self, BenchError> {
        let seed = Seed(scene.seed).derive("true worlds");
        let errors = Perturbation { materials: false, ..errors.clone() };
        let scenes = (0..count)
            .map(|index| {
                let truth = redraw_materials(&scene.truth, seed.derive_index("materials", index as u64));
                let bare = true_scene(&truth, scene.seed)?.without_pictures();
                Ok(errors.scene(&bare, seed, index))
            })
            .collect::<Result<_, BenchError>>()?;
        let (task, options) = (&scene.task, scene.task.world_options());
        Ok(Self { task, factory: &RapierFactory, options, errors, seed, scenes })
    }

    /// The same worlds in another engine than the planner's, at a share of the planner's time step.
    #[must_use]
    pub fn simulated_by(self, factory: &'a dyn WorldFactory, step: f64) -> Self {
        let options = self.task.world_options();
        Self { factory, options: WorldOptions { dt: step * options.dt, ..options }, ..self }
    }

    /// The `index`-th world.
    pub fn scene(&self, index: usize) -> &Scene {
        &self.scenes[index]
    }

    /// Carries out an action in every world: objectives in the worlds' order, `None` where the simulation cannot be
    /// believed.
    ///
    /// # Errors
    /// [`BenchError`]: a world that cannot be simulated, or interruption.
    pub fn realise(&self, action: &Action, cancel: &Cancel) -> Result<Vec<Option<f64>>, BenchError> {
        let motion = self.task.strike(action);
        let run = |(index, scene): (usize, &Scene)| {
            cancel.check()?;
            self.rollout(scene, &motion, &self.errors.strike(&motion, self.seed, index))
        };
        self.scenes.par_iter().enumerate().map(run).collect()
    }

    /// Mean change, over `runs`, of an action's objective in the first world when the bodies move by a micrometre. `None` if no
    /// run is valid.
    ///
    /// # Errors
    /// As [`TrueWorlds::realise`].
    pub fn chaos(&self, action: &Action, runs: usize, cancel: &Cancel) -> Result<Option<f64>, BenchError> {
        let asked = self.task.strike(action);
        let motion = self.errors.strike(&asked, self.seed, 0);
        let jitter = Perturbation {
            materials: false,
            position_m: CHAOS_M,
            radius_m: 0.0,
            object_m: CHAOS_M,
            object_rad: 0.0,
            ..self.errors.clone()
        };
        let Some(first) = self.scenes.first() else { return Ok(None) };
        let Some(reference) = self.rollout(first, &asked, &motion)? else { return Ok(None) };
        let seed = self.seed.derive("chaos");
        let runs: Vec<Option<f64>> = (0..runs)
            .into_par_iter()
            .map(|k| {
                cancel.check()?;
                self.rollout(&jitter.scene(first, seed, k), &asked, &motion)
            })
            .collect::<Result<_, BenchError>>()?;
        let off: Vec<f64> = runs.into_iter().flatten().map(|v| (v - reference).abs()).collect();
        Ok((!off.is_empty()).then(|| off.iter().sum::<f64>() / off.len() as f64))
    }

    /// The objective of a strike that is executed with an error; `None` if the rollout is invalid,
    /// or the arm cannot make it.
    fn rollout(
        &self,
        scene: &Scene,
        asked: &StrikerMotion,
        carried_out: &StrikerMotion,
    ) -> Result<Option<f64>, BenchError> {
        let task = self.task;
        let bodies = task.bodies_in(scene, &task.target().name).map_err(PlanError::from)?;
        let outcome: Result<f64, SimError> = task.striker_near(asked, carried_out).and_then(|striker| {
            let mut simulation = task.prepare(self.factory, scene, &self.options, &bodies)?;
            Ok(task.rollout(&mut simulation, striker, &bodies, None)?.objective)
        });
        match outcome {
            Ok(objective) => Ok(Some(objective)),
            Err(e) if e.is_invalid_rollout() => Ok(None),
            Err(e) => Err(PlanError::from(e).into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{MaterialPrior, SceneFamily};

    #[test]
    fn true_worlds_differ_by_what_is_not_known_and_repeat() {
        let scene = PlanScene::with_prior(SceneFamily::Open, 1001, MaterialPrior::Noisy).unwrap();
        let errors = Perturbation::default();
        let worlds = TrueWorlds::new(&scene, &errors, 3).unwrap();
        let again = TrueWorlds::new(&scene, &errors, 2).unwrap();
        assert_eq!(worlds.scene(1), again.scene(1));
        assert_ne!(worlds.scene(0).bodies[1].x_wb, worlds.scene(1).bodies[1].x_wb);
        let (a, b) = (&worlds.scene(0).bodies[1], &scene.scene.bodies[1]);
        assert_eq!(a.name, b.name);
        assert!(a.x_wb.translation.distance(b.x_wb.translation) < 0.002);
        assert_ne!(a.material.friction, b.material.friction);
        let action = scene.task.suggestions().swap_remove(0);
        let cancel = Cancel::new();
        let realised = worlds.realise(&action, &cancel).unwrap();
        assert_eq!(realised[..2], again.realise(&action, &cancel).unwrap());
        assert!(realised.iter().flatten().any(|v| *v < 0.05), "{realised:?}");
        let chaos = worlds.chaos(&action, 2, &cancel).unwrap().unwrap();
        assert!((0.0..0.01).contains(&chaos), "{chaos}");
    }
}
