//! The command `sms`.
fn main() {}
