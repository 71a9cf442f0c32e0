//! The settings file: one TOML table a stage, each overriding single values of the preset's.

use serde::{Serialize, de::DeserializeOwned};
use sms_core::{InputError, atomic};
use sms_entities::EntitiesConfig;
use sms_frames::{LoadSettings, ReadOptions};
use sms_gaussians::ScanConfig;
use sms_masks::GeometryConfig;
use sms_plan::PlanConfig;
use sms_report::EvaluateSettings;
use std::path::{Path, PathBuf};

/// Overrides from `--settings FILE`; empty without one.
#[derive(Debug, Default)]
pub(crate) struct Settings {
    table: toml::Table,
    path: PathBuf,
}

const SECTIONS: &str = "read, frames, masks, scan, entities, plan, evaluate";

impl Settings {
    /// Reads the file and checks every key of every section, so that a mistake is found before any work.
    pub(crate) fn read(path: Option<&Path>) -> anyhow::Result<Self> {
        let Some(path) = path else { return Ok(Self::default()) };
        let settings = Self { table: atomic::read_toml(path)?, path: path.to_owned() };
        for name in settings.table.keys() {
            match name.as_str() {
                "read" => settings.checked::<ReadOptions>(name)?,
                "frames" => settings.checked::<LoadSettings>(name)?,
                "masks" => settings.checked::<GeometryConfig>(name)?,
                "scan" => settings.checked::<ScanConfig>(name)?,
                "entities" => settings.checked::<EntitiesConfig>(name)?,
                "plan" => settings.checked::<PlanConfig>(name)?,
                "evaluate" => settings.checked::<EvaluateSettings>(name)?,
                _ => {
                    return Err(InputError::new(
                        format!("this settings file has an unknown section `{name}`"),
                        path,
                        format!("use one of: {SECTIONS}"),
                    )
                    .into());
                }
            }
        }
        Ok(settings)
    }

    /// Whether every key of a section exists and has a value of its kind.
    fn checked<T: Default + Serialize + DeserializeOwned>(&self, name: &str) -> anyhow::Result<()> {
        self.section(name, T::default()).map(|_| ())
    }

    /// `base` with this file's values of a section in place of its own.
    pub(crate) fn section<T: Serialize + DeserializeOwned>(&self, name: &str, base: T) -> anyhow::Result<T> {
        let Some(overrides) = self.table.get(name) else { return Ok(base) };
        let fault = |why: String| {
            InputError::new(
                format!("section [{name}] of this settings file has an error"),
                &self.path,
                "correct the key; run.toml of any run lists the keys that exist",
            )
            .because(why.trim_end().to_owned())
        };
        let mut value = toml::Value::try_from(&base).map_err(|e| fault(e.to_string()))?;
        merge(&mut value, overrides);
        value.try_into().map_err(|e| fault(e.to_string()).into())
    }
}

fn merge(base: &mut toml::Value, overrides: &toml::Value) {
    match (base, overrides) {
        (toml::Value::Table(base), toml::Value::Table(overrides)) => {
            for (key, value) in overrides {
                match base.get_mut(key) {
                    Some(slot) => merge(slot, value),
                    None => drop(base.insert(key.clone(), value.clone())),
                }
            }
        }
        // `1` where a float is expected is a float: people write round numbers without a point.
        (slot @ toml::Value::Float(_), toml::Value::Integer(i)) => *slot = toml::Value::Float(*i as f64),
        (slot, value) => *slot = value.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(text: &str) -> anyhow::Result<Settings> {
        let dir = tempfile::tempdir()?;
        let path = dir.path().join("mine.toml");
        std::fs::write(&path, text)?;
        Settings::read(Some(&path))
    }

    #[test]
    fn single_values_override_the_base() {
        let s = settings("[frames]\nlong_side = 123\n[read]\nmax_depth_m = 2\n").unwrap();
        let base = LoadSettings { stride: 3, ..LoadSettings::default() };
        let merged = s.section("frames", base).unwrap();
        assert_eq!((merged.long_side, merged.stride), (123, 3));
        assert_eq!(s.section("read", ReadOptions::default()).unwrap().max_depth_m, 2.0);
    }

    #[test]
    fn unknown_keys_and_sections_are_named() {
        let message = format!("{:#}", settings("[frames]\nlong_sid = 1\n").unwrap_err());
        assert!(message.contains("long_sid") && message.contains("mine.toml"), "{message}");
        let message = format!("{:#}", settings("[frame]\n").unwrap_err());
        assert!(message.contains("`frame`") && message.contains("entities"), "{message}");
    }
}
