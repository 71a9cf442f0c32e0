//! The figures of `sms bench robust` over all scenes, and as a table.

use crate::robust::{ORACLE, PLAIN};
use crate::{RobustBench, paired_difference};
use sms_core::metrics::Metrics;
use std::fmt::Write as _;

/// Figures of each planner whose means over the scenes are kept.
const MEANS: [&str; 11] = [
    "realised_m",
    "realised_median_m",
    "realised_q90_m",
    "first_m",
    "success_share",
    "invalid",
    "predicted_m",
    "nominal_m",
    "rollouts",
    "cpu_s",
    "chaos_m",
];

fn of_scene(metrics: &Metrics, name: &str, seed: u64, key: &str) -> Option<f64> {
    metrics.number(&format!("bench.robust.{name}.scene_{seed}.{key}"))
}

/// Adds what follows from the scenes' figures `bench.robust.{name}.scene_{seed}.{key}`: `bench.robust.scenes`, the mean
/// over the scenes of each figure (`bench.robust.{name}.{key}`; `invalid` is the number of true worlds in all),
/// `bench.robust.oracle.best_m`, `bench.robust.{name}.regret_m` (the objective in the first true world less that of the
/// best shot that was found in that world itself), and `bench.robust.{name}.{change_share, change_low_share,
/// change_high_share}`: the change of the realised mean relative to plain planning, with the 95 % interval of a paired
/// bootstrap over scenes.
pub(crate) fn summarise(bench: &RobustBench, metrics: &mut Metrics) {
    metrics.set("bench.robust.scenes", bench.seeds.len());
    metrics.set("bench.robust.materials", bench.told.as_str());
    let column = |metrics: &Metrics, name: &str, key: &str| -> Vec<f64> {
        bench.seeds.iter().filter_map(|&s| of_scene(metrics, name, s, key)).collect()
    };
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let best = column(metrics, ORACLE, "best_m");
    if !best.is_empty() {
        metrics.set(format!("bench.robust.{ORACLE}.best_m"), mean(&best));
    }
    for name in bench.names() {
        let mut found: Vec<(&str, f64)> = Vec::new();
        for key in MEANS {
            let values = column(metrics, name, key);
            if !values.is_empty() {
                let sum: f64 = values.iter().sum();
                found.push((key, if key == "invalid" { sum } else { mean(&values) }));
            }
        }
        let first = column(metrics, name, "first_m");
        if first.len() == best.len() && !best.is_empty() {
            found.push(("regret_m", mean(&first) - mean(&best)));
        }
        let (own, plain) = (column(metrics, name, "realised_m"), column(metrics, PLAIN, "realised_m"));
        if name != PLAIN
            && own.len() == plain.len()
            && let Some(d) = paired_difference(&own, &plain)
        {
            let base = mean(&plain);
            found.push(("change_share", d.mean / base));
            found.push(("change_low_share", d.low / base));
            found.push(("change_high_share", d.high / base));
        }
        for (key, value) in found {
            metrics.set(format!("bench.robust.{name}.{key}"), value);
        }
    }
}

/// The figures as a table: one row a planner, then one a scene.
pub fn robust_table(bench: &RobustBench, metrics: &Metrics) -> String {
    let names = bench.names();
    let mut text = format!(
        "distance to the goal, mm: mean over {} scenes with {} true worlds each, materials told: {}; invalid worlds count \
         as shots that do nothing\n{:<12} {:>9} {:>8} {:>6} {:>8} {:>10} {:>8} {:>7} {:>6} {:>7} {:>9} {:>7}  {}\n",
        bench.seeds.len(),
        bench.worlds,
        bench.told.as_str(),
        "planner",
        "realised",
        "median",
        "q90",
        "success",
        "predicted",
        "nominal",
        "regret",
        "chaos",
        "invalid",
        "rollouts",
        "CPU s",
        "change of the mean"
    );
    for name in &names {
        let get = |key: &str| metrics.number(&format!("bench.robust.{name}.{key}")).unwrap_or(f64::NAN);
        let mm = |key: &str| 1e3 * get(key);
        let _ = write!(
            text,
            "{name:<12} {:>9.1} {:>8.1} {:>6.1} {:>6.0} % {:>10} {:>8.1} {:>7} {:>6.2} {:>7.0} {:>9.0} {:>7.1}",
            mm("realised_m"),
            mm("realised_median_m"),
            mm("realised_q90_m"),
            100.0 * get("success_share"),
            or_dash(mm("predicted_m")),
            mm("nominal_m"),
            or_dash(mm("regret_m")),
            mm("chaos_m"),
            get("invalid"),
            get("rollouts"),
            get("cpu_s"),
        );
        if get("change_share").is_finite() {
            let [c, l, h] = ["change_share", "change_low_share", "change_high_share"].map(|k| 100.0 * get(k));
            let _ = write!(text, "  {c:+.0} % [{l:+.0}, {h:+.0}]");
        }
        text.push('\n');
    }
    let _ = write!(text, "{:<6} {:>7}", "scene", "best");
    for name in &names {
        let _ = write!(text, "  | {name}: nominal, realised, success");
    }
    text.push('\n');
    for &seed in &bench.seeds {
        let get = |name: &str, key: &str| of_scene(metrics, name, seed, key).unwrap_or(f64::NAN);
        let _ = write!(text, "{seed:<6} {:>7}", or_dash(1e3 * get(ORACLE, "best_m")));
        for name in &names {
            let _ = write!(
                text,
                "  | {:>7.1} {:>7.1} {:>4.0} %",
                1e3 * get(name, "nominal_m"),
                1e3 * get(name, "realised_m"),
                100.0 * get(name, "success_share")
            );
        }
        text.push('\n');
    }
    text
}

fn or_dash(value: f64) -> String {
    if value.is_finite() { format!("{value:.1}") } else { "–".to_owned() }
}
