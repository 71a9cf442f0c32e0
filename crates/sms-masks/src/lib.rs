//! s the truth of a generated recording, for ablations only and named so. => the truth of a generated recording, for
//! ablations only; labels are marked as truth.

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
pub use refine::refine_edges;
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
    /// Labels every frame of `sequence`: one map per frame, of the frame's size, with ids consistent through the
    /// sequence and objects ordered by id.
    ///
    /// # Errors
    /// [`MasksError::Input`] if the user's input does not fit the sequence, [`MasksError::Core`] for files and
    /// interruption.
    fn segment(&self, sequence: &Sequence, context: StageContext<'_>) -> Result<Labels, MasksError>;
}
