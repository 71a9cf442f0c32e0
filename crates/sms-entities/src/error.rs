//! Errors of the stage.

use sms_core::{CoreError, ErrorKind, InputError, StageError};

/// Errors of the entities stage.
#[derive(Debug, thiserror::Error)]
pub enum EntitiesError {
    /// The model, the sequence and the labels do not belong together.
    #[error("{0}")]
    Mismatch(String),
    /// Bad settings or files.
    #[error(transparent)]
    Input(#[from] InputError),
    /// Files or interruption.
    #[error(transparent)]
    Core(#[from] CoreError),
}

impl StageError for EntitiesError {
    fn kind(&self) -> ErrorKind<'_> {
        match self {
            Self::Input(e) => e.kind(),
            Self::Core(e) => e.kind(),
            Self::Mismatch(_) => ErrorKind::Other,
        }
    }
}
