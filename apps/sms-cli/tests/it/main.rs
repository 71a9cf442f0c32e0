//! The commands of `sms`, started as a user starts them.

mod common;
mod faults;
mod landing;
mod masks;
mod materials;
mod robot;
#[cfg(unix)]
mod view;
