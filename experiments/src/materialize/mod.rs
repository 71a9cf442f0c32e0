//! Quality and time of materialize: meshes of scanned models against the models.
//!
//! A model is rendered from an orbit and scanned once ([`train`]; the result is kept on disk); each [`run_materialize`]
//! then builds the entities again and measures them, so that work on the entities stage is judged in seconds.

mod measure;
mod options;
mod table;
mod trained;

pub use measure::run_materialize;
pub use options::{MaskChoice, MaterializeOptions};
pub use table::{
    MaterializeTarget, add_materialize_means, materialize_markdown, materialize_table, materialize_targets,
};
pub(crate) use trained::scan_key;
pub use trained::{Inputs, Trained, train};
