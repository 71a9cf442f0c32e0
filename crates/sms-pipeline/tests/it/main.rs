//! Tests of the pipeline on a generated recording.

mod flow;
mod follow;
mod resume;
mod settings_keys;
mod tracking;
