//! Timing of the stages of a scan.

use std::collections::BTreeMap;
use std::time::Instant;

/// Wall-clock seconds by stage.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StageSeconds(BTreeMap<&'static str, f64>);

impl StageSeconds {
    /// Adds the time since `began` to `stage`.
    pub(crate) fn add(&mut self, stage: &'static str, began: Instant) {
        *self.0.entry(stage).or_default() += began.elapsed().as_secs_f64();
    }

    /// Returns the stages in alphabetical order with their seconds.
    pub fn iter(&self) -> impl Iterator<Item = (&'static str, f64)> {
        self.0.iter().map(|(stage, seconds)| (*stage, *seconds))
    }
}
