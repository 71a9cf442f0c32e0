//! Errors of resolving or running a task.

use sms_core::{CoreError, InputError};
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
