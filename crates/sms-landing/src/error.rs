//! Errors of the landing task.

use sms_core::{CoreError, ErrorKind, InputError, StageError};
use sms_plan::PlanError;
use sms_robots::VehicleError;
use sms_sim::SimError;
use sms_wash::WashError;

/// An error of the landing task. Variants about user input hold an [`InputError`], which names the file and the cure;
/// [`StageError::input`] returns it.
#[derive(Debug, thiserror::Error)]
pub enum LandingError {
    /// A bad task file, vehicle file or setting.
    #[error(transparent)]
    Input(#[from] InputError),
    /// No surface of the scene is level and high enough.
    #[error(transparent)]
    NoSurface(InputError),
    /// The vehicle does not fit on any of the surfaces.
    #[error(transparent)]
    TooNarrow(InputError),
    /// The task names a body that the scene does not have.
    #[error(transparent)]
    UnknownBody(InputError),
    /// The structure moves before anything flies over it.
    #[error(transparent)]
    AlreadyFalling(InputError),
    /// Reading or writing failed, or the run was interrupted.
    #[error(transparent)]
    Core(#[from] CoreError),
    /// The world cannot be built.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// The wash model cannot be built.
    #[error(transparent)]
    Wash(#[from] WashError),
    /// The flight cannot be built.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
    /// The search failed.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// All rollouts are invalid.
    #[error(
        "all {evaluations} simulated landings are invalid ({engine} diverged in each); check the scene's masses and shapes with \
         `sms simulate`"
    )]
    Nothing {
        /// Name of the engine.
        engine: String,
        /// Number of rollouts.
        evaluations: usize,
    },
}

impl StageError for LandingError {
    fn kind(&self) -> ErrorKind<'_> {
        match self {
            Self::Input(e)
            | Self::NoSurface(e)
            | Self::TooNarrow(e)
            | Self::UnknownBody(e)
            | Self::AlreadyFalling(e) => e.kind(),
            Self::Core(e) => e.kind(),
            Self::Plan(e) => e.kind(),
            Self::Sim(_) | Self::Wash(_) | Self::Vehicle(_) | Self::Nothing { .. } => ErrorKind::Other,
        }
    }
}
