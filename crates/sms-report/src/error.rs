//! Errors of writing a report.

use sms_core::{CoreError, ErrorKind, StageError};

/// An error of writing a report.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// Reading or writing a file failed.
    #[error(transparent)]
    Core(#[from] CoreError),
}

impl StageError for ReportError {
    fn kind(&self) -> ErrorKind<'_> {
        match self {
            Self::Core(e) => e.kind(),
        }
    }
}
