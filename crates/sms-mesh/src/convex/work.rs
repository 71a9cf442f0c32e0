//! Counts the work of a decomposition, so that no mesh takes forever.
//!
//! Steps are counted and not seconds: the same mesh stops at the same place on every machine, with any number of
//! threads. A step is about the cost of testing a point against a face of a hull, 5 to 10 ns.

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
