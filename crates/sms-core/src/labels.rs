//! Object labels of pixels.

use crate::Image;
use serde::{Deserialize, Serialize};

/// The label of pixels without an object: floor, walls, clutter.
pub const BACKGROUND: u16 = 0;

/// Per-pixel object labels of one frame; [`BACKGROUND`] where there is no object.
pub type LabelMap = Image<u16>;

/// Origin of masks; named in the report.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MaskSource {
    /// Label images that came with the recording.
    Files,
    /// Clustering of the fused depth.
    Geometry,
    /// The truth of a generated scene; for ablations only.
    Truth,
    /// Open-vocabulary detection and video segmentation networks.
    Foundation,
}

/// One labelled object.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LabelInfo {
    /// Value in the label maps, at least 1.
    pub id: u16,
    /// Name, unique in the scene, usable as a file name.
    pub name: String,
    /// Free-text description by the labeller ("glue bottle"); may be empty.
    #[serde(default)]
    pub description: String,
}

/// Labels of a whole sequence: one map per frame, with the same id for the same object throughout.
#[derive(Debug, Clone, PartialEq)]
pub struct Labels {
    /// One map per frame, in the frames' order.
    pub maps: Vec<LabelMap>,
    /// The objects, ordered by id.
    pub objects: Vec<LabelInfo>,
    /// Their origin.
    pub source: MaskSource,
}

impl Labels {
    /// Returns the number of classes including the background: the largest id plus one.
    pub fn class_count(&self) -> usize {
        self.objects.iter().map(|o| o.id as usize).max().unwrap_or(0) + 1
    }

    /// Returns the object with this id.
    pub fn object(&self, id: u16) -> Option<&LabelInfo> {
        self.objects.iter().find(|o| o.id == id)
    }
}
