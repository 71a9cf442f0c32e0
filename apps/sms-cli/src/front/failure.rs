//! Error messages and exit codes: 2 for bad input and a full disk, 130 for an interruption, 1 for any other failure.

use super::note;
use sms_core::{CoreError, ErrorKind, InputError, StageError};
use std::process::ExitCode;

/// Prints the error and returns its exit code. `E` is the program's own error type.
pub fn report<E: StageError + Send + Sync + 'static>(error: &anyhow::Error) -> ExitCode {
    note(format_args!("error: {error:#}"));
    ExitCode::from(match kind::<E>(error) {
        ErrorKind::Input(_) | ErrorKind::DiskFull => 2,
        ErrorKind::Interrupted => 130,
        ErrorKind::Other => 1,
    })
}

fn kind<E: StageError + Send + Sync + 'static>(error: &anyhow::Error) -> ErrorKind<'_> {
    let own = error.downcast_ref::<E>().map(E::kind);
    own.or_else(|| error.downcast_ref::<sms_pipeline::Error>().map(StageError::kind))
        .or_else(|| error.downcast_ref::<CoreError>().map(StageError::kind))
        .or_else(|| error.downcast_ref::<InputError>().map(StageError::kind))
        .unwrap_or(ErrorKind::Other)
}
