//! Integration tests.

// Fixture shared with the tests of tasks.
#[path = "../../../crates/sms-task/tests/it/common.rs"]
mod common;
mod examples;
mod grid;
mod round_trip;
