//! Objects from geometry alone: large planes are removed, the rest is clustered, and clusters are projected into every
//! frame.
//!
//! 1. [`fuse`]: all frames become one cloud of surfels, without points that other frames see through.
//! 2. [`planes`]: planar pieces too large to be a face of an object (floor, desk, walls) are static, except in
//!    assemblies that stand free on the ground as a whole ([`assembly`]: furniture, containers, their loads).
//! 3. [`cluster`]: the rest is split into connected pieces. Pieces are split where two convex objects meet
//!    ([`segments`]) and around balls ([`balls`]); assemblies are split where one object stands on another. Posts join
//!    their loads. Pieces that cannot be objects become background.
//! 4. [`project`]: each pixel takes the label of the surfels visible in it.

mod assembly;
mod balls;
mod cluster;
mod config;
mod extents;
mod fuse;
mod linalg;
mod planes;
mod posts;
mod project;
mod seams;
mod segments;

pub use config::GeometryConfig;

use crate::{MasksError, STAGE, Segmenter};
use glamx::DVec3;
use rayon::prelude::*;
use sms_core::{Cancel, LabelInfo, LabelMap, Labels, MaskSource, Progress, StageContext, counted};
use sms_frames::Sequence;

/// Objects from geometry, without a network: the default segmentation.
///
/// Objects are named `object_01`, `object_02`, … by decreasing observed surface. Touching objects are separated where
/// they meet in an inward crease and differ in colour, or touch in less than their cross-section. A crease alone is not
/// enough, since toys and statues have creases. A ball is a separate object if its colour differs from that of its
/// neighbours. Clutter (connected pieces longer than [`GeometryConfig::clutter_m`]) needs less evidence, and in pieces
/// longer than 0.35 m a level crease all around separates an object from its support. The bottom of a vessel belongs to
/// its walls, and upright posts to their load. A free-standing assembly on the ground that is larger than an object is
/// a stack of bodies that meet in level seams.
///
/// Limits: a stack with flush sides and similar colours remains one object or is cut wrongly, unless the upper body
/// visibly juts out over the lower one along half of the perimeter. Objects of one colour side by side on furniture
/// also remain one object. An object without contrast to a wall that it touches may keep a fringe of the wall. Flat
/// soft objects on a noisy support may be lost.
#[derive(Debug, Clone, Default)]
pub struct GeometryMasks {
    /// The settings.
    pub config: GeometryConfig,
}

/// The fused cloud of a sequence and the objects in it.
pub(crate) struct Clustered {
    surfels: Vec<fuse::Surfel>,
    /// The neighbours of each surfel.
    pub(crate) graph: fuse::Neighbors,
    /// Whether each surfel belongs to a large plane.
    is_static: Vec<bool>,
    /// The objects: sorted surfels, the largest first.
    pub(crate) clusters: Vec<Vec<usize>>,
    /// Lengths of free-standing surfaces that are static only because of their size, metres.
    oversize_m: Vec<f64>,
}

/// Number of steps of [`Clustered::new`] and of the label maps made from it.
pub(crate) const CLUSTER_STEPS: u64 = 4;

impl Clustered {
    /// Finds the objects of a sequence, in [`CLUSTER_STEPS`] steps of the current part of the work.
    pub(crate) fn new(
        sequence: &Sequence,
        config: &GeometryConfig,
        progress: &dyn Progress,
        cancel: &Cancel,
    ) -> Result<Self, MasksError> {
        config.validate()?;
        let (surfels, graph) = fuse::fuse(sequence, config, cancel)?;
        progress.update(1, &format!("{} surface points", surfels.len()));
        let (is_static, assembly_of, planes) =
            planes::static_surfels(&surfels, &graph, sequence, config, cancel)?;
        progress.update(2, &format!("{} large planes", planes.len()));
        let clusters =
            cluster::clusters(&surfels, &graph, &is_static, &assembly_of, &planes, sequence, config, cancel)?;
        cancel.check()?;
        progress.update(3, &counted(clusters.len(), "object", "objects"));
        let oversize_m = planes.iter().filter_map(|p| p.free_length_m).collect();
        Ok(Self { surfels, graph, is_static, clusters, oversize_m })
    }

    /// Marks the surfels with a world position accepted by `holds`.
    pub(crate) fn surfels_where(&self, holds: impl Fn(DVec3) -> bool + Sync) -> Vec<bool> {
        self.surfels.par_iter().map(|s| holds(s.p_w)).collect()
    }

    /// Returns whether a surfel lies beside a wall or another upright static surface.
    pub(crate) fn touches_wall(&self, i: usize) -> bool {
        self.graph.of(i).any(|j| self.is_static[j] && self.surfels[j].n_w.z < planes::ROUGHLY_ALIGNED)
    }

    /// Returns a label map for every frame; the label is the cluster's index plus 1.
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
        project::label_frames(sequence, &self.surfels, &labels_of, config, cancel)
    }
}

impl Segmenter for GeometryMasks {
    fn segment(&self, sequence: &Sequence, context: StageContext<'_>) -> Result<Labels, MasksError> {
        let StageContext { progress, cancel, warnings, .. } = context;
        progress.begin("masks from geometry", CLUSTER_STEPS);
        let clustered = Clustered::new(sequence, &self.config, progress, cancel)?;
        let maps = clustered.maps(sequence, &self.config, cancel)?;
        let count = clustered.clusters.len();
        for long in &clustered.oversize_m {
            warnings.add(
                STAGE,
                "oversize",
                format!(
                    "a free-standing surface {long:.2} m long was taken for static, with all attached to it"
                ),
                format!(
                    "if it can move, raise the limit: `--set masks.max_structure_m={:.1}`",
                    1.1 * long + 0.05
                ),
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
        progress.end(&counted(count, "object", "objects"));
        Ok(Labels { maps, objects: (1..=count).map(object).collect(), source: MaskSource::Geometry })
    }
}

#[cfg(test)]
mod tests;
