//! Integration tests.

mod common;
mod conventions;
mod faults;
mod images;
mod real_data;
mod tum;
mod without_poses;
mod world;
