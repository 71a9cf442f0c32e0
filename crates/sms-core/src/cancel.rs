//! Cancellation.

use crate::CoreError;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A flag that long work polls between units of work; Ctrl-C sets it.
#[derive(Debug, Clone, Default)]
pub struct Cancel(Arc<AtomicBool>);

impl Cancel {
    /// Creates a flag that is not set.
    pub fn new() -> Self {
        Self::default()
    }

    /// Requests that the work stops at the next unit.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::SeqCst);
    }

    /// Returns whether a stop was requested.
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }

    /// Returns `Err(CoreError::Interrupted)` once a stop was requested.
    pub fn check(&self) -> Result<(), CoreError> {
        if self.is_cancelled() { Err(CoreError::Interrupted) } else { Ok(()) }
    }
}
