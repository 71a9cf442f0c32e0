//! The figures of the table.

use super::{BilliardsScene, Replaced, Row};
use crate::MaterialPrior;
use sms_core::metrics::Metrics;
use std::collections::BTreeSet;

/// Mean and standard deviation (n − 1; zero for a single value). Not a number without values.
pub(super) fn mean_sd(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    (mean, if values.len() > 1 { (squares / (n - 1.0)).sqrt() } else { 0.0 })
}

fn best(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::INFINITY, f64::min)
}

fn worst(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
}

/// The figures of results, with the keys of experiments/metrics.md: for every engine, row and material prior, over the scenes that
/// are there. Overall means and deviations pool all starts of all scenes; `best` and `worst` are those of each scene's
/// starts, as means and deviations over the scenes.
pub fn billiards_metrics(scenes: &[BilliardsScene]) -> Metrics {
    let mut metrics = Metrics::new();
    let engines: BTreeSet<&String> = scenes.iter().flat_map(|s| s.realised.keys()).collect();
    for material_prior in MaterialPrior::ALL {
        let of_prior: Vec<&BilliardsScene> =
            scenes.iter().filter(|s| s.material_prior == material_prior).collect();
        for engine in &engines {
            let there: Vec<&BilliardsScene> =
                of_prior.iter().copied().filter(|s| s.realised.contains_key(*engine)).collect();
            if there.is_empty() {
                continue;
            }
            let engine_prefix = format!("bench.billiards.{engine}");
            let is_planned = |row: &Row| there.iter().any(|s| s.plans.contains_key(row));
            for row in [Row::Paper, Row::Ours, Row::Grid].into_iter().filter(is_planned) {
                let prefix = format!("{engine_prefix}.{}.{}", row.as_str(), material_prior.as_str());
                metrics.set(format!("{prefix}.scenes"), there.len());
                add_row(&mut metrics, &prefix, engine, row, &there);
            }
            let prefix = format!("{engine_prefix}.ours.{}", material_prior.as_str());
            if is_planned(&Row::Robust) {
                add_single(&mut metrics, &prefix, engine, &there);
            }
        }
        for s in &of_prior {
            let prefix = format!("bench.billiards.scene_{:02}.{}", s.number, material_prior.as_str());
            metrics.set(format!("{prefix}.objects"), s.objects);
            metrics.set(format!("{prefix}.matched"), s.matched);
            metrics.set(format!("{prefix}.strays"), s.strays);
            metrics.set(format!("{prefix}.idle_m"), s.idle_m);
            for (row, seconds) in &s.seconds {
                metrics.set(format!("{prefix}.{}_plan_s", row.as_str()), *seconds);
            }
            for (part, seconds) in &s.cpu_s {
                metrics.set(format!("{prefix}.cpu_{part}_s"), *seconds);
            }
        }
        add_ablation(&mut metrics, material_prior, &of_prior);
    }
    for (engine, why) in scenes.iter().flat_map(|s| &s.not_run) {
        metrics.set(format!("bench.billiards.{engine}.not_run"), why.clone());
    }
    metrics
}

fn add_row(metrics: &mut Metrics, prefix: &str, engine: &str, row: Row, scenes: &[&BilliardsScene]) {
    let mut spent = Vec::new();
    let mut iterations = Vec::new();
    let mut unfinished = 0usize;
    for what in ["predicted", "realised"] {
        let values: Vec<Vec<f64>> = scenes
            .iter()
            .filter_map(|s| {
                if what == "predicted" { Some(s.predicted_m(row)) } else { s.realised_m(engine, row) }
            })
            .collect();
        for (s, values) in scenes.iter().zip(&values) {
            let key = format!("{prefix}.scene_{:02}.{what}", s.number);
            let (mean, sd) = mean_sd(values);
            metrics.set(format!("{key}_mean_m"), mean).set(format!("{key}_sd_m"), sd);
            metrics.set(format!("{key}_best_m"), best(values)).set(format!("{key}_worst_m"), worst(values));
        }
        let bests: Vec<f64> = values.iter().map(|v| best(v)).collect();
        let worsts: Vec<f64> = values.iter().map(|v| worst(v)).collect();
        let all = mean_sd(&values.concat());
        for (name, (mean, sd)) in [("", all), ("best_", mean_sd(&bests)), ("worst_", mean_sd(&worsts))] {
            metrics.set(format!("{prefix}.{what}_{name}mean_m"), mean);
            metrics.set(format!("{prefix}.{what}_{name}sd_m"), sd);
        }
    }
    for s in scenes {
        for shot in s.plans.get(&row).into_iter().flatten() {
            spent.push(shot.evaluations as f64);
            iterations.push(shot.iterations as f64);
        }
        let outcomes = s.realised.get(engine).and_then(|of| of.get(&row));
        unfinished += outcomes.map_or(0, |v| v.iter().filter(|v| v.is_none()).count());
    }
    metrics.set(format!("{prefix}.unfinished"), unfinished);
    if row != Row::Grid {
        metrics.set(format!("{prefix}.evaluations"), mean_sd(&spent).0);
        metrics.set(format!("{prefix}.iterations"), mean_sd(&iterations).0);
    }
}

/// Realised objectives with one input replaced by the truth. The keys do not name the material prior: it is the first one.
fn add_ablation(metrics: &mut Metrics, material_prior: MaterialPrior, scenes: &[&BilliardsScene]) {
    let there: Vec<&BilliardsScene> = scenes.iter().copied().filter(|s| s.ablation.is_some()).collect();
    let Some(ablation) = there.first().and_then(|s| s.ablation.as_ref()) else { return };
    let plain = "bench.billiards.ablation";
    let is_first = metrics.get(&format!("{plain}.materials_told")).is_none();
    let prefix = if is_first { plain.to_owned() } else { format!("{plain}.{}", material_prior.as_str()) };
    metrics.set(format!("{prefix}.materials_told"), material_prior.as_str());
    metrics.set(format!("{prefix}.judge"), ablation.judge.clone());
    metrics.set(format!("{prefix}.starts"), ablation.starts);
    metrics.set(format!("{prefix}.scenes"), there.len());
    for what in Replaced::ALL {
        for (row, name, of_scene) in [
            (Row::Ours, "realised_mean_m", "realised_mean_m"),
            (Row::Robust, "robust_single_mean_m", "robust_single_m"),
        ] {
            let mut values = Vec::new();
            for s in &there {
                let value = s.ablation.as_ref().and_then(|a| a.realised_m(what, row, s.idle_m));
                if let Some(value) = value {
                    let key = format!("{prefix}.scene_{:02}.{}.{of_scene}", s.number, what.as_str());
                    metrics.set(key, value);
                    values.push(value);
                }
            }
            metrics.set(format!("{prefix}.{}.{name}", what.as_str()), mean_sd(&values).0);
        }
    }
    for s in &there {
        if let Some(value) = s.ablation.as_ref().and_then(|a| a.sensitivity_m) {
            metrics.set(format!("{prefix}.scene_{:02}.sensitivity_m", s.number), value);
        }
    }
}

/// The one robust plan of each scene.
fn add_single(metrics: &mut Metrics, prefix: &str, engine: &str, scenes: &[&BilliardsScene]) {
    let (mut realised, mut predicted) = (Vec::new(), Vec::new());
    let mut unfinished = 0usize;
    for s in scenes {
        let outcomes = s.realised.get(engine).and_then(|of| of.get(&Row::Robust));
        unfinished += outcomes.map_or(0, |v| v.iter().filter(|v| v.is_none()).count());
        let Some(value) = s.realised_m(engine, Row::Robust).and_then(|v| v.first().copied()) else {
            continue;
        };
        metrics.set(format!("{prefix}.scene_{:02}.robust_single_m", s.number), value);
        realised.push(value);
        if let Some(shot) = s.plans.get(&Row::Robust).and_then(|v| v.first()) {
            let expected = shot.predicted_mean_m.unwrap_or(shot.predicted_m);
            metrics.set(format!("{prefix}.scene_{:02}.robust_single_predicted_m", s.number), expected);
            predicted.push(expected);
        }
    }
    let (mean, sd) = mean_sd(&realised);
    metrics.set(format!("{prefix}.robust_single_mean_m"), mean);
    metrics.set(format!("{prefix}.robust_single_sd_m"), sd);
    metrics.set(format!("{prefix}.robust_single_unfinished"), unfinished);
    metrics.set(format!("{prefix}.robust_single_predicted_mean_m"), mean_sd(&predicted).0);
}
