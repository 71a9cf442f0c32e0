//! Where the time of a scan goes.

use std::collections::BTreeMap;
use std::time::Instant;

/// Wall-clock seconds by what they were spent on.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StageSeconds(BTreeMap<&'static str, f64>);

impl StageSeconds {
    /// What has passed since `began` was spent on `stage`.
    pub(crate) fn add(&mut self, stage: &'static str, began: Instant) {
        *self.0.entry(stage).or_default() += began.elapsed().as_secs_f64();
    }

    /// Stages in alphabetical order with their seconds.
    pub fn iter(&self) -> impl Iterator<Item = (&'static str, f64)> {
        self.0.iter().map(|(stage, seconds)| (*stage, *seconds))
    }

    /// Seconds of a stage; 0 where there was none.
    pub fn of(&self, stage: &str) -> f64 {
        self.0.get(stage).copied().unwrap_or(0.0)
    }
}
