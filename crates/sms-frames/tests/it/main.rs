//! Integration tests.

mod common;
mod conventions;
mod faults;
mod following;
mod images;
mod real_data;
mod tum;
mod without_poses;
mod world;
