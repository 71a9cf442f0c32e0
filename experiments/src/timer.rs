//! Wall and CPU time of a part of the work.

use crate::cpu_time::cpu_seconds;
use std::time::Instant;

/// Time on the wall and on the processors since it was started.
pub(crate) struct Timer(Instant, Option<f64>);

impl Timer {
    pub(crate) fn start() -> Self {
        Self(Instant::now(), cpu_seconds())
    }

    /// Seconds and CPU seconds (NaN if the system does not report them).
    pub(crate) fn seconds(&self) -> (f64, f64) {
        let cpu = self.1.zip(cpu_seconds()).map_or(f64::NAN, |(from, to)| to - from);
        (self.0.elapsed().as_secs_f64(), cpu)
    }
}
