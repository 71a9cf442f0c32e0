//! Object masks through a sequence: from files, from geometry, from the truth of a generated scene.
//!
//! Every source is a [`Segmenter`]: it looks at a posed RGB-D [`Sequence`] and returns [`Labels`], one label map a
//! frame with the same id for the same object throughout. What no label explains stays [`BACKGROUND`] and becomes a
//! static collision mesh in a later stage.
//!
//! - [`FileMasks`]: label images that came with the recording.
//! - [`GeometryMasks`]: the embedded default. Large planes are removed from the fused cloud, what is left is
//!   clustered (and split where two convex things meet), and the clusters are projected back into every frame.
//! - [`TruthMasks`]: the truth of a generated recording, for ablations only and named so.
//!
//! [`refine_edges`] is the paper's correction of mask borders by nearest neighbours in the back-projected cloud, and
//! [`add_unknown`] adds what a source missed; [`complete`] does both for the sources that need it; [`save_labels`] / [`load_labels`] keep labels in the run folder, where names
//! may be edited and objects merged.
//!
//! ```
//! use sms_core::{Cancel, StageContext, Warnings, glamx::DPose3};
//! use sms_frames::Sequence;
//! use sms_masks::{GeometryMasks, Segmenter};
//! let empty = Sequence { frames: vec![], x_world_recording: DPose3::identity(), source: "nowhere".into() };
//! let warnings = Warnings::new();
//! let labels = GeometryMasks::default().segment(&empty, StageContext::quiet(&Cancel::new(), &warnings))?;
//! assert!(labels.maps.is_empty() && labels.objects.is_empty());
//! assert_eq!(warnings.snapshot()[0].code, "no_objects");
//! # Ok::<(), sms_masks::MasksError>(())
//! ```

mod complete;
mod error;
mod files;
mod geometry;
mod names;
mod palette;
mod refine;
mod store;
mod truth;
mod unknown;
mod voxels;

#[cfg(test)]
mod fixture;

pub use complete::{Completed, complete};
pub use error::MasksError;
pub use files::FileMasks;
pub use geometry::{GeometryConfig, GeometryMasks};
pub use palette::label_color;
pub use refine::{DEFAULT_MARGIN_PX, DEFAULT_NEIGHBORS, refine_edges, scaled_margin_px};
pub use sms_core::{BACKGROUND, LabelInfo, LabelMap, Labels, MaskSource};
pub use store::{load_labels, save_labels};
pub use truth::TruthMasks;
pub use unknown::add_unknown;

use sms_core::StageContext;
use sms_frames::Sequence;

/// The stage's name in warnings.
pub(crate) const STAGE: &str = "masks";

/// A source of object labels.
pub trait Segmenter {
    /// Labels every frame of `sequence`: one map a frame, of the frame's size, with ids consistent through the
    /// sequence and objects ordered by id.
    ///
    /// # Errors
    /// [`MasksError::Input`] when what the user gave does not fit the sequence, [`MasksError::Core`] for files and
    /// interruption.
    fn segment(&self, sequence: &Sequence, context: StageContext<'_>) -> Result<Labels, MasksError>;
}
