//! Sources of masks, among them the networks OWLv2 and SAM 2.1 (feature `nets`).

#[cfg(feature = "nets")]
mod sam2;
#[cfg(not(feature = "nets"))]
mod unavailable;

#[cfg(feature = "nets")]
pub(crate) use sam2::Networks;
#[cfg(not(feature = "nets"))]
pub(crate) use unavailable::Networks;

use std::path::PathBuf;

/// Source of the object masks of a scan.
#[derive(Debug, Clone, Default, PartialEq)]
pub enum MasksSource {
    /// Clusters of the fused depth.
    #[default]
    Geometry,
    /// Label images of the recording.
    Files,
    /// The ground truth of a generated recording, for ablations.
    Truth,
    /// OWLv2 detects objects in the first frame, SAM 2.1 tracks them. Needs the feature `nets`.
    Networks(NetworksRequest),
}

impl MasksSource {
    /// Returns the name in `run.toml` and metrics.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Geometry => "geometry",
            Self::Files => "files",
            Self::Truth => "truth",
            Self::Networks(_) => "sam2",
        }
    }
}

/// Options of masks by networks.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct NetworksRequest {
    /// Object names to detect, separated by commas; by default household objects.
    pub objects: Option<String>,
    /// Boxes in the first frame, `NAME=X0,Y0,X1,Y1`. Without `objects`, no other objects are detected.
    pub boxes: Vec<String>,
    /// Smallest score of a detection, 0 to 1.
    pub threshold: Option<f64>,
    /// Overlap above which the weaker of two detections is dropped, 0 to 1.
    pub max_overlap: Option<f64>,
    /// Tracking method; by default memory on a GPU and reprompting on a CPU.
    pub tracking: Option<TrackMode>,
    /// Name of the SAM 2.1 model.
    pub sam2: Option<String>,
    /// Folder with the models' files, in place of the Hugging Face cache.
    pub weights: Option<PathBuf>,
}

impl NetworksRequest {
    /// Returns whether any option selects the objects to detect.
    pub fn is_question(&self) -> bool {
        let Self { objects, boxes, threshold, max_overlap, .. } = self;
        objects.is_some() || !boxes.is_empty() || threshold.is_some() || max_overlap.is_some()
    }
}

/// Tracking method of SAM 2.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TrackMode {
    /// With the memory of each object, as in the paper.
    Memory,
    /// Segments each image from boxes projected by pose and depth; several times cheaper.
    Reprompt,
}

/// A network in `sms models list`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ModelEntry {
    /// Name for [`fetch_models`].
    pub name: &'static str,
    /// Repository on Hugging Face.
    pub repository: &'static str,
    /// Purpose and size.
    pub about: &'static str,
    /// Folder and commit of the files in the cache, if they are there.
    pub cached: Option<(PathBuf, String)>,
}

#[cfg(feature = "nets")]
pub use sam2::{fetch_models, list_models};
#[cfg(not(feature = "nets"))]
pub use unavailable::{fetch_models, list_models};
