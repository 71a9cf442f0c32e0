//! The figures of `sms-experiments robust` over all scenes, and as a table.

use crate::RobustBench;
use crate::bootstrap::paired_ratio;
use crate::robust::{ORACLE, PLAIN};
use sms_core::metrics::Metrics;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Figures of each planner that are averaged over the scenes.
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

/// A figure of each scene that has it, by the scene's seed.
fn column(bench: &RobustBench, metrics: &Metrics, name: &str, key: &str) -> BTreeMap<u64, f64> {
    bench.seeds.iter().filter_map(|&s| Some((s, of_scene(metrics, name, s, key)?))).collect()
}

/// Both figures of the scenes that have both.
fn pairs(a: &BTreeMap<u64, f64>, b: &BTreeMap<u64, f64>) -> Vec<(f64, f64)> {
    a.iter().filter_map(|(seed, &a)| Some((a, *b.get(seed)?))).collect()
}

/// Adds the summary of the scenes' figures `bench.robust.{name}.scene_{seed}.{key}`: `bench.robust.scenes`, the mean
/// over the scenes of each figure (`bench.robust.{name}.{key}`; `invalid` is the number of true worlds in all),
/// `bench.robust.oracle.best_m`, `bench.robust.{name}.{regret_m, regret_scenes}` (the objective in the first true world
/// less that of the best shot that was found in that world itself, over the scenes where that was searched),
/// `bench.robust.{name}.{forecast_error_m, forecast_scenes}` (how far the predicted mean is from the realised one, mean
/// of the absolute differences over the scenes), and `bench.robust.{name}.{change_share, change_low_share,
/// change_high_share, change_scenes}`: the ratio of the realised means to plain planning's, less 1, with the 95 % interval
/// of a bootstrap that resamples scenes as pairs. Each compares the same scenes; `…_scenes` is their number.
pub(crate) fn summarise(bench: &RobustBench, metrics: &mut Metrics) {
    metrics.set("bench.robust.scenes", bench.seeds.len());
    metrics.set("bench.robust.materials", bench.material_prior.as_str());
    let mean = |v: &BTreeMap<u64, f64>| v.values().sum::<f64>() / v.len() as f64;
    let best = column(bench, metrics, ORACLE, "best_m");
    if !best.is_empty() {
        metrics.set(format!("bench.robust.{ORACLE}.best_m"), mean(&best));
    }
    let plain = column(bench, metrics, PLAIN, "realised_m");
    for name in bench.names() {
        let mut found: Vec<(&str, f64)> = Vec::new();
        for key in MEANS {
            let values = column(bench, metrics, name, key);
            if !values.is_empty() {
                found.push((key, if key == "invalid" { values.values().sum() } else { mean(&values) }));
            }
        }
        let own = column(bench, metrics, name, "realised_m");
        let first = pairs(&column(bench, metrics, name, "first_m"), &best);
        let forecast = pairs(&column(bench, metrics, name, "predicted_m"), &own);
        let mut mean_of = |key, scenes, of: Vec<f64>| {
            if !of.is_empty() {
                found.push((key, of.iter().sum::<f64>() / of.len() as f64));
                found.push((scenes, of.len() as f64));
            }
        };
        mean_of("regret_m", "regret_scenes", first.iter().map(|(f, b)| f - b).collect());
        mean_of("forecast_error_m", "forecast_scenes", forecast.iter().map(|(p, r)| (p - r).abs()).collect());
        let both = pairs(&own, &plain);
        if name != PLAIN
            && let Some(ratio) = paired_ratio(&both)
        {
            found.push(("change_share", ratio.mean));
            found.push(("change_low_share", ratio.low));
            found.push(("change_high_share", ratio.high));
            found.push(("change_scenes", both.len() as f64));
        }
        for (key, value) in found {
            metrics.set(format!("bench.robust.{name}.{key}"), value);
        }
    }
}

/// The figures as a table: one row a planner, then one a scene.
pub fn robust_table(bench: &RobustBench, metrics: &Metrics) -> String {
    let names = bench.names();
    let text_of = |key: &str| {
        metrics.get(&format!("bench.robust.{key}")).and_then(|v| v.as_str()).unwrap_or("not known").to_owned()
    };
    let mut text = format!(
        "distance to the goal, mm: mean over {} scenes with {} true worlds each ({}, struck by {}), material prior: {}; \
         invalid worlds count as shots that do nothing; in brackets the scenes that a figure compares, where not all\n\
         {:<12} {:>9} {:>8} {:>6} {:>8} {:>10} {:>8} {:>8} {:>12} {:>6} {:>7} {:>9} {:>7}  {}\n",
        bench.seeds.len(),
        bench.worlds,
        text_of("engine"),
        text_of("striker"),
        bench.material_prior.as_str(),
        "planner",
        "realised",
        "median",
        "q90",
        "success",
        "predicted",
        "error",
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
        let scenes = |key: &str| {
            let n = get(key);
            if n == bench.seeds.len() as f64 { String::new() } else { format!(" ({n:.0})") }
        };
        let _ = write!(
            text,
            "{name:<12} {:>9.1} {:>8.1} {:>6.1} {:>6.0} % {:>10} {:>8} {:>8.1} {:>12} {:>6.2} {:>7.0} {:>9.0} {:>7.1}",
            mm("realised_m"),
            mm("realised_median_m"),
            mm("realised_q90_m"),
            100.0 * get("success_share"),
            or_dash(mm("predicted_m")),
            or_dash(mm("forecast_error_m")),
            mm("nominal_m"),
            if get("regret_m").is_finite() {
                format!("{:.1}{}", mm("regret_m"), scenes("regret_scenes"))
            } else {
                or_dash(f64::NAN)
            },
            mm("chaos_m"),
            get("invalid"),
            get("rollouts"),
            get("cpu_s"),
        );
        if get("change_share").is_finite() {
            let [c, l, h] = ["change_share", "change_low_share", "change_high_share"].map(|k| 100.0 * get(k));
            let _ = write!(text, "  {c:+.0} % [{l:+.0}, {h:+.0}]{}", scenes("change_scenes"));
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SceneFamily;

    #[test]
    fn only_figures_of_the_same_scenes_are_compared_and_counted() {
        let bench = RobustBench::new(vec![1, 2, 3, 4], SceneFamily::Crowded);
        let mut metrics = Metrics::new();
        let mut set = |name: &str, seed: u64, key: &str, value: f64| {
            metrics.set(format!("bench.robust.{name}.scene_{seed}.{key}"), value);
        };
        // Plain planning lacks scene 1, robust planning scene 4, the search in the true world scenes 1 and 2: columns of
        // three, three and two, of which no two are of the same scenes.
        for (seed, realised) in [(2, 0.2), (3, 0.1), (4, 0.9)] {
            set(PLAIN, seed, "realised_m", realised);
            set(PLAIN, seed, "first_m", realised);
        }
        for (seed, realised) in [(1, 0.7), (2, 0.1), (3, 0.05)] {
            set("robust", seed, "realised_m", realised);
            set("robust", seed, "first_m", realised);
            set("robust", seed, "predicted_m", realised + if seed == 1 { 0.03 } else { -0.06 });
        }
        for (seed, best) in [(3, 0.02), (4, 0.04)] {
            set(ORACLE, seed, "best_m", best);
        }
        summarise(&bench, &mut metrics);
        let get = |name: &str, key: &str| metrics.number(&format!("bench.robust.{name}.{key}")).unwrap();
        let is = |name: &str, key: &str, value: f64| {
            let found = get(name, key);
            assert!((found - value).abs() < 1e-12, "{name} {key}: {found} instead of {value}");
        };
        // Scenes 2 and 3, in both of which robust planning halves the distance.
        for key in ["change_share", "change_low_share", "change_high_share"] {
            is("robust", key, -0.5);
        }
        is("robust", "change_scenes", 2.0);
        is("robust", "regret_m", 0.03);
        is("robust", "regret_scenes", 1.0);
        is(PLAIN, "regret_m", 0.47);
        is(PLAIN, "regret_scenes", 2.0);
        is("robust", "forecast_error_m", 0.05);
        is("robust", "forecast_scenes", 3.0);
        assert!(metrics.get("bench.robust.plain.change_share").is_none());
        let table = robust_table(&bench, &metrics);
        assert!(table.contains("-50 % [-50, -50] (2)") && table.contains("470.0 (2)"), "{table}");
    }
}
