//! Integration tests.

mod examples;
mod round_trip;
