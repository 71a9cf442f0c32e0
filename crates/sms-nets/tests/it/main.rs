//! Integration tests of the networks.

mod gpu;
mod hub;
mod owlv2;
mod random;
mod sam2;
mod segmenter;
mod support;
