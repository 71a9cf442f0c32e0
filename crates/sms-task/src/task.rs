//! Task files.

use crate::{Billiards, Strike};
use serde::{Deserialize, Serialize};
use sms_core::{CoreError, InputError, atomic};
use std::path::Path;

/// A task file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Task {
    /// Strike the cue ball so that the target ball passes over the goal.
    Billiards(Billiards),
    /// Strike a body so that a sum of wishes is met.
    Strike(Strike),
}

impl Task {
    /// Reads and checks a task file (TOML).
    ///
    /// # Errors
    /// [`CoreError::Input`] that names the file and the key: the file cannot be read, is no TOML, has an unknown or
    /// missing key, an unknown kind, or a value out of range.
    pub fn read(path: &Path) -> Result<Self, CoreError> {
        // The kind decides which keys exist, so it is looked at first; the typed reading then reports lines.
        let table: toml::Table = atomic::read_toml(path)?;
        match table.get("kind").and_then(toml::Value::as_str) {
            Some("billiards") => {
                let mut task: Billiards = atomic::read_toml(path)?;
                task.source = path.to_owned();
                task.validate()?;
                Ok(Self::Billiards(task))
            }
            Some("strike") => {
                let mut task: Strike = atomic::read_toml(path)?;
                task.source = path.to_owned();
                task.validate()?;
                Ok(Self::Strike(task))
            }
            other => {
                let what = match other {
                    Some(kind) => format!("this task file has an unknown `kind`, \"{kind}\""),
                    None => "this task file does not say its `kind`".to_owned(),
                };
                Err(InputError::new(what, path, "write kind = \"billiards\" or kind = \"strike\"").into())
            }
        }
    }

    /// Writes the task as TOML, with every setting that is in force.
    ///
    /// # Errors
    /// [`CoreError::Write`].
    pub fn write(&self, path: &Path) -> Result<(), CoreError> {
        let text = toml::to_string(self)
            .map_err(|e| CoreError::Write { path: path.to_owned(), source: std::io::Error::other(e) })?;
        atomic::write_bytes(path, text.as_bytes())
    }

    /// Name of the kind ("billiards").
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Billiards(_) => "billiards",
            Self::Strike(_) => "strike",
        }
    }
}
