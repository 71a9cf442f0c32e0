//! `sms check`: is this recording what it says?

use crate::cli::Check;
use crate::context::Context;
use sms_frames::{ReadOptions, Recording, check};

pub(crate) fn run(context: &Context, a: &Check) -> anyhow::Result<()> {
    let options = context.settings.section("read", ReadOptions::default())?;
    let recording = Recording::open(&a.recording, &options)?;
    let report = check(&recording, context.progress.as_ref(), &context.cancel)?;
    if context.json {
        context.print_json(&report.metrics())
    } else {
        context.say(report.to_text());
        Ok(())
    }
}
