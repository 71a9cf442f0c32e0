//! `metrics.json`: one flat object, SI units, stable keys (documented in `docs/book/src/reference/metrics.md`).

use crate::{CoreError, atomic};
use serde::Serialize;
use serde_json::{Map, Value};
use std::path::Path;

/// A flat set of metrics.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Metrics(Map<String, Value>);

impl Metrics {
    /// Creates an empty set.
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns the fields of a struct as metrics `<prefix>.<field>`.
    pub fn of_fields(prefix: &str, fields: &impl Serialize) -> Self {
        let Ok(Value::Object(fields)) = serde_json::to_value(fields) else { return Self::new() };
        Self(fields.into_iter().map(|(key, value)| (format!("{prefix}.{key}"), value)).collect())
    }

    /// Sets one metric. A number that is not finite is stored as null.
    pub fn set(&mut self, key: impl Into<String>, value: impl Into<Value>) -> &mut Self {
        self.0.insert(key.into(), value.into());
        self
    }

    /// Returns the number under `key`.
    pub fn number(&self, key: &str) -> Option<f64> {
        self.0.get(key).and_then(Value::as_f64)
    }

    /// Returns the value under `key`.
    pub fn get(&self, key: &str) -> Option<&Value> {
        self.0.get(key)
    }

    /// Iterates over all metrics, ordered by key.
    pub fn iter(&self) -> impl Iterator<Item = (&String, &Value)> {
        let mut all: Vec<_> = self.0.iter().collect();
        all.sort_by(|a, b| a.0.cmp(b.0));
        all.into_iter()
    }

    /// Removes every key that starts with `prefix`.
    pub fn remove_prefix(&mut self, prefix: &str) {
        self.0.retain(|k, _| !k.starts_with(prefix));
    }

    /// Adds all metrics of another set.
    pub fn merge(&mut self, other: Metrics) {
        self.0.extend(other.0);
    }

    /// Reads the file; a missing file has no metrics.
    ///
    /// # Errors
    /// When the file exists and cannot be read.
    pub fn load(path: &Path) -> Result<Self, CoreError> {
        if path.exists() { Ok(Self(atomic::read_json(path)?)) } else { Ok(Self::default()) }
    }

    /// Writes the file, ordered by key.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), CoreError> {
        let ordered: Map<String, Value> = self.iter().map(|(k, v)| (k.clone(), v.clone())).collect();
        atomic::write_json(path, &ordered)
    }
}
