//! Objects from geometry alone: large planes go, the rest is clustered, clusters are seen again in every frame.
//!
//! 1. [`fuse`]: all frames become one cloud of surfels; what other frames see through is dropped.
//! 2. [`planes`]: planar pieces too large to be a face of an object (floor, desk, walls) are static, but none of what
//!    stands free on the ground as a whole ([`assembly`]: furniture, containers, what is stacked on them).
//! 3. [`cluster`]: what is left falls into connected pieces; pieces are split where two convex things meet
//!    ([`segments`]) and around what is round all over ([`balls`]), assemblies where one thing stands on another; posts join what
//!    they carry; pieces that cannot be objects are left to the background.
//! 4. [`project`]: each pixel takes the label of the surfels that it sees.

mod assembly;
mod balls;
mod cluster;
mod fuse;
mod linalg;
mod planes;
mod posts;
mod project;
mod seams;
mod segments;

use crate::{MasksError, STAGE, Segmenter};
use glamx::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sms_core::{
    Cancel, InputError, LabelInfo, LabelMap, Labels, MaskSource, Progress, Ranges, Seed, StageContext,
};
use sms_frames::Sequence;

/// Settings of [`GeometryMasks`]. Lengths in metres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GeometryConfig {
    /// Size of a cell of the fused cloud. About a pixel's footprint: finer cells hold too few samples to average.
    pub voxel_m: f64,
    /// At most so many frames are fused, evenly spread; labels are made for all frames.
    pub max_fused_frames: usize,
    /// Depth beyond this is not used: noise grows with the square of depth.
    pub max_depth_m: f64,
    /// Neither is depth beyond this multiple of the median depth in the middle of the images.
    pub depth_spread: f64,
    /// Planar pieces longer than this, and pieces of any shape longer than this, are not objects.
    pub max_object_m: f64,
    /// Things that stand free (stools, planks, low tables) may be so long: of their planar pieces the surroundings are seen
    /// past most of the rim, and they touch little that is static.
    pub max_structure_m: f64,
    /// Planar pieces with more area than this (m²) are not faces of an object; the side of a large cereal box has
    /// 0.057.
    pub max_face_m2: f64,
    /// An object is at least so long, and stands out at least half as much from the planes around it.
    pub min_object_m: f64,
    /// An object shows at least this surface (m²).
    pub min_area_m2: f64,
    /// Two surfaces nearer than this are connected; normals are taken from this neighbourhood.
    pub gap_m: f64,
    /// Neighbouring patches that bend inwards by more than this (radians) form a crease; a piece is split along
    /// creases.
    pub crease_rad: f64,
    /// Share of a border that bends inwards from which it is a crease.
    pub crease_share: f64,
    /// A connected piece longer than this is taken for several things rather than one.
    pub clutter_m: f64,
    /// The share of frames in which an object must be visible.
    pub min_seen_share: f64,
    /// For the random draws of plane fitting.
    pub seed: Seed,
    /// Of masks from any source but the truth: whether their borders are corrected in 3-D ([`crate::refine_edges`]).
    pub refine_edges: bool,
    /// Of masks from any source but geometry and the truth: whether what stands free and bears no label becomes an object
    /// ([`crate::add_unknown`]).
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
    /// The first value that cannot be used.
    ///
    /// # Errors
    /// [`InputError`] that names the key and what is allowed.
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

/// The embedded default: objects by geometry, without any network.
///
/// Objects are named `object_01`, `object_02`, … by decreasing observed surface. Things that touch are separated where
/// they meet in an inward crease and differ in colour, or touch in less than their cross-section; a crease alone is not
/// enough, since toys and statues have creases. A ball is a thing of its own where it differs in colour from what it touches. In clutter (connected pieces longer than [`GeometryConfig::clutter_m`])
/// less evidence is needed, and in pieces longer than 0.35 m a level crease all around is where one thing stands on
/// another. The bottom of a vessel belongs to its walls, and upright posts to what they carry. What stands free on the ground
/// and is larger than an object is stacked of bodies that meet in level seams.
///
/// Limits: a stack whose sides are flush and whose colours are alike remains one object, or is cut wrongly, unless what is above juts
/// out over what is below and shows it along half of the way around; so do things of one
/// colour side by side on a piece of furniture; a thing without
/// contrast to a wall that it touches may keep a fringe of it; flat soft things on a noisy support may be lost in it.
#[derive(Debug, Clone, Default)]
pub struct GeometryMasks {
    /// The settings.
    pub config: GeometryConfig,
}

/// The fused cloud of a sequence and the objects in it.
pub(crate) struct Clustered {
    surfels: Vec<fuse::Surfel>,
    /// Which surfels are near each other.
    pub(crate) graph: fuse::Neighbors,
    /// What belongs to large planes.
    is_static: Vec<bool>,
    /// The objects: sorted surfels, the largest first.
    pub(crate) clusters: Vec<Vec<usize>>,
    /// Lengths of what stands free like a structure and is static for its size alone, metres.
    oversize_m: Vec<f64>,
}

impl Clustered {
    /// Finds the objects of a sequence.
    pub(crate) fn new(
        sequence: &Sequence,
        config: &GeometryConfig,
        progress: &dyn Progress,
        cancel: &Cancel,
    ) -> Result<Self, MasksError> {
        config.validate()?;
        progress.begin("masks from geometry", 4);
        let (surfels, graph) = fuse::fuse(sequence, config, cancel)?;
        progress.update(1, &format!("{} surface points", surfels.len()));
        let (is_static, assembly_of, planes) =
            planes::static_surfels(&surfels, &graph, sequence, config, cancel)?;
        progress.update(2, &format!("{} large planes", planes.len()));
        let clusters =
            cluster::clusters(&surfels, &graph, &is_static, &assembly_of, &planes, sequence, config, cancel)?;
        cancel.check()?;
        progress.update(3, &format!("{} objects", clusters.len()));
        let oversize_m = planes.iter().filter_map(|p| p.free_length_m).collect();
        Ok(Self { surfels, graph, is_static, clusters, oversize_m })
    }

    /// Which surfels hold, by their position in the world.
    pub(crate) fn surfels_where(&self, holds: impl Fn(DVec3) -> bool + Sync) -> Vec<bool> {
        self.surfels.par_iter().map(|s| holds(s.p_w)).collect()
    }

    /// Whether a surfel lies beside a wall or another upright static surface.
    pub(crate) fn touches_wall(&self, i: usize) -> bool {
        self.graph.of(i).any(|j| self.is_static[j] && self.surfels[j].n_w.z < planes::ROUGHLY_ALIGNED)
    }

    /// A label map of every frame, of the clusters' positions plus 1.
    pub(crate) fn maps(
        &self,
        sequence: &Sequence,
        config: &GeometryConfig,
        cancel: &Cancel,
    ) -> Result<Vec<LabelMap>, MasksError> {
        let mut labels_of = vec![sms_core::BACKGROUND; self.surfels.len()];
        for (index, cluster) in self.clusters.iter().enumerate() {
            for &i in cluster {
                labels_of[i] = index as u16 + 1;
            }
        }
        Ok(project::label_frames(sequence, &self.surfels, &labels_of, config, cancel)?)
    }
}

impl Segmenter for GeometryMasks {
    fn segment(&self, sequence: &Sequence, context: StageContext<'_>) -> Result<Labels, MasksError> {
        let StageContext { progress, cancel, warnings, .. } = context;
        let clustered = Clustered::new(sequence, &self.config, progress, cancel)?;
        let maps = clustered.maps(sequence, &self.config, cancel)?;
        let count = clustered.clusters.len();
        for long in &clustered.oversize_m {
            warnings.add(
                STAGE,
                "oversize",
                format!("a surface {long:.2} m long stands free and was taken for static, with what is one with it"),
                format!("if it is a thing that can move, `--set masks.max_structure_m={:.1}`", 1.1 * long + 0.05),
            );
        }
        if count == 0 {
            warnings.add(
                STAGE,
                "no_objects",
                "no objects were found in the recording's geometry: everything is static",
                "give label images with `--masks files`, or record closer and from more sides",
            );
        }
        let object = |id: usize| LabelInfo {
            id: id as u16,
            name: format!("object_{id:02}"),
            description: String::new(),
        };
        progress.end(&format!("{count} objects"));
        Ok(Labels { maps, objects: (1..=count).map(object).collect(), source: MaskSource::Geometry })
    }
}

#[cfg(test)]
mod tests;
