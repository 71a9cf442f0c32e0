//! Errors of this crate.

use sms_core::{CoreError, ErrorKind, InputError, StageError};

/// An error of segmentation.
#[derive(Debug, thiserror::Error)]
pub enum MasksError {
    /// Bad input by the user: the message names the file and the cure.
    #[error(transparent)]
    Input(#[from] InputError),
    /// A file could not be written or read, or the user asked to stop.
    #[error(transparent)]
    Core(CoreError),
}

impl StageError for MasksError {
    fn kind(&self) -> ErrorKind<'_> {
        match self {
            Self::Input(e) => e.kind(),
            Self::Core(e) => e.kind(),
        }
    }
}

impl From<CoreError> for MasksError {
    /// Converts input errors of other crates to [`MasksError::Input`].
    fn from(error: CoreError) -> Self {
        match error {
            CoreError::Input(input) => Self::Input(input),
            other => Self::Core(other),
        }
    }
}
