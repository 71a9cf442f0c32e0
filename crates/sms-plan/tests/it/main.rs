//! Integration tests of the planner, in one binary.

mod arm;
// Fixture shared with the tests of tasks.
#[path = "../../../sms-task/tests/it/common.rs"]
mod common;
mod nelder_mead;
mod planning;
mod rehearsal;
