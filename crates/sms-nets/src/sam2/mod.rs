//! SAM 2.1: masks of boxed objects, in an image or through a video.

mod config;
mod decoder;
mod encoder;
mod memory;
mod model;
mod positions;
mod preprocess;
mod prompt;
mod tracker;

pub use config::{DecoderConfig, EncoderConfig, HieraConfig, RopeParameters, Sam2Config};
pub use encoder::ImageFeatures;
pub use model::{ObjectMask, Sam2};
pub use preprocess::pixel_values;
pub use tracker::Tracker;
