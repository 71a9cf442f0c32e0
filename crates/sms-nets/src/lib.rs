//! OWLv2 and SAM 2.1 on candle: text-prompted detection and video masks, from their official weights.
//!
//! - [`owlv2`]: boxes around objects named by text queries (Minderer et al. 2023).
//! - [`sam2`]: masks of boxed objects, in an image or through a video with memories (Ravi et al. 2024).
//! - [`NetsMasks`]: both as one [`sms_masks::Segmenter`]: detection in the first frame and tracking through the rest,
//!   as in the paper.
//! - [`hub`]: their weights, from the Hugging Face hub or a folder.
//!
//! Tests compare intermediate tensors with the reference implementation (`tests/`), to within 1e-4. The networks
//! compute in 32-bit floats, including memories (the reference library rounds memories to bfloat16). The same input
//! gives the same bytes for any number of threads.
//!
//! ```
//! use sms_nets::owlv2::{Detection, PixelBox, suppressed};
//! let at = |x0, score| Detection { query: 0, score, bbox: PixelBox { x0, y0: 0.0, x1: x0 + 10.0, y1: 10.0 } };
//! let kept = suppressed(vec![at(0.0, 0.4), at(1.0, 0.8), at(30.0, 0.5)], 0.5);
//! assert_eq!(kept.iter().map(|d| d.score).collect::<Vec<_>>(), [0.8, 0.5]);
//! ```

mod attention;
mod carry;
mod error;
mod kernels;
mod objects;
mod ops;
mod safetensors;
mod segmenter;
mod weights;

pub mod hub;
pub mod owlv2;
pub mod sam2;

pub use candle_core::Device;
pub use error::NetsError;
pub use objects::{NamedBox, foreign, parse_objects};
pub use ops::TensorObserver;
pub use segmenter::{DetectedObject, ModelFolders, NetsConfig, NetsMasks, Track};
pub use weights::{Weights, WeightsSource};
