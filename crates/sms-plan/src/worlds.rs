//! Simulations that rollouts borrow, and the disturbed worlds in which candidates are tried.

use crate::space::Space;
use crate::{Disturbances, LocalSearch, PlanError, Refusal, Unbelievable, Unknown};
use rayon::prelude::*;
use sms_core::{Cancel, Progress, Seed};
use sms_scene::Scene;
use sms_sim::{SimError, Simulation, Striker, StrikerMotion, WorldFactory, WorldOptions};
use sms_task::{Recording, ResolvedTask, Rollout, WorldBodies};
use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// What comes of a shot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Shot {
    /// It was simulated: its objective.
    Done(f64),
    /// Its simulation cannot be believed.
    Unbelievable,
    /// The robot cannot make it; nothing was simulated.
    Refused,
}

impl Shot {
    /// What searches minimise: infinite where there is no objective.
    pub(crate) fn objective(self) -> f64 {
        match self {
            Self::Done(objective) => objective,
            Self::Unbelievable | Self::Refused => f64::INFINITY,
        }
    }
}

/// Counts rollouts, reports them, and stops when asked to.
pub(crate) struct Counter<'a> {
    progress: &'a dyn Progress,
    cancel: &'a Cancel,
    done: AtomicUsize,
    /// Of these, before the current part of the work.
    before: AtomicUsize,
    invalid: AtomicUsize,
    /// Rollouts that cannot be believed, by reason: how many, and the first of them in the order of their texts.
    unbelievable: Mutex<BTreeMap<String, (usize, String)>>,
    /// Strikes that the robot cannot make, by reason, that took the place of a rollout.
    refused: Mutex<Reasons>,
    /// The same of points of scans and searches: others were tried in their place.
    passed_over: Mutex<Reasons>,
}

/// Reasons why the robot cannot make strikes, with the number of strikes.
pub(crate) type Reasons = BTreeMap<String, usize>;

impl<'a> Counter<'a> {
    pub(crate) fn new(progress: &'a dyn Progress, cancel: &'a Cancel) -> Self {
        Self {
            progress,
            cancel,
            done: AtomicUsize::new(0),
            before: AtomicUsize::new(0),
            invalid: AtomicUsize::new(0),
            unbelievable: Mutex::default(),
            refused: Mutex::default(),
            passed_over: Mutex::default(),
        }
    }

    /// Begins a part of the work with about so many rollouts.
    pub(crate) fn begin(&self, part: &str, rollouts: usize) {
        self.before.store(self.done(), Ordering::SeqCst);
        self.progress.begin(part, rollouts as u64);
    }

    pub(crate) fn done(&self) -> usize {
        self.done.load(Ordering::SeqCst)
    }

    pub(crate) fn invalid(&self) -> usize {
        self.invalid.load(Ordering::SeqCst)
    }

    /// Whether the robot can make the strike of a point that a scan or a search asks for; counted where it cannot. Nothing
    /// is simulated, and it is no rollout.
    pub(crate) fn draw(&self, task: &ResolvedTask, action: &sms_task::Action) -> Result<bool, PlanError> {
        self.cancel.check()?;
        match task.striker(&task.strike(action)) {
            Err(SimError::Refused(e)) => {
                if let Ok(mut passed_over) = self.passed_over.lock() {
                    *passed_over.entry(e.reason()).or_default() += 1;
                }
                Ok(false)
            }
            other => Ok(other.map(|_| true)?),
        }
    }

    /// Whether the whole motion of an action's strike, from home to the lift after it, passes every check of the robot;
    /// counted among the refused where it does not.
    pub(crate) fn executable(
        &self,
        task: &ResolvedTask,
        action: &sms_task::Action,
    ) -> Result<bool, PlanError> {
        self.cancel.check()?;
        let Some(reason) = task.not_executable(&task.strike(action)) else { return Ok(true) };
        if let Ok(mut passed_over) = self.passed_over.lock() {
            *passed_over.entry(reason).or_default() += 1;
        }
        Ok(false)
    }

    /// The next point of a search whose strike the robot can make; `None` when the search has ended.
    pub(crate) fn next_feasible(
        &self,
        task: &ResolvedTask,
        space: &Space,
        search: &mut LocalSearch,
    ) -> Result<Option<Vec<f64>>, PlanError> {
        while let Some(x) = search.next_point().map(<[f64]>::to_vec) {
            if self.draw(task, &space.action(&x))? {
                return Ok(Some(x));
            }
            search.refuse();
        }
        Ok(None)
    }

    fn note_unbelievable(&self, e: &SimError) {
        let (Ok(mut all), Some(reason)) = (self.unbelievable.lock(), e.spoilt_by()) else { return };
        let example = e.to_string();
        // The least text, not the first in time: threads come in any order.
        let (count, least) = all.entry(reason).or_insert_with(|| (0, example.clone()));
        *count += 1;
        if example < *least {
            *least = example;
        }
    }

    /// Rollouts that could not be believed so far, by reason, the most frequent first.
    pub(crate) fn unbelievable(&self) -> Vec<Unbelievable> {
        let all = self.unbelievable.lock().map(|all| all.clone()).unwrap_or_default();
        let mut all: Vec<Unbelievable> = all
            .into_iter()
            .map(|(reason, (count, example))| Unbelievable { reason, count, example })
            .collect();
        all.sort_by(|a, b| b.count.cmp(&a.count).then_with(|| a.reason.cmp(&b.reason)));
        all
    }

    /// Strikes refused so far in the place of a rollout.
    pub(crate) fn refused(&self) -> Reasons {
        self.refused.lock().map(|r| r.clone()).unwrap_or_default()
    }

    /// Points of scans and searches that were refused so far, together with `refused`, the most frequent reason first.
    pub(crate) fn refusals(&self, refused: &Reasons) -> Vec<Refusal> {
        let mut counted = self.passed_over.lock().map(|r| r.clone()).unwrap_or_default();
        for (reason, count) in refused {
            *counted.entry(reason.clone()).or_default() += count;
        }
        let mut all: Vec<Refusal> =
            counted.into_iter().map(|(reason, count)| Refusal { reason, count }).collect();
        all.sort_by(|a, b| b.count.cmp(&a.count).then_with(|| a.reason.cmp(&b.reason)));
        all
    }

    /// The objective of a rollout; infinite where the simulation cannot be believed, or the robot cannot make the strike.
    pub(crate) fn count(&self, rollout: impl FnOnce() -> Result<f64, SimError>) -> Result<f64, PlanError> {
        Ok(self.shot(rollout)?.objective())
    }

    /// As [`Counter::count`], with what became of it.
    pub(crate) fn shot(&self, rollout: impl FnOnce() -> Result<f64, SimError>) -> Result<Shot, PlanError> {
        self.cancel.check()?;
        let shot = match rollout() {
            Err(SimError::Refused(e)) => {
                if let Ok(mut refused) = self.refused.lock() {
                    *refused.entry(e.reason()).or_default() += 1;
                }
                Shot::Refused
            }
            Err(e @ (SimError::Diverged { .. } | SimError::Unphysical { .. })) => {
                self.invalid.fetch_add(1, Ordering::SeqCst);
                self.note_unbelievable(&e);
                Shot::Unbelievable
            }
            other => Shot::Done(other?),
        };
        let done = self.done.fetch_add(1, Ordering::SeqCst) + 1;
        let before = self.before.load(Ordering::SeqCst);
        self.progress.update(done.saturating_sub(before) as u64, "shots simulated");
        Ok(shot)
    }
}

/// Simulations of one scene, reused: each is built once, and returned to its first state before every rollout, so
/// that it does not matter which of them a rollout gets.
pub(crate) struct Worlds<'a> {
    task: &'a ResolvedTask,
    scene: std::borrow::Cow<'a, Scene>,
    factory: &'a dyn WorldFactory,
    options: WorldOptions,
    bodies: WorldBodies,
    idle: Mutex<Vec<Simulation>>,
}

impl<'a> Worlds<'a> {
    pub(crate) fn new(
        task: &'a ResolvedTask,
        scene: std::borrow::Cow<'a, Scene>,
        factory: &'a dyn WorldFactory,
    ) -> Result<Self, PlanError> {
        let bodies = task.bodies_in(&scene, &task.target().name)?;
        Ok(Self { task, scene, factory, options: task.world_options(), bodies, idle: Mutex::default() })
    }

    pub(crate) fn rollout(
        &self,
        motion: &StrikerMotion,
        recording: Option<Recording>,
    ) -> Result<Rollout, SimError> {
        self.carry_out(&self.task.striker(motion)?, recording)
    }

    fn carry_out(&self, striker: &Striker, recording: Option<Recording>) -> Result<Rollout, SimError> {
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

/// A family of disturbed worlds: the same ones for every action (common random numbers).
pub(crate) struct DisturbedWorlds<'a> {
    task: &'a ResolvedTask,
    disturbances: &'a Disturbances,
    seed: Seed,
    /// Whether the execution is disturbed too.
    execution: bool,
    worlds: Vec<(usize, Worlds<'a>)>,
}

impl<'a> DisturbedWorlds<'a> {
    /// The worlds of these indices, with only those unknowns disturbed that `which` picks.
    pub(crate) fn new(
        task: &'a ResolvedTask,
        scene: &Scene,
        factory: &'a dyn WorldFactory,
        disturbances: &'a Disturbances,
        seed: Seed,
        indices: std::ops::Range<usize>,
        which: &(dyn Fn(&Unknown) -> bool + Sync),
    ) -> Result<Self, PlanError> {
        let bare = scene.without_pictures();
        let worlds = indices
            .into_par_iter()
            .map(|index| {
                let scene = disturbances.scene_of(&bare, seed, index, which);
                Ok((index, Worlds::new(task, std::borrow::Cow::Owned(scene), factory)?))
            })
            .collect::<Result<_, PlanError>>()?;
        Ok(Self { task, disturbances, seed, execution: which(&Unknown::Execution), worlds })
    }

    /// Number of worlds.
    pub(crate) fn len(&self) -> usize {
        self.worlds.len()
    }

    /// The objectives of pairs of a world (position) and an action, in their order.
    pub(crate) fn each<A: std::borrow::Borrow<sms_task::Action> + Sync>(
        &self,
        jobs: &[(usize, A)],
        counter: &Counter<'_>,
    ) -> Result<Vec<f64>, PlanError> {
        Ok(self.look_each(jobs, counter, &|_| ())?.into_iter().map(|seen| seen.0.objective()).collect())
    }

    /// What comes of each, with what `look` sees in it where it was simulated.
    fn look_each<A: std::borrow::Borrow<sms_task::Action> + Sync, T: Send>(
        &self,
        jobs: &[(usize, A)],
        counter: &Counter<'_>,
        look: &(dyn Fn(&Rollout) -> T + Sync),
    ) -> Result<Vec<(Shot, Option<T>)>, PlanError> {
        // World by world, so that each is built once per thread at most.
        let mut order: Vec<usize> = (0..jobs.len()).collect();
        order.sort_by_key(|&j| jobs[j].0);
        let found: Vec<(Shot, Option<T>)> = order
            .par_iter()
            .map(|&j| {
                let (index, world) = &self.worlds[jobs[j].0];
                let asked = self.task.strike(jobs[j].1.borrow());
                let mut seen = None;
                let shot = counter.shot(|| {
                    let striker = if self.execution {
                        let strike = self.disturbances.strike(&asked, self.seed, *index);
                        self.task.striker_near(&asked, &strike)?
                    } else {
                        self.task.striker(&asked)?
                    };
                    let rollout = world.carry_out(&striker, None)?;
                    seen = Some(look(&rollout));
                    Ok(rollout.objective)
                })?;
                Ok((shot, seen))
            })
            .collect::<Result<_, PlanError>>()?;
        let mut values: Vec<(Shot, Option<T>)> =
            std::iter::repeat_with(|| (Shot::Unbelievable, None)).take(jobs.len()).collect();
        for (j, value) in order.into_iter().zip(found) {
            values[j] = value;
        }
        Ok(values)
    }

    /// The objectives of each action in the worlds `range` (positions, not indices), in the worlds' order.
    pub(crate) fn objectives(
        &self,
        actions: &[sms_task::Action],
        range: std::ops::Range<usize>,
        counter: &Counter<'_>,
    ) -> Result<Vec<Vec<f64>>, PlanError> {
        let rows = self.look(actions, range, counter, &|_| ())?;
        Ok(rows.into_iter().map(|row| row.into_iter().map(|seen| seen.0.objective()).collect()).collect())
    }

    /// What comes of each action in the worlds `range`, with what `look` sees in it where it was simulated.
    pub(crate) fn look<T: Send>(
        &self,
        actions: &[sms_task::Action],
        range: std::ops::Range<usize>,
        counter: &Counter<'_>,
        look: &(dyn Fn(&Rollout) -> T + Sync),
    ) -> Result<Vec<Vec<(Shot, Option<T>)>>, PlanError> {
        let (first, count) = (range.start, range.len());
        let pairs: Vec<(usize, usize)> =
            range.flat_map(|w| (0..actions.len()).map(move |a| (w, a))).collect();
        let jobs: Vec<(usize, &sms_task::Action)> = pairs.iter().map(|&(w, a)| (w, &actions[a])).collect();
        let values = self.look_each(&jobs, counter, look)?;
        let nothing = || std::iter::repeat_with(|| (Shot::Unbelievable, None)).take(count).collect();
        let mut rows: Vec<Vec<(Shot, Option<T>)>> =
            std::iter::repeat_with(nothing).take(actions.len()).collect();
        for ((w, a), value) in pairs.into_iter().zip(values) {
            rows[a][w - first] = value;
        }
        Ok(rows)
    }
}

/// Carries out an action in `count` disturbed worlds of a family: the objectives in the worlds' order, infinite where a
/// rollout cannot be believed. For measuring what a plan is worth; the planner's own families have other seeds.
///
/// # Errors
/// [`PlanError`]: a scene that cannot be simulated, or interruption.
pub fn rehearse(
    task: &ResolvedTask,
    scene: &Scene,
    factory: &dyn WorldFactory,
    disturbances: &Disturbances,
    action: &sms_task::Action,
    seed: Seed,
    count: usize,
    cancel: &Cancel,
) -> Result<Vec<f64>, PlanError> {
    let worlds = DisturbedWorlds::new(task, scene, factory, disturbances, seed, 0..count, &|_| true)?;
    let counter = Counter::new(&sms_core::NoProgress, cancel);
    Ok(worlds.objectives(std::slice::from_ref(action), 0..count, &counter)?.remove(0))
}
