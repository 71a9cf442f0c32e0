//! Errors of resolving or running a task.

use sms_core::{CoreError, ErrorKind, InputError, StageError};
use sms_sim::SimError;

/// Errors of resolving or running a task.
#[derive(Debug, thiserror::Error)]
pub enum TaskError {
    /// The task does not fit the scene; names the task file and lists the bodies of the scene.
    #[error(transparent)]
    Input(#[from] InputError),
    /// The world could not be built, or the simulation is invalid.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// A file could not be read or written.
    #[error(transparent)]
    Core(#[from] CoreError),
}

impl StageError for TaskError {
    fn kind(&self) -> ErrorKind<'_> {
        match self {
            Self::Input(e) => e.kind(),
            Self::Core(e) => e.kind(),
            Self::Sim(_) => ErrorKind::Other,
        }
    }
}
