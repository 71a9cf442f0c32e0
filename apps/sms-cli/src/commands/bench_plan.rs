//! `sms bench plan` and `sms bench robust`: the planner's speed and what its plans are worth.

use super::bench_optimisers::{Family, finish, parse_seeds};
use clap::{Args, ValueEnum};
use serde_json::{Map, Value, json};
use sms_cli::front::Console;
use sms_core::metrics::Metrics;
use sms_core::{InputError, atomic};
use sms_experiments::{
    MaterialsTold, PlanScene, RobustBench, Shard, merge_plan_speed, part_of, robust_table, run_plan_speed,
};
use sms_plan::PlanConfig;
use sms_target::TargetEngine;
use std::collections::BTreeMap;
use std::path::PathBuf;

#[derive(Debug, Args, Clone)]
pub(crate) struct BenchPlan {
    /// Seeds of the generated billiards scenes.
    #[arg(long, value_name = "SEEDS", default_value = "1001..1003")]
    pub seeds: String,
    /// How hard they are.
    #[arg(long, value_enum, default_value = "open")]
    pub family: Family,
    /// Only every n-th scene, from the i-th (i/n, from 1); for `sms bench merge`.
    #[arg(long, value_name = "I/N", requires = "out")]
    pub shard: Option<String>,
    /// File for the results.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

#[derive(Debug, Args, Clone)]
pub(crate) struct BenchRobust {
    /// Seeds of the generated billiards scenes.
    #[arg(long, value_name = "SEEDS", default_value = "1001..1012")]
    pub seeds: String,
    /// How hard they are.
    #[arg(long, value_enum, default_value = "crowded")]
    pub family: Family,
    /// What the planner is told of the true materials.
    #[arg(long, value_enum, default_value = "noisy")]
    pub materials: Told,
    /// True worlds per scene in which each plan is carried out.
    #[arg(long, value_name = "N", default_value_t = 48)]
    pub worlds: usize,
    /// Shots of the search in the true world itself, for the regret; 0 leaves it out.
    #[arg(long, value_name = "N", default_value_t = 4000)]
    pub oracle: usize,
    /// Robust planners to compare: a TOML file with one table a planner, each with keys of `[plan]` (default: the
    /// planner's settings). Planning for the scanned world alone costs as much as the first.
    #[arg(long, value_name = "FILE")]
    pub planners: Option<PathBuf>,
    /// Let the arm strike, in planning and in the true worlds, in place of the finger that gives no way.
    #[arg(long)]
    pub arm: bool,
    /// Engine of the true worlds; the planner's own is rapier.
    #[arg(long, value_enum, default_value = "rapier")]
    pub engine: TrueEngine,
    /// Only every n-th scene, from the i-th (i/n, from 1); for `sms bench merge`.
    #[arg(long, value_name = "I/N", requires = "out")]
    pub shard: Option<String>,
    /// Results of earlier runs, interrupted ones too, or of other shards, with the same settings: what is in them is not
    /// run again.
    #[arg(long, value_name = "FILES", value_delimiter = ',')]
    pub with: Vec<PathBuf>,
    /// File for the results; written after every plan.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Engine of the true worlds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum TrueEngine {
    /// The planner's own.
    Rapier,
    /// PhysX, precise, at a quarter of the planner's time step.
    Physx,
}

/// What the planner is told of materials.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Told {
    /// The true class with the handbook's values.
    Class,
    /// The true values with the errors that vision-language models make.
    Noisy,
    /// Nothing.
    Prior,
    /// The truth.
    Truth,
    /// What a vision-language model says of the scan's views (SMS_VLM_URL, SMS_VLM_MODEL).
    Vlm,
}

impl Told {
    pub(crate) fn told(self) -> MaterialsTold {
        match self {
            Self::Class => MaterialsTold::Class,
            Self::Noisy => MaterialsTold::Noisy,
            Self::Prior => MaterialsTold::Prior,
            Self::Truth => MaterialsTold::Truth,
            Self::Vlm => MaterialsTold::Vlm,
        }
    }
}

/// Plans with the settings of `[plan]`.
pub(crate) fn run(console: &Console, a: &BenchPlan) -> anyhow::Result<()> {
    let part = a.shard.as_deref().map(parse_shard).transpose()?.unwrap_or((1, 1));
    let config = console.context.settings.section("plan", PlanConfig::default())?;
    let mut shard =
        Shard::new("plan", part, settings([("family", json!(a.family.family())), ("plan", json!(config))]));
    for seed in part_of(parse_seeds(&a.seeds)?, part) {
        let scene = PlanScene::new(a.family.family(), seed)?;
        let figures =
            run_plan_speed(&[scene], &config, console.context.progress.as_ref(), &console.context.cancel)?;
        shard.add(&seed.to_string(), &figures);
    }
    if let (Some(out), Some(_)) = (&a.out, &a.shard) {
        shard.save(&Shard::path_beside(out))?;
    }
    show_plan(console, &shard, a.out.as_ref())
}

/// Figures and text of a run of `sms bench plan`, or of merged parts.
pub(crate) fn show_plan(console: &Console, whole: &Shard, out: Option<&PathBuf>) -> anyhow::Result<()> {
    let each: Vec<Metrics> = whole.items.keys().map(|k| whole.figures(k)).collect();
    let metrics = merge_plan_speed(&each);
    finish(console, &metrics, out, &speed_text(&metrics))
}

fn speed_text(metrics: &Metrics) -> String {
    let get = |key: &str| metrics.number(&format!("bench.plan.{key}")).unwrap_or(f64::NAN);
    format!(
        "one shot: {:.1} ms ({:.0} a second on one thread), {:.0} steps, of which {:.0} by splitting\n  \
         engine {:.0} %, impacts {:.0} %, arm {:.0} %, planning its sweep {:.0} %, restore {:.1} %, other {:.0} %; with a \
         finger that gives no way {:.1} ms\n  \
         {:.0} % of the strikes are refused, in {:.1} ms each; building a world takes {:.1} ms\n\
         one plan on {:.0} threads: {:.1} s for the scanned world alone, {:.1} s robust, {:.1} s the paper's way",
        1e3 * get("evaluation_s"),
        get("evaluations_per_s"),
        get("steps"),
        get("splits"),
        100.0 * get("engine_share"),
        100.0 * get("impacts_share"),
        100.0 * get("arm_share"),
        100.0 * get("sweep_plan_share"),
        100.0 * get("restore_share"),
        100.0 * get("other_share"),
        1e3 * get("finger_evaluation_s"),
        100.0 * get("refused"),
        1e3 * get("refusal_s"),
        1e3 * get("prepare_s"),
        get("threads"),
        get("scene_s"),
        get("robust_scene_s"),
        get("paper_scene_s"),
    )
}

/// Settings of a part by their names.
pub(crate) fn settings<const N: usize>(all: [(&str, Value); N]) -> Map<String, Value> {
    all.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
}

pub(crate) fn run_robust(console: &Console, a: &BenchRobust) -> anyhow::Result<()> {
    let part = a.shard.as_deref().map(parse_shard).transpose()?;
    let seeds = part_of(parse_seeds(&a.seeds)?, part.unwrap_or((1, 1)));
    let mut bench = RobustBench::new(seeds, a.family.family());
    if a.materials == Told::Vlm {
        let what = "a vision-language model needs pictures, and these scenes are not scanned";
        return Err(InputError::new(what, "--materials", "ask one in `sms bench billiards`").into());
    }
    bench.told = a.materials.told();
    bench.worlds = a.worlds.max(1);
    bench.oracle_evaluations = a.oracle;
    if let Some(path) = &a.planners {
        let planners: BTreeMap<String, PlanConfig> = atomic::read_toml(path)?;
        for config in planners.values() {
            config.validate(path)?;
        }
        if planners.is_empty() || planners.contains_key("plain") || planners.contains_key("oracle") {
            let what = "the file needs a table for each planner, none called `plain` or `oracle`";
            return Err(InputError::new(what, path, "write for example [mean] and [q90]").into());
        }
        bench.planners = planners.into_iter().collect();
    }
    bench.arm = a.arm;
    bench.engine = match a.engine {
        TrueEngine::Rapier => None,
        TrueEngine::Physx => Some(TargetEngine::Physx),
    };
    let mut known = Metrics::new();
    for path in &a.with {
        let earlier = Metrics::load(path)?;
        bench.check_same(&earlier, path)?;
        known.merge(earlier);
    }
    // What is done is kept at once: an interrupted run goes on with `--with` this file.
    let keep = |metrics: &Metrics| match &a.out {
        Some(out) => Ok(metrics.save(out)?),
        None => Ok(()),
    };
    let metrics = sms_experiments::run_robust(
        &bench,
        &known,
        &keep,
        console.context.progress.as_ref(),
        &console.context.cancel,
    )?;
    if let (Some(out), Some(part)) = (&a.out, part) {
        let mut shard = Shard::new("robust", part, robust_settings(&bench));
        for &seed in &bench.seeds {
            let mut own = Metrics::new();
            let of_scene = format!(".scene_{seed}.");
            for (key, value) in metrics.iter().filter(|(key, _)| key.contains(&of_scene)) {
                own.set(key.clone(), value.clone());
            }
            shard.add(&seed.to_string(), &own);
        }
        shard.save(&Shard::path_beside(out))?;
    }
    finish(console, &metrics, a.out.as_ref(), robust_table(&bench, &metrics).trim_end())
}

fn robust_settings(bench: &RobustBench) -> Map<String, Value> {
    settings([
        ("family", json!(bench.family)),
        ("materials", json!(bench.told)),
        ("worlds", json!(bench.worlds)),
        ("oracle", json!(bench.oracle_evaluations)),
        ("planners", json!(bench.planners)),
        ("chaos_runs", json!(bench.chaos_runs)),
        ("errors", json!(bench.errors)),
        ("arm", json!(bench.arm)),
        ("engine", json!(bench.engine.map(TargetEngine::name))),
    ])
}

/// Seeds that are the names of items, in order.
pub(crate) fn seeds_of(whole: &Shard) -> Vec<u64> {
    let mut seeds: Vec<u64> = whole.items.keys().filter_map(|k| k.parse().ok()).collect();
    seeds.sort_unstable();
    seeds
}

/// Figures and table of merged parts of `sms bench robust`: all is known, and nothing runs.
pub(crate) fn show_robust(console: &Console, whole: &Shard, out: Option<&PathBuf>) -> anyhow::Result<()> {
    let engine: Option<String> = whole.setting("engine")?;
    let bench = RobustBench {
        seeds: seeds_of(whole),
        family: whole.setting("family")?,
        told: whole.setting("materials")?,
        worlds: whole.setting("worlds")?,
        planners: whole.setting("planners")?,
        oracle_evaluations: whole.setting("oracle")?,
        chaos_runs: whole.setting("chaos_runs")?,
        errors: whole.setting("errors")?,
        arm: whole.setting("arm")?,
        engine: engine.and_then(|name| TargetEngine::ALL.into_iter().find(|e| e.name() == name)),
    };
    let mut known = Metrics::new();
    whole.items.keys().for_each(|k| known.merge(whole.figures(k)));
    let keep = |_: &Metrics| Ok(());
    let metrics = sms_experiments::run_robust(
        &bench,
        &known,
        &keep,
        console.context.progress.as_ref(),
        &console.context.cancel,
    )?;
    finish(console, &metrics, out, robust_table(&bench, &metrics).trim_end())
}

/// `2/4`: the second of four parts.
pub(crate) fn parse_shard(text: &str) -> anyhow::Result<(usize, usize)> {
    let parts =
        text.split_once('/').and_then(|(i, n)| Some((i.trim().parse().ok()?, n.trim().parse().ok()?)));
    match parts {
        Some((i, n)) if 1 <= i && i <= n => Ok((i, n)),
        _ => Err(InputError::new(format!("`{text}` is no shard"), "--shard", "write for example 2/4").into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_are_counted_from_one() {
        assert_eq!(parse_shard("2/4").unwrap(), (2, 4));
        for bad in ["0/2", "3/2", "2", "a/b"] {
            assert!(parse_shard(bad).is_err(), "{bad}");
        }
    }
}
