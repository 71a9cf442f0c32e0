//! Settings of the segmentation by geometry.

use serde::{Deserialize, Serialize};
use sms_core::{InputError, Ranges, Seed};

/// Settings of [`crate::GeometryMasks`]. Lengths in metres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GeometryConfig {
    /// Cell size of the fused cloud, about a pixel's footprint. Finer cells hold too few samples to average.
    pub voxel_m: f64,
    /// Largest number of fused frames, evenly spread; all frames get labels.
    pub max_fused_frames: usize,
    /// Largest depth that is used: noise grows with the square of depth.
    pub max_depth_m: f64,
    /// Largest depth as a multiple of the median depth in the middle of the images.
    pub depth_spread: f64,
    /// Largest length of an object. Longer pieces, planar or not, are not objects.
    pub max_object_m: f64,
    /// Largest length of free-standing furniture (stools, planks, low tables). The surroundings are visible beyond most
    /// of the rim of its planar pieces, and it touches few static surfaces.
    pub max_structure_m: f64,
    /// Largest area of an object's face (m²). The side of a large cereal box has 0.057.
    pub max_face_m2: f64,
    /// Smallest length of an object. An object must also stand out by at least half as much from the planes around it.
    pub min_object_m: f64,
    /// Smallest visible surface of an object (m²).
    pub min_area_m2: f64,
    /// Surfaces closer than this are connected. Also the neighbourhood for normals.
    pub gap_m: f64,
    /// Neighbouring patches that bend inwards by more than this (radians) form a crease; a piece is split along
    /// creases.
    pub crease_rad: f64,
    /// Smallest share of a border that must bend inwards to form a crease.
    pub crease_share: f64,
    /// A longer connected piece is assumed to be several objects.
    pub clutter_m: f64,
    /// Smallest share of frames in which an object must be visible.
    pub min_seen_share: f64,
    /// Seed of plane fitting.
    pub seed: Seed,
    /// Whether to correct mask borders in 3-D ([`crate::refine_edges`]), for all sources except the truth.
    pub refine_edges: bool,
    /// Whether unlabelled free-standing pieces become objects ([`crate::add_unknown`]), for all sources except geometry
    /// and the truth.
    pub add_unknown: bool,
}

impl Default for GeometryConfig {
    fn default() -> Self {
        Self {
            voxel_m: 0.004,
            max_fused_frames: 40,
            max_depth_m: 2.5,
            depth_spread: 1.8,
            max_object_m: 0.42,
            max_structure_m: 1.0,
            max_face_m2: 0.065,
            min_object_m: 0.010,
            min_area_m2: 5e-4,
            gap_m: 0.010,
            crease_rad: 0.5,
            crease_share: 0.4,
            clutter_m: 0.22,
            min_seen_share: 0.2,
            seed: Seed(0),
            refine_edges: true,
            add_unknown: true,
        }
    }
}

impl GeometryConfig {
    /// Validates all values.
    ///
    /// # Errors
    /// [`InputError`] with the key of the first invalid value and its range.
    pub fn validate(&self) -> Result<(), InputError> {
        let r = Ranges::of("masks");
        for (key, value, low, high) in [
            ("voxel_m", self.voxel_m, 2e-4, 0.1),
            ("max_depth_m", self.max_depth_m, 0.01, 1e3),
            ("depth_spread", self.depth_spread, 1.0, 1e3),
            ("max_object_m", self.max_object_m, 1e-3, 100.0),
            ("max_structure_m", self.max_structure_m, 1e-3, 100.0),
            ("max_face_m2", self.max_face_m2, 1e-6, 1e4),
            ("min_object_m", self.min_object_m, 0.0, 100.0),
            ("min_area_m2", self.min_area_m2, 0.0, 1e4),
            ("gap_m", self.gap_m, 1e-4, 1.0),
            ("crease_rad", self.crease_rad, 0.0, std::f64::consts::PI),
            ("crease_share", self.crease_share, 0.0, 1.0),
            ("clutter_m", self.clutter_m, 0.0, 1e3),
            ("min_seen_share", self.min_seen_share, 0.0, 1.0),
        ] {
            r.within(key, value, low, high)?;
        }
        r.count("max_fused_frames", self.max_fused_frames, 1, 100_000)?;
        r.ordered(("min_object_m", self.min_object_m), ("max_object_m", self.max_object_m))
    }
}
