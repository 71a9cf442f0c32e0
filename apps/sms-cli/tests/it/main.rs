//! The commands of `sms`, started as a user starts them.

mod common;
mod faults;
mod flow;
mod help;
mod landing;
mod manual;
mod masks;
mod materials;
mod robot;
mod stale;
#[cfg(unix)]
mod view;
