//! The paper's Table 1 and ours.

use super::options::ENGINES;
use super::{BilliardsScene, Replaced, Row, Shot, billiards_metrics};
use crate::MaterialPrior;
use sms_core::metrics::Metrics;
use sms_synth::{FIRST_DRAWN, FIXED_SCENES};
use sms_target::TargetEngine;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// The paper's figures (Table 1), centimetres: label, key, SMS, baseline. The baseline is one plan a scene.
const PAPER: [(&str, &str, &str, &str); 6] = [
    ("predicted, overall", "predicted_", "5.5 (12.7)", "5.8 (10.2)"),
    ("predicted, best per scene", "predicted_best_", "0.0 (0.0)", ""),
    ("predicted, worst per scene", "predicted_worst_", "27.1 (19.3)", ""),
    ("realised, overall", "realised_", "20.5 (17.9)", "28.2 (21.7)"),
    ("realised, best per scene", "realised_best_", "5.5 (8.3)", ""),
    ("realised, worst per scene", "realised_worst_", "41.2 (22.1)", ""),
];

/// The table of results, one block for each engine and material prior, with one line for each scene below it: those where
/// the robust plan fares worst come first.
pub fn billiards_table(scenes: &[BilliardsScene]) -> String {
    let metrics = billiards_metrics(scenes);
    let mut text = String::new();
    for material_prior in MaterialPrior::ALL {
        let of_prior: Vec<&BilliardsScene> =
            scenes.iter().filter(|s| s.material_prior == material_prior).collect();
        if of_prior.is_empty() {
            let _ = writeln!(text, "materials {}: not run", material_prior.as_str());
            continue;
        }
        // The judge first.
        for engine in ENGINES {
            block(&mut text, &metrics, &of_prior, material_prior, engine);
        }
        ablation(&mut text, &of_prior);
        time(&mut text, &of_prior);
    }
    text
}

fn block(
    text: &mut String,
    metrics: &Metrics,
    scenes: &[&BilliardsScene],
    material_prior: MaterialPrior,
    engine: TargetEngine,
) {
    let key = engine.key();
    let there: Vec<&BilliardsScene> =
        scenes.iter().copied().filter(|s| s.realised.contains_key(key)).collect();
    if there.is_empty() {
        let why = metrics.get(&format!("bench.billiards.{key}.not_run")).and_then(|w| w.as_str());
        let _ = writeln!(
            text,
            "{key}, materials {}: not run ({})",
            material_prior.as_str(),
            why.unwrap_or("not requested")
        );
        return;
    }
    let same = if engine == TargetEngine::Rapier { " (same engine)" } else { "" };
    let geometry = there[0].geometry.as_str();
    let starts = [Row::Ours, Row::Paper].iter().find_map(|row| there[0].plans.get(row)).map_or(1, Vec::len);
    let _ = writeln!(
        text,
        "{key}{same}, materials {}, geometry {geometry}: {} of {} scenes, {starts} starts; cm, mean (sd)\n  {:<28}{:>14}{:>14}{:>14}{:>14}{:>14}",
        material_prior.as_str(),
        there.len(),
        if there.iter().all(|s| s.number < FIRST_DRAWN) { FIXED_SCENES.len() } else { there.len() },
        "",
        "SMS, paper's",
        "row paper",
        "row ours",
        "grid, paper's",
        "grid"
    );
    let prefix = format!("bench.billiards.{key}");
    let cell = |row: &str, name: &str| {
        let at = |what: &str| {
            metrics.number(&format!("{prefix}.{row}.{}.{name}{what}_m", material_prior.as_str()))
        };
        match (at("mean"), at("sd")) {
            (Some(mean), Some(sd)) => format!("{:.1} ({:.1})", 1e2 * mean, 1e2 * sd),
            _ => "-".to_owned(),
        }
    };
    for (label, name, paper, paper_grid) in PAPER {
        let grid = if paper_grid.is_empty() { String::new() } else { cell("grid", name) };
        let (paper_row, ours) = (cell("paper", name), cell("ours", name));
        let _ = writeln!(text, "  {label:<28}{paper:>14}{paper_row:>14}{ours:>14}{paper_grid:>14}{grid:>14}");
    }
    let single = cell("ours", "robust_single_");
    let _ = writeln!(text, "  {:<28}{:>14}{:>14}{single:>14}", "one robust plan, realised", "", "");
    for (label, key) in [("rollouts a start", "evaluations"), ("iterations a start", "iterations")] {
        let of = |row: &str| {
            let value = metrics.number(&format!("{prefix}.{row}.{}.{key}", material_prior.as_str()));
            value.map_or_else(|| "-".to_owned(), |v| format!("{v:.0}"))
        };
        let _ = writeln!(text, "  {label:<28}{:>14}{:>14}{:>14}", "", of("paper"), of("ours"));
    }
    unfinished(text, &there, key);
    per_scene(text, &there, key);
}

/// Scenes without a plan in row `paper`, and shots that the engine could not finish, with the reasons: they count as shots that do
/// nothing.
fn unfinished(text: &mut String, scenes: &[&BilliardsScene], engine: &str) {
    for s in scenes {
        if let Some(why) = &s.paper_problem {
            let _ = writeln!(text, "  not planned, scene {:>2}: row paper: {why}", s.number);
        }
        let mut whys: BTreeMap<&str, Vec<String>> = BTreeMap::new();
        for row in Row::ALL {
            let outcomes = s.realised.get(engine).and_then(|of| of.get(&row)).map_or(&[][..], Vec::as_slice);
            for start in (0..outcomes.len()).filter(|&i| outcomes[i].is_none()) {
                let why = s.why_unfinished(engine, row, start).unwrap_or("the file does not say why");
                whys.entry(why).or_default().push(format!("{} {}", row.as_str(), start + 1));
            }
        }
        for (why, shots) in whys {
            let _ = writeln!(text, "  not finished, scene {:>2}: {}: {why}", s.number, shots.join(", "));
        }
    }
}

/// One line a scene, worst robust plan first.
fn per_scene(text: &mut String, scenes: &[&BilliardsScene], engine: &str) {
    let of = |s: &BilliardsScene, row: Row| s.realised_m(engine, row).unwrap_or_default();
    let single = |s: &BilliardsScene| of(s, Row::Robust).first().copied().unwrap_or(f64::NAN);
    // Rows that were not requested are absent.
    let cm = |m: f64| if m.is_finite() { format!("{:.1}", 1e2 * m) } else { "-".to_owned() };
    let mut order = scenes.to_vec();
    order.sort_by(|a, b| single(b).total_cmp(&single(a)).then(a.number.cmp(&b.number)));
    let _ = writeln!(
        text,
        "  scene            robust (pred.)   ours mean  best worst    paper mean  best worst    grid   matched"
    );
    for s in order {
        let spread = |row: Row| {
            let values = of(s, row);
            let (mean, _) = super::figures::mean_sd(&values);
            let best = values.iter().copied().fold(f64::INFINITY, f64::min);
            let worst = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            format!("{:>10} {:>5} {:>5}", cm(mean), cm(best), cm(worst))
        };
        let shot = s.plans.get(&Row::Robust).and_then(|v| v.first());
        let predicted = shot.map_or(f64::NAN, Shot::expected_m);
        let _ = writeln!(
            text,
            "  {:>2} {:<10} {:>8} {:>7}    {}    {}  {:>6}   {}/{}",
            s.number,
            s.layout.as_str(),
            cm(single(s)),
            format!("({})", cm(predicted)),
            spread(Row::Ours),
            spread(Row::Paper),
            cm(of(s, Row::Grid).first().copied().unwrap_or(f64::NAN)),
            s.matched,
            s.objects
        );
    }
}

/// Realised objectives of row `ours` and of the robust plan with one input after another replaced by the truth.
fn ablation(text: &mut String, scenes: &[&BilliardsScene]) {
    let there: Vec<&BilliardsScene> = scenes.iter().copied().filter(|s| s.ablation.is_some()).collect();
    let Some(first) = there.first().and_then(|s| s.ablation.as_ref()) else { return };
    let _ = writeln!(
        text,
        "ablation: {} scenes, {} starts, judge {}; cm realised, means\n  {:<22}{:>12}{:>12}",
        there.len(),
        first.starts,
        first.judge,
        "replaced by the truth",
        "row ours",
        "robust plan"
    );
    for what in Replaced::ALL {
        let mean = |row| {
            let of = |s: &&BilliardsScene| s.ablation.as_ref()?.realised_m(what, row, s.idle_m);
            let values: Vec<f64> = there.iter().filter_map(of).collect();
            1e2 * super::figures::mean_sd(&values).0
        };
        let lost = |row| -> usize {
            let of =
                |s: &&BilliardsScene| Some(s.ablation.as_ref()?.rows.get(&what)?.get(&row)?.unfinished());
            there.iter().filter_map(of).sum()
        };
        let lost = lost(Row::Ours) + lost(Row::Robust);
        let lost = if lost == 0 { String::new() } else { format!("   {lost} not finished") };
        let (ours, robust) = (mean(Row::Ours), mean(Row::Robust));
        let _ = writeln!(text, "  {:<22}{ours:>12.1}{robust:>12.1}{lost}", what.as_str());
    }
}

/// CPU time by part.
fn time(text: &mut String, scenes: &[&BilliardsScene]) {
    let mut parts: BTreeMap<&str, (f64, f64)> = BTreeMap::new();
    for (part, &seconds) in scenes.iter().flat_map(|s| &s.cpu_s) {
        let part = parts.entry(part.as_str()).or_default();
        *part = (part.0 + seconds, part.1.max(seconds));
    }
    if parts.is_empty() {
        return;
    }
    let mut parts: Vec<(&str, (f64, f64))> = parts.into_iter().collect();
    parts.sort_by(|a, b| b.1.0.total_cmp(&a.1.0));
    let all: f64 = parts.iter().map(|p| p.1.0).sum();
    let list: Vec<String> =
        parts.iter().map(|(p, (sum, most))| format!("{p} {sum:.0} ({most:.0})")).collect();
    let _ = writeln!(
        text,
        "CPU seconds, all scenes (most in one): {}; together {:.1} CPU-minutes",
        list.join(", "),
        all / 60.0
    );
}
