//! What is printed when something fails, and the exit code: 2 for what the user can mend, 1 for anything else.

use sms_core::{CoreError, InputError};
use std::io::ErrorKind;
use std::process::ExitCode;

/// Prints the error and gives its exit code.
pub fn report(error: &anyhow::Error) -> ExitCode {
    eprintln!("error: {error:#}");
    ExitCode::from(exit_code(error))
}

fn exit_code(error: &anyhow::Error) -> u8 {
    if is_input_error(error) {
        return 2;
    }
    match core_error(error) {
        Some(CoreError::Input(_)) => 2,
        Some(CoreError::Write { source, .. })
            if matches!(source.kind(), ErrorKind::StorageFull | ErrorKind::QuotaExceeded) =>
        {
            2
        }
        Some(CoreError::Interrupted) => 130,
        _ => 1,
    }
}

/// Stage errors are transparent over the vocabulary's, so that these are no `source` of theirs: each is asked.
macro_rules! inside {
    ($error:expr, $($pattern:pat => $found:expr),* $(,)?) => {
        $(if let Some($pattern) = $error.downcast_ref() { return $found; })*
    };
}

fn is_input_error(error: &anyhow::Error) -> bool {
    use sms_entities::EntitiesError;
    use sms_gaussians::ScanError;
    use sms_masks::MasksError;
    use sms_plan::PlanError;
    use sms_target::TargetError;
    use sms_task::TaskError;
    inside!(
        error,
        MasksError::Input(_) => true,
        ScanError::Input(_) => true,
        EntitiesError::Input(_) => true,
        TaskError::Input(_) => true,
        PlanError::Input(_) => true,
        PlanError::OutOfReach(_) => true,
        PlanError::Task(TaskError::Input(_)) => true,
        TargetError::Task(TaskError::Input(_)) => true,
        TargetError::Landing(e) => e.input().is_some(),
    );
    error.downcast_ref::<InputError>().is_some()
}

fn core_error(error: &anyhow::Error) -> Option<&CoreError> {
    use sms_entities::EntitiesError;
    use sms_eval::EvaluateError;
    use sms_gaussians::ScanError;
    use sms_landing::LandingError;
    use sms_masks::MasksError;
    use sms_plan::PlanError;
    use sms_report::ReportError;
    use sms_scene::SceneError;
    use sms_target::TargetError;
    use sms_task::TaskError;
    inside!(
        error,
        MasksError::Core(core) => Some(core),
        ScanError::Core(core) => Some(core),
        EntitiesError::Core(core) => Some(core),
        SceneError::Core(core) => Some(core),
        TaskError::Core(core) => Some(core),
        PlanError::Core(core) => Some(core),
        PlanError::Task(TaskError::Core(core)) => Some(core),
        TargetError::Task(TaskError::Core(core)) => Some(core),
        LandingError::Core(core) => Some(core),
        TargetError::Landing(LandingError::Core(core)) => Some(core),
        EvaluateError::Core(core) => Some(core),
        ReportError::Core(core) => Some(core),
    );
    error.downcast_ref::<CoreError>()
}
