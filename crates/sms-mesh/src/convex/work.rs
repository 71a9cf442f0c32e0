//! Counts what a decomposition costs, so that no mesh can take for ever.
//!
//! Steps are counted and not seconds: the same mesh stops at the same place on every machine, however many threads there
//! are. A step is about what one test of a point against a face of a hull costs, 5 to 10 ns.

use std::sync::atomic::{AtomicU64, Ordering};

/// Steps of a query for the nearest point of a surface.
pub(crate) const QUERY: u64 = 40;

/// Steps of one decomposition so far.
#[derive(Debug, Default)]
pub(crate) struct Work(AtomicU64);

impl Work {
    pub(crate) fn add(&self, steps: u64) {
        self.0.fetch_add(steps, Ordering::Relaxed);
    }

    /// All steps so far. Equal between runs only where no other task is under way.
    pub(crate) fn steps(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}
