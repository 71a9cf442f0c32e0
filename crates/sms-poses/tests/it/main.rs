//! Integration tests.

mod common;
mod compare;
mod degenerate;
mod recovery;
mod tracking;
