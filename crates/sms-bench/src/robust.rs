//! `sms bench robust`: what plans are worth in worlds that are one more sample of what is not known.

use crate::{BenchError, PlanScene, SceneFamily, paired_difference};
use rayon::prelude::*;
use sms_core::metrics::Metrics;
use sms_core::{Cancel, NoProgress, Progress, Property, Seed, Warnings};
use sms_plan::{Disturbances, PlanConfig, RobustObjective, plan, rehearse};
use sms_sim::RapierFactory;
use std::fmt::Write as _;
use std::sync::atomic::{AtomicUsize, Ordering};

/// How far the materials may be from what is believed: half widths, as a share of the value, of density, friction and
/// rolling resistance; for restitution, absolute.
const MATERIAL_SHARE: [f64; 3] = [0.25, 0.25, 0.5];
const RESTITUTION: f64 = 0.08;

/// What to compare.
#[derive(Debug, Clone)]
pub struct RobustBench {
    /// Seeds of the scenes.
    pub seeds: Vec<u64>,
    /// How hard they are.
    pub family: SceneFamily,
    /// True worlds per scene.
    pub worlds: usize,
    /// Planners: name and settings. The first is what the others are compared with.
    pub entrants: Vec<(String, PlanConfig)>,
}

impl RobustBench {
    /// Planning for the nominal world with as many rollouts as robust planning takes in all, and robust planning.
    pub fn new(seeds: Vec<u64>, family: SceneFamily) -> Self {
        let robust = PlanConfig { sensitivity_rollouts: 0, forecast_worlds: 1, ..PlanConfig::default() };
        let plain = PlanConfig {
            evaluations: 2 * robust.evaluations,
            disturbances: Disturbances { worlds: 0, ..robust.disturbances.clone() },
            ..robust.clone()
        };
        let mut entrants = vec![("plain".to_owned(), plain)];
        for (name, objective) in [("mean", RobustObjective::Mean), ("q90", RobustObjective::Q90)] {
            entrants.push((name.to_owned(), PlanConfig { objective, ..robust.clone() }));
        }
        Self { seeds, family, worlds: 48, entrants }
    }

    /// Sets the robust planners' nominal budget; plain planning gets twice as many rollouts.
    pub fn set_evaluations(&mut self, evaluations: usize) {
        for (_, config) in &mut self.entrants {
            let twice = config.disturbances.worlds == 0;
            config.evaluations = if twice { 2 * evaluations } else { evaluations };
        }
    }
}

/// A generated scene whose materials are known within intervals only.
fn uncertain(family: SceneFamily, seed: u64) -> Result<PlanScene, BenchError> {
    let mut scene = PlanScene::new(family, seed)?;
    for body in &mut scene.scene.bodies {
        let m = &mut body.material;
        let widen = |p: &mut Property, half: f64, most: f64| {
            let best = p.value.best;
            p.value = sms_core::Interval::new(best, (best - half).max(0.0), (best + half).min(most));
        };
        let [density, friction, rolling] = MATERIAL_SHARE;
        let (d, f, r) = (m.density.value.best, m.friction.value.best, m.rolling_m.value.best);
        widen(&mut m.density, density * d, f64::INFINITY);
        widen(&mut m.friction, friction * f, f64::INFINITY);
        widen(&mut m.rolling_m, rolling * r, f64::INFINITY);
        widen(&mut m.restitution, RESTITUTION, 1.0);
    }
    Ok(scene)
}

/// Plans with every planner on every scene, and carries each plan out in `worlds` true worlds per scene, which are drawn
/// as the planner's disturbed worlds are, from another seed. Keys are `bench.robust.{name}.{realised_mean_m,
/// realised_median_m, success_share, predicted_mean_m, nominal_m, rollouts, change_share, change_low_share,
/// change_high_share, scene_{seed}.realised_m, scene_{seed}.nominal_m}`; the change is that of the realised mean relative to the first planner, with a paired 95 %
/// bootstrap interval over scenes of the difference, divided by the first planner's mean.
///
/// # Errors
/// [`BenchError`].
pub fn run_robust(
    bench: &RobustBench,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<Metrics, BenchError> {
    let scenes: Vec<PlanScene> =
        bench.seeds.iter().map(|&s| uncertain(bench.family, s)).collect::<Result<_, _>>()?;
    let jobs: Vec<(usize, usize)> =
        (0..bench.entrants.len()).flat_map(|e| (0..scenes.len()).map(move |s| (e, s))).collect();
    progress.begin("bench robust", jobs.len() as u64);
    let done = AtomicUsize::new(0);
    let rows: Vec<[f64; 6]> = jobs
        .par_iter()
        .map(|&(e, s)| {
            let (scene, config) = (&scenes[s], &bench.entrants[e].1);
            let (factory, warnings) = (RapierFactory, Warnings::new());
            let seed = Seed(scene.seed).derive("bench robust");
            let outcome =
                plan(&scene.task, &scene.scene, &factory, config, seed, &NoProgress, cancel, &warnings)?;
            let truth = rehearse(
                &scene.task,
                &scene.scene,
                &factory,
                &config.disturbances,
                &outcome.plan.action,
                Seed(scene.seed).derive("true worlds"),
                bench.worlds,
                cancel,
            )?;
            progress.update(done.fetch_add(1, Ordering::SeqCst) as u64 + 1, "plans");
            // Where a true world cannot be believed, the shot is taken to have done nothing.
            let initial = scene.task.initial_objective();
            let truth: Vec<f64> =
                truth.into_iter().map(|v| if v.is_finite() { v } else { initial }).collect();
            let n = truth.len().max(1) as f64;
            let mut sorted = truth.clone();
            sorted.sort_by(f64::total_cmp);
            Ok([
                truth.iter().sum::<f64>() / n,
                sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN),
                truth.iter().filter(|&&v| scene.task.is_success(v)).count() as f64 / n,
                outcome.plan.predicted.map_or(f64::NAN, |p| p.mean),
                outcome.plan.objective,
                outcome.plan.evaluations as f64,
            ])
        })
        .collect::<Result<_, BenchError>>()?;
    progress.end("");
    let mut metrics = Metrics::new();
    metrics.set("bench.robust.scenes", scenes.len());
    let column = |e: usize, k: usize| -> Vec<f64> {
        (0..scenes.len()).map(|s| rows[e * scenes.len() + s][k]).collect()
    };
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len().max(1) as f64;
    for (e, (name, _)) in bench.entrants.iter().enumerate() {
        let mut set = |key: &str, value: f64| {
            if value.is_finite() {
                metrics.set(format!("bench.robust.{name}.{key}"), value);
            }
        };
        set("realised_mean_m", mean(&column(e, 0)));
        set("realised_median_m", mean(&column(e, 1)));
        set("success_share", mean(&column(e, 2)));
        set("predicted_mean_m", mean(&column(e, 3)));
        set("nominal_m", mean(&column(e, 4)));
        set("rollouts", mean(&column(e, 5)));
        for (s, scene) in scenes.iter().enumerate() {
            set(&format!("scene_{}.realised_m", scene.seed), column(e, 0)[s]);
            set(&format!("scene_{}.nominal_m", scene.seed), column(e, 4)[s]);
        }
        let base = mean(&column(0, 0));
        if let Some(d) = paired_difference(&column(e, 0), &column(0, 0)).filter(|_| e > 0) {
            set("change_share", d.mean / base);
            set("change_low_share", d.low / base);
            set("change_high_share", d.high / base);
        }
    }
    Ok(metrics)
}

/// The figures of [`run_robust`] as a table.
pub fn robust_table(bench: &RobustBench, metrics: &Metrics) -> String {
    let mut text = format!(
        "mean over {} scenes of the distance to the goal, mm, in {} true worlds each\n  planner       realised  (median)  success  predicted  nominal  rollouts  change of the mean\n",
        bench.seeds.len(),
        bench.worlds
    );
    for (name, _) in &bench.entrants {
        let get = |key: &str| metrics.number(&format!("bench.robust.{name}.{key}")).unwrap_or(f64::NAN);
        let _ = write!(
            text,
            "  {name:<12} {:>9.1} {:>9.1} {:>7.0} % {:>9.1} {:>9.1} {:>9.0}",
            1e3 * get("realised_mean_m"),
            1e3 * get("realised_median_m"),
            100.0 * get("success_share"),
            1e3 * get("predicted_mean_m"),
            1e3 * get("nominal_m"),
            get("rollouts"),
        );
        if get("change_share").is_finite() {
            let [c, l, h] = ["change_share", "change_low_share", "change_high_share"].map(|k| 100.0 * get(k));
            let _ = write!(text, "  {c:+.0} % [{l:+.0}, {h:+.0}]");
        }
        text.push('\n');
    }
    text
}
