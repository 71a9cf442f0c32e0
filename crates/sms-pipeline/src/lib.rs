//! The pipeline as a library: from a posed RGB-D recording to a simulated scene, a plan, its execution and a report.
//!
//! [`Run`] works on a folder: each method runs one command of the program `sms`, stores its stages there, and
//! recomputes only outdated ones. [`stages`] contains the same stages as functions without a folder. A [`Context`]
//! carries progress, cancellation, settings and events; the library prints nothing.
//!
//! ```no_run
//! use sms_pipeline::{Context, Format, MaterializeRequest, PlanRequest, Run, ScanRequest};
//! use std::path::Path;
//!
//! # fn main() -> Result<(), sms_pipeline::Error> {
//! let context = Context::default();
//! let run = Run::new("my-run", &context);
//! run.scan(Path::new("recording"), &ScanRequest::default())?;
//! run.materialize(&MaterializeRequest::default())?;
//! run.plan(&PlanRequest::new("recording/task.toml"))?;
//! let files = run.export(&[Format::Mjcf], None)?;
//! # Ok(())
//! # }
//! ```

mod cache;
mod command_options;
mod context;
mod device;
mod error;
mod material_edits;
mod memory;
mod networks;
mod object_names;
mod origin;
mod picture;
mod preview;
mod resumption;
mod robot_place;
mod run;
mod samples;
mod separate;
pub mod settings;
mod stage_list;
pub mod stages;
mod vlm;

pub use context::{Context, Event, EventSink};
pub use device::{Device, without_gpu};
pub use error::Error;
pub use material_edits::{ObjectMaterials, material_properties, source_name};
pub use networks::{MasksSource, ModelEntry, NetworksRequest, TrackMode, fetch_models, list_models};
pub use robot_place::{RobotPlace, write_robot_place};
pub use run::{
    EvaluateOutcome, ExecuteOutcome, ExecuteRequest, MaterializeOutcome, MaterializeRequest, NamedObjects,
    PlanRequest, PlannedTask, RecordedAgreement, RobotOutcome, RobotRequest, Run, RunSettings, RunStatus,
    ScanOutcome, ScanRequest, StageCondition, StageStatus, is_at_rest,
};
pub use samples::{landing_task_of, strike_task_of, write_task_files};
pub use settings::Settings;
pub use sms_export::Format;
pub use sms_masks::Rename;
pub use vlm::{Estimates, VlmMode, estimates};
