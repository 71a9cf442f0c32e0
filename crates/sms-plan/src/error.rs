//! Errors of planning.

use sms_core::{CoreError, InputError};
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
