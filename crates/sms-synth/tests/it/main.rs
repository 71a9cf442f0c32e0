//! Integration tests.

mod camera;
mod challenge;
mod landing;
mod recordings;
mod scenes;
mod shutter;
