//! Integration tests of the crate.

mod bad_input;
mod bowl;
mod build;
mod common;
