//! `sms simulate`: simulates the scene at rest.

use crate::cli::SimulateArguments;
use sms_cli::front::Console;
use sms_core::length_text;
use sms_pipeline::Run;

pub(crate) fn run(console: &Console, a: &SimulateArguments) -> anyhow::Result<()> {
    let run = Run::new(&a.run, &console.context);
    for d in run.simulate(a.seconds)? {
        console.say(format!(
            "{:>16}: moved {}, turned {:.2}° in {} s",
            d.body,
            length_text(d.moved_m),
            d.turned_rad.to_degrees(),
            a.seconds
        ));
    }
    console.print_metrics(&run)
}
