//! `sms bench optimisers`: search methods against each other on generated scenes.

use super::bench_plan::{parse_shard, seeds_of, settings};
use clap::{Args, ValueEnum};
use serde_json::json;
use sms_cli::front::Console;
use sms_core::InputError;
use sms_core::metrics::Metrics;
use sms_experiments::{
    OptimiserBench, SceneFamily, Shard, merge_optimisers, optimiser_table, part_of, run_optimisers,
};
use std::path::PathBuf;

/// How hard the scenes of a planner's benchmark are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Family {
    /// The paper's: free corridors from cue to target ball to goal, cut of at most 35°.
    Open,
    /// Nine obstacles that may stand in the way, cut of up to 75°.
    Crowded,
    /// The eighteen scenes of `sms bench billiards`; the seeds are their numbers.
    Fixed,
}

impl Family {
    pub(crate) fn family(self) -> SceneFamily {
        match self {
            Self::Open => SceneFamily::Open,
            Self::Crowded => SceneFamily::Crowded,
            Self::Fixed => SceneFamily::Fixed,
        }
    }
}

#[derive(Debug, Args, Clone)]
pub(crate) struct BenchOptimisers {
    /// Seeds of the generated billiards scenes, such as 1001..1012 or 1,2,7 (tune on seeds of 1000 and above only).
    #[arg(long, value_name = "SEEDS", default_value = "1001..1012")]
    pub seeds: String,
    /// How hard they are.
    #[arg(long, value_enum, default_value = "crowded")]
    pub family: Family,
    /// Budgets: simulated shots per search.
    #[arg(long, value_name = "N", value_delimiter = ',', default_value = "60,240,960")]
    pub evaluations: Vec<usize>,
    /// Methods to compare (default: all): multi_start (the paper's), halving (the default of `sms plan`), cma_es.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub methods: Vec<String>,
    /// Only every n-th seed, from the i-th (i/n, from 1); for `sms bench merge`.
    #[arg(long, value_name = "I/N", requires = "out")]
    pub shard: Option<String>,
    /// Let the arm strike, which cannot make every strike, in place of the finger that gives no way.
    #[arg(long)]
    pub arm: bool,
    /// File for the results.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

pub(crate) fn run(console: &Console, a: &BenchOptimisers) -> anyhow::Result<()> {
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

/// Keeps the figures of a benchmark and prints them, or `text` for people.
pub(crate) fn finish(
    console: &Console,
    metrics: &Metrics,
    out: Option<&PathBuf>,
    text: &str,
) -> anyhow::Result<()> {
    if let Some(out) = out {
        metrics.save(out)?;
    }
    if console.json {
        return console.print_json(metrics);
    }
    console.say(text);
    Ok(())
}

/// `1001..1012` (both included), `1,2,7`, or a mixture.
pub(crate) fn parse_seeds(text: &str) -> anyhow::Result<Vec<u64>> {
    let mut seeds = Vec::new();
    for part in text.split(',').map(str::trim) {
        let number = |s: &str| s.trim().parse::<u64>();
        match part.split_once("..") {
            None => seeds.push(number(part)),
            Some((first, last)) => match (number(first), number(last.trim_start_matches('='))) {
                (Ok(first), Ok(last)) if first <= last && last - first < 10_000 => {
                    seeds.extend((first..=last).map(Ok));
                }
                (Err(e), _) | (_, Err(e)) => seeds.push(Err(e)),
                _ => return Err(no_seeds(text).into()),
            },
        }
    }
    let seeds: Vec<u64> = seeds.into_iter().collect::<Result<_, _>>().map_err(|_| no_seeds(text))?;
    Ok(seeds)
}

fn no_seeds(text: &str) -> InputError {
    InputError::new(
        format!("`{text}` names no seeds"),
        "--seeds",
        "give a range such as 1001..1012, or a list such as 1,2,7",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_are_ranges_and_lists() {
        assert_eq!(parse_seeds("1001..1003").unwrap(), [1001, 1002, 1003]);
        assert_eq!(parse_seeds("7, 1..=2").unwrap(), [7, 1, 2]);
        for bad in ["", "x", "3..1", "1..x"] {
            assert!(parse_seeds(bad).unwrap_err().downcast_ref::<InputError>().is_some(), "{bad}");
        }
    }
}
