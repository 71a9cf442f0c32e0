//! Errors of this crate.

use sms_core::{CoreError, ErrorKind, InputError, StageError};
use sms_masks::MasksError;

/// An error of the networks.
#[derive(Debug, thiserror::Error)]
pub enum NetsError {
    /// Bad input by the user: the message names the file and the cure.
    #[error(transparent)]
    Input(#[from] InputError),
    /// A file could not be written or read, or the user asked to stop.
    #[error(transparent)]
    Core(CoreError),
    /// A computation failed on the device: out of memory, a driver fault, or a bug.
    #[error("a network could not be computed: {0}")]
    Compute(#[from] candle_core::Error),
}

impl StageError for NetsError {
    fn kind(&self) -> ErrorKind<'_> {
        match self {
            Self::Input(e) => e.kind(),
            Self::Core(e) => e.kind(),
            Self::Compute(_) => ErrorKind::Other,
        }
    }
}

impl From<CoreError> for NetsError {
    /// Converts input errors of other crates to [`NetsError::Input`].
    fn from(error: CoreError) -> Self {
        match error {
            CoreError::Input(input) => Self::Input(input),
            other => Self::Core(other),
        }
    }
}

impl From<NetsError> for MasksError {
    fn from(error: NetsError) -> Self {
        match error {
            NetsError::Input(input) => Self::Input(input),
            NetsError::Core(core) => core,
            NetsError::Compute(error) => Self::Input(
                InputError::new(
                    "a network could not be computed",
                    "masks",
                    "free some memory, or choose another device or a smaller model",
                )
                .because(error),
            ),
        }
    }
}
