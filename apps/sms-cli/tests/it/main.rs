//! The commands of `sms`, started as a user starts them.

mod common;
mod faults;
mod flow;
mod help;
mod landing;
mod manual;
mod masks;
mod materials;
mod names;
mod robot;
/// The server of the tests of `sms-vlm`, which use all of it.
#[allow(dead_code)]
#[path = "../../../../crates/sms-vlm/tests/it/server.rs"]
mod server;
mod stale;
#[cfg(unix)]
mod view;
