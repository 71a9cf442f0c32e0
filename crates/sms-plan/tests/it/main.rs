//! Integration tests of the planner, in one binary.

mod arm;
// The fixture of the task's tests serves the planner, too.
#[path = "../../../sms-task/tests/it/common.rs"]
mod common;
mod grid;
mod nelder_mead;
mod planning;
