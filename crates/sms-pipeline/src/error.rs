//! Errors of the pipeline.

use sms_core::{CoreError, ErrorKind, InputError, StageError};

/// Declares [`Error`] with one transparent variant per stage error.
macro_rules! errors {
    ($($(#[doc = $doc:literal])* $name:ident($kind:ty),)*) => {
        /// An error of the pipeline, from the stage that failed. [`StageError::kind`] separates bad input from other
        /// failures.
        #[derive(Debug, thiserror::Error)]
        pub enum Error {
            $($(#[doc = $doc])* #[error(transparent)] $name(#[from] $kind),)*
            /// The scene cannot be simulated.
            #[error(transparent)]
            Sim(#[from] sms_sim::SimError),
            /// No scene can be built from the entities and materials.
            #[error(transparent)]
            Build(#[from] sms_scene::BuildError),
            /// A value cannot be serialized.
            #[error("cannot serialize: {0}")]
            Serialize(String),
        }

        impl StageError for Error {
            fn kind(&self) -> ErrorKind<'_> {
                match self {
                    $(Self::$name(e) => e.kind(),)*
                    Self::Sim(_) | Self::Build(_) | Self::Serialize(_) => ErrorKind::Other,
                }
            }
        }
    };
}

errors! {
    /// Bad input.
    Input(InputError),
    /// A file cannot be read or written, or the run was interrupted.
    Core(CoreError),
    /// The training of the Gaussians failed.
    Scan(sms_gaussians::ScanError),
    /// The entities failed.
    Entities(sms_entities::EntitiesError),
    /// The scene cannot be read or written.
    Scene(sms_scene::SceneError),
    /// The task does not fit the scene.
    Task(sms_task::TaskError),
    /// The planner failed.
    Plan(sms_plan::PlanError),
    /// The landing planner failed.
    Landing(sms_landing::LandingError),
    /// The execution failed.
    Target(sms_target::TargetError),
    /// The comparison with known models failed.
    Evaluate(sms_eval::EvaluateError),
}

#[cfg(feature = "rerun")]
impl From<sms_report::RrdError> for Error {
    fn from(error: sms_report::RrdError) -> Self {
        match error {
            sms_report::RrdError::Core(core) => Self::Core(core),
            other => Self::Serialize(other.to_string()),
        }
    }
}

impl From<serde_json::Error> for Error {
    fn from(error: serde_json::Error) -> Self {
        Self::Serialize(error.to_string())
    }
}

impl From<toml::ser::Error> for Error {
    fn from(error: toml::ser::Error) -> Self {
        Self::Serialize(error.to_string())
    }
}
