//! OWLv2 and SAM 2.1 on candle: text-prompted detection and video masks, from their official weights.
//!
//! ```
//! use sms_nets::owlv2::{Detection, PixelBox, suppressed};
//! let at = |x0, score| Detection { query: 0, score, bbox: PixelBox { x0, y0: 0.0, x1: x0 + 10.0, y1: 10.0 } };
//! let kept = suppressed(vec![at(0.0, 0.4), at(1.0, 0.8), at(30.0, 0.5)], 0.5);
//! assert_eq!(kept.len(), 2);
//! ```

mod error;
mod kernels;
mod ops;
mod safetensors;
mod weights;

pub mod owlv2;
pub mod sam2;

pub use error::NetsError;
pub use kernels::resize_bilinear;
pub use ops::Seams;
pub use safetensors::SafetensorsFile;
pub use weights::{Shapes, Weights};
