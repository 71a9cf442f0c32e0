//! Settings of all stages: the defaults or a preset, overridden by `sms.toml` in the working folder, by `--settings
//! FILE`, then by each `--set section.key=value`.

mod keys;
mod listing;

pub use keys::{describe, descriptions};
pub use listing::{text, values};

use crate::Error;
use serde::{Serialize, de::DeserializeOwned};
use sms_core::{InputError, atomic};
use sms_entities::EntitiesConfig;
use sms_eval::EvaluateSettings;
use sms_frames::{LoadSettings, ReadOptions};
use sms_gaussians::ScanConfig;
use sms_landing::LandingSettings;
use sms_masks::GeometryConfig;
use sms_plan::PlanConfig;
use sms_poses::PosesConfig;
use sms_robots::RobotConfig;
use sms_robots::autopilot::FlightFiles;
use sms_synth::RecordingSettings;
use sms_vlm::VlmConfig;
use std::path::{Path, PathBuf};

/// Settings of one stage: a section of the settings file.
pub trait Section: Default + Serialize + DeserializeOwned {
    /// Checks the ranges; returns an error for the first invalid value.
    fn validate(&self) -> Result<(), InputError>;
}

/// The sections in the order of the data flow, with their types and descriptions: the list for the checks of the file
/// and of `--set`, and for `sms settings`. Some types take the name that errors give to the source of their values.
macro_rules! sections {
    ($($name:literal: $kind:ty, $about:literal $(, $source:literal)?;)*) => {
        /// Names and descriptions of the sections.
        pub const SECTIONS: &[(&str, &str)] = &[$(($name, $about)),*];

        $(impl Section for $kind {
            fn validate(&self) -> Result<(), InputError> {
                <$kind>::validate(self $(, Path::new($source))?)
            }
        })*

        impl Settings {
            /// Checks that a section's keys exist and that their values have valid types and ranges.
            fn check(&self, name: &str) -> Result<(), Error> {
                match name {
                    $($name => self.section(name, <$kind>::default()).map(drop),)*
                    _ => Err(self.unknown_section(name).into()),
                }
            }
        }
    };
}

sections! {
    "recording": RecordingSettings, "generated recordings (sms synth, sms demo): path, size and errors of the sensor";
    "read": ReadOptions, "reading of a recording";
    "frames": LoadSettings, "frames: size, choice, alignment";
    "poses": PosesConfig, "refinement of the camera poses";
    "masks": GeometryConfig, "objects by geometry; borders of masks and missed objects";
    "scan": ScanConfig, "Gaussians: steps, seeding, losses, rates";
    "entities": EntitiesConfig, "meshes, spheres, convex parts";
    "vlm": VlmConfig, "vision-language model for materials";
    "plan": PlanConfig, "search for an action", "[plan]";
    "landing": LandingSettings, "search for a landing", "[landing]";
    "flight": FlightFiles, "files of a planned flight, and the arming position";
    "robot": RobotConfig, "the striking arm and its pose";
    "evaluate": EvaluateSettings, "comparison with known models";
}

/// One `--set section.key=value`.
#[derive(Debug)]
struct Assignment {
    /// The text of the argument.
    text: String,
    section: String,
    /// The key's path within the section.
    key: Vec<String>,
    value: toml::Value,
}

/// A file of settings.
#[derive(Debug)]
struct SettingsFile {
    path: PathBuf,
    table: toml::Table,
}

/// Overrides of the settings; may be empty.
#[derive(Debug, Default)]
pub struct Settings {
    /// The files; later ones take precedence.
    files: Vec<SettingsFile>,
    assignments: Vec<Assignment>,
}

impl Settings {
    /// Reads the file and the assignments and checks every key of every section, so that mistakes are found before any
    /// work.
    pub fn read(path: Option<&Path>, assignments: &[String]) -> Result<Self, Error> {
        Self::read_layers(path.as_slice(), assignments)
    }

    /// Does the same as [`Settings::read`] for several files; later ones take precedence, key by key.
    pub fn read_layers(paths: &[&Path], assignments: &[String]) -> Result<Self, Error> {
        let mut settings = Self::default();
        for path in paths {
            let table: toml::Table = atomic::read_toml_as(path, "settings file")?;
            let names: Vec<String> = table.keys().cloned().collect();
            settings.files.push(SettingsFile { path: (*path).to_owned(), table });
            for name in names {
                settings.check(&name)?;
            }
        }
        for text in assignments {
            let assignment = Assignment::parse(text)?;
            let section = assignment.section.clone();
            settings.assignments.push(assignment);
            settings.check(&section)?;
        }
        Ok(settings)
    }

    /// Returns `base` overridden by the section's values of the file and the assignments.
    pub fn section<T: Section>(&self, name: &str, base: T) -> Result<T, Error> {
        let assigned: Vec<&Assignment> = self.assignments.iter().filter(|a| a.section == name).collect();
        let given: Vec<_> = self.files.iter().filter_map(|f| Some((&f.path, f.table.get(name)?))).collect();
        if given.is_empty() && assigned.is_empty() {
            return Ok(base);
        }
        let mut value = toml::Value::try_from(&base)?;
        let mut made = base;
        for (path, overrides) in given {
            if !overrides.is_table() {
                return Err(InputError::new(
                    format!("`{name}` is a section, not a value"),
                    path,
                    format!("write `[{name}]` on a line of its own and its keys below"),
                )
                .into());
            }
            merge(&mut value, overrides);
            made = value.clone().try_into().map_err(|e| fault(name, path, &e))?;
        }
        for assignment in assigned {
            merge(&mut value, &assignment.as_table());
            made = value.clone().try_into().map_err(|e| fault(name, assignment.source(), &e))?;
        }
        T::validate(&made).map_err(|e| self.blame(name, e))?;
        Ok(made)
    }

    /// Returns the error for an invalid value, with the source of the value.
    fn blame(&self, section: &str, error: InputError) -> InputError {
        let set = error.key().and_then(|key| self.assignments.iter().rev().find(|a| a.concerns(key)));
        let sets_key = |file: &&SettingsFile| error.key().is_some_and(|key| has_key(&file.table, key));
        let with_section = |file: &&SettingsFile| file.table.contains_key(section);
        let file =
            self.files.iter().rev().find(sets_key).or_else(|| self.files.iter().rev().find(with_section));
        match (set, file.map(|f| f.path.clone())) {
            (Some(assignment), _) => error.at_path(assignment.source()),
            (None, Some(path)) => error.at_path(path),
            (None, None) => error,
        }
    }

    fn unknown_section(&self, name: &str) -> InputError {
        let names = SECTIONS.iter().map(|s| s.0);
        let all: Vec<&str> = names.clone().collect();
        let near = near_matches(name, names);
        let cure = format!("use one of: {}", all.join(", "));
        let source = self
            .assignments
            .iter()
            .find(|a| a.section == name)
            .map(Assignment::source)
            .or_else(|| {
                let file = self.files.iter().rev().find(|f| f.table.contains_key(name))?;
                Some(file.path.display().to_string())
            })
            .unwrap_or_default();
        InputError::new(
            format!("the settings do not have a section `{name}`"),
            source,
            if near.is_empty() { cure } else { format!("did you mean {}? {cure}", near.join(" or ")) },
        )
    }
}

impl Assignment {
    fn parse(text: &str) -> Result<Self, InputError> {
        let malformed = || {
            InputError::new(
                "this is not an assignment",
                format!("--set {text}"),
                "write section.key=value, such as --set scan.final_steps=500",
            )
        };
        let (key, value) = text.split_once('=').ok_or_else(malformed)?;
        let mut parts = key.trim().split('.').map(|p| p.trim().to_owned());
        let section = parts.next().unwrap_or_default();
        let key: Vec<String> = parts.collect();
        if section.is_empty() || key.is_empty() || key.iter().any(String::is_empty) {
            return Err(malformed());
        }
        // Text that is not a TOML value is a string: `--set entities.mesh=prune` needs no quotes.
        let value = toml::from_str::<toml::Table>(&format!("value = {value}"))
            .ok()
            .filter(|table| table.len() == 1)
            .and_then(|mut table| table.remove("value"))
            .unwrap_or_else(|| toml::Value::String(value.trim().to_owned()));
        Ok(Self { text: text.to_owned(), section, key, value })
    }

    /// Returns the value nested in tables of its keys.
    fn as_table(&self) -> toml::Value {
        self.key.iter().rev().fold(self.value.clone(), |value, key| {
            toml::Value::Table(std::iter::once((key.clone(), value)).collect())
        })
    }

    /// Returns the argument, for messages.
    fn source(&self) -> String {
        format!("--set {}", self.text)
    }

    /// Returns whether it sets `key` (`section.key`), a part of it, or a table that contains it.
    fn concerns(&self, key: &str) -> bool {
        let own = format!("{}.{}", self.section, self.key.join("."));
        let within = |a: &str, b: &str| {
            a.strip_prefix(b).is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[', ' ']))
        };
        within(key, &own) || within(&own, key)
    }
}

/// Returns whether a table has a dotted key, of which the last parts may be inside a value.
fn has_key(table: &toml::Table, key: &str) -> bool {
    let (first, rest) = key.split_once(['.', '[', ' ']).unwrap_or((key, ""));
    match table.get(first) {
        Some(toml::Value::Table(inner)) if !rest.is_empty() => has_key(inner, rest),
        found => found.is_some(),
    }
}

/// Keys of earlier versions: section, key, and the key that took their place.
const MOVED: [(&str, &str, &str); 2] =
    [("scan", "noise", "frames.noise"), ("poses", "noise", "frames.noise")];

/// Converts serde's error about a key or a value, and adds similar names.
fn fault(section: &str, source: impl AsRef<Path>, error: &toml::de::Error) -> InputError {
    let text = error.to_string();
    let quoted: Vec<&str> = text.split('`').skip(1).step_by(2).collect();
    let is_unknown = text.contains("unknown field") || text.contains("unknown variant");
    let near = match quoted.split_first() {
        Some((wrong, known)) if is_unknown => near_matches(wrong, known.iter().copied()),
        _ => Vec::new(),
    };
    let list = format!("`sms settings` lists the keys of [{section}] with their values");
    let moved =
        MOVED.iter().find(|(old, key, _)| is_unknown && *old == section && quoted.first() == Some(key));
    let cure = match moved {
        Some((old, key, now)) => format!("`{old}.{key}` is now `{now}`"),
        None if near.is_empty() => list,
        None => format!("did you mean {}? {list}", near.join(" or ")),
    };
    InputError::new(format!("section [{section}] of the settings has an error"), source, cure)
        .because(text.trim_end().replace('\n', " "))
}

/// Returns up to three names similar to `wrong`, best first, in backticks.
fn near_matches<'a>(wrong: &str, names: impl Iterator<Item = &'a str>) -> Vec<String> {
    let mut scored: Vec<(f64, &str)> =
        names.map(|name| (strsim::normalized_damerau_levenshtein(wrong, name), name)).collect();
    scored.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(b.1)));
    scored.dedup();
    scored.into_iter().filter(|s| s.0 >= 0.6).take(3).map(|s| format!("`{}`", s.1)).collect()
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
        // Accepts `1` for a float.
        (slot @ toml::Value::Float(_), toml::Value::Integer(i)) => *slot = toml::Value::Float(*i as f64),
        (slot, value) => *slot = value.clone(),
    }
}

/// Returns the default settings with the server and model of the environment.
pub fn vlm_defaults() -> VlmConfig {
    let named = |key: &str| std::env::var(key).map(|v| v.trim().to_owned()).unwrap_or_default();
    VlmConfig { url: named("SMS_VLM_URL"), model: named("SMS_VLM_MODEL"), ..VlmConfig::default() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::StageError;

    fn settings(text: &str, assignments: &[&str]) -> Result<Settings, Error> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("mine.toml");
        std::fs::write(&path, text).unwrap();
        let assignments: Vec<String> = assignments.iter().map(|s| (*s).to_owned()).collect();
        Settings::read(Some(&path), &assignments)
    }

    fn refusal(text: &str, assignments: &[&str]) -> String {
        let error = settings(text, assignments).unwrap_err();
        assert!(error.input().is_some(), "{error}");
        error.to_string()
    }

    #[test]
    fn single_values_override_the_base() {
        let s = settings("[frames]\nlong_side = 123\n[read]\nmax_depth_m = 2\n", &[]).unwrap();
        let base = LoadSettings { stride: 3, ..LoadSettings::default() };
        let merged = s.section("frames", base).unwrap();
        assert_eq!((merged.long_side, merged.stride), (123, 3));
        assert_eq!(s.section("read", ReadOptions::default()).unwrap().max_depth_m, 2.0);
    }

    #[test]
    fn assignments_win_over_the_file_the_last_one_over_all() {
        let given = [
            "scan.final_steps=500",
            "scan.seeding.spacing_px = 3",
            "entities.mesh=prune",
            "scan.final_steps=600",
            "read.depth_unit_m=0.0002",
            "frames.align={ up = [0, 0, 1] }",
        ];
        let s = settings("[scan]\nfinal_steps = 400\nsteps_frame = 7\n", &given).unwrap();
        let scan = s.section("scan", ScanConfig::default()).unwrap();
        assert_eq!((scan.final_steps, scan.steps_frame, scan.seeding.spacing_px), (600, 7, 3.0));
        let entities = s.section("entities", EntitiesConfig::default()).unwrap();
        assert_eq!(entities.mesh, sms_entities::MeshRule::Prune);
        assert_eq!(s.section("read", ReadOptions::default()).unwrap().depth_unit_m, Some(0.0002));
        let frames = s.section("frames", LoadSettings::default()).unwrap();
        assert_eq!(frames.align, sms_frames::Align::Up([0.0, 0.0, 1.0]));
    }

    #[test]
    fn later_files_win_key_by_key_and_faults_name_their_file() {
        let dir = tempfile::tempdir().unwrap();
        let [own, given] = ["sms.toml", "mine.toml"].map(|name| dir.path().join(name));
        std::fs::write(&own, "[scan]\nfinal_steps = 400\nsteps_frame = 7\n").unwrap();
        std::fs::write(&given, "[scan]\nfinal_steps = 500\n[frames]\nstride = 2\n").unwrap();
        let read = |set: &[String]| Settings::read_layers(&[&own, &given], set);
        let scan = read(&[]).unwrap().section("scan", ScanConfig::default()).unwrap();
        assert_eq!((scan.final_steps, scan.steps_frame), (500, 7));
        let scan =
            read(&["scan.final_steps=600".into()]).unwrap().section("scan", ScanConfig::default()).unwrap();
        assert_eq!((scan.final_steps, scan.steps_frame), (600, 7));
        for wrong in ["[scan]\nbatch_steps = 0\n", "[scan]\nfinal_stps = 1\n", "[scna]\n", "scan = 3\n"] {
            std::fs::write(&own, wrong).unwrap();
            let error = read(&[]).unwrap_err();
            assert!(error.input().unwrap().path.ends_with("sms.toml"), "{error}");
        }
    }

    #[test]
    fn unknown_keys_and_sections_are_named_with_what_comes_near() {
        let message = refusal("[frames]\nlong_sid = 1\n", &[]);
        assert!(message.contains("did you mean `long_side`") && message.contains("mine.toml"), "{message}");
        let message = refusal("[frame]\n", &[]);
        assert!(message.contains("did you mean `frames`") && message.contains("entities"), "{message}");
        let message = refusal("", &["scan.seeding.spacing=1"]);
        assert!(
            message.contains("`spacing_px`") && message.contains("--set scan.seeding.spacing=1"),
            "{message}"
        );
        let message = refusal("", &["scn.final_steps=1"]);
        assert!(message.contains("did you mean `scan`") && message.contains("--set scn"), "{message}");
        assert!(refusal("", &["entities.mesh=prunes"]).contains("did you mean `prune`"));
        for malformed in ["scan.final_steps", "scan=3", ".x=3", "scan..x=3", "=4"] {
            let message = refusal("", &[malformed]);
            assert!(message.contains("section.key=value"), "{malformed}: {message}");
        }
        assert!(refusal("scan = 3\n", &[]).contains("is a section"));
    }

    #[test]
    fn wrong_types_and_ranges_name_where_they_were_given() {
        for wrong in ["scan.final_steps=abc", "scan.final_steps=1.5", "scan.stop.enabled=3", "scan.seeding=1"]
        {
            let message = refusal("", &[wrong]);
            assert!(message.contains(&format!("--set {wrong}")) && message.contains("type"), "{message}");
        }
        let message = refusal("[scan]\nbatch_steps = 0\n", &["plan.starts=5"]);
        assert!(message.contains("`scan.batch_steps` is 0") && message.contains("mine.toml"), "{message}");
        let message = refusal("", &["scan.noise.a_m=0.001"]);
        assert!(message.contains("`frames.noise`"), "{message}");
        let message = refusal("[scan]\nbatch_steps = 5\n", &["scan.seeding={spacing_px = -1.0}"]);
        assert!(
            message.contains("`scan.seeding.spacing_px` is -1") && message.contains("--set scan.seeding"),
            "{message}"
        );
    }

    /// Every number of every section has a range that rejects absurd values.
    #[test]
    fn every_number_of_every_section_is_checked() {
        fn numbers(value: &toml::Value, at: &str, found: &mut Vec<(String, bool)>) {
            match value {
                toml::Value::Table(table) => {
                    table.iter().for_each(|(key, v)| numbers(v, &format!("{at}.{key}"), found))
                }
                toml::Value::Float(_) => found.push((at.to_owned(), true)),
                toml::Value::Integer(_) if !at.ends_with(".seed") => found.push((at.to_owned(), false)),
                _ => {}
            }
        }
        let defaults: toml::Table =
            toml::from_str(&text(&Settings::default(), sms_gaussians::Preset::Standard).unwrap()).unwrap();
        let mut found = Vec::new();
        defaults.iter().for_each(|(name, section)| numbers(section, name, &mut found));
        assert!(found.len() > 100, "{}", found.len());
        for (key, is_float) in found {
            let absurd: &[&str] =
                if is_float { &["nan", "-1e30", "inf"] } else { &["-1", "4611686018427387904"] };
            for value in absurd {
                let given = format!("{key}={value}");
                let Err(error) = Settings::read(None, std::slice::from_ref(&given)) else {
                    panic!("{given} is accepted");
                };
                let message = error.to_string();
                assert!(message.contains(&format!("--set {given}")), "{message}");
                assert!(message.contains(key.rsplit('.').next().unwrap()), "{message}");
            }
        }
    }
}
