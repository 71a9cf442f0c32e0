//! Posed RGB-D recordings: readers, checks, resampling, normals and world alignment.

mod sequence;

pub use sequence::{Frame, Sequence};
