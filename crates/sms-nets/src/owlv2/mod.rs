//! OWLv2: boxes around objects named by text queries.

mod config;
mod detect;
mod model;
mod preprocess;
mod tokenizer;

pub use config::{Owlv2Config, TextConfig, VisionConfig};
pub use detect::{Detection, PixelBox, detections, suppressed};
pub use model::{Owlv2, Owlv2Heads};
pub use preprocess::pixel_values;
pub use tokenizer::{ClipTokenizer, Tokens};
