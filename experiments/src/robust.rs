//! `sms-experiments robust`: objectives of plans in worlds that differ from the planner's.

use crate::cpu_time::thread_cpu_seconds;
use crate::robust_table::summarise;
use crate::{BenchError, MaterialPrior, PlanScene, SceneFamily, TrueWorlds};
use sms_core::metrics::Metrics;
use sms_core::{Cancel, Hash, InputError, Progress, Seed, StageContext, Warnings, hash_serializable};
use sms_plan::{Perturbation, PlanConfig, optimiser, plan, search_nominal};
use sms_sim::{RapierFactory, WorldFactory};
use sms_target::TargetEngine;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Condvar, Mutex};
use std::time::Instant;

/// Cost of building and settling a perturbed world, in rollouts (`sms-experiments plan`: 35 ms to 21 ms, rounded up).
const WORLD_ROLLOUTS: usize = 2;
/// Name of the planner that the others are compared with: planning for the given world alone.
pub(crate) const PLAIN: &str = "plain";
/// Name of the best shot in the true world.
pub(crate) const ORACLE: &str = "oracle";

/// Settings of the comparison.
#[derive(Debug, Clone)]
pub struct RobustBench {
    /// Seeds of the scenes.
    pub seeds: Vec<u64>,
    /// Family of the scenes.
    pub family: SceneFamily,
    /// The planner's knowledge of materials.
    pub material_prior: MaterialPrior,
    /// True worlds per scene.
    pub worlds: usize,
    /// Robust planners: name and settings. Plain planning costs as much as the first.
    pub planners: Vec<(String, PlanConfig)>,
    /// Shots of the search in the true world, for the regret; 0 leaves it out.
    pub oracle_evaluations: usize,
    /// Runs with everything a micrometre elsewhere, for the chaos floor.
    pub chaos_runs: usize,
    /// Errors of poses, radii and strikes in the true worlds.
    pub errors: Perturbation,
    /// Whether the arm strikes, in planning and in the true worlds; otherwise a kinematic finger does.
    pub arm: bool,
    /// Engine of the true worlds; the planner's own where there is none.
    pub engine: Option<TargetEngine>,
}

impl RobustBench {
    /// The planner's default settings against plain planning, with the prior `noisy`.
    pub fn new(seeds: Vec<u64>, family: SceneFamily) -> Self {
        let robust = PlanConfig { sensitivity_rollouts: 0, ..PlanConfig::default() };
        Self {
            seeds,
            family,
            material_prior: MaterialPrior::Noisy,
            worlds: 48,
            errors: robust.perturbation.clone(),
            planners: vec![("robust".to_owned(), robust)],
            oracle_evaluations: 4000,
            chaos_runs: 8,
            arm: false,
            engine: None,
        }
    }

    /// Returns the hash of all inputs to a scene's figures except the seeds.
    fn hash(&self) -> Hash {
        let planners: BTreeMap<&String, String> =
            self.planners.iter().map(|(name, config)| (name, hash_serializable(config).0)).collect();
        let first = self.planners.first().map(|p| p.0.as_str());
        hash_serializable(&(
            (self.family, self.material_prior, self.worlds, self.oracle_evaluations, self.chaos_runs),
            (&self.errors, self.arm, self.engine.map(TargetEngine::name)),
            (planners, first),
        ))
    }

    /// Checks that the results of an earlier run or of another shard have the same settings.
    ///
    /// # Errors
    /// [`InputError`] that names the file.
    pub fn check_same(&self, earlier: &Metrics, path: &Path) -> Result<(), InputError> {
        let theirs = earlier.get(SETTINGS).and_then(|v| v.as_str());
        if theirs == Some(self.hash().0.as_str()) {
            return Ok(());
        }
        let what = match theirs {
            Some(_) => "these results are of other settings than this run's",
            None => "it is not known of which settings these results are",
        };
        Err(InputError::new(
            what,
            path,
            "give the same --family, --materials, --worlds, --oracle, --planners, --arm and --engine, or leave the \
             file out of --with",
        ))
    }

    /// Prefix of the keys of a job's figures.
    fn prefix(&self, job: Job, scenes: &[PlanScene]) -> String {
        let (name, scene) = match job {
            Job::Robust { scene, planner } => (self.planners[planner].0.as_str(), scene),
            Job::Plain { scene } => (PLAIN, scene),
            Job::Oracle { scene } => (ORACLE, scene),
        };
        format!("bench.robust.{name}.scene_{}.", scenes[scene].seed)
    }

    /// Rollouts of a nominal plan that costs as much as a robust one with `rollouts`.
    fn cost(&self, rollouts: usize) -> usize {
        let built = self.planners.first().map_or(0, |(_, config)| match config.perturbation.worlds {
            0 => 0,
            worlds => 2 * worlds + config.forecast_worlds,
        });
        rollouts + WORLD_ROLLOUTS * built
    }

    /// Names of all planners in the order of the table.
    pub(crate) fn names(&self) -> Vec<&str> {
        std::iter::once(PLAIN).chain(self.planners.iter().map(|(name, _)| name.as_str())).collect()
    }
}

/// Key of the hash of the settings.
const SETTINGS: &str = "bench.robust.settings";

/// One piece of work. Jobs are independent, except that plain planning waits for the cost of robust planning.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Job {
    Robust { scene: usize, planner: usize },
    Plain { scene: usize },
    Oracle { scene: usize },
}

/// Plans with every planner on every scene, executes each plan in the same [`TrueWorlds`], and searches the first
/// of them for the best shot that there is. Every job runs on one thread, so that its CPU seconds can be measured; rayon's
/// current number of threads works side by side. The figures but the CPU seconds depend on seeds alone.
///
/// Plain planning gets as many rollouts as the first robust planner spends in all: search, choice and forecast, and two
/// for each perturbed world that it builds. Keys are those of experiments/metrics.md. The figures in `known` (of an earlier run, or
/// of another shard) are not computed again; `keep` is given all figures of scenes so far whenever a job is done.
///
/// # Errors
/// [`BenchError`].
pub fn run_robust(
    bench: &RobustBench,
    known: &Metrics,
    keep: &(dyn Fn(&Metrics) -> Result<(), BenchError> + Sync),
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<Metrics, BenchError> {
    let scenes: Vec<PlanScene> = bench
        .seeds
        .iter()
        .map(|&s| {
            let scene = PlanScene::with_prior(bench.family, s, bench.material_prior)?;
            Ok(if bench.arm { PlanScene { task: scene.arm_task()?, ..scene } } else { scene })
        })
        .collect::<Result<_, BenchError>>()?;
    let factory = bench.engine.map(TargetEngine::factory).transpose()?;
    let all = 0..scenes.len();
    let mut jobs: Vec<Job> = Vec::new();
    for scene in all.clone() {
        jobs.extend((0..bench.planners.len()).map(|planner| Job::Robust { scene, planner }));
        jobs.push(Job::Plain { scene });
    }
    if bench.oracle_evaluations > 0 {
        jobs.extend(all.map(|scene| Job::Oracle { scene }));
    }
    let mut metrics = Metrics::new();
    metrics.set(SETTINGS, bench.hash().0);
    let mut costs = vec![None; scenes.len()];
    jobs.retain(|&job| {
        let prefix = bench.prefix(job, &scenes);
        let is_known = known.number(&format!("{prefix}cpu_s")).is_some();
        for (key, value) in known.iter().filter(|(key, _)| is_known && key.starts_with(&prefix)) {
            metrics.set(key.clone(), value.clone());
        }
        let rollouts = metrics.number(&format!("{prefix}rollouts"));
        if let (Job::Robust { scene, planner: 0 }, Some(n)) = (job, rollouts) {
            costs[scene] = Some(bench.cost(n as usize));
        }
        !is_known
    });
    let queue = Queue { waiting: Mutex::new((jobs.clone(), costs)), changed: Condvar::new() };
    let running = Running { bench, scenes: &scenes, queue: &queue, engine: factory.as_deref() };
    progress.begin("bench robust", jobs.len() as u64);
    let (done, found) = (AtomicUsize::new(0), Mutex::new(metrics));
    let work = || -> Result<(), BenchError> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().map_err(|e| {
            InputError::new(format!("no thread can be started: {e}"), "bench robust", "use fewer threads")
        })?;
        while let Some((job, budget)) = queue.next() {
            let row = pool.install(|| running.run(job, budget, cancel));
            if row.is_err() {
                queue.abandon();
            }
            let row = row?;
            if let Ok(mut found) = found.lock() {
                found.merge(row);
                keep(&found)?;
            }
            progress.update(done.fetch_add(1, Ordering::SeqCst) as u64 + 1, "plans");
        }
        Ok(())
    };
    let outcomes: Vec<Result<(), BenchError>> = std::thread::scope(|scope| {
        let count = rayon::current_num_threads().min(jobs.len());
        let threads: Vec<_> = (0..count).map(|_| scope.spawn(work)).collect();
        threads
            .into_iter()
            .map(|t| match t.join() {
                Ok(outcome) => outcome,
                Err(panic) => std::panic::resume_unwind(panic),
            })
            .collect()
    });
    outcomes.into_iter().collect::<Result<(), _>>()?;
    progress.end("");
    let mut metrics = found.into_inner().unwrap_or_default();
    metrics.set("bench.robust.engine", factory.as_deref().map_or(RapierFactory.engine(), |f| f.engine()));
    if let Some(scene) = scenes.first() {
        metrics.set("bench.robust.striker", scene.task.striker_name());
    }
    summarise(bench, &mut metrics);
    Ok(metrics)
}

/// Remaining jobs in order, and the rollouts that plain planning may spend on each scene once they are known.
struct Queue {
    waiting: Mutex<(Vec<Job>, Vec<Option<usize>>)>,
    changed: Condvar,
}

impl Queue {
    /// The first job that need not wait for another, with its budget if it is plain planning. `None` when all is done
    /// or being done.
    fn next(&self) -> Option<(Job, usize)> {
        let mut state = self.waiting.lock().ok()?;
        loop {
            let (jobs, costs) = &mut *state;
            if jobs.is_empty() {
                return None;
            }
            let ready = jobs.iter().position(|job| match job {
                Job::Plain { scene } => costs[*scene].is_some(),
                Job::Robust { .. } | Job::Oracle { .. } => true,
            });
            if let Some(index) = ready {
                let job = jobs.remove(index);
                let budget = if let Job::Plain { scene } = job { costs[scene] } else { None };
                return Some((job, budget.unwrap_or(0)));
            }
            state = self.changed.wait(state).ok()?;
        }
    }

    fn set_cost(&self, scene: usize, rollouts: usize) {
        if let Ok(mut state) = self.waiting.lock() {
            state.1[scene] = Some(rollouts);
        }
        self.changed.notify_all();
    }

    /// Nothing more is to be done.
    fn abandon(&self) {
        if let Ok(mut state) = self.waiting.lock() {
            state.0.clear();
        }
        self.changed.notify_all();
    }
}

struct Running<'a> {
    bench: &'a RobustBench,
    scenes: &'a [PlanScene],
    queue: &'a Queue,
    /// Engine of the true worlds.
    engine: Option<&'a dyn WorldFactory>,
}

/// Time steps of another engine than the planner's, as a share of the planner's.
const STEP: f64 = 0.25;

impl Running<'_> {
    fn worlds<'s>(&'s self, scene: &'s PlanScene, count: usize) -> Result<TrueWorlds<'s>, BenchError> {
        let worlds = TrueWorlds::new(scene, &self.bench.errors, count)?;
        Ok(match self.engine {
            Some(factory) => worlds.simulated_by(factory, STEP),
            None => worlds,
        })
    }

    fn run(&self, job: Job, budget: usize, cancel: &Cancel) -> Result<Metrics, BenchError> {
        let prefix = self.bench.prefix(job, self.scenes);
        match job {
            Job::Robust { scene, planner } => {
                let (metrics, rollouts) =
                    self.plan(scene, &prefix, &self.bench.planners[planner].1, cancel)?;
                if planner == 0 {
                    self.queue.set_cost(scene, self.bench.cost(rollouts));
                }
                Ok(metrics)
            }
            Job::Plain { scene } => {
                let base = self.bench.planners.first().map(|p| p.1.clone()).unwrap_or_default();
                let perturbation = Perturbation { worlds: 0, ..base.perturbation.clone() };
                let config = PlanConfig { evaluations: budget.max(1), perturbation, ..base };
                Ok(self.plan(scene, &prefix, &config, cancel)?.0)
            }
            Job::Oracle { scene } => self.oracle(scene, &prefix, cancel),
        }
    }

    /// Plans and executes the plan; returns the figures of the scene and the rollouts of the plan.
    fn plan(
        &self,
        scene: usize,
        prefix: &str,
        config: &PlanConfig,
        cancel: &Cancel,
    ) -> Result<(Metrics, usize), BenchError> {
        let scene = &self.scenes[scene];
        let (seed, warnings) = (Seed(scene.seed).derive("bench robust"), Warnings::new());
        let clock = ThreadClock::start();
        let outcome = plan(
            &scene.task,
            &scene.scene,
            &RapierFactory,
            config,
            StageContext::quiet(cancel, &warnings).with_seed(seed),
        )?;
        let cpu_s = clock.seconds();
        let worlds = self.worlds(scene, self.bench.worlds)?;
        let action = &outcome.plan.action;
        let realised = worlds.realise(action, cancel)?;
        let invalid = realised.iter().filter(|v| v.is_none()).count();
        // An invalid rollout counts as a shot without effect; the table counts such worlds.
        let initial = scene.task.initial_objective();
        let mut values: Vec<f64> = realised.iter().map(|v| v.unwrap_or(initial)).collect();
        let n = values.len().max(1) as f64;
        let mut metrics = Metrics::new();
        let mut set = |key: &str, value: f64| {
            if value.is_finite() {
                metrics.set(format!("{prefix}{key}"), value);
            }
        };
        set("realised_m", values.iter().sum::<f64>() / n);
        set("first_m", values.first().copied().unwrap_or(f64::NAN));
        set("success_share", values.iter().filter(|&&v| scene.task.is_success(v)).count() as f64 / n);
        values.sort_by(f64::total_cmp);
        set("realised_median_m", values.get(values.len() / 2).copied().unwrap_or(f64::NAN));
        set("realised_q90_m", values.get(values.len() * 9 / 10).copied().unwrap_or(f64::NAN));
        set("invalid", invalid as f64);
        set("predicted_m", outcome.plan.predicted.map_or(f64::NAN, |p| p.mean));
        set("nominal_m", outcome.plan.objective);
        set("rollouts", outcome.plan.evaluations as f64);
        set("cpu_s", cpu_s);
        set("chaos_m", worlds.chaos(action, self.bench.chaos_runs, cancel)?.unwrap_or(f64::NAN));
        Ok((metrics, outcome.plan.evaluations))
    }

    /// The best shot of a search in the first true world itself.
    fn oracle(&self, scene: usize, prefix: &str, cancel: &Cancel) -> Result<Metrics, BenchError> {
        let scene = &self.scenes[scene];
        let worlds = self.worlds(scene, 1)?;
        let factory = self.engine.unwrap_or(&RapierFactory);
        let budget = self.bench.oracle_evaluations;
        let config = PlanConfig { evaluations: budget, ..PlanConfig::default() };
        let seed = Seed(scene.seed).derive("oracle").derive("search");
        let clock = ThreadClock::start();
        let found = search_nominal(
            &scene.task,
            worlds.scene(0),
            factory,
            &|space, feasible| optimiser(space, &config, seed, feasible),
            budget,
            cancel,
        )?;
        let best = Some(found.best()).filter(|v| v.is_finite());
        let best = best.unwrap_or_else(|| scene.task.initial_objective());
        let mut metrics = Metrics::new();
        metrics.set(format!("{prefix}best_m"), best);
        metrics.set(format!("{prefix}initial_m"), scene.task.initial_objective());
        metrics.set(format!("{prefix}cpu_s"), clock.seconds());
        Ok(metrics)
    }
}

/// CPU seconds of this thread; where the system does not tell, those of the clock on the wall.
struct ThreadClock {
    cpu_s: Option<f64>,
    began: Instant,
}

impl ThreadClock {
    fn start() -> Self {
        Self { cpu_s: thread_cpu_seconds(), began: Instant::now() }
    }

    fn seconds(&self) -> f64 {
        match (self.cpu_s, thread_cpu_seconds()) {
            (Some(then), Some(now)) => now - then,
            _ => self.began.elapsed().as_secs_f64(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robust_table;
    use sms_core::NoProgress;

    #[test]
    fn fixed_scenes_go_by_their_numbers() {
        assert!(SceneFamily::Fixed.generate(18).is_ok());
        for none in [0, 19] {
            assert!(SceneFamily::Fixed.generate(none).unwrap_err().to_string().contains("1 to 18"));
        }
    }

    #[test]
    fn what_the_arm_cannot_make_is_no_rollout_of_a_true_world() {
        let scene = PlanScene::with_prior(SceneFamily::Crowded, 1005, MaterialPrior::Truth).unwrap();
        let mut scene = PlanScene { task: scene.arm_task().unwrap(), ..scene };
        let action = scene.task.suggestions().swap_remove(0);
        let errors = Perturbation::default();
        let realise = |scene: &PlanScene| {
            TrueWorlds::new(scene, &errors, 2).unwrap().realise(&action, &Cancel::new()).unwrap()
        };
        assert!(realise(&scene).iter().all(Option::is_some));
        scene.robot.x_recording_robot =
            Some([[1.0, 0.0, 0.0, -9.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]);
        scene.task = scene.arm_task().unwrap();
        assert_eq!(realise(&scene), [None, None]);
    }

    #[test]
    fn figures_are_complete_do_not_depend_on_threads_and_shards_make_the_whole() {
        let small = PlanConfig {
            robust_evaluations: 12,
            scan: 8,
            candidates: 4,
            descents: 1,
            descent: 2,
            finalists: 2,
            polish_starts: 0,
            forecast_worlds: 2,
            sensitivity_rollouts: 0,
            perturbation: Perturbation { worlds: 2, ..Perturbation::default() },
            ..PlanConfig::draft()
        };
        let mut bench = RobustBench::new(vec![1001, 1002], SceneFamily::Open);
        (bench.worlds, bench.oracle_evaluations, bench.chaos_runs) = (2, 10, 1);
        bench.planners = vec![("robust".to_owned(), small)];
        let kept = AtomicUsize::new(0);
        let run = |bench: &RobustBench, known: &Metrics, threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let keep = |_: &Metrics| {
                kept.fetch_add(1, Ordering::SeqCst);
                Ok(())
            };
            pool.install(|| run_robust(bench, known, &keep, &NoProgress, &Cancel::new())).unwrap()
        };
        let whole = run(&bench, &Metrics::new(), 2);
        let part = run(&RobustBench { seeds: vec![1002], ..bench.clone() }, &Metrics::new(), 1);
        assert_eq!(kept.swap(0, Ordering::SeqCst), 9, "three jobs a scene");
        let merged = run(&bench, &part, 1);
        assert_eq!(kept.load(Ordering::SeqCst), 3, "one scene is known");
        let is_time = |key: &str| key.ends_with("cpu_s");
        for (key, value) in whole.iter().filter(|(k, _)| !is_time(k)) {
            assert_eq!(merged.get(key), Some(value), "{key}");
        }
        for name in ["plain", "robust"] {
            for key in ["realised_m", "rollouts", "cpu_s", "regret_m", "chaos_m", "invalid"] {
                let value = whole.number(&format!("bench.robust.{name}.{key}"));
                assert!(value.is_some_and(f64::is_finite), "{name} {key}: {value:?}");
            }
        }
        let rollouts = |name: &str| whole.number(&format!("bench.robust.{name}.rollouts")).unwrap();
        assert!(rollouts("plain") >= rollouts("robust"), "plain planning gets at least as much");
        assert!(whole.number("bench.robust.robust.change_share").is_some());
        let other = RobustBench { worlds: 3, ..bench.clone() };
        let path = Path::new("part.json");
        bench.check_same(&part, path).unwrap();
        for (bench, results) in [(&other, &part), (&bench, &Metrics::new())] {
            let message = bench.check_same(results, path).unwrap_err().to_string();
            assert!(message.contains("settings") && message.contains("part.json"), "{message}");
        }
        let table = robust_table(&bench, &whole);
        assert!(table.contains("1002") && table.contains("robust"), "{table}");
        for key in ["bench.robust.engine", "bench.robust.striker"] {
            let material_prior = whole.get(key).and_then(|v| v.as_str()).unwrap();
            assert!(
                !material_prior.is_empty() && table.contains(material_prior),
                "{key}: {material_prior}; {table}"
            );
        }
    }
}
