//! All effective settings: as a commented file for `--settings`, and as values.

use super::keys::{describe, names_in};
use super::{SECTIONS, Settings, vlm_defaults};
use crate::Error;
use serde_json::{Map, Value};
use sms_core::{toml_value, wrapped};
use sms_entities::EntitiesConfig;
use sms_eval::EvaluateSettings;
use sms_frames::{LoadSettings, ReadOptions};
use sms_gaussians::{Preset, ScanConfig};
use sms_landing::LandingSettings;
use sms_masks::GeometryConfig;
use sms_plan::PlanConfig;
use sms_poses::PosesConfig;
use sms_robots::RobotConfig;
use sms_robots::autopilot::FlightFiles;
use sms_synth::RecordingSettings;

/// Longest line of a comment, characters.
const WIDTH: usize = 100;

/// Returns the values of all sections, with the overrides applied to the preset's. Keys that are not set are absent.
///
/// # Errors
/// [`Error::Input`] for an invalid override.
pub fn values(settings: &Settings, preset: Preset) -> Result<Map<String, Value>, Error> {
    let frames = LoadSettings { long_side: preset.long_side(), ..LoadSettings::default() };
    let frames = settings.section("frames", frames)?;
    let mut all = Map::new();
    for (name, _) in SECTIONS {
        let value = match *name {
            "recording" => serde_json::to_value(settings.section(name, RecordingSettings::default())?)?,
            "read" => serde_json::to_value(settings.section(name, ReadOptions::default())?)?,
            "frames" => serde_json::to_value(&frames)?,
            "poses" => serde_json::to_value(settings.section(name, PosesConfig::default())?)?,
            "masks" => serde_json::to_value(settings.section(name, GeometryConfig::default())?)?,
            "scan" => serde_json::to_value(settings.section(name, ScanConfig::preset(preset))?)?,
            "entities" => serde_json::to_value(settings.section(name, EntitiesConfig::default())?)?,
            "vlm" => serde_json::to_value(settings.section(name, vlm_defaults())?)?,
            "plan" => serde_json::to_value(settings.section(name, PlanConfig::default())?)?,
            "landing" => serde_json::to_value(settings.section(name, LandingSettings::default())?)?,
            "flight" => serde_json::to_value(settings.section(name, FlightFiles::default())?)?,
            "robot" => serde_json::to_value(settings.section(name, RobotConfig::default())?)?,
            "evaluate" => serde_json::to_value(settings.section(name, EvaluateSettings::default())?)?,
            other => return Err(settings.unknown_section(other).into()),
        };
        // Through TOML, in which single-precision numbers have few decimals.
        all.insert((*name).to_owned(), serde_json::to_value(toml_value(&value))?);
    }
    Ok(all)
}

/// Returns all sections as TOML, each key with its description. Keys that are not set are comments.
///
/// # Errors
/// As [`values`].
pub fn text(settings: &Settings, preset: Preset) -> Result<String, Error> {
    let mut out = String::from(
        "# Settings of all stages. Keep the changed values and pass the file with --settings FILE, or single values with\n\
         # --set section.key=value. Lengths in metres, angles in radians, times in seconds unless the name says otherwise.\n",
    );
    let values = values(settings, preset)?;
    for (name, about) in SECTIONS {
        write_table(name, about, values.get(*name), &mut out);
    }
    Ok(out)
}

/// Writes a table with its keys, then the tables in it. Without a value, it is a comment.
fn write_table(path: &str, about: &str, value: Option<&Value>, out: &mut String) {
    let off = if value.is_some() { "" } else { "# " };
    out.push_str(&format!("\n{}{off}[{path}]\n", comment(about)));
    let mut tables = Vec::new();
    for name in names_in(path) {
        let key = format!("{path}.{name}");
        let (about, value) = (describe(&key).unwrap_or_default(), value.and_then(|v| v.get(name)));
        if !names_in(&key).is_empty() {
            tables.push((key, about, value));
            continue;
        }
        out.push_str(&comment(about));
        match value.and_then(toml_value) {
            Some(value) => out.push_str(&format!("{name} = {value}\n")),
            None => out.push_str(&format!("# {name} = (not set)\n")),
        }
    }
    for (key, about, value) in tables {
        write_table(&key, about, value, out);
    }
}

fn comment(text: &str) -> String {
    format!("# {}\n", wrapped(text, WIDTH - 2, "# "))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn leaves(value: &Value, path: &str, found: &mut Vec<String>) {
        match value {
            Value::Object(map) => map.iter().for_each(|(key, v)| leaves(v, &format!("{path}.{key}"), found)),
            _ => found.push(path.to_owned()),
        }
    }

    #[test]
    fn every_key_of_every_section_is_listed_with_a_description() {
        let all = values(&Settings::default(), Preset::Standard).unwrap();
        assert_eq!(all.keys().collect::<Vec<_>>(), SECTIONS.iter().map(|s| s.0).collect::<Vec<_>>());
        let mut keys = Vec::new();
        all.iter().for_each(|(name, section)| leaves(section, name, &mut keys));
        assert!(keys.len() > 200, "{}", keys.len());
        let text = text(&Settings::default(), Preset::Standard).unwrap();
        for key in &keys {
            assert!(describe(key).is_some_and(|about| about.len() > 3), "{key}");
            let name = key.rsplit('.').next().unwrap();
            assert!(text.contains(&format!("\n{name} = ")), "{key}");
        }
        assert!(text.lines().all(|line| line.chars().count() <= 120));
    }

    #[test]
    fn the_text_has_the_values() {
        let given =
            ["frames.align={ up = [0, 0.6, 0.8] }", "read.depth_unit_m=0.0002", "landing.jet.rings=7"];
        let settings = Settings::read(None, &given.map(str::to_owned)).unwrap();
        let written: toml::Table = toml::from_str(&text(&settings, Preset::Fine).unwrap()).unwrap();
        let values = values(&settings, Preset::Fine).unwrap();
        assert_eq!(serde_json::to_value(written).unwrap(), Value::Object(values.clone()));
        assert_eq!(values["landing"]["jet"]["rings"], 7);
        assert_eq!(values["frames"]["align"]["up"][1], 0.6);
        assert_eq!(
            (&values["read"]["depth_unit_m"], values["read"].get("axes")),
            (&Value::from(0.0002), None)
        );
    }
}
