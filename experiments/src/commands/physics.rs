//! `sms-experiments physics`: the closed-form suite in every engine that is built in.

use clap::Args;
use sms_cli::front::Console;
use sms_core::InputError;
use sms_core::metrics::Metrics;
use sms_eval::closed_form::{Statistic, probes};
use sms_sim::{RapierF64Factory, RapierFactory, WorldFactory};
use sms_target::TargetEngine;

/// The planner's engine, whose figures must be within the limits. Targets may miss them (experiments/studies/target.md
/// explains why).
const PLANNER: &str = "rapier";

#[derive(Debug, Args, Clone)]
pub(crate) struct PhysicsArguments {
    /// Run only experiments whose name contains this text.
    #[arg(long, value_name = "TEXT", default_value = "")]
    pub only: String,
    /// Run only engines whose name contains this text.
    #[arg(long, value_name = "TEXT", default_value = "")]
    pub engine: String,
}

/// The factories of all engines that are built in, with their names in metrics, the planner's first, in both
/// precisions. An engine that cannot be used has the reason in place of the factory.
fn engine_factories() -> Vec<(&'static str, Result<Box<dyn WorldFactory>, InputError>)> {
    let mut all: Vec<(&'static str, Result<Box<dyn WorldFactory>, InputError>)> =
        vec![("rapier_f32", Ok(Box::new(RapierFactory))), ("rapier_f64", Ok(Box::new(RapierF64Factory)))];
    let others = TargetEngine::ALL.into_iter().filter(|e| e.is_built_in() && *e != TargetEngine::Rapier);
    all.extend(others.map(|engine| (engine.key(), engine.factory())));
    all
}

pub(crate) fn run(console: &Console, a: &PhysicsArguments) -> anyhow::Result<()> {
    let mut engines: Vec<(&str, Box<dyn WorldFactory>)> = Vec::new();
    for (key, factory) in engine_factories().into_iter().filter(|e| e.0.contains(&a.engine)) {
        match factory {
            Ok(factory) => engines.push((key, factory)),
            Err(e) => console.say(format!("{key} is not run: {e}")),
        }
    }
    let mut metrics = Metrics::new();
    let chosen: Vec<_> = probes().iter().filter(|p| p.name.contains(&a.only)).collect();
    if chosen.is_empty() || engines.is_empty() {
        let names: Vec<&str> = probes().iter().map(|p| p.name).collect();
        let (what, option) = if chosen.is_empty() { (&a.only, "--only") } else { (&a.engine, "--engine") };
        let keys: Vec<&str> = engine_factories().into_iter().map(|e| e.0).collect();
        let there = if chosen.is_empty() { names } else { keys };
        return Err(InputError::new(
            format!("no name contains `{what}`"),
            option,
            format!("there are {}", there.join(", ")),
        )
        .into());
    }
    let heads: String = engines.iter().map(|(key, _)| format!(" {key:>14}")).collect();
    console.say(format!("{:>22}  {:>10}{heads}", "probe", "limit"));
    let (mut missed, mut shown) = (0, 0);
    for probe in chosen {
        let mut row = format!("{:>22}  {:>10}", probe.name, probe.limit);
        for (key, factory) in &engines {
            console.context.cancel.check()?;
            let figure = probe.figure(&probe.measure(&**factory)?);
            metrics.set(format!("bench.physics.{key}.{}", probe.name), figure);
            let is_beyond = figure > probe.limit;
            if key.starts_with(PLANNER) {
                missed += usize::from(is_beyond)
            } else {
                shown += usize::from(is_beyond)
            }
            row += &format!(" {figure:>13.6}{}", if is_beyond { "!" } else { " " });
        }
        let which = if probe.statistic == Statistic::Rms { "rms" } else { "worst" };
        console.say(format!("{row} {which}: {}", probe.what));
    }
    if console.json {
        console.print_json(&metrics)?;
    }
    anyhow::ensure!(missed == 0, "{missed} figures of the planner's engine are beyond their limits");
    console.say(match shown {
        0 => "all within their limits".to_owned(),
        n => format!(
            "the planner's engine is within its limits; {n} figures of target engines are beyond them (!)"
        ),
    });
    Ok(())
}
