//! The table with the paper's figures, and the metrics.

use super::options::word;
use super::result::OURS;
use super::{LandingFlight, LandingPlanned, LandingScan};
use crate::MaterialPrior;
use crate::scenes::LANDING_SCENES;
use sms_core::metrics::Metrics;
use std::collections::BTreeSet;
use std::fmt::Write;

/// Landing success of the paper's method and of its baseline on its four scenes (section "Quadrotor Landing Scenario"); its scenes
/// are not ours.
const PAPER_SMS: [f64; 4] = [1.0, 0.8, 0.9, 0.9];
const PAPER_PROMPTING: [f64; 4] = [0.5, 0.5, 0.6, 0.5];

/// The baseline that asks a vision-language model.
const PROMPTING: &str = "visual_prompting";

/// The landings of one planner on one scene.
fn of<'a>(
    flights: &'a [LandingFlight],
    scene: Option<usize>,
    material_prior: MaterialPrior,
    name: &str,
) -> Vec<&'a LandingPlanned> {
    flights
        .iter()
        .filter(|f| f.material_prior == material_prior && scene.is_none_or(|s| s == f.scene))
        .filter_map(|f| f.planned.get(name))
        .collect()
}

fn rate(landings: &[&LandingPlanned]) -> Option<f64> {
    let good = landings.iter().filter(|l| l.success).count();
    (!landings.is_empty()).then(|| good as f64 / landings.len() as f64)
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let values: Vec<f64> = values.collect();
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Names of the baselines that flew.
fn baselines(flights: &[LandingFlight]) -> BTreeSet<&str> {
    let names = flights.iter().flat_map(|f| f.planned.keys());
    names.map(String::as_str).filter(|n| *n != OURS).collect()
}

/// `bench.landing.{scene}.{success_rate,noisy_success_rate,evaluation_s,…}`, the baselines' rates, and the means over the fixed scenes as
/// `bench.landing.mean.…`.
pub fn landing_metrics(flights: &[LandingFlight]) -> Metrics {
    let mut metrics = Metrics::new();
    let (class, noisy) = (MaterialPrior::Class, MaterialPrior::Noisy);
    let mut figures: Vec<(String, Vec<f64>)> = Vec::new();
    let scanned = flights.iter().any(|f| f.scanned);
    let mean_word = if scanned { "scanned_mean" } else { "mean" };
    for scene in scenes(flights) {
        let word = word(scene, scanned);
        let own = of(flights, Some(scene), class, OURS);
        let jet: Vec<f64> = own.iter().filter_map(|l| Some(f64::from(u8::from(l.jet_success?)))).collect();
        let there = || flights.iter().filter(move |f| f.scene == scene);
        let mut found = vec![
            ("success_rate".to_owned(), rate(&own)),
            ("noisy_success_rate".to_owned(), rate(&of(flights, Some(scene), noisy, OURS))),
            ("jet_success_rate".to_owned(), mean(jet.into_iter())),
            ("evaluation_s".to_owned(), mean(there().filter_map(|f| f.evaluation_s))),
            ("plan_cpu_s".to_owned(), mean(own.iter().map(|l| l.plan_cpu_s))),
            ("target_cpu_s".to_owned(), mean(own.iter().map(|l| l.target_cpu_s))),
            ("predicted_share".to_owned(), mean(own.iter().filter_map(|l| l.predicted_share))),
            ("matched_share".to_owned(), mean(there().map(|f| f.matched as f64 / f.objects.max(1) as f64))),
        ];
        for name in baselines(flights) {
            let landings = of(flights, Some(scene), class, name);
            let air = landings.iter().map(|l| f64::from(u8::from(l.in_the_air)));
            found.push((format!("{name}_success_rate"), rate(&landings)));
            found.push((format!("{name}_toppled_in_the_air_rate"), mean(air)));
        }
        for (key, value) in found {
            let Some(value) = value else { continue };
            metrics.set(format!("bench.landing.{word}.{key}"), value);
            if !LANDING_SCENES.contains(&scene) {
                continue;
            }
            match figures.iter_mut().find(|(k, _)| *k == key) {
                Some((_, values)) => values.push(value),
                None => figures.push((key, vec![value])),
            }
        }
    }
    for (key, values) in figures {
        metrics.set(
            format!("bench.landing.{mean_word}.{key}"),
            values.iter().sum::<f64>() / values.len() as f64,
        );
    }
    metrics.set("bench.landing.flights", flights.len() as f64);
    metrics
}

/// `bench.landing.{scene}.{matched_share,drift_m,drift_rad,tipping_load_end_error,…}` of scans in which nothing was planned yet.
pub fn landing_scan_metrics(scans: &[LandingScan]) -> Metrics {
    let mut metrics = Metrics::new();
    for scan in scans {
        let word = word(scan.scene, scan.scanned);
        let share = scan.matched as f64 / scan.objects.max(1) as f64;
        metrics.set(format!("bench.landing.{word}.matched_share"), share);
        metrics.set(format!("bench.landing.{word}.falling"), scan.falling.is_some());
        if let Some(standing) = scan.standing.as_ref().filter(|_| scan.falling.is_none()) {
            standing.tell(&word, &mut metrics);
        }
    }
    metrics
}

/// Numbers of the scenes that were flown in, in their order.
fn scenes(flights: &[LandingFlight]) -> BTreeSet<usize> {
    flights.iter().map(|f| f.scene).collect()
}

/// Success by scene with the paper's (its four scenes differ: compare means only).
pub fn landing_table(flights: &[LandingFlight]) -> String {
    let mut text = String::new();
    let percent = |v: Option<f64>| v.map_or_else(|| "-".to_owned(), |v| format!("{:.0} %", 100.0 * v));
    let scenes = scenes(flights);
    let titles: String = scenes.iter().map(|n| format!("{:>12}", format!("scene {n}"))).collect();
    let _ = writeln!(text, "landing success                      {titles}        mean");
    let mut row = |label: &str, values: &[Option<f64>]| {
        let known: Vec<f64> = values.iter().flatten().copied().collect();
        let cells: String = values.iter().map(|v| format!("{:>12}", percent(*v))).collect();
        if !known.is_empty() {
            let all = known.iter().sum::<f64>() / known.len() as f64;
            let _ = writeln!(text, "  {label:<35}{cells}{:>12}", percent(Some(all)));
        }
    };
    let each = |material_prior, name: &str| -> Vec<Option<f64>> {
        scenes.iter().map(|n| rate(&of(flights, Some(*n), material_prior, name))).collect()
    };
    row("ours, materials class", &each(MaterialPrior::Class, OURS));
    row("ours, materials noisy", &each(MaterialPrior::Noisy, OURS));
    let jet = |scene: &usize| {
        let own = of(flights, Some(*scene), MaterialPrior::Class, OURS);
        mean(own.iter().filter_map(|l| Some(f64::from(u8::from(l.jet_success?)))))
    };
    row("ours, target's wash a jet", &scenes.iter().map(jet).collect::<Vec<_>>());
    for name in baselines(flights) {
        row(&format!("{} (baseline)", name.replace('_', " ")), &each(MaterialPrior::Class, name));
    }
    if !baselines(flights).contains(PROMPTING) {
        let _ = writeln!(text, "  visual prompting: not run");
    }
    for (label, rates) in [("paper, SMS", PAPER_SMS), ("paper, visual prompting", PAPER_PROMPTING)] {
        let its_own = rates.map(|r| percent(Some(r))).join(", ");
        let all = percent(mean(rates.into_iter()));
        let _ = writeln!(text, "  {label}, on its own four scenes: {its_own}; mean {all}");
    }
    for flight in flights {
        let Some(own) = flight.planned.get(OURS).filter(|p| !p.success) else { continue };
        let why = own.failure.as_deref().unwrap_or("it failed");
        let air = if own.in_the_air { ", in the air" } else { "" };
        let _ = writeln!(
            text,
            "  scene {}, start {}, {}{}: {why}{air}{}",
            flight.scene,
            flight.start,
            flight.material_prior.as_str(),
            if flight.material_prior == MaterialPrior::Noisy {
                format!(" {}", flight.draw)
            } else {
                String::new()
            },
            own.problem.as_ref().map_or(String::new(), |p| format!(" ({p})"))
        );
    }
    let engines: BTreeSet<&str> = flights.iter().map(|f| f.engine.as_str()).collect();
    for engine in engines {
        let _ = writeln!(text, "target world: {engine}");
    }
    let sph = mean(flights.iter().filter_map(|f| f.evaluation_s));
    let plans: Vec<&LandingPlanned> = flights.iter().filter_map(|f| f.planned.get(OURS)).collect();
    let plan = mean(plans.iter().map(|p| p.plan_cpu_s));
    let target = mean(plans.iter().map(|p| p.target_cpu_s));
    if let (Some(sph), Some(plan), Some(target)) = (sph, plan, target) {
        let _ = writeln!(
            text,
            "one evaluation with sph {sph:.2} s; a plan {plan:.0} CPU-s, a flight in the target {target:.0} CPU-s"
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::Hash;

    fn landing(success: bool) -> LandingPlanned {
        LandingPlanned {
            action: None,
            problem: None,
            variant: String::new(),
            predicted_share: Some(1.0),
            predicted: Some(0.01),
            success,
            failure: (!success).then(|| "`box` was moved by 40 cm".to_owned()),
            failure_kind: None,
            in_the_air: !success,
            realised: None,
            jet_success: Some(true),
            plan_cpu_s: 60.0,
            target_cpu_s: 20.0,
        }
    }

    fn flight(
        scene: usize,
        start: usize,
        material_prior: MaterialPrior,
        ours: bool,
        random: bool,
    ) -> LandingFlight {
        let planned = [(OURS, ours), ("random", random)].map(|(n, s)| (n.to_owned(), landing(s)));
        LandingFlight {
            key: Hash(String::new()),
            scene,
            scanned: false,
            engine: "an engine".to_owned(),
            start,
            material_prior,
            draw: 0,
            objects: 2,
            matched: 2,
            evaluation_s: Some(0.8),
            planned: planned.into_iter().collect(),
        }
    }

    #[test]
    fn rates_are_by_scene_and_means_are_over_scenes() {
        let class = MaterialPrior::Class;
        let flights = [
            flight(1, 0, class, true, false),
            flight(1, 5, class, true, true),
            flight(2, 0, class, false, false),
            flight(2, 0, MaterialPrior::Noisy, true, true),
            flight(1001, 0, class, true, true),
        ];
        let m = landing_metrics(&flights);
        let at = |key: &str| m.number(&format!("bench.landing.{key}"));
        assert_eq!(at("box_on_ladder.success_rate"), Some(1.0));
        assert_eq!(at("tote_on_stool.success_rate"), Some(0.0));
        assert_eq!(at("tote_on_stool_1001.success_rate"), Some(1.0));
        assert_eq!(at("mean.success_rate"), Some(0.5));
        assert_eq!(at("box_on_ladder.random_success_rate"), Some(0.5));
        assert_eq!(at("tote_on_stool.noisy_success_rate"), Some(1.0));
        assert_eq!(at("box_on_ladder.noisy_success_rate"), None);
        assert_eq!(at("mean.evaluation_s"), Some(0.8));
        let text = landing_table(&flights);
        for part in [
            "ours, materials class",
            "random (baseline)",
            "paper, SMS",
            "scene 1001",
            "scene 2, start 0",
            "target world: an engine",
            "visual prompting: not run",
            "40 cm",
        ] {
            assert!(text.contains(part), "{text}");
        }
    }
}
