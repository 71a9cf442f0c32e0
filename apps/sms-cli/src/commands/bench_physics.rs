//! `sms bench physics`: the closed-form suite in every engine that is built.

use crate::context::Context;
use clap::Args;
use sms_core::metrics::Metrics;
use sms_sim::suite::{Statistic, probes};
use sms_sim::{RapierF64Factory, RapierFactory, WorldFactory};

#[derive(Debug, Args, Clone)]
pub(crate) struct BenchPhysics {
    /// Only the probes whose names contain this.
    #[arg(long, value_name = "TEXT", default_value = "")]
    pub only: String,
}

pub(crate) fn run(context: &Context, a: &BenchPhysics) -> anyhow::Result<()> {
    let engines: [(&str, &dyn WorldFactory); 2] =
        [("rapier_f32", &RapierFactory), ("rapier_f64", &RapierF64Factory)];
    let mut metrics = Metrics::new();
    let chosen: Vec<_> = probes().iter().filter(|p| p.name.contains(&a.only)).collect();
    if chosen.is_empty() {
        let names: Vec<&str> = probes().iter().map(|p| p.name).collect();
        return Err(sms_core::InputError::new(
            format!("no probe has `{}` in its name", a.only),
            "--only",
            format!("there are {}", names.join(", ")),
        )
        .into());
    }
    context.say(format!("{:>22}  {:>10} {:>10} {:>10}", "probe", "limit", engines[0].0, engines[1].0));
    let mut missed = 0;
    for probe in chosen {
        context.cancel.check()?;
        let mut row = format!("{:>22}  {:>10}", probe.name, probe.limit);
        for (name, factory) in engines {
            let figure = probe.figure(&probe.measure(factory)?);
            metrics.set(format!("bench.physics.{name}.{}", probe.name), figure);
            missed += usize::from(figure > probe.limit);
            row += &format!(" {figure:>9.5}{}", if figure > probe.limit { "!" } else { " " });
        }
        let which = if probe.statistic == Statistic::Rms { "rms" } else { "worst" };
        context.say(format!("{row} {which}: {}", probe.what));
    }
    if context.json {
        context.print_json(&metrics)?;
    }
    anyhow::ensure!(missed == 0, "{missed} figures are beyond their limits");
    context.say("all within their limits");
    Ok(())
}
