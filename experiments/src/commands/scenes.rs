//! `sms-experiments scenes`: which generated scenes can be solved, and how.

use super::shared::{finish, parse_seeds, parse_shard, settings};
use anyhow::Context as _;
use clap::Args;
use serde_json::{Value, json};
use sms_cli::front::Console;
use sms_cli::front::EngineName;
use sms_core::InputError;
use sms_core::metrics::Metrics;
use sms_experiments::{
    ReachabilityBench, Shard, Solvability, SolvabilityBench, part_of, reachability_metrics,
    reachability_table, run_reachability, run_solvability,
};
use sms_synth::Layout;
use sms_target::TargetEngine;
use std::fmt::Write as _;
use std::path::PathBuf;

#[derive(Debug, Args, Clone)]
pub(crate) struct ScenesArguments {
    /// Layouts, with commas: empty, direct, backstop, screened, cue_bank, chain, two_ways (default: all).
    #[arg(long, value_name = "LAYOUTS")]
    pub layouts: Option<String>,
    /// Seeds of the scenes.
    #[arg(long, value_name = "SEEDS", default_value = "1001..1004")]
    pub seeds: String,
    /// Obstacles besides those of the layout.
    #[arg(long, value_name = "N", default_value_t = 4)]
    pub obstacles: usize,
    /// Shots per scene.
    #[arg(long, value_name = "N", default_value_t = 1500)]
    pub shots: u64,
    /// Only every n-th seed, from the i-th (i/n, from 1); for `sms-experiments merge`.
    #[arg(long, value_name = "I/N", requires = "out", conflicts_with = "engine")]
    pub shard: Option<String>,
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

pub(crate) fn run(console: &Console, a: &ScenesArguments) -> anyhow::Result<()> {
    if let Some(engine) = a.engine {
        return run_in(console, a, engine.engine());
    }
    let layouts = match &a.layouts {
        None => Layout::ALL.to_vec(),
        Some(text) => text.split(',').map(layout_of).collect::<Result<_, _>>()?,
    };
    let part = a.shard.as_deref().map(parse_shard).transpose()?;
    let bench = SolvabilityBench {
        layouts,
        seeds: part_of(parse_seeds(&a.seeds)?, part.unwrap_or((1, 1))),
        obstacles: a.obstacles,
        shots: a.shots.max(1),
    };
    let found = run_solvability(&bench, console.context.progress.as_ref(), &console.context.cancel)?;
    if let (Some(out), Some(part)) = (&a.out, part) {
        let settings = settings([("obstacles", json!(bench.obstacles)), ("shots", json!(bench.shots))]);
        let mut shard = Shard::new("scenes", part, settings);
        for s in &found {
            let value = serde_json::to_value(s).context("a scene's result cannot be written")?;
            shard.items.insert(format!("{} {}", s.layout.as_str(), s.seed), value);
        }
        shard.save(&Shard::path_beside(out))?;
    }
    finish(console, &metrics(&found), a.out.as_ref(), table(&found).trim_end())
}

/// Figures and table of merged parts.
pub(crate) fn show_merged(console: &Console, whole: &Shard, out: Option<&PathBuf>) -> anyhow::Result<()> {
    let mut found: Vec<Solvability> = whole.items.values().map(scene_of).collect::<Result<_, _>>()?;
    let place = |s: &Solvability| Layout::ALL.iter().position(|l| *l == s.layout);
    found.sort_by_key(|s| (place(s), s.seed));
    finish(console, &metrics(&found), out, table(&found).trim_end())
}

/// A scene's result as a part has it: JSON knows no infinity, which is null there.
fn scene_of(value: &Value) -> anyhow::Result<Solvability> {
    let mut value = value.clone();
    let best = value.get("best_m").cloned().unwrap_or_default();
    let best: [Option<f64>; 3] = serde_json::from_value(best).context("a part holds no results of scenes")?;
    value["best_m"] = json!([0.0, 0.0, 0.0]);
    let mut found: Solvability =
        serde_json::from_value(value).context("a part holds no results of scenes")?;
    found.best_m = best.map(|v| v.unwrap_or(f64::INFINITY));
    Ok(found)
}

/// The fixed scenes in a target engine.
fn run_in(console: &Console, a: &ScenesArguments, engine: TargetEngine) -> anyhow::Result<()> {
    let scenes = parse_seeds(&a.scenes)?.into_iter().map(|n| n as usize).collect();
    let bench = ReachabilityBench { scenes, shots: a.shots.max(1), ..ReachabilityBench::default() };
    let target = engine.target()?;
    let found = run_reachability(
        &bench,
        target.as_ref(),
        console.context.progress.as_ref(),
        &console.context.cancel,
    )?;
    finish(
        console,
        &reachability_metrics(&found),
        a.out.as_ref(),
        reachability_table(&found, target.label()).trim_end(),
    )
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_without_a_shot_of_some_kind_survives_a_part() {
        let found = Solvability {
            layout: Layout::ALL[1],
            seed: 1001,
            obstacles: 6,
            best_m: [0.1, f64::INFINITY, 0.3],
            success_share: [0.1, 0.0, 0.2],
            best_action: vec![0.5, 0.1],
            refused_share: 0.2,
        };
        let text = serde_json::to_string(&found).unwrap();
        assert_eq!(scene_of(&serde_json::from_str(&text).unwrap()).unwrap(), found);
    }
}
