//! `sms bench robust`: what plans are worth in worlds other than the one that was told.

use crate::robust_table::summarise;
use crate::{BenchError, MaterialsTold, PlanScene, SceneFamily, TrueWorlds, thread_cpu_seconds};
use sms_core::metrics::Metrics;
use sms_core::{Cancel, CoreError, NoProgress, Progress, Seed, Warnings};
use sms_plan::{Disturbances, PlanConfig, plan, search_nominal};
use sms_sim::RapierFactory;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Condvar, Mutex};
use std::time::Instant;

/// What building and settling a disturbed world costs, in rollouts (`sms bench plan`: 35 ms to 21 ms, rounded up).
const WORLD_ROLLOUTS: usize = 2;
/// Name of the planner that the others are compared with: planning for the world as told alone.
pub(crate) const PLAIN: &str = "plain";
/// Name of the best shot in the true world.
pub(crate) const ORACLE: &str = "oracle";

/// What to compare.
#[derive(Debug, Clone)]
pub struct RobustBench {
    /// Seeds of the scenes.
    pub seeds: Vec<u64>,
    /// How hard they are.
    pub family: SceneFamily,
    /// What the planner is told of materials.
    pub told: MaterialsTold,
    /// True worlds per scene.
    pub worlds: usize,
    /// Robust planners: name and settings. Plain planning costs as much as the first.
    pub planners: Vec<(String, PlanConfig)>,
    /// Shots of the search in the true world, for the regret; 0 leaves it out.
    pub oracle_evaluations: usize,
    /// Runs with everything a micrometre elsewhere, for the chaos floor.
    pub chaos_runs: usize,
    /// How far poses, radii and strikes are off in the true worlds.
    pub errors: Disturbances,
}

impl RobustBench {
    /// The planner's default settings against plain planning, told `noisy` materials.
    pub fn new(seeds: Vec<u64>, family: SceneFamily) -> Self {
        let robust = PlanConfig { sensitivity_rollouts: 0, ..PlanConfig::default() };
        Self {
            seeds,
            family,
            told: MaterialsTold::Noisy,
            worlds: 48,
            errors: robust.disturbances.clone(),
            planners: vec![("robust".to_owned(), robust)],
            oracle_evaluations: 4000,
            chaos_runs: 8,
        }
    }

    /// Names of all planners in the order of the table.
    pub(crate) fn names(&self) -> Vec<&str> {
        std::iter::once(PLAIN).chain(self.planners.iter().map(|(name, _)| name.as_str())).collect()
    }
}

/// One thing to do; jobs are independent but for plain planning, which waits to know what robust planning cost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Job {
    Robust { scene: usize, planner: usize },
    Plain { scene: usize },
    Oracle { scene: usize },
}

/// Plans with every planner on every scene, carries each plan out in the same [`TrueWorlds`], and searches the first
/// of them for the best shot that there is. Every job runs on one thread, so that its CPU seconds can be told; rayon's
/// current number of threads works side by side. The figures but the CPU seconds depend on seeds alone.
///
/// Plain planning gets as many rollouts as the first robust planner spends in all: search, choice and forecast, and two
/// for each disturbed world that it builds. Keys: [`summarise`]; scenes whose figures `known` holds (an earlier run, or
/// another shard's) are not run again.
///
/// # Errors
/// [`BenchError`].
pub fn run_robust(
    bench: &RobustBench,
    known: &Metrics,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<Metrics, BenchError> {
    let mut metrics = Metrics::new();
    let todo: Vec<u64> =
        bench.seeds.iter().copied().filter(|&s| !take_known(bench, s, known, &mut metrics)).collect();
    let scenes: Vec<PlanScene> =
        todo.into_iter().map(|s| PlanScene::told(bench.family, s, bench.told)).collect::<Result<_, _>>()?;
    let all = 0..scenes.len();
    // Plain jobs last: by then it is known what they may cost.
    let mut jobs: Vec<Job> = Vec::new();
    for planner in 0..bench.planners.len() {
        jobs.extend(all.clone().map(|scene| Job::Robust { scene, planner }));
    }
    if bench.oracle_evaluations > 0 {
        jobs.extend(all.clone().map(|scene| Job::Oracle { scene }));
    }
    jobs.extend(all.map(|scene| Job::Plain { scene }));
    let bench_state =
        Running { bench, scenes: &scenes, costs: Mutex::new(vec![None; scenes.len()]), told: Condvar::new() };
    let results = side_by_side(&jobs, progress, |job| bench_state.run(job, cancel))?;
    for row in results {
        metrics.merge(row);
    }
    summarise(bench, &mut metrics);
    Ok(metrics)
}

/// Copies the figures of a scene when all are there.
fn take_known(bench: &RobustBench, seed: u64, known: &Metrics, into: &mut Metrics) -> bool {
    let mut names = bench.names();
    if bench.oracle_evaluations > 0 {
        names.push(ORACLE);
    }
    let prefix = |name: &str| format!("bench.robust.{name}.scene_{seed}.");
    let is_known = names.iter().all(|n| known.number(&format!("{}cpu_s", prefix(n))).is_some());
    if is_known {
        for (key, value) in known.iter() {
            if names.iter().any(|n| key.starts_with(&prefix(n))) {
                into.set(key.clone(), value.clone());
            }
        }
    }
    is_known
}

/// Runs jobs in their order on as many threads as rayon's pool has, each on a pool of its own with one thread. Results
/// come in the order of the jobs.
fn side_by_side(
    jobs: &[Job],
    progress: &dyn Progress,
    run: impl Fn(Job) -> Result<Metrics, BenchError> + Sync,
) -> Result<Vec<Metrics>, BenchError> {
    let (next, done) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let results: Mutex<Vec<(usize, Result<Metrics, BenchError>)>> = Mutex::default();
    let failed = std::sync::atomic::AtomicBool::new(false);
    progress.begin("bench robust", jobs.len() as u64);
    std::thread::scope(|scope| {
        for _ in 0..rayon::current_num_threads().min(jobs.len()) {
            scope.spawn(|| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
                loop {
                    let index = next.fetch_add(1, Ordering::SeqCst);
                    if index >= jobs.len() || failed.load(Ordering::SeqCst) {
                        break;
                    }
                    let outcome = match &pool {
                        Ok(pool) => pool.install(|| run(jobs[index])),
                        Err(e) => Err(CoreError::from(sms_core::InputError::new(
                            format!("no thread can be started: {e}"),
                            "bench robust",
                            "use fewer threads",
                        ))
                        .into()),
                    };
                    failed.fetch_or(outcome.is_err(), Ordering::SeqCst);
                    if let Ok(mut results) = results.lock() {
                        results.push((index, outcome));
                    }
                    progress.update(done.fetch_add(1, Ordering::SeqCst) as u64 + 1, "plans");
                }
            });
        }
    });
    progress.end("");
    let mut results = results.into_inner().unwrap_or_default();
    results.sort_by_key(|r| r.0);
    results.into_iter().map(|r| r.1).collect()
}

struct Running<'a> {
    bench: &'a RobustBench,
    scenes: &'a [PlanScene],
    /// Rollouts that plain planning may spend, by scene; 0 where the robust planner failed.
    costs: Mutex<Vec<Option<usize>>>,
    told: Condvar,
}

impl Running<'_> {
    fn run(&self, job: Job, cancel: &Cancel) -> Result<Metrics, BenchError> {
        match job {
            Job::Robust { scene, planner } => {
                let (name, config) = &self.bench.planners[planner];
                let outcome = self.plan(scene, name, config, cancel);
                if planner == 0 {
                    let d = config.disturbances.worlds;
                    let built = if d == 0 { 0 } else { 2 * d + config.forecast_worlds };
                    let spent = outcome.as_ref().map_or(0, |(_, rollouts)| rollouts + WORLD_ROLLOUTS * built);
                    if let Ok(mut costs) = self.costs.lock() {
                        costs[scene] = Some(spent);
                    }
                    self.told.notify_all();
                }
                Ok(outcome?.0)
            }
            Job::Plain { scene } => {
                let evaluations = self.cost(scene);
                let base = self.bench.planners.first().map(|p| p.1.clone()).unwrap_or_default();
                let disturbances = Disturbances { worlds: 0, ..base.disturbances.clone() };
                let config = PlanConfig { evaluations: evaluations.max(1), disturbances, ..base };
                Ok(self.plan(scene, PLAIN, &config, cancel)?.0)
            }
            Job::Oracle { scene } => self.oracle(scene, cancel),
        }
    }

    /// Waits until it is known what plain planning may spend.
    fn cost(&self, scene: usize) -> usize {
        let Ok(mut costs) = self.costs.lock() else { return 0 };
        loop {
            if let Some(cost) = costs[scene] {
                return cost;
            }
            match self.told.wait(costs) {
                Ok(guard) => costs = guard,
                Err(_) => return 0,
            }
        }
    }

    /// Plans, and carries the plan out; the figures of the scene and the rollouts of the plan.
    fn plan(
        &self,
        scene: usize,
        name: &str,
        config: &PlanConfig,
        cancel: &Cancel,
    ) -> Result<(Metrics, usize), BenchError> {
        let scene = &self.scenes[scene];
        let (seed, warnings) = (Seed(scene.seed).derive("bench robust"), Warnings::new());
        let clock = Clock::start();
        let outcome =
            plan(&scene.task, &scene.scene, &RapierFactory, config, seed, &NoProgress, cancel, &warnings)?;
        let cpu_s = clock.seconds();
        let worlds = TrueWorlds::new(scene, &self.bench.errors, self.bench.worlds)?;
        let action = &outcome.plan.action;
        let realised = worlds.realise(action, cancel)?;
        let invalid = realised.iter().filter(|v| v.is_none()).count();
        // Where a true world cannot be believed, the shot is taken to have done nothing; the table counts such worlds.
        let initial = scene.task.initial_objective();
        let mut values: Vec<f64> = realised.iter().map(|v| v.unwrap_or(initial)).collect();
        let n = values.len().max(1) as f64;
        let mut metrics = Metrics::new();
        let mut set = |key: &str, value: f64| {
            if value.is_finite() {
                metrics.set(format!("bench.robust.{name}.scene_{}.{key}", scene.seed), value);
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
    fn oracle(&self, scene: usize, cancel: &Cancel) -> Result<Metrics, BenchError> {
        let scene = &self.scenes[scene];
        let worlds = TrueWorlds::new(scene, &self.bench.errors, 1)?;
        let budget = self.bench.oracle_evaluations;
        let config = PlanConfig { evaluations: budget, ..PlanConfig::default() };
        let seed = Seed(scene.seed).derive("oracle");
        let clock = Clock::start();
        let found =
            search_nominal(&scene.task, worlds.scene(0), &RapierFactory, &config, budget, seed, cancel)?;
        let best = found.best().map_or_else(|| scene.task.initial_objective(), |t| t.objective);
        let mut metrics = Metrics::new();
        let prefix = format!("bench.robust.{ORACLE}.scene_{}", scene.seed);
        metrics.set(format!("{prefix}.best_m"), best);
        metrics.set(format!("{prefix}.initial_m"), scene.task.initial_objective());
        metrics.set(format!("{prefix}.cpu_s"), clock.seconds());
        Ok(metrics)
    }
}

/// CPU seconds of this thread; where the system does not tell, those of the clock on the wall.
struct Clock {
    cpu_s: Option<f64>,
    began: Instant,
}

impl Clock {
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
            disturbances: Disturbances { worlds: 2, ..Disturbances::default() },
            ..PlanConfig::draft()
        };
        let mut bench = RobustBench::new(vec![1001, 1002], SceneFamily::Open);
        (bench.worlds, bench.oracle_evaluations, bench.chaos_runs) = (2, 10, 1);
        bench.planners = vec![("robust".to_owned(), small)];
        let run = |bench: &RobustBench, known: &Metrics, threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| run_robust(bench, known, &NoProgress, &Cancel::new())).unwrap()
        };
        let whole = run(&bench, &Metrics::new(), 2);
        let part = run(&RobustBench { seeds: vec![1002], ..bench.clone() }, &Metrics::new(), 1);
        let merged = run(&bench, &part, 1);
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
        let table = robust_table(&bench, &whole);
        assert!(table.contains("1002") && table.contains("robust"), "{table}");
    }
}
