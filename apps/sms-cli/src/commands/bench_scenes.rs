//! `sms bench scenes`: which generated scenes can be solved, and how.

use super::bench_optimisers::{finish, parse_seeds};
use crate::cli::EngineName;
use crate::context::Context;
use clap::Args;
use sms_bench::{
    Solvability, SolvabilityBench, SolvedBench, run_solvability, run_solved, solved_metrics, solved_table,
};
use sms_core::InputError;
use sms_core::metrics::Metrics;
use sms_synth::Layout;
use sms_target::TargetEngine;
use std::fmt::Write as _;
use std::path::PathBuf;

#[derive(Debug, Args, Clone)]
pub(crate) struct BenchScenes {
    /// Layouts, with commas: empty, direct, backstop, screened, cue_bank, chain, two_ways (default: all).
    #[arg(long, value_name = "LAYOUTS")]
    pub layouts: Option<String>,
    /// Seeds of the scenes.
    #[arg(long, value_name = "SEEDS", default_value = "1001..1004")]
    pub seeds: String,
    /// Obstacles besides what a layout needs.
    #[arg(long, value_name = "N", default_value_t = 4)]
    pub obstacles: usize,
    /// Shots per scene.
    #[arg(long, value_name = "N", default_value_t = 1500)]
    pub shots: u64,
    /// Carry the best shots on the fixed scenes out in this engine instead.
    #[arg(long, value_enum, conflicts_with_all = ["layouts", "seeds", "obstacles"])]
    pub engine: Option<EngineName>,
    /// Numbers of the fixed scenes, such as 1..18 or 2,8, with `--engine`.
    #[arg(long, value_name = "NUMBERS", default_value = "1..18", requires = "engine")]
    pub scenes: String,
    /// File for the results.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

pub(crate) fn run(context: &Context, a: &BenchScenes) -> anyhow::Result<()> {
    if let Some(engine) = a.engine {
        return run_in(context, a, engine.engine());
    }
    let layouts = match &a.layouts {
        None => Layout::ALL.to_vec(),
        Some(text) => text.split(',').map(layout_of).collect::<Result<_, _>>()?,
    };
    let bench = SolvabilityBench {
        layouts,
        seeds: parse_seeds(&a.seeds)?,
        obstacles: a.obstacles,
        shots: a.shots.max(1),
    };
    let found = run_solvability(&bench, context.progress.as_ref(), &context.cancel)?;
    finish(context, &metrics(&found), a.out.as_ref(), table(&found).trim_end())
}

/// The fixed scenes in a target engine.
fn run_in(context: &Context, a: &BenchScenes, engine: TargetEngine) -> anyhow::Result<()> {
    let scenes = parse_seeds(&a.scenes)?.into_iter().map(|n| n as usize).collect();
    let bench = SolvedBench { scenes, shots: a.shots.max(1), ..SolvedBench::default() };
    let target = engine.target()?;
    let found = run_solved(&bench, target.as_ref(), context.progress.as_ref(), &context.cancel)?;
    finish(context, &solved_metrics(&found), a.out.as_ref(), solved_table(&found, target.label()).trim_end())
}

fn metrics(found: &[Solvability]) -> Metrics {
    let mut metrics = Metrics::new();
    metrics.set("bench.scenes.scenes", found.len());
    for s in found {
        let key = |name: &str| format!("bench.scenes.{}.{}.{name}", s.layout.as_str(), s.seed);
        for (k, kind) in ["none", "one", "more"].into_iter().enumerate() {
            if s.best_m[k].is_finite() {
                metrics.set(key(&format!("best_{kind}_m")), s.best_m[k]);
            }
            metrics.set(key(&format!("success_{kind}_share")), s.success_share[k]);
        }
        metrics.set(key("refused_share"), s.refused_share);
    }
    metrics
}

fn layout_of(word: &str) -> Result<Layout, InputError> {
    Layout::ALL.into_iter().find(|l| l.as_str() == word.trim()).ok_or_else(|| {
        let all: Vec<&str> = Layout::ALL.iter().map(|l| l.as_str()).collect();
        InputError::new(
            format!("there is no layout `{word}`"),
            "--layouts",
            format!("name some of: {}", all.join(", ")),
        )
    })
}

fn table(found: &[Solvability]) -> String {
    let mut text = String::from(
        "best distance to the goal, mm (share of shots within 5 cm), by rebounds; shots that the arm cannot make\n  layout       seed  objects      none           one            two or more     refused\n",
    );
    for s in found {
        let _ = write!(text, "  {:<10} {:>6} {:>6}  ", s.layout.as_str(), s.seed, s.obstacles);
        for k in 0..3 {
            let best =
                if s.best_m[k].is_finite() { format!("{:.0}", 1e3 * s.best_m[k]) } else { "-".to_owned() };
            let _ = write!(text, " {best:>5} ({:>4.1} %)", 100.0 * s.success_share[k]);
        }
        let _ = writeln!(text, "   {:>4.0} %", 100.0 * s.refused_share);
    }
    text
}
