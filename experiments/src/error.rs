//! Errors of the experiments.

use sms_core::{CoreError, ErrorKind, InputError, StageError};

/// Errors of a measurement.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// Bad input by the user.
    #[error(transparent)]
    Input(#[from] InputError),
    /// A vision-language model's server stopped answering: its rows cannot be run now, all others can.
    #[error(transparent)]
    Unanswered(InputError),
    /// Files or interruption.
    #[error(transparent)]
    Core(#[from] CoreError),
    /// A stage of the pipeline failed.
    #[error(transparent)]
    Pipeline(#[from] sms_pipeline::Error),
    /// The planner failed.
    #[error(transparent)]
    Plan(#[from] sms_plan::PlanError),
    /// A scene could not be kept.
    #[error(transparent)]
    Scene(#[from] sms_scene::SceneError),
    /// A landing could not be planned.
    #[error(transparent)]
    Landing(#[from] sms_landing::LandingError),
    /// A target world could not be built.
    #[error(transparent)]
    Target(#[from] sms_target::TargetError),
    /// A comparison with a scanned model failed.
    #[error(transparent)]
    Evaluate(#[from] sms_eval::EvaluateError),
}

impl StageError for BenchError {
    fn kind(&self) -> ErrorKind<'_> {
        match self {
            Self::Input(e) | Self::Unanswered(e) => e.kind(),
            Self::Core(e) => e.kind(),
            Self::Pipeline(e) => e.kind(),
            Self::Plan(e) => e.kind(),
            Self::Scene(e) => e.kind(),
            Self::Landing(e) => e.kind(),
            Self::Target(e) => e.kind(),
            Self::Evaluate(e) => e.kind(),
        }
    }
}
