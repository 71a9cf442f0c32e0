//! Every engine through the same closed-form suite. Run with `--nocapture` for the figures.

use sms_eval::closed_form::{Statistic, probes};
use sms_sim::{RapierF64Factory, RapierFactory, WorldFactory};

#[test]
fn every_engine_passes_the_closed_form_suite() {
    let mut missed = Vec::new();
    let factories: [&dyn WorldFactory; 2] = [&RapierFactory, &RapierF64Factory];
    for factory in factories {
        for probe in probes() {
            let measured = probe.measure(factory).unwrap();
            let figure = probe.figure(&measured);
            let which = if probe.statistic == Statistic::Rms { "rms" } else { "worst" };
            let line = format!(
                "{:>13} {:>22}: {which} {figure:.5} of {} (worst {:.5} of {})",
                factory.engine(),
                probe.name,
                probe.limit,
                measured.worst,
                measured.count
            );
            println!("{line}");
            assert!(measured.count > 0);
            if figure > probe.limit {
                missed.push(line);
            }
        }
    }
    assert!(missed.is_empty(), "{missed:#?}");
}
