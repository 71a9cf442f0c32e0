//! Selects the features of third-party crates that the whole workspace uses, also for a build of one binary.
//!
//! Cargo selects features by the packages of a command. Without this crate, `cargo test --workspace` after
//! `cargo run` compiles most dependencies a second time, because the tests, the networks and the GPU kernels select
//! more features of them than `sms` does. Every build includes `sms-core`, which depends on this crate.
//!
//! The list is complete if `cargo test --release --workspace --no-run` after `cargo build --release` compiles no crate
//! that `sms` uses. After a change of dependencies, compare the features of both commands with `cargo tree -e features`.
