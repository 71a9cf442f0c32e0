//! Task files, and actions as points in a box of named parameters.

use crate::{Billiards, Selector, Strike};
use serde::{Deserialize, Serialize};
use sms_core::{CoreError, InputError, atomic};
use std::path::Path;

/// One parameter of an action.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Name ("speed").
    pub name: String,
    /// Unit ("m/s").
    pub unit: String,
    /// Smallest allowed value.
    pub low: f64,
    /// Largest allowed value.
    pub high: f64,
}

/// Values of the task's parameters, in the task's order.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Action(pub Vec<f64>);

/// Values of `kind` in task files. The crate `sms-landing` reads those of `landing`.
pub const TASK_KINDS: [&str; 3] = ["billiards", "strike", "landing"];

/// Name of the files in messages.
const TASK_FILE: &str = "task file";

/// A task file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Task {
    /// Strike the cue ball so that the target ball passes over the goal.
    Billiards(Billiards),
    /// Strike a body to minimise a weighted sum of terms.
    Strike(Strike),
}

impl Task {
    /// Reads and checks a task file (TOML).
    ///
    /// # Errors
    /// [`CoreError::Input`] that names the file and the key: the file cannot be read, is not TOML, has an unknown or
    /// missing key, an unknown kind, or a value out of range.
    pub fn read(path: &Path) -> Result<Self, CoreError> {
        // The kind decides which keys exist, so it is read first. The typed reading then reports lines.
        let table: toml::Table = atomic::read_toml_as(path, TASK_FILE)?;
        refuse_robot(&table, path)?;
        match table.get("kind").and_then(toml::Value::as_str) {
            Some("billiards") => {
                let task = Billiards { source: path.to_owned(), ..atomic::read_toml_as(path, TASK_FILE)? };
                task.validate()?;
                Ok(Self::Billiards(task))
            }
            Some("strike") => {
                let task = Strike { source: path.to_owned(), ..atomic::read_toml_as(path, TASK_FILE)? };
                task.validate()?;
                Ok(Self::Strike(task))
            }
            other => {
                let what = match other {
                    Some(kind) => format!("this task file has an unknown `kind`, \"{kind}\""),
                    None => "this task file has no `kind`".to_owned(),
                };
                let kinds = TASK_KINDS.map(|kind| format!("kind = \"{kind}\"")).join(", ");
                Err(InputError::new(what, path, format!("write one of: {kinds}")).into())
            }
        }
    }

    /// Writes the task as TOML with all settings, defaults included.
    ///
    /// # Errors
    /// [`CoreError::Write`].
    pub fn write(&self, path: &Path) -> Result<(), CoreError> {
        let text = toml::to_string(self)
            .map_err(|e| CoreError::Write { path: path.to_owned(), source: std::io::Error::other(e) })?;
        atomic::write_bytes(path, text.as_bytes())
    }

    /// Returns the selectors of its bodies.
    pub fn selectors(&self) -> Vec<&Selector> {
        match self {
            Self::Billiards(task) => vec![&task.cue, &task.target],
            Self::Strike(task) => {
                let of_terms = task.terms.iter().filter_map(|term| term.bodies().selector());
                std::iter::once(&task.strike).chain(of_terms).collect()
            }
        }
    }

    /// Name of the kind ("billiards").
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Billiards(_) => "billiards",
            Self::Strike(_) => "strike",
        }
    }
}

/// Rejects a pose of the robot in a task file: it belongs in the settings.
fn refuse_robot(table: &toml::Table, path: &Path) -> Result<(), InputError> {
    let is_place = |key: &&String| {
        ["x_world_robot", "x_recording_robot", "robot"].iter().any(|k| key.eq_ignore_ascii_case(k))
    };
    let Some(key) = table.keys().find(is_place) else { return Ok(()) };
    Err(InputError::new(
        format!("`{key}` is not a key of a task: a task states the goal, not the pose of the robot"),
        path,
        "write `[robot]` with `x_world_robot = [[…], […], […], [0, 0, 0, 1]]` in a settings file and give it with --settings \
         (docs/book/src/guides/robot.md)",
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_task_and_an_unknown_kind_are_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("task.toml");
        let refused = || match Task::read(&path) {
            Err(CoreError::Input(error)) => error,
            other => panic!("{other:?}"),
        };
        let missing = refused();
        assert!(missing.what.contains("task file") && missing.path.ends_with("task.toml"), "{missing}");
        for text in ["kind = \"juggle\"", "goal_w = [0.1, 0.2]"] {
            std::fs::write(&path, text).unwrap();
            let error = refused();
            assert!(TASK_KINDS.iter().all(|kind| error.cure.contains(&format!("\"{kind}\""))), "{error}");
        }
    }

    #[test]
    fn a_robot_in_a_task_file_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("task.toml");
        for text in
            ["X_world_robot = [[1.0]]\nkind = \"billiards\"", "kind = \"strike\"\n[robot]\nfront_m = 0.01"]
        {
            std::fs::write(&path, text).unwrap();
            let e = Task::read(&path).unwrap_err().to_string();
            assert!(e.contains("[robot]") && e.contains("--settings"), "{e}");
        }
    }
}
