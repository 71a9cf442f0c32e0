//! Integration tests of the crate.

mod common;
mod delaunay;
mod parts;
mod sphere;
