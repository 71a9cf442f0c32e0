//! Integration tests.

mod common;
mod degenerate;
mod recovery;
