//! Integration tests of sms-sim.

mod arm;
mod common;
mod motion;
mod touches;
mod wash;
