//! `sms simulate`: simulates the scene at rest.

use crate::cli::SimulateArguments;
use sms_cli::front::Console;
use sms_core::{counted, length_text};
use sms_pipeline::{Run, is_at_rest};
use sms_sim::RestingDrift;

pub(crate) fn run(console: &Console, a: &SimulateArguments) -> anyhow::Result<()> {
    let run = Run::new(&a.run, &console.context);
    let drifts = run.simulate(a.seconds)?;
    for d in &drifts {
        console.say(format!(
            "{:>16}: {} (moved {}, turned {:.2}° in {} s)",
            d.body,
            if is_at_rest(d) { "at rest" } else { "moves" },
            length_text(d.moved_m),
            d.turned_rad.to_degrees(),
            a.seconds
        ));
    }
    console.say(verdict(&drifts));
    console.conclude(&run)
}

/// Says whether the scene is at rest, or which bodies move.
fn verdict(drifts: &[RestingDrift]) -> String {
    let moving: Vec<&str> = drifts.iter().filter(|d| !is_at_rest(d)).map(|d| d.body.as_str()).collect();
    match (drifts.len(), moving.len()) {
        (0, _) => "simulate: no body can move".to_owned(),
        (all, 0) => format!("simulate: at rest ({})", counted(all, "body", "bodies")),
        (all, some) => {
            let bodies = counted(all, "body", "bodies");
            format!("simulate: {some} of {bodies} move: {}", moving.join(", "))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_verdict_names_the_bodies_that_move() {
        let drift =
            |body: &str, moved_m: f64| RestingDrift { body: body.to_owned(), moved_m, turned_rad: 0.0 };
        let still = [drift("mug", 1e-5), drift("duck", 0.0)];
        assert!(verdict(&still).contains("at rest"));
        let falling = [drift("mug", 1e-5), drift("duck", 0.05), drift("can", 0.003)];
        let text = verdict(&falling);
        assert!(text.contains("2 of 3") && text.contains("duck, can") && !text.contains("mug"), "{text}");
        assert!(!verdict(&[]).contains("at rest"));
    }
}
