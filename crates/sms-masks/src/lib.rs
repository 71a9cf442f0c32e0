//! Object masks of a sequence: from files, from geometry, or from the truth of a generated scene.
//!
//! Every source is a [`Segmenter`]: it takes a posed RGB-D [`Sequence`] and returns [`Labels`], one label map per frame
//! with the same id for the same object throughout. Pixels without a label are [`BACKGROUND`] and become a static
//! collision mesh in a later stage.
//!
//! - [`FileMasks`]: label images of the recording.
//! - [`GeometryMasks`]: the default. Large planes are removed from the fused cloud, the rest is clustered (and split
//!   where two convex objects meet), and the clusters are projected back into every frame.
//! - [`TruthMasks`]: the truth of a generated recording, for ablations only; labels are marked as truth.
//!
//! [`refine_edges`] is the paper's correction of mask borders by nearest neighbours in the back-projected cloud,
//! [`add_unknown`] adds missed objects, and [`complete`] does both for the sources that need it. [`save_labels`] and
//! [`load_labels`] keep labels in the run folder, where names may be edited and objects merged.
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

mod carry;
mod complete;
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

pub use carry::{CarriedOver, save_labels_again};
pub use complete::{Completed, complete};
pub use files::FileMasks;
pub use geometry::{GeometryConfig, GeometryMasks};
pub use names::{file_name, is_automatic, is_usable, unique};
pub use palette::label_color;
pub use refine::refine_edges;
pub use sms_core::{BACKGROUND, LabelInfo, LabelMap, Labels, MaskSource};
pub use store::{LabelRow, Rename, check_renames, load_label_rows, load_labels, rename_labels, save_labels};
pub use truth::TruthMasks;
pub use unknown::add_unknown;

use sms_core::StageContext;
use sms_frames::Sequence;

/// Errors of this crate: bad input, unreadable files, an interruption.
pub type MasksError = sms_core::CoreError;

/// The stage's name in warnings.
pub(crate) const STAGE: &str = "masks";

/// A source of object labels.
pub trait Segmenter {
    /// Labels every frame of `sequence`: one map per frame, of the frame's size, with ids consistent through the
    /// sequence and objects ordered by id.
    ///
    /// # Errors
    /// [`MasksError::Input`] if the user's input does not fit the sequence; errors of files, and interruption.
    fn segment(&self, sequence: &Sequence, context: StageContext<'_>) -> Result<Labels, MasksError>;
}
