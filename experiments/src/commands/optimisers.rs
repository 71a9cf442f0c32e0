//! `sms-experiments optimisers`: search methods against each other on generated scenes.

use super::shared::{Family, finish, parse_seeds, parse_shard, seeds_of, settings};
use clap::Args;
use serde_json::json;
use sms_cli::front::Console;
use sms_core::InputError;
use sms_core::metrics::Metrics;
use sms_experiments::{OptimiserBench, Shard, merge_optimisers, optimiser_table, part_of, run_optimisers};
use std::path::PathBuf;

#[derive(Debug, Args, Clone)]
pub(crate) struct OptimisersArguments {
    /// Seeds of the generated billiards scenes, such as 1001..1012 or 1,2,7 (tune on seeds of 1000 and above only).
    #[arg(long, value_name = "SEEDS", default_value = "1001..1012")]
    pub seeds: String,
    /// Family of the scenes.
    #[arg(long, value_enum, default_value = "crowded")]
    pub family: Family,
    /// Budgets: simulated shots per search.
    #[arg(long, value_name = "N", value_delimiter = ',', default_value = "60,240,960")]
    pub evaluations: Vec<usize>,
    /// Methods to compare (default: all): multi_start (the paper's), halving (the default of `sms plan`), cma_es.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub methods: Vec<String>,
    /// Only every n-th seed, from the i-th (i/n, from 1); for `sms-experiments merge`.
    #[arg(long, value_name = "I/N", requires = "out")]
    pub shard: Option<String>,
    /// Strike with the arm, which cannot make every strike, instead of a kinematic finger.
    #[arg(long)]
    pub arm: bool,
    /// File for the results.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

pub(crate) fn run(console: &Console, a: &OptimisersArguments) -> anyhow::Result<()> {
    if a.evaluations.contains(&0) {
        return Err(InputError::new("a search needs shots", "--evaluations", "give numbers above 0").into());
    }
    let mut bench = OptimiserBench::new(parse_seeds(&a.seeds)?, a.family.family(), a.evaluations.clone());
    bench.arm = a.arm;
    if let Some(unknown) = a.methods.iter().find(|m| bench.entrants.iter().all(|(name, _)| name != *m)) {
        let names: Vec<&str> = bench.entrants.iter().map(|(name, _)| name.as_str()).collect();
        let cure = format!("the methods are {}", names.join(", "));
        return Err(InputError::new(format!("no method is called `{unknown}`"), "--methods", cure).into());
    }
    if !a.methods.is_empty() {
        bench.entrants.retain(|(name, _)| a.methods.contains(name));
    }
    let (Some(shard), Some(out)) = (&a.shard, &a.out) else {
        let metrics = run_optimisers(&bench, console.context.progress.as_ref(), &console.context.cancel)?;
        return finish(console, &metrics, a.out.as_ref(), optimiser_table(&bench, &metrics).trim_end());
    };
    let part = parse_shard(shard)?;
    let names: Vec<&String> = bench.entrants.iter().map(|(name, _)| name).collect();
    let settings = settings([
        ("family", json!(bench.family)),
        ("evaluations", json!(bench.evaluations)),
        ("methods", json!(names)),
        ("arm", json!(bench.arm)),
    ]);
    let mut shard = Shard::new("optimisers", part, settings);
    for seed in part_of(bench.seeds.clone(), part) {
        let one = OptimiserBench { seeds: vec![seed], ..bench.clone() };
        let figures = run_optimisers(&one, console.context.progress.as_ref(), &console.context.cancel)?;
        shard.add(&seed.to_string(), &figures);
    }
    shard.save(&Shard::path_beside(out))?;
    show_merged(console, &shard, Some(out))
}

/// Figures and table of parts.
pub(crate) fn show_merged(console: &Console, whole: &Shard, out: Option<&PathBuf>) -> anyhow::Result<()> {
    let seeds = seeds_of(whole);
    let each: Vec<Metrics> = seeds.iter().map(|s| whole.figures(&s.to_string())).collect();
    let mut bench = OptimiserBench::new(seeds, whole.setting("family")?, whole.setting("evaluations")?);
    let methods: Vec<String> = whole.setting("methods")?;
    bench.entrants.retain(|(name, _)| methods.contains(name));
    bench.arm = whole.setting("arm")?;
    let metrics = merge_optimisers(&bench, &each);
    finish(console, &metrics, out, optimiser_table(&bench, &metrics).trim_end())
}
