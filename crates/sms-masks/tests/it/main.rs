//! Integration tests of the segmentation sources.

mod recordings;
