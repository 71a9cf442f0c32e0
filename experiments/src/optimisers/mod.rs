//! `sms-experiments optimisers`: search methods at equal numbers of rollouts.

mod cma_es;
mod jacobi;

use self::cma_es::{CmaSearch, CmaSettings};
use crate::bootstrap::{median, paired_difference};
use crate::{BenchError, PlanScene, SceneFamily};
use rayon::prelude::*;
use sms_core::metrics::Metrics;
use sms_core::{Cancel, Progress, Seed};
use sms_plan::{Method, PlanConfig, PlanError, SearchLog, optimiser, screening, search_nominal};
use sms_sim::RapierFactory;
use sms_task::ResolvedTask;
use std::fmt::Write as _;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Name of CMA-ES in keys.
const CMA_ES: &str = "cma_es";

/// Rollouts that one of the paper's searches of 30 iterations takes in four dimensions.
const PAPER_SEARCH: usize = 53;

/// A search method.
#[derive(Debug, Clone)]
pub enum Entrant {
    /// A method of the planner with settings; the budget replaces their `evaluations`.
    Planner(Box<PlanConfig>),
    /// CMA-ES (IPOP) from the best points of a scan, with the planner's default settings of scan and tolerances.
    CmaEs,
}

/// Share of the budget that CMA-ES spends on its scan.
const CMA_SCREENING_SHARE: f64 = 0.5;

impl Entrant {
    fn search(
        &self,
        task: &ResolvedTask,
        scene: &PlanScene,
        budget: usize,
        cancel: &Cancel,
    ) -> Result<SearchLog, PlanError> {
        let seed = Seed(scene.seed).derive("bench optimisers").derive("search");
        match self {
            Self::Planner(config) => {
                let config = with_budget(config, budget);
                search_nominal(
                    task,
                    &scene.scene,
                    &RapierFactory,
                    &|space, feasible| optimiser(space, &config, seed, feasible),
                    budget,
                    cancel,
                )
            }
            Self::CmaEs => {
                let config = PlanConfig::default();
                let settings = CmaSettings {
                    initial_step: config.initial_step,
                    starts: config.starts,
                    population: 0,
                    x_tolerance: config.nelder_mead.x_tolerance,
                    f_tolerance: config.nelder_mead.f_tolerance,
                };
                let count = ((budget as f64 * CMA_SCREENING_SHARE).round() as usize).max(1);
                search_nominal(
                    task,
                    &scene.scene,
                    &RapierFactory,
                    &|space, feasible| {
                        let screen = screening::points(space, config.suggestions, seed, count, feasible)?;
                        Ok(Box::new(CmaSearch::new(space, settings.clone(), screen, seed)))
                    },
                    budget,
                    cancel,
                )
            }
        }
    }
}

/// Settings of the comparison.
#[derive(Debug, Clone)]
pub struct OptimiserBench {
    /// Seeds of the scenes.
    pub seeds: Vec<u64>,
    /// Family of the scenes.
    pub family: SceneFamily,
    /// Budgets, rollouts.
    pub evaluations: Vec<usize>,
    /// The methods by name.
    pub entrants: Vec<(String, Entrant)>,
    /// Name of the method that the others are compared with.
    pub baseline: String,
    /// Whether the arm strikes, which cannot make every strike; else a kinematic finger.
    pub arm: bool,
}

impl OptimiserBench {
    /// The planner's methods and CMA-ES, compared with the paper's multi-start search.
    pub fn new(seeds: Vec<u64>, family: SceneFamily, evaluations: Vec<usize>) -> Self {
        let planner =
            |method: Method| (method.as_str().to_owned(), Entrant::Planner(Box::new(Self::settings(method))));
        let mut entrants: Vec<_> = Method::ALL.into_iter().map(planner).collect();
        entrants.push((CMA_ES.to_owned(), Entrant::CmaEs));
        Self {
            seeds,
            family,
            evaluations,
            entrants,
            baseline: Method::MultiStart.as_str().to_owned(),
            arm: false,
        }
    }

    /// The settings with which a method enters.
    pub fn settings(method: Method) -> PlanConfig {
        match method {
            Method::MultiStart => PlanConfig::paper(),
            Method::Halving => PlanConfig { method, ..PlanConfig::default() },
        }
    }
}

/// Result of one search.
struct Best {
    objective: f64,
    success: bool,
    starts: usize,
    /// Local searches without any value.
    blind: usize,
}

fn with_budget(config: &PlanConfig, budget: usize) -> PlanConfig {
    let mut config = PlanConfig { evaluations: budget, ..config.clone() };
    if config.method == Method::MultiStart {
        // The number of the paper's searches that fit into the budget.
        config.starts = (budget / PAPER_SEARCH).clamp(1, config.starts);
    }
    config
}

/// Best objective in metres that each method finds within each budget, over the scenes. Keys are
/// `bench.optimisers.{name}.{evaluations}.{mean_m, median_m, success_share, blind_starts_share, difference_m,
/// difference_low_m, difference_high_m}`; `blind_starts_share` is the share of local searches that end without any value,
/// mean over scenes: every strike that they tried was refused by the robot or could not be believed. The differences are
/// those of the means to the baseline with a paired 95 % bootstrap interval over scenes. The figures do not depend on the
/// number of threads.
///
/// # Errors
/// [`BenchError`]: interruption, or settings out of range.
pub fn run_optimisers(
    bench: &OptimiserBench,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<Metrics, BenchError> {
    let scenes: Vec<PlanScene> =
        bench.seeds.iter().map(|&s| PlanScene::new(bench.family, s)).collect::<Result<_, _>>()?;
    let jobs: Vec<(usize, usize, usize)> = (0..bench.entrants.len())
        .flat_map(|e| (0..bench.evaluations.len()).map(move |b| (e, b)))
        .flat_map(|(e, b)| (0..scenes.len()).map(move |s| (e, b, s)))
        .collect();
    let tasks: Vec<_> = scenes
        .iter()
        .map(|s| if bench.arm { s.arm_task() } else { Ok(s.task.clone()) })
        .collect::<Result<_, _>>()?;
    progress.begin("bench optimisers", jobs.len() as u64);
    let done = AtomicUsize::new(0);
    let best: Vec<Best> = jobs
        .par_iter()
        .map(|&(e, b, s)| {
            let (scene, task, budget) = (&scenes[s], &tasks[s], bench.evaluations[b]);
            let found = bench.entrants[e].1.search(task, scene, budget, cancel)?;
            progress.update(done.fetch_add(1, Ordering::SeqCst) as u64 + 1, "searches");
            // A search without a valid rollout leaves the ball where it is.
            let best = Some(found.best()).filter(|v| v.is_finite());
            let objective = best.unwrap_or_else(|| task.initial_objective());
            Ok(Best {
                objective,
                success: task.is_success(objective),
                starts: found.starts.len(),
                blind: found.starts.iter().filter(|s| !s.objective.is_finite()).count(),
            })
        })
        .collect::<Result<_, BenchError>>()?;
    progress.end("");
    let column = |e: usize, b: usize| {
        let first = (e * bench.evaluations.len() + b) * scenes.len();
        &best[first..first + scenes.len()]
    };
    let baseline = bench.entrants.iter().position(|(name, _)| *name == bench.baseline);
    let mut metrics = Metrics::new();
    metrics.set("bench.optimisers.scenes", scenes.len());
    for (e, (name, _)) in bench.entrants.iter().enumerate() {
        for (b, budget) in bench.evaluations.iter().enumerate() {
            let values: Vec<f64> = column(e, b).iter().map(|v| v.objective).collect();
            let mut set = |key: &str, value: f64| {
                metrics.set(format!("bench.optimisers.{name}.{budget}.{key}"), value);
            };
            let n = values.len().max(1) as f64;
            set("mean_m", values.iter().sum::<f64>() / n);
            set("median_m", median(&values));
            set("success_share", column(e, b).iter().filter(|v| v.success).count() as f64 / n);
            let blind = column(e, b).iter().map(|v| v.blind as f64 / v.starts.max(1) as f64).sum::<f64>();
            set("blind_starts_share", blind / n);
            if let Some(other) = baseline.filter(|&o| o != e) {
                let others: Vec<f64> = column(other, b).iter().map(|v| v.objective).collect();
                if let Some(d) = paired_difference(&values, &others) {
                    set("difference_m", d.mean);
                    set("difference_low_m", d.low);
                    set("difference_high_m", d.high);
                }
            }
        }
    }
    Ok(metrics)
}

/// The figures of [`run_optimisers`] as a table, millimetres.
pub fn optimiser_table(bench: &OptimiserBench, metrics: &Metrics) -> String {
    let mut text = format!(
        "best objective found, mm, mean (median) over {} scenes, share of successes, share of local searches without any value; difference to `{}` with its 95 % interval\n",
        bench.seeds.len(),
        bench.baseline
    );
    for budget in &bench.evaluations {
        let _ = writeln!(text, "{budget} rollouts");
        for (name, _) in &bench.entrants {
            let get = |key: &str| metrics.number(&format!("bench.optimisers.{name}.{budget}.{key}"));
            let mm = |key: &str| get(key).map_or_else(|| "?".to_owned(), |v| format!("{:.2}", 1e3 * v));
            let _ = write!(
                text,
                "  {name:<12} {:>8} ({:>7})  {:>4.0} %  {:>4.0} % blind",
                mm("mean_m"),
                mm("median_m"),
                100.0 * get("success_share").unwrap_or(f64::NAN),
                100.0 * get("blind_starts_share").unwrap_or(f64::NAN)
            );
            if get("difference_m").is_some() {
                let _ = write!(
                    text,
                    "  {:>8} [{}, {}]",
                    mm("difference_m"),
                    mm("difference_low_m"),
                    mm("difference_high_m")
                );
            }
            text.push('\n');
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::NoProgress;

    #[test]
    fn figures_are_complete_and_do_not_depend_on_threads() {
        let bench = OptimiserBench::new(vec![1001, 1002], SceneFamily::Open, vec![16]);
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| run_optimisers(&bench, &NoProgress, &Cancel::new())).unwrap()
        };
        let (one, two) = (run(1), run(2));
        assert_eq!(one, two);
        for (name, _) in &bench.entrants {
            let mean = one.number(&format!("bench.optimisers.{name}.16.mean_m")).unwrap();
            assert!(mean.is_finite() && mean > 0.0 && mean < 0.4, "{name}: {mean}");
            let difference = one.number(&format!("bench.optimisers.{name}.16.difference_m"));
            assert_eq!(difference.is_none(), *name == bench.baseline);
        }
        assert!(optimiser_table(&bench, &one).contains("cma_es"));
    }
}
