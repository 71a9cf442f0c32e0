//! Tests of the pipeline on a generated recording.

mod flow;
mod settings_keys;
