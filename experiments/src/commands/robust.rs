//! `sms-experiments robust`: realised objectives of plans in true worlds that differ from the planner's.

use super::shared::{Family, PriorName, finish, parse_seeds, parse_shard, seeds_of, settings};
use clap::{Args, ValueEnum};
use serde_json::{Map, Value, json};
use sms_cli::front::Console;
use sms_core::metrics::Metrics;
use sms_core::{InputError, atomic};
use sms_experiments::{RobustBench, Shard, part_of, robust_table};
use sms_plan::PlanConfig;
use sms_target::TargetEngine;
use std::collections::BTreeMap;
use std::path::PathBuf;

#[derive(Debug, Args, Clone)]
pub(crate) struct RobustArguments {
    /// Seeds of the generated billiards scenes.
    #[arg(long, value_name = "SEEDS", default_value = "1001..1012")]
    pub seeds: String,
    /// Family of the scenes.
    #[arg(long, value_enum, default_value = "crowded")]
    pub family: Family,
    /// The planner's knowledge of the true materials.
    #[arg(long, value_enum, default_value = "noisy")]
    pub materials: PriorName,
    /// True worlds per scene that each plan is executed in.
    #[arg(long, value_name = "N", default_value_t = 48)]
    pub worlds: usize,
    /// Shots of the search in the true world itself, for the regret; 0 leaves it out.
    #[arg(long, value_name = "N", default_value_t = 4000)]
    pub oracle: usize,
    /// Robust planners to compare: a TOML file with one table per planner, each with keys of `[plan]` (default: the
    /// planner's settings). Nominal planning costs as much as the first.
    #[arg(long, value_name = "FILE")]
    pub planners: Option<PathBuf>,
    /// Plan and execute with the arm instead of a kinematic finger.
    #[arg(long)]
    pub arm: bool,
    /// Engine of the true worlds; the planner's own is rapier.
    #[arg(long, value_enum, default_value = "rapier")]
    pub engine: TrueEngine,
    /// Only every n-th scene, from the i-th (i/n, from 1); for `sms-experiments merge`.
    #[arg(long, value_name = "I/N", requires = "out")]
    pub shard: Option<String>,
    /// Results of earlier runs, interrupted ones too, or of other shards, with the same settings: their results are not
    /// computed again.
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

pub(crate) fn run(console: &Console, a: &RobustArguments) -> anyhow::Result<()> {
    let part = a.shard.as_deref().map(parse_shard).transpose()?;
    let seeds = part_of(parse_seeds(&a.seeds)?, part.unwrap_or((1, 1)));
    let mut bench = RobustBench::new(seeds, a.family.family());
    if a.materials == PriorName::Vlm {
        let what = "a vision-language model needs pictures, and these scenes are not scanned";
        return Err(InputError::new(what, "--materials", "ask one in `sms-experiments billiards`").into());
    }
    bench.material_prior = a.materials.prior();
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
    // Results are kept at once: an interrupted run resumes with `--with` this file.
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
        ("materials", json!(bench.material_prior)),
        ("worlds", json!(bench.worlds)),
        ("oracle", json!(bench.oracle_evaluations)),
        ("planners", json!(bench.planners)),
        ("chaos_runs", json!(bench.chaos_runs)),
        ("errors", json!(bench.errors)),
        ("arm", json!(bench.arm)),
        ("engine", json!(bench.engine.map(TargetEngine::name))),
    ])
}

/// Figures and table of merged parts of `sms-experiments robust`, without new runs.
pub(crate) fn show_merged(console: &Console, whole: &Shard, out: Option<&PathBuf>) -> anyhow::Result<()> {
    let engine: Option<String> = whole.setting("engine")?;
    let bench = RobustBench {
        seeds: seeds_of(whole),
        family: whole.setting("family")?,
        material_prior: whole.setting("materials")?,
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
