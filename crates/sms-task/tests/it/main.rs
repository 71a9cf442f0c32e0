//! Integration tests of tasks, in one binary.

mod common;
mod rollout;
mod strike;
