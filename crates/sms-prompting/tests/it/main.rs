//! Integration tests of the landing baselines.

mod visual;
