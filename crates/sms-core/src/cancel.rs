//! Interruption.

use crate::CoreError;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A flag that long work looks at between units of work; set by Ctrl-C.
#[derive(Debug, Clone, Default)]
pub struct Cancel(Arc<AtomicBool>);

impl Cancel {
    /// A flag that is not set.
    pub fn new() -> Self {
        Self::default()
    }

    /// Asks the work to stop at the next unit.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::SeqCst);
    }

    /// Whether a stop was asked for.
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }

    /// `Err(CoreError::Interrupted)` once a stop was asked for.
    pub fn check(&self) -> Result<(), CoreError> {
        if self.is_cancelled() { Err(CoreError::Interrupted) } else { Ok(()) }
    }
}
