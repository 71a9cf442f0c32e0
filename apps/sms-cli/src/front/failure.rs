//! Error messages and exit codes: 2 for bad input and a full disk, 130 for an interruption, 1 for any other failure.

use sms_core::{CoreError, ErrorKind, InputError, StageError};
use std::process::ExitCode;

/// Prints the error and returns its exit code.
pub fn report(error: &anyhow::Error) -> ExitCode {
    eprintln!("error: {error:#}");
    ExitCode::from(match kind(error) {
        ErrorKind::Input(_) | ErrorKind::DiskFull => 2,
        ErrorKind::Interrupted => 130,
        ErrorKind::Other => 1,
    })
}

/// Returns the kind of the stage's error inside.
fn kind(error: &anyhow::Error) -> ErrorKind<'_> {
    macro_rules! first_of {
        ($($kind:ty),* $(,)?) => {
            $(if let Some(error) = error.downcast_ref::<$kind>() { return error.kind(); })*
        };
    }
    first_of!(
        InputError,
        CoreError,
        sms_masks::MasksError,
        sms_gaussians::ScanError,
        sms_entities::EntitiesError,
        sms_scene::SceneError,
        sms_task::TaskError,
        sms_plan::PlanError,
        sms_landing::LandingError,
        sms_target::TargetError,
        sms_eval::EvaluateError,
        sms_report::ReportError,
    );
    ErrorKind::Other
}
