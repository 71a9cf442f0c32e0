//! `sms settings`: prints all effective settings, as a file for `--settings`.

use crate::cli::SettingsArguments;
use sms_cli::front::{Console, PresetName};
use sms_pipeline::settings::text;

pub(crate) fn run(console: &Console, a: &SettingsArguments) -> anyhow::Result<()> {
    let preset = a.preset.unwrap_or(PresetName::Standard);
    console.print(text(&console.context.settings, preset.preset())?.trim_end());
    Ok(())
}
