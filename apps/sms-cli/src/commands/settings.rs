//! `sms settings`: every setting that would be in force, as a file for `--settings`.

use crate::cli::SettingsArguments;
use crate::context::Context;
use crate::settings::{SECTIONS, Settings};
use sms_core::toml_value;
use sms_entities::EntitiesConfig;
use sms_eval::EvaluateSettings;
use sms_frames::{LoadSettings, ReadOptions};
use sms_gaussians::{Preset, ScanConfig};
use sms_masks::GeometryConfig;
use sms_plan::PlanConfig;
use sms_poses::PosesConfig;
use sms_robots::RobotConfig;
use std::fmt::Write;

pub(crate) fn run(context: &Context, a: &SettingsArguments) -> anyhow::Result<()> {
    let preset = a.preset.unwrap_or(crate::cli::PresetName::Standard);
    context.print(text(&context.settings, preset.preset())?.trim_end());
    Ok(())
}

/// Pose refinement weighs depth by the noise that the frames are loaded with.
pub(crate) fn poses_defaults(frames: &LoadSettings) -> PosesConfig {
    PosesConfig { noise: frames.noise, ..PosesConfig::default() }
}

/// All sections as TOML, with the overrides applied to the preset's values.
pub(crate) fn text(settings: &Settings, preset: Preset) -> anyhow::Result<String> {
    let frames = LoadSettings { long_side: preset.long_side(), ..LoadSettings::default() };
    let mut out = String::from(
        "# Settings of all stages. Keep what you change and give the file with --settings FILE, or single values with\n\
         # --set section.key=value. Lengths in metres, angles in radians, times in seconds unless the name says else.\n",
    );
    let frames = settings.section("frames", frames)?;
    for (name, about) in SECTIONS {
        let value = match *name {
            "read" => serde_json::to_value(settings.section(name, ReadOptions::default())?)?,
            "frames" => serde_json::to_value(&frames)?,
            "poses" => serde_json::to_value(settings.section(name, poses_defaults(&frames))?)?,
            "masks" => serde_json::to_value(settings.section(name, GeometryConfig::default())?)?,
            "scan" => serde_json::to_value(settings.section(name, ScanConfig::preset(preset))?)?,
            "entities" => serde_json::to_value(settings.section(name, EntitiesConfig::default())?)?,
            "vlm" => serde_json::to_value(settings.section(name, super::vlm::defaults())?)?,
            "plan" => serde_json::to_value(settings.section(name, PlanConfig::default())?)?,
            "robot" => serde_json::to_value(settings.section(name, RobotConfig::default())?)?,
            "evaluate" => serde_json::to_value(settings.section(name, EvaluateSettings::default())?)?,
            _ => continue,
        };
        let mut table = toml::Table::new();
        table.extend(toml_value(&value).map(|v| ((*name).to_owned(), v)));
        write!(out, "\n# {about}\n{table}")?;
    }
    Ok(out)
}
