//! The services that every stage receives beside its input and its settings.

use crate::{Cancel, NoProgress, Progress, Seed, Warnings};

/// Progress, cancellation, warnings and the seed of one stage run.
///
/// The context is cheap to copy. A stage reports progress after every unit of work, polls `cancel` at least once per
/// unit, and adds to `warnings` instead of printing.
#[derive(Clone, Copy)]
pub struct StageContext<'a> {
    /// Receives progress.
    pub progress: &'a dyn Progress,
    /// Set when the user interrupts.
    pub cancel: &'a Cancel,
    /// Collects warnings.
    pub warnings: &'a Warnings,
    /// Seed of everything random in the stage.
    pub seed: Seed,
}

impl<'a> StageContext<'a> {
    /// A context with seed 0.
    pub fn new(progress: &'a dyn Progress, cancel: &'a Cancel, warnings: &'a Warnings) -> Self {
        Self { progress, cancel, warnings, seed: Seed(0) }
    }

    /// A context without progress and with seed 0, for tests and for callers that show nothing.
    pub fn quiet(cancel: &'a Cancel, warnings: &'a Warnings) -> Self {
        Self::new(&NoProgress, cancel, warnings)
    }

    /// The same services with another seed.
    #[must_use]
    pub fn with_seed(self, seed: Seed) -> Self {
        Self { seed, ..self }
    }
}
