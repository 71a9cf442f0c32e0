//! The value of an action in perturbed worlds, without the planner.

use sms_core::Seed;
use sms_plan::Perturbation;
use sms_scene::Scene;
use sms_sim::RapierFactory;
use sms_task::{Action, ResolvedTask};

/// Carries out an action in the first `count` worlds of a seed. Returns the objectives in the order of the worlds,
/// infinite for invalid rollouts.
pub(crate) fn rehearse(
    task: &ResolvedTask,
    scene: &Scene,
    perturbation: &Perturbation,
    seed: Seed,
    action: &Action,
    count: usize,
) -> Vec<f64> {
    let asked = task.strike(action);
    let objective = |index: usize| {
        let world = perturbation.scene(scene, seed, index);
        let bodies = task.bodies_in(&world, &task.target().name).unwrap();
        let striker = task.striker_near(&asked, &perturbation.strike(&asked, seed, index))?;
        let mut simulation = task.prepare(&RapierFactory, &world, &task.world_options(), &bodies)?;
        task.rollout(&mut simulation, striker, &bodies, None)
    };
    (0..count).map(|i| objective(i).map_or(f64::INFINITY, |rollout| rollout.objective)).collect()
}
