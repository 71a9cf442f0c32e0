//! Warnings: collected, saved with the run, and shown once at the end and in the report.

use crate::CoreError;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::Mutex;

/// A warning about a result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Warning {
    /// The stage that added it.
    pub stage: String,
    /// Short stable identifier, `snake_case`.
    pub code: String,
    /// The message, with its figures.
    pub message: String,
    /// The cure; may be empty.
    #[serde(default)]
    pub cure: String,
    /// How often it happened.
    pub count: usize,
}

impl Warning {
    fn key(&self) -> (&str, &str, &str) {
        (&self.stage, &self.code, &self.message)
    }
}

/// Collects warnings from any thread. The same code with the same message is counted, not repeated.
#[derive(Debug, Default)]
pub struct Warnings {
    list: Mutex<Vec<Warning>>,
}

impl Warnings {
    /// Creates an empty collector.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a warning.
    pub fn add(&self, stage: &str, code: &str, message: impl Into<String>, cure: impl Into<String>) {
        let (stage, code) = (stage.to_owned(), code.to_owned());
        self.take_over(vec![Warning { stage, code, message: message.into(), cure: cure.into(), count: 1 }]);
    }

    /// Adds the warnings of an earlier attempt at the same work, with their counts.
    pub fn take_over(&self, earlier: Vec<Warning>) {
        let Ok(mut list) = self.list.lock() else { return };
        for warning in earlier {
            match list.iter_mut().find(|w| w.key() == warning.key()) {
                Some(known) => known.count += warning.count,
                None => list.push(warning),
            }
        }
    }

    /// Returns the warnings so far, ordered by stage, code and message so that it does not depend on threads.
    pub fn snapshot(&self) -> Vec<Warning> {
        let mut list = self.list.lock().map(|l| l.clone()).unwrap_or_default();
        list.sort_by(|a, b| a.key().cmp(&b.key()));
        list
    }

    /// Merges the warnings into `warnings.json` as those of `stage`: they replace the earlier ones of this stage, whichever
    /// part of the program added them. Other stages' warnings are kept.
    ///
    /// # Errors
    /// When the file cannot be read or written.
    pub fn save_as(&self, path: &Path, stage: &str) -> Result<(), CoreError> {
        let mut all: Vec<Warning> = if path.exists() { crate::atomic::read_json(path)? } else { Vec::new() };
        all.retain(|w| w.stage != stage);
        all.extend(self.snapshot().into_iter().map(|w| Warning { stage: stage.to_owned(), ..w }));
        crate::atomic::write_json(path, &all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_warnings_are_counted_and_stages_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("warnings.json");
        let first = Warnings::new();
        first.add("reader", "few_frames", "only 3 frames", "");
        first.add("reader", "few_frames", "only 3 frames", "");
        assert_eq!(first.snapshot()[0].count, 2);
        let later = Warnings::new();
        later.add("reader", "few_frames", "only 3 frames", "");
        later.take_over(first.snapshot());
        assert_eq!((later.snapshot().len(), later.snapshot()[0].count), (1, 3));
        first.save_as(&path, "frames").unwrap();
        let second = Warnings::new();
        second.add("plan", "hard", "no shot found", "");
        second.save_as(&path, "plan").unwrap();
        let both: Vec<Warning> = crate::atomic::read_json(&path).unwrap();
        assert_eq!(both.iter().map(|w| w.stage.as_str()).collect::<Vec<_>>(), ["frames", "plan"]);
        Warnings::new().save_as(&path, "frames").unwrap();
        let left: Vec<Warning> = crate::atomic::read_json(&path).unwrap();
        assert_eq!(left.len(), 1);
        assert_eq!(left[0].stage, "plan");
    }
}
