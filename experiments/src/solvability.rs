//! Brute-force search, in a target world, for solutions of a scene by a straight shot or only by rebounds.

use crate::BenchError;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sms_core::{Cancel, Progress, Seed};
use sms_plan::{Halton, PlanError};
use sms_scene::{BodyShape, Scene};
use sms_sim::{ContactEvent, RapierFactory, SimError, Simulation, WorldFactory, WorldOptions};
use sms_synth::{Layout, TruthScene, generate_challenge};
use sms_target::robot_of;
use sms_target::scene_from_truth;
use sms_task::{Action, ActionForm, Billiards, ResolvedTask, Selector, Task, WorldBodies};
use std::sync::atomic::{AtomicU64, Ordering};

/// Scenes to look at: layouts times seeds.
#[derive(Debug, Clone)]
pub struct SolvabilityBench {
    /// Layouts of the scenes.
    pub layouts: Vec<Layout>,
    /// Their seeds.
    pub seeds: Vec<u64>,
    /// Obstacles scattered around, besides those of the layout.
    pub obstacles: usize,
    /// Shots per scene, spread evenly over speed and angle.
    pub shots: u64,
}

/// Result of brute force for one scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Solvability {
    /// The scene's layout.
    pub layout: Layout,
    /// Its seed.
    pub seed: u64,
    /// Objects besides the two balls.
    pub obstacles: usize,
    /// Best distance to the goal, metres, by number of rebounds: none, one, two or more. Infinite where no shot of that
    /// kind reached the target ball.
    pub best_m: [f64; 3],
    /// Share of all shots that end within 5 cm, by number of rebounds.
    pub success_share: [f64; 3],
    /// The strike that came nearest to the goal: speed (m/s), angle (rad).
    pub best_action: Vec<f64>,
    /// Share of the shots that the arm cannot make.
    pub refused_share: f64,
}

impl Solvability {
    /// The best of all shots, metres.
    pub fn best(&self) -> f64 {
        self.best_m.iter().copied().fold(f64::INFINITY, f64::min)
    }
}

/// Rebounds before the target ball is nearest to the goal: touches of it, or of the cue ball before that meets it, with
/// anything but each other and the floor. `None` where the target ball is never touched.
pub(crate) fn rebounds(
    contacts: &[ContactEvent],
    until_s: f64,
    scene: &Scene,
    task: &ResolvedTask,
) -> Option<usize> {
    let (cue, target) = (task.cue().index, task.target().index);
    let is_prop =
        |b: usize| scene.bodies.get(b).is_some_and(|body| !matches!(body.shape, BodyShape::HalfSpace));
    let (mut count, mut reached) = (0, false);
    for c in contacts.iter().filter(|c| c.time_s <= until_s && is_prop(c.body) && is_prop(c.other)) {
        let has = |b: usize| c.body == b || c.other == b;
        if has(cue) && has(target) {
            reached = true;
        } else if has(target) || (has(cue) && !reached) {
            count += 1;
            reached |= has(target);
        }
    }
    reached.then_some(count)
}

/// A true scene with the arm before it.
pub(crate) struct ArmScene {
    pub(crate) scene: Scene,
    pub(crate) task: ResolvedTask,
    pub(crate) bodies: WorldBodies,
}

/// The task of a true scene: bring the target ball to a goal with the arm.
pub(crate) fn task_in(
    scene: &Scene,
    truth: &TruthScene,
    goal_w: [f64; 2],
) -> Result<ResolvedTask, BenchError> {
    let (cue, target) = (Selector::by_name(&truth.cue), Selector::by_name(&truth.target));
    let mut billiards = Billiards::new(cue, target, goal_w);
    billiards.form = ActionForm::SpeedAngle;
    let task = Task::Billiards(billiards).resolve(scene).map_err(PlanError::from)?;
    Ok(task.with_robot(&robot_of(truth), scene)?)
}

/// A shot of the arm that was simulated.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Tried {
    pub(crate) action: Action,
    /// Distance to the goal, metres.
    pub(crate) objective: f64,
    /// [`rebounds`].
    pub(crate) rebounds: Option<usize>,
}

impl ArmScene {
    /// `None` where a truth names masses that no body has.
    pub(crate) fn new(truth: &TruthScene) -> Result<Option<Self>, BenchError> {
        let Ok(scene) = scene_from_truth(truth) else { return Ok(None) };
        let task = task_in(&scene, truth, truth.goal_w)?;
        let bodies = task.bodies_in(&scene, &task.target().name).map_err(PlanError::from)?;
        Ok(Some(Self { scene, task, bodies }))
    }

    /// A world of it at rest, for [`ArmScene::shoot`].
    pub(crate) fn world(
        &self,
        factory: &dyn WorldFactory,
        options: &WorldOptions,
    ) -> Result<Simulation, BenchError> {
        Ok(self.task.prepare(factory, &self.scene, options, &self.bodies).map_err(PlanError::from)?)
    }

    /// The action at a point of the unit box.
    pub(crate) fn action_at(&self, unit: &[f64]) -> Action {
        let parameters = self.task.parameters();
        Action(unit.iter().zip(&parameters).map(|(t, p)| p.low + t * (p.high - p.low)).collect())
    }

    /// Executes a shot. Invalid rollouts are `Err` inside, `SimError::Refused` if the arm cannot make the strike.
    pub(crate) fn shoot(
        &self,
        simulation: &mut Simulation,
        action: Action,
    ) -> Result<Result<Tried, SimError>, BenchError> {
        simulation.restore();
        let struck = self.task.striker(&self.task.strike(&action));
        match struck.and_then(|s| self.task.rollout(simulation, s, &self.bodies, None)) {
            Ok(rollout) => {
                let rebounds = rebounds(&rollout.contacts, rollout.closest_s, &self.scene, &self.task);
                Ok(Ok(Tried { action, objective: rollout.objective, rebounds }))
            }
            Err(e) if e.is_invalid_rollout() => Ok(Err(e)),
            Err(e) => Err(PlanError::from(e).into()),
        }
    }
}

/// Simulates `shots` shots of the arm in the true scene.
fn look(
    bench: &SolvabilityBench,
    layout: Layout,
    seed: u64,
    cancel: &Cancel,
) -> Result<Option<Solvability>, BenchError> {
    let Some(truth) = generate_challenge(layout, Seed(seed), bench.obstacles) else { return Ok(None) };
    let Some(table) = ArmScene::new(&truth)? else { return Ok(None) };
    let mut simulation = table.world(&RapierFactory, &table.task.world_options())?;
    let points = Halton::new(table.task.parameters().len(), Seed(seed));
    let mut found = Solvability {
        layout,
        seed,
        obstacles: truth.objects.len() - 2,
        best_m: [f64::INFINITY; 3],
        success_share: [0.0; 3],
        best_action: Vec::new(),
        refused_share: 0.0,
    };
    for i in 0..bench.shots {
        cancel.check()?;
        let tried = match table.shoot(&mut simulation, table.action_at(&points.point(i)))? {
            Ok(tried) => tried,
            Err(SimError::Refused(_)) => {
                found.refused_share += 1.0 / bench.shots as f64;
                continue;
            }
            Err(_) => continue,
        };
        let Some(count) = tried.rebounds else { continue };
        if tried.objective < found.best() {
            found.best_action = tried.action.0;
        }
        let kind = count.min(2);
        found.best_m[kind] = found.best_m[kind].min(tried.objective);
        if table.task.is_success(tried.objective) {
            found.success_share[kind] += 1.0 / bench.shots as f64;
        }
    }
    Ok(Some(found))
}

/// Looks at every scene that its seed allows, in the order of layouts and seeds.
///
/// # Errors
/// [`BenchError`]: a scene that cannot be simulated, or interruption.
pub fn run_solvability(
    bench: &SolvabilityBench,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<Vec<Solvability>, BenchError> {
    let jobs: Vec<(Layout, u64)> =
        bench.layouts.iter().flat_map(|&l| bench.seeds.iter().map(move |&s| (l, s))).collect();
    progress.begin("bench scenes", jobs.len() as u64);
    let done = AtomicU64::new(0);
    let found: Vec<Option<Solvability>> = jobs
        .par_iter()
        .map(|&(layout, seed)| {
            let found = look(bench, layout, seed, cancel);
            progress.update(done.fetch_add(1, Ordering::SeqCst) + 1, "scenes");
            found
        })
        .collect::<Result<_, _>>()?;
    progress.end("");
    Ok(found.into_iter().flatten().collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::NoProgress;

    #[test]
    fn two_balls_on_an_empty_floor_need_no_rebound() {
        let bench =
            SolvabilityBench { layouts: vec![Layout::Empty], seeds: vec![1001], obstacles: 0, shots: 300 };
        let found = run_solvability(&bench, &NoProgress, &Cancel::new()).unwrap();
        assert_eq!((found.len(), found[0].obstacles), (1, 0));
        assert!(found[0].best_m[0] < 0.05 && found[0].best_m[1].is_infinite(), "{found:?}");
        assert!(found[0].success_share[0] > 0.0 && found[0].success_share[1] == 0.0);
    }
}
