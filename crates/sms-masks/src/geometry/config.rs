//! Settings of the segmentation by geometry.

use serde::{Deserialize, Serialize};
use sms_core::{InputError, Ranges, Seed};

/// Settings of [`crate::GeometryMasks`]. Lengths in metres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GeometryConfig {
    /// Size of a cell of the fused cloud. About a pixel's footprint: finer cells hold too few samples to average.
    pub voxel_m: f64,
    /// Greatest number of fused frames, evenly spread; labels are made for all frames.
    pub max_fused_frames: usize,
    /// Depth beyond this is not used: noise grows with the square of depth.
    pub max_depth_m: f64,
    /// The same as a multiple of the median depth in the middle of the images.
    pub depth_spread: f64,
    /// Planar pieces longer than this, and pieces of any shape longer than this, are not objects.
    pub max_object_m: f64,
    /// Greatest length of free-standing furniture (stools, planks, low tables): the surroundings are visible past most of
    /// the rim of its planar pieces, and it touches few static surfaces.
    pub max_structure_m: f64,
    /// Planar pieces with more area than this (m²) are not faces of an object; the side of a large cereal box has
    /// 0.057.
    pub max_face_m2: f64,
    /// Least length of an object, which stands out at least half as much from the planes around it.
    pub min_object_m: f64,
    /// Least visible surface of an object (m²).
    pub min_area_m2: f64,
    /// Two surfaces nearer than this are connected; normals are taken from this neighbourhood.
    pub gap_m: f64,
    /// Neighbouring patches that bend inwards by more than this (radians) form a crease; a piece is split along
    /// creases.
    pub crease_rad: f64,
    /// Share of a border that bends inwards from which it is a crease.
    pub crease_share: f64,
    /// A connected piece longer than this is taken for several objects rather than one.
    pub clutter_m: f64,
    /// The share of frames in which an object must be visible.
    pub min_seen_share: f64,
    /// Seed of plane fitting.
    pub seed: Seed,
    /// Whether to correct the borders of masks in 3-D ([`crate::refine_edges`]), for all sources but the truth.
    pub refine_edges: bool,
    /// Whether free-standing things without a label become objects ([`crate::add_unknown`]), for all sources but geometry
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
