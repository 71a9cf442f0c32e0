//! `sms settings`: prints all effective settings, as a file for `--settings`, or as JSON.

use crate::cli::SettingsArguments;
use sms_cli::front::{Console, PresetName};
use sms_pipeline::settings::{text, values};

pub(crate) fn run(console: &Console, a: &SettingsArguments) -> anyhow::Result<()> {
    let (settings, preset) = (&console.context.settings, a.preset.unwrap_or(PresetName::Standard).preset());
    if console.json {
        console.print(serde_json::to_string_pretty(&values(settings, preset)?)?);
    } else {
        console.print(text(settings, preset)?.trim_end());
    }
    Ok(())
}
