//! Counts the work of a decomposition, so that no mesh takes forever.
//!
//! The unit is steps instead of seconds: the same mesh stops at the same point on every machine, with any number of
//! threads. A step costs about as much as testing a point against a face of a hull, 5 to 10 ns.

use std::sync::atomic::{AtomicU64, Ordering};

/// Steps per nearest-point query on a surface.
pub(crate) const QUERY: u64 = 40;

/// Steps of one decomposition so far.
#[derive(Debug, Default)]
pub(crate) struct Work(AtomicU64);

impl Work {
    pub(crate) fn add(&self, steps: u64) {
        self.0.fetch_add(steps, Ordering::Relaxed);
    }

    /// Returns all steps so far. The number is reproducible only while no other task runs.
    pub(crate) fn steps(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}
