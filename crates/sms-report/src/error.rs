//! Errors of writing a report.

use sms_core::CoreError;

/// Errors of writing a report.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// Files.
    #[error(transparent)]
    Core(#[from] CoreError),
}
