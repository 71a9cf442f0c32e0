//! Errors of the scan.

use crate::TrainerError;
use sms_core::{CoreError, ErrorKind, InputError, StageError};

/// An error of the scan.
#[derive(Debug, thiserror::Error)]
pub enum ScanError {
    /// Bad input by the user.
    #[error(transparent)]
    Input(#[from] InputError),
    /// Files, or an interruption ([`CoreError::Interrupted`]) after which the scan can be resumed.
    #[error(transparent)]
    Core(#[from] CoreError),
    /// The back end failed.
    #[error(transparent)]
    Trainer(#[from] TrainerError),
}

impl StageError for ScanError {
    fn kind(&self) -> ErrorKind<'_> {
        match self {
            Self::Input(e) => e.kind(),
            Self::Core(e) | Self::Trainer(TrainerError::Core(e)) => e.kind(),
            Self::Trainer(_) => ErrorKind::Other,
        }
    }
}
