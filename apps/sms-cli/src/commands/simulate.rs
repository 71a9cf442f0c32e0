//! `sms simulate`: does the scene rest?

use super::length_text;
use super::materialize::drift_text;
use crate::cli::Simulate;
use sms_cli::front::Console;
use sms_core::metrics::Metrics;
use sms_core::{InputError, RunFolder, Warnings, atomic};
use sms_scene::load_scene;
use sms_sim::{RapierFactory, resting_drift};

pub(crate) fn run(console: &Console, a: &Simulate) -> anyhow::Result<()> {
    if !(a.seconds > 0.0 && a.seconds <= 600.0) {
        return Err(InputError::new(
            format!("{} seconds cannot be simulated", a.seconds),
            "--seconds",
            "give more than 0 and at most 600",
        )
        .into());
    }
    let run = RunFolder::open(&a.run)?;
    let scene = load_scene(&run.stage_dir("scene", "materialize")?)?;
    let drifts = resting_drift(&RapierFactory, &scene, a.seconds)?;
    let mut metrics = Metrics::new();
    let worst = |f: fn(&sms_sim::RestingDrift) -> f64| drifts.iter().map(f).fold(0.0, f64::max);
    metrics.set("simulate.seconds_simulated", a.seconds);
    metrics.set("simulate.drift_m", worst(|d| d.moved_m));
    metrics.set("simulate.turn_rad", worst(|d| d.turned_rad));
    let warnings = Warnings::new();
    for d in &drifts {
        console.say(format!(
            "{:>16}: moved {}, turned {:.2}° in {} s",
            d.body,
            length_text(d.moved_m),
            d.turned_rad.to_degrees(),
            a.seconds
        ));
        if d.moved_m > 0.002 || d.turned_rad > 1f64.to_radians() {
            warnings.add(
                "simulate",
                "does_not_rest",
                drift_text(d),
                "look at its underside and neighbours in the report's 3-D view",
            );
        }
    }
    atomic::write_json(&run.root().join("simulate.json"), &drifts)?;
    console.finish(&run, "simulate", &["simulate."], metrics, &warnings)?;
    console.print_metrics(&run)
}
