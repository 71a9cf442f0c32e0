//! What a landing cannot be planned for.

use sms_core::{CoreError, ErrorKind, InputError, StageError};
use sms_plan::PlanError;
use sms_robots::VehicleError;
use sms_sim::SimError;
use sms_wash::WashError;

/// Errors of the landing task. Those about user input hold an [`InputError`], which names the file and the cure;
/// [`StageError::input`] returns it whatever the variant.
#[derive(Debug, thiserror::Error)]
pub enum LandingError {
    /// A bad task file, vehicle file or setting.
    #[error(transparent)]
    Input(#[from] InputError),
    /// No surface of the scene is level and high enough.
    #[error(transparent)]
    NoSurface(InputError),
    /// There is a surface, but the vehicle does not fit on it.
    #[error(transparent)]
    TooNarrow(InputError),
    /// The task names a body that the scene does not have.
    #[error(transparent)]
    UnknownBody(InputError),
    /// The structure moves before anything flies over it.
    #[error(transparent)]
    AlreadyFalling(InputError),
    /// Files, or interruption.
    #[error(transparent)]
    Core(#[from] CoreError),
    /// The world cannot be built.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// The air cannot be built.
    #[error(transparent)]
    Wash(#[from] WashError),
    /// The flight cannot be built.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
    /// The search failed.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// Not one rollout can be believed.
    #[error(
        "none of the {evaluations} simulated landings can be believed ({engine} blew up in each); check the scene's masses and shapes \
         with `sms simulate`"
    )]
    Nothing {
        /// Engine.
        engine: String,
        /// Rollouts.
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
