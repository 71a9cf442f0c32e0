//! `sms-experiments merge`: parts of a benchmark that ran with `--shard`, as one.

use super::{billiards, landing, masks, materialize, optimisers, plan, robust, scan, scenes};
use clap::Args;
use sms_cli::front::Console;
use sms_core::InputError;
use sms_experiments::{Merged, merge_shards};
use std::path::PathBuf;

#[derive(Debug, Args, Clone)]
pub(crate) struct MergeArguments {
    /// Files `*.shard.json` that runs with `--shard` wrote beside their results, or folders of such.
    #[arg(value_name = "PARTS", required = true)]
    pub parts: Vec<PathBuf>,
    /// Folder for results.json (of `billiards`, which needs one, pictures and shots.parquet too).
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

pub(crate) fn run(console: &Console, a: &MergeArguments) -> anyhow::Result<()> {
    let Merged { whole, missing, builds } = merge_shards(&a.parts)?;
    if !missing.is_empty() {
        eprintln!("warning: missing parts: {}", missing.join(", "));
    }
    if builds > 1 {
        eprintln!(
            "warning: {builds} builds of the program wrote these parts; results may differ where its code changed between them"
        );
    }
    let results = a.out.as_ref().map(|dir| dir.join("results.json"));
    let out = results.as_ref();
    match whole.bench.as_str() {
        "billiards" => match &a.out {
            Some(dir) => billiards::show_merged(console, &whole, dir),
            None => {
                let cure = "say where its pictures and results go";
                Err(InputError::new("`billiards` needs a folder", "--out", cure).into())
            }
        },
        "landing" => landing::show_merged(console, &whole, out),
        "masks" => masks::show_merged(console, &whole, out),
        "scan" => scan::show_merged(console, &whole, out),
        "robust" => robust::show_merged(console, &whole, out),
        "plan" => plan::show_merged(console, &whole, out),
        "optimisers" => optimisers::show_merged(console, &whole, out),
        "materialize" => materialize::show_merged(console, &whole, out),
        "scenes" => scenes::show_merged(console, &whole, out),
        other => Err(InputError::new(
            format!("`{other}` has no parts to merge"),
            "merge",
            "use the version that wrote these parts",
        )
        .into()),
    }
}
