//! `sms-experiments plan`: speed of shots and plans.

use super::shared::{Family, finish, parse_seeds, parse_shard, settings};
use clap::Args;
use serde_json::json;
use sms_cli::front::Console;
use sms_core::metrics::Metrics;
use sms_experiments::{PlanScene, Shard, merge_plan_speed, part_of, run_plan_speed};
use sms_plan::PlanConfig;
use std::path::PathBuf;

#[derive(Debug, Args, Clone)]
pub(crate) struct PlanSpeedArguments {
    /// Seeds of the generated billiards scenes.
    #[arg(long, value_name = "SEEDS", default_value = "1001..1003")]
    pub seeds: String,
    /// Family of the scenes.
    #[arg(long, value_enum, default_value = "open")]
    pub family: Family,
    /// Only every n-th scene, from the i-th (i/n, from 1); for `sms-experiments merge`.
    #[arg(long, value_name = "I/N", requires = "out")]
    pub shard: Option<String>,
    /// File for the results.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Plans with the settings of `[plan]`.
pub(crate) fn run(console: &Console, a: &PlanSpeedArguments) -> anyhow::Result<()> {
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
    show_merged(console, &shard, a.out.as_ref())
}

/// Figures and text of a run of `sms-experiments plan`, or of merged parts.
pub(crate) fn show_merged(console: &Console, whole: &Shard, out: Option<&PathBuf>) -> anyhow::Result<()> {
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
