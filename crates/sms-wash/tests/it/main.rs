//! Integration tests of sms-wash.

mod common;
mod sph;
mod streams;
mod thresholds;
