//! `sms export`: exports the scene for other simulators.

use crate::cli::ExportArguments;
use sms_cli::front::Console;
use sms_pipeline::{Format, Run};

pub(crate) fn run(console: &Console, a: &ExportArguments) -> anyhow::Result<()> {
    let run = Run::new(&a.run, &console.context);
    // Keeps each format once, in the order of the list.
    let formats: Vec<Format> =
        Format::ALL.into_iter().filter(|f| a.format.iter().any(|name| name.includes(*f))).collect();
    for file in run.export(&formats, a.out.as_deref())? {
        console.say(file.display());
    }
    console.conclude(&run)
}
