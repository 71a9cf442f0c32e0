//! `sms-experiments engines`: the same shots in every engine.

use super::shared::{Family, finish, parse_seeds};
use clap::Args;
use sms_cli::front::Console;
use sms_experiments::{PlanScene, engines_table, run_engines};
use std::path::PathBuf;

#[derive(Debug, Args, Clone)]
pub(crate) struct EnginesArguments {
    /// Seeds of the generated billiards scenes.
    #[arg(long, value_name = "SEEDS", default_value = "1001..1006")]
    pub seeds: String,
    /// Family of the scenes.
    #[arg(long, value_enum, default_value = "open")]
    pub family: Family,
    /// Shots per scene: the best of those found geometrically.
    #[arg(long, value_name = "N", default_value_t = 2)]
    pub shots: usize,
    /// File for the results.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

pub(crate) fn run(console: &Console, a: &EnginesArguments) -> anyhow::Result<()> {
    let scenes: Vec<PlanScene> = parse_seeds(&a.seeds)?
        .into_iter()
        .map(|seed| PlanScene::new(a.family.family(), seed))
        .collect::<Result<_, _>>()?;
    let metrics =
        run_engines(&scenes, a.shots.max(1), console.context.progress.as_ref(), &console.context.cancel)?;
    finish(console, &metrics, a.out.as_ref(), engines_table(&metrics).trim_end())
}
