//! Errors of planning.

use sms_core::{CoreError, ErrorKind, InputError, StageError};
use sms_sim::SimError;
use sms_task::TaskError;

/// Errors of planning.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// Invalid settings.
    #[error(transparent)]
    Input(#[from] InputError),
    /// Interrupted, or a file could not be written.
    #[error(transparent)]
    Core(#[from] CoreError),
    /// The task does not fit the scene.
    #[error(transparent)]
    Task(#[from] TaskError),
    /// The scene cannot be simulated.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// The robot cannot carry out any of the strikes.
    #[error(transparent)]
    OutOfReach(InputError),
    /// Every rollout was invalid.
    #[error(
        "all {evaluations} simulated shots are invalid ({engine} diverged or broke a conservation law in each); check \
         masses and shapes of the scene with `sms simulate`"
    )]
    Nothing {
        /// Engine.
        engine: String,
        /// Rollouts.
        evaluations: usize,
    },
}

impl StageError for PlanError {
    fn kind(&self) -> ErrorKind<'_> {
        match self {
            Self::Input(e) | Self::OutOfReach(e) => e.kind(),
            Self::Core(e) => e.kind(),
            Self::Task(e) => e.kind(),
            Self::Sim(_) | Self::Nothing { .. } => ErrorKind::Other,
        }
    }
}
