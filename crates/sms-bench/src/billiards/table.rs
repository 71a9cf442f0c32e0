//! The paper's Table 1 with ours beside it.

use super::{BilliardsScene, Row, billiards_metrics};
use crate::MaterialsTold;
use sms_core::metrics::Metrics;
use sms_synth::FIXED_SCENES;
use sms_target::TargetEngine;
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
/// Objective up to which a shot counts as done, metres (the task's default).
const DONE_M: f64 = 0.05;

/// The table of results, one block for each engine and what was told, with one line for each scene below it: those where
/// the robust plan fares worst come first.
pub fn billiards_table(scenes: &[BilliardsScene]) -> String {
    let metrics = billiards_metrics(scenes);
    let mut text = String::new();
    for told in MaterialsTold::ALL {
        let of_told: Vec<&BilliardsScene> = scenes.iter().filter(|s| s.told == told).collect();
        if of_told.is_empty() {
            let _ = writeln!(text, "materials {}: not run", told.as_str());
            continue;
        }
        // The judge first.
        for engine in
            [TargetEngine::Physx, TargetEngine::PhysxStock, TargetEngine::Mujoco, TargetEngine::Rapier]
        {
            block(&mut text, &metrics, &of_told, told, engine);
        }
    }
    text.push_str("materials vlm: not run\n");
    text
}

fn block(
    text: &mut String,
    metrics: &Metrics,
    scenes: &[&BilliardsScene],
    told: MaterialsTold,
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
            told.as_str(),
            why.unwrap_or("not asked for")
        );
        return;
    }
    let same = if engine == TargetEngine::Rapier { " (same engine)" } else { "" };
    let geometry = there[0].geometry.as_str();
    let starts = there[0].plans.get(&Row::Ours).map_or(0, Vec::len);
    let _ = writeln!(
        text,
        "{key}{same}, materials {}, geometry {geometry}: {} of {} scenes, {starts} starts; cm, mean (sd)\n  {:<28}{:>14}{:>14}{:>14}{:>14}{:>14}",
        told.as_str(),
        there.len(),
        FIXED_SCENES.len(),
        "",
        "SMS, paper's",
        "row paper",
        "row ours",
        "grid, paper's",
        "grid"
    );
    let prefix = format!("bench.billiards.{key}");
    let cell = |row: &str, name: &str| {
        let at = |what: &str| metrics.number(&format!("{prefix}.{row}.{}.{name}{what}_m", told.as_str()));
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
    per_scene(text, &there, key);
}

/// One line a scene, worst robust plan first.
fn per_scene(text: &mut String, scenes: &[&BilliardsScene], engine: &str) {
    let of = |s: &BilliardsScene, row: Row| s.realised_m(engine, row).unwrap_or_default();
    let single = |s: &BilliardsScene| of(s, Row::Robust).first().copied().unwrap_or(f64::NAN);
    let mut order = scenes.to_vec();
    order.sort_by(|a, b| single(b).total_cmp(&single(a)).then(a.number.cmp(&b.number)));
    let _ = writeln!(
        text,
        "  scene            robust (told)    ours mean  best worst    paper mean  best worst    grid   seen"
    );
    for s in order {
        let spread = |row: Row| {
            let values = of(s, row);
            let (mean, _) = super::figures::mean_sd(&values);
            let best = values.iter().copied().fold(f64::INFINITY, f64::min);
            let worst = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            format!("{:>10.1} {:>5.1} {:>5.1}", 1e2 * mean, 1e2 * best, 1e2 * worst)
        };
        let shot = s.plans.get(&Row::Robust).and_then(|v| v.first());
        let promised = shot.map_or(f64::NAN, |p| p.predicted_mean_m.unwrap_or(p.predicted_m));
        let _ = writeln!(
            text,
            "  {:>2} {:<10} {:>8.1} {:>7}    {}    {}  {:>6.1}   {}/{}{}",
            s.number,
            s.layout.as_str(),
            1e2 * single(s),
            format!("({:.1})", 1e2 * promised),
            spread(Row::Ours),
            spread(Row::Paper),
            1e2 * of(s, Row::Grid).first().copied().unwrap_or(f64::NAN),
            s.matched,
            s.objects,
            cause(s, single(s), promised, engine)
        );
    }
}

/// Why the robust plan of a scene missed, as far as the figures tell.
fn cause(s: &BilliardsScene, realised: f64, promised: f64, engine: &str) -> String {
    if let Some(problem) = &s.problem {
        return format!("  nothing planned: {problem}");
    }
    if realised <= DONE_M {
        return String::new();
    }
    let unfinished = s
        .realised
        .get(engine)
        .and_then(|of| of.get(&Row::Robust))
        .is_some_and(|v| v.first().is_some_and(Option::is_none));
    if unfinished {
        "  the engine could not finish the shot".into()
    } else if promised > DONE_M {
        "  no shot was found that holds in disturbed worlds".into()
    } else if s.matched < s.objects {
        format!("  {} objects are not where the scan has any", s.objects - s.matched)
    } else {
        "  the target differs from what the plan allows for".into()
    }
}
