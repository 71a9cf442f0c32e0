//! From a task and a scene to a plan (paper section "Simulate").

use crate::robust::{acceptable, candidates, most_robust};
use crate::search::{Scored, search};
use crate::space::Space;
use crate::{Phase, Plan, PlanConfig, PlanOutcome, StartSummary, Trial, disturb};
use rayon::prelude::*;
use sms_core::{Cancel, CoreError, InputError, Progress, Seed, Warnings};
use sms_scene::Scene;
use sms_sim::{SimError, Simulation, StrikerMotion, WorldFactory, WorldOptions};
use sms_task::{Recording, ResolvedTask, Rollout, TaskError, WorldBodies};
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Time between recorded states of the plan's trajectory, seconds.
const RECORD_EVERY_S: f64 = 1.0 / 120.0;

/// Errors of planning.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// Bad settings.
    #[error(transparent)]
    Input(#[from] InputError),
    /// Interrupted, or a file could not be written.
    #[error(transparent)]
    Core(#[from] CoreError),
    /// The task does not fit the scene.
    #[error(transparent)]
    Task(#[from] TaskError),
    /// The scene cannot be simulated.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// No rollout reached its end.
    #[error(
        "none of the {evaluations} simulated shots could be carried out ({engine} blew up in each); check the \
         scene's masses and shapes with `sms simulate`"
    )]
    Nothing {
        /// Engine.
        engine: String,
        /// Rollouts.
        evaluations: usize,
    },
}

/// Plans: searches the actions in the nominal world, then chooses among the good ones by how they fare in disturbed
/// worlds (materials sampled within their intervals, balls and strike a little off; the same worlds for every
/// candidate).
///
/// Choice: of the actions whose nominal objective is at most [`PlanConfig::good_m`] (or 1.5 times the best one,
/// where none is as good), the one with the smallest 90 % quantile. The plan is the same for any number of threads;
/// rayon's current pool is used. Only `scene`, which the scan made, is looked at.
///
/// # Errors
/// [`PlanError`]: bad settings, a scene that cannot be simulated, or interruption.
pub fn plan(
    task: &ResolvedTask,
    scene: &Scene,
    factory: &dyn WorldFactory,
    config: &PlanConfig,
    seed: Seed,
    progress: &dyn Progress,
    cancel: &Cancel,
    warnings: &Warnings,
) -> Result<PlanOutcome, PlanError> {
    config.validate(Path::new("(settings of the planner)"))?;
    let space = Space::new(task);
    let nominal = Worlds::new(task, scene, factory)?;
    let counter = Counter { progress, cancel, done: AtomicUsize::new(0), failed: AtomicUsize::new(0) };

    progress.begin("plan: search", config.evaluations as u64);
    let mut found = search(&space, config, seed.derive("search"), config.budget(), &|x| {
        counter.count(|| nominal.objective(&task.strike(&space.action(x))))
    })?;
    let limit = acceptable(&found.scored, config.good_m);
    let steps = space.steps(config.initial_step, true);
    let chosen = candidates(&found.scored, limit, &steps, config.candidates);
    let evaluations = counter.done.load(Ordering::SeqCst);
    let Some(best) = chosen.first().filter(|c| c.objective.is_finite()) else {
        return Err(PlanError::Nothing { engine: factory.engine().to_owned(), evaluations });
    };
    progress.end(&format!("best of {evaluations} shots passes the goal at {:.1} mm", 1e3 * best.objective));

    let (winner, q90) = {
        let disturbed = Disturbed { task, scene, factory, config, space: &space, seed, counter: &counter };
        disturbed.choose(&chosen, &mut found.trials)?
    };
    let action = space.action(&winner.x);
    for start in &mut found.starts {
        if start.action == action {
            start.objective_q90 = Some(q90);
        }
    }
    let rollout = nominal.rollout(&task.strike(&action), Some(Recording { every_s: RECORD_EVERY_S }))?;
    let plan = Plan {
        task: task.kind().to_owned(),
        engine: factory.engine().to_owned(),
        parameters: task.parameters(),
        action,
        objective: winner.objective,
        objective_unit: task.objective_unit().to_owned(),
        objective_q90: q90,
        evaluations: counter.done.load(Ordering::SeqCst) + 1,
        starts: found.starts,
        trajectory: rollout.trajectory.unwrap_or_default(),
    };
    warn(task, &plan, counter.failed.load(Ordering::SeqCst), warnings);
    Ok(PlanOutcome { plan, trials: found.trials })
}

/// What a search of the nominal world alone found.
#[derive(Debug, Clone, PartialEq)]
pub struct NominalSearch {
    /// Every rollout: the scan, then the searches in order of their starts.
    pub trials: Vec<Trial>,
    /// The local searches.
    pub starts: Vec<StartSummary>,
}

impl NominalSearch {
    /// The best valid trial.
    pub fn best(&self) -> Option<&Trial> {
        self.trials.iter().filter(|t| t.valid).min_by(|a, b| a.objective.total_cmp(&b.objective))
    }
}

/// The first part of [`plan`] alone, for comparing methods: searches the nominal world with at most `budget` rollouts.
///
/// # Errors
/// As [`plan`]; a search without any valid rollout is not an error here.
pub fn search_nominal(
    task: &ResolvedTask,
    scene: &Scene,
    factory: &dyn WorldFactory,
    config: &PlanConfig,
    budget: usize,
    seed: Seed,
    cancel: &Cancel,
) -> Result<NominalSearch, PlanError> {
    config.validate(Path::new("(settings of the planner)"))?;
    let space = Space::new(task);
    let nominal = Worlds::new(task, scene, factory)?;
    let counter = Counter {
        progress: &sms_core::NoProgress,
        cancel,
        done: AtomicUsize::new(0),
        failed: AtomicUsize::new(0),
    };
    let found = search(&space, config, seed.derive("search"), budget, &|x| {
        counter.count(|| nominal.objective(&task.strike(&space.action(x))))
    })?;
    Ok(NominalSearch { trials: found.trials, starts: found.starts })
}

fn warn(task: &ResolvedTask, plan: &Plan, failed: usize, warnings: &Warnings) {
    if !task.is_success(plan.objective) {
        warnings.add(
            "plan",
            "no_good_shot",
            format!(
                "no shot was found that brings the target ball to the goal; the best one passes it at {:.1} cm",
                1e2 * plan.objective
            ),
            "move the goal, widen the task's bounds, or plan with more evaluations",
        );
    } else if !task.is_success(plan.objective_q90) {
        warnings.add(
            "plan",
            "fragile_shot",
            format!(
                "the chosen shot passes the goal at {:.1} cm, but at up to {:.1} cm in nine of ten worlds that \
                 differ within what is known",
                1e2 * plan.objective,
                1e2 * plan.objective_q90
            ),
            "narrow the material intervals, or choose a goal that is easier to reach",
        );
    }
    if failed > 0 {
        warnings.add(
            "plan",
            "failed_rollouts",
            format!("{failed} of {} simulated shots blew up and were counted as misses", plan.evaluations),
            "look for interpenetrating or very light bodies in the scene",
        );
    }
}

/// Counts rollouts, reports them, and stops when asked to.
struct Counter<'a> {
    progress: &'a dyn Progress,
    cancel: &'a Cancel,
    done: AtomicUsize,
    failed: AtomicUsize,
}

impl Counter<'_> {
    fn count(&self, rollout: impl FnOnce() -> Result<f64, SimError>) -> Result<f64, PlanError> {
        self.cancel.check()?;
        let objective = match rollout() {
            Err(SimError::Diverged { .. }) => {
                self.failed.fetch_add(1, Ordering::SeqCst);
                f64::INFINITY
            }
            other => other?,
        };
        let done = self.done.fetch_add(1, Ordering::SeqCst) + 1;
        self.progress.update(done as u64, "shots simulated");
        Ok(objective)
    }
}

/// Simulations of one scene, reused: each is built once, and returned to its first state before every rollout, so
/// that it does not matter which of them a rollout gets.
struct Worlds<'a> {
    task: &'a ResolvedTask,
    scene: &'a Scene,
    factory: &'a dyn WorldFactory,
    options: WorldOptions,
    bodies: WorldBodies,
    idle: Mutex<Vec<Simulation>>,
}

impl<'a> Worlds<'a> {
    fn new(
        task: &'a ResolvedTask,
        scene: &'a Scene,
        factory: &'a dyn WorldFactory,
    ) -> Result<Self, PlanError> {
        let bodies = task.bodies_in(scene, &task.target().name)?;
        Ok(Self { task, scene, factory, options: task.world_options(), bodies, idle: Mutex::default() })
    }

    fn rollout(&self, motion: &StrikerMotion, recording: Option<Recording>) -> Result<Rollout, SimError> {
        let idle = self.idle.lock().ok().and_then(|mut idle| idle.pop());
        let mut simulation = match idle {
            Some(simulation) => simulation,
            None => self.task.prepare(self.factory, self.scene, &self.options, &self.bodies)?,
        };
        let reusable = simulation.restore();
        let rollout = self.task.rollout(&mut simulation, motion, &self.bodies, recording);
        if reusable && let Ok(mut idle) = self.idle.lock() {
            idle.push(simulation);
        }
        rollout
    }

    fn objective(&self, motion: &StrikerMotion) -> Result<f64, SimError> {
        Ok(self.rollout(motion, None)?.objective)
    }
}

/// The choice among candidates.
struct Disturbed<'a> {
    task: &'a ResolvedTask,
    scene: &'a Scene,
    factory: &'a dyn WorldFactory,
    config: &'a PlanConfig,
    space: &'a Space,
    seed: Seed,
    counter: &'a Counter<'a>,
}

impl Disturbed<'_> {
    /// The most robust candidate and its 90 % quantile over all worlds. All candidates see the first quarter of the
    /// worlds; the best ones of those see the rest.
    fn choose(&self, all: &[Scored], trials: &mut Vec<Trial>) -> Result<(Scored, f64), PlanError> {
        let worlds = self.config.disturbances.worlds;
        let first = worlds.div_ceil(4);
        let progress = self.counter.progress;
        progress.begin("plan: disturbed worlds", worlds as u64);
        let everyone: Vec<usize> = (0..all.len()).collect();
        let mut outcomes = vec![Vec::new(); all.len()];
        self.run(all, &everyone, 0..first, &mut outcomes, trials)?;
        let finalists = most_robust(&outcomes, self.config.finalists);
        self.run(all, &finalists, first..worlds, &mut outcomes, trials)?;
        let rows: Vec<Vec<f64>> = finalists.iter().map(|&i| outcomes[i].clone()).collect();
        let winner = most_robust(&rows, 1)[0];
        let q90 = disturb::quantile(&rows[winner], 0.9);
        progress.end(&format!("chosen shot: {:.1} mm in nine of ten worlds", 1e3 * q90));
        Ok((all[finalists[winner]].clone(), q90))
    }

    /// Tries the candidates `who` in the given worlds; outcomes are appended in the worlds' order.
    fn run(
        &self,
        all: &[Scored],
        who: &[usize],
        worlds: std::ops::Range<usize>,
        outcomes: &mut [Vec<f64>],
        trials: &mut Vec<Trial>,
    ) -> Result<(), PlanError> {
        let disturbances = &self.config.disturbances;
        let columns: Vec<(usize, Vec<f64>)> = worlds
            .into_par_iter()
            .map(|w| {
                let scene = disturbances.scene(self.scene, self.seed.derive("disturbed"), w);
                let world = Worlds::new(self.task, &scene, self.factory)?;
                let run = |&i: &usize| {
                    let strike = self.task.strike(&self.space.action(&all[i].x));
                    let strike = disturbances.strike(&strike, self.seed.derive("disturbed"), w);
                    self.counter.count(|| world.objective(&strike))
                };
                Ok((w, who.iter().map(run).collect::<Result<_, PlanError>>()?))
            })
            .collect::<Result<_, PlanError>>()?;
        for (w, column) in columns {
            for (&i, objective) in who.iter().zip(column) {
                outcomes[i].push(objective);
                let action = self.space.action(&all[i].x);
                trials.push(Trial::new(Phase::Disturbed, i as i32, w as i32, action, objective));
            }
        }
        Ok(())
    }
}
