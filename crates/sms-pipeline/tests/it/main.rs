//! Tests of the pipeline on a generated recording.

mod flow;
mod resume;
mod settings_keys;
mod tracking;
