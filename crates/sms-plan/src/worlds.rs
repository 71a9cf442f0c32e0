//! Worlds: pools of simulations that rollouts borrow, for the scanned scene and for perturbed ones.

use crate::prediction::RolloutOutcome;
use crate::session::Session;
use crate::{PlanError, Unknown};
use rayon::prelude::*;
use sms_core::Seed;
use sms_scene::Scene;
use sms_sim::{SimError, Simulation, Striker, StrikerMotion, WorldFactory, WorldOptions};
use sms_task::{Action, MotionRecording, ResolvedTask, Rollout, WorldBodies};
use std::borrow::{Borrow, Cow};
use std::ops::Range;
use std::sync::Mutex;

/// A pool of simulations of one scene. Each is built once and restored to its initial state before every rollout, so
/// that all are interchangeable.
pub(crate) struct Worlds<'a> {
    task: &'a ResolvedTask,
    scene: Cow<'a, Scene>,
    factory: &'a dyn WorldFactory,
    options: WorldOptions,
    bodies: WorldBodies,
    idle: Mutex<Vec<Simulation>>,
}

impl<'a> Worlds<'a> {
    pub(crate) fn new(
        task: &'a ResolvedTask,
        scene: Cow<'a, Scene>,
        factory: &'a dyn WorldFactory,
    ) -> Result<Self, PlanError> {
        let bodies = task.bodies_in(&scene, &task.target().name)?;
        Ok(Self { task, scene, factory, options: task.world_options(), bodies, idle: Mutex::default() })
    }

    pub(crate) fn rollout(
        &self,
        motion: &StrikerMotion,
        recording: Option<MotionRecording>,
    ) -> Result<Rollout, SimError> {
        self.carry_out(&self.task.striker(motion)?, recording)
    }

    fn carry_out(&self, striker: &Striker, recording: Option<MotionRecording>) -> Result<Rollout, SimError> {
        let idle = self.idle.lock().ok().and_then(|mut idle| idle.pop());
        let mut simulation = match idle {
            Some(simulation) => simulation,
            None => self.task.prepare(self.factory, &self.scene, &self.options, &self.bodies)?,
        };
        let reusable = simulation.restore();
        let rollout = self.task.rollout(&mut simulation, striker, &self.bodies, recording);
        if reusable && let Ok(mut idle) = self.idle.lock() {
            idle.push(simulation);
        }
        rollout
    }

    pub(crate) fn objective(&self, motion: &StrikerMotion) -> Result<f64, SimError> {
        Ok(self.rollout(motion, None)?.objective)
    }
}

/// Perturbed worlds of a family. An index gives the same world for every action (common random numbers).
pub(crate) struct PerturbedWorlds<'a> {
    session: &'a Session<'a>,
    /// Seed of the family.
    seed: Seed,
    /// Whether the execution is perturbed too.
    execution: bool,
    worlds: Vec<(usize, Worlds<'a>)>,
}

impl<'a> PerturbedWorlds<'a> {
    /// Builds the worlds with these indices, with only the unknowns selected by `which` perturbed.
    pub(crate) fn new(
        session: &'a Session<'a>,
        seed: Seed,
        indices: Range<usize>,
        which: &(dyn Fn(&Unknown) -> bool + Sync),
    ) -> Result<Self, PlanError> {
        let bare = session.scene.without_pictures();
        let worlds = indices
            .into_par_iter()
            .map(|index| {
                let scene = session.config.perturbation.scene_of(&bare, seed, index, which);
                Ok((index, Worlds::new(session.task, Cow::Owned(scene), session.factory)?))
            })
            .collect::<Result<_, PlanError>>()?;
        Ok(Self { session, seed, execution: which(&Unknown::Execution), worlds })
    }

    /// Number of worlds.
    pub(crate) fn len(&self) -> usize {
        self.worlds.len()
    }

    /// Returns the objectives of pairs of a world (position) and an action, in order.
    pub(crate) fn each<A: Borrow<Action> + Sync>(&self, jobs: &[(usize, A)]) -> Result<Vec<f64>, PlanError> {
        Ok(self.look_each(jobs, &|_| ())?.into_iter().map(|seen| seen.0.objective()).collect())
    }

    /// Returns the outcome of each pair, with the result of `look` for simulated ones.
    fn look_each<A: Borrow<Action> + Sync, T: Send>(
        &self,
        jobs: &[(usize, A)],
        look: &(dyn Fn(&Rollout) -> T + Sync),
    ) -> Result<Vec<(RolloutOutcome, Option<T>)>, PlanError> {
        let task = self.session.task;
        // Grouped by world, so that each thread builds each world at most once.
        let mut order: Vec<usize> = (0..jobs.len()).collect();
        order.sort_by_key(|&j| jobs[j].0);
        let mut found: Vec<(usize, (RolloutOutcome, Option<T>))> = order
            .into_par_iter()
            .map(|j| {
                let (index, world) = &self.worlds[jobs[j].0];
                let asked = task.strike(jobs[j].1.borrow());
                let mut seen = None;
                let shot = self.session.counter.shot(|| {
                    let striker = if self.execution {
                        let strike = self.session.config.perturbation.strike(&asked, self.seed, *index);
                        task.striker_near(&asked, &strike)?
                    } else {
                        task.striker(&asked)?
                    };
                    let rollout = world.carry_out(&striker, None)?;
                    seen = Some(look(&rollout));
                    Ok(rollout.objective)
                })?;
                Ok((j, (shot, seen)))
            })
            .collect::<Result<_, PlanError>>()?;
        found.sort_by_key(|(j, _)| *j);
        Ok(found.into_iter().map(|(_, outcome)| outcome).collect())
    }

    /// The objectives of each action in the worlds `range` (positions, not indices), in the order of the worlds.
    pub(crate) fn objectives(
        &self,
        actions: &[Action],
        range: Range<usize>,
    ) -> Result<Vec<Vec<f64>>, PlanError> {
        let rows = self.look(actions, range, &|_| ())?;
        Ok(rows.into_iter().map(|row| row.into_iter().map(|seen| seen.0.objective()).collect()).collect())
    }

    /// The outcomes of each action in the worlds `range`, with the results of `look` for simulated ones.
    pub(crate) fn look<T: Send>(
        &self,
        actions: &[Action],
        range: Range<usize>,
        look: &(dyn Fn(&Rollout) -> T + Sync),
    ) -> Result<Vec<Vec<(RolloutOutcome, Option<T>)>>, PlanError> {
        let jobs: Vec<(usize, &Action)> = range.flat_map(|w| actions.iter().map(move |a| (w, a))).collect();
        let mut rows: Vec<Vec<_>> = actions.iter().map(|_| Vec::new()).collect();
        for (k, outcome) in self.look_each(&jobs, look)?.into_iter().enumerate() {
            rows[k % actions.len()].push(outcome);
        }
        Ok(rows)
    }
}
