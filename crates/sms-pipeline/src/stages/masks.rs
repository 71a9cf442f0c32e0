//! Frames → object masks.

use crate::Error;
use sms_core::metrics::Metrics;
use sms_core::{BACKGROUND, Labels, StageContext, counted};
use sms_frames::Sequence;
use sms_masks::{Completed, GeometryConfig, Segmenter, complete};

/// Object masks of a sequence.
#[derive(Debug, Clone)]
pub struct ObjectMasks {
    /// The masks and their objects.
    pub labels: Labels,
    /// Corrections of the masks by geometry.
    pub completed: Completed,
    /// Number of pixels in all frames.
    pub pixels: usize,
}

/// Segments the frames. Then geometry corrects borders and adds missed objects, if `geometry` enables it.
///
/// # Errors
/// As [`Segmenter::segment`].
pub fn masks(
    sequence: &Sequence,
    segmenter: &dyn Segmenter,
    geometry: &GeometryConfig,
    context: StageContext<'_>,
) -> Result<ObjectMasks, Error> {
    let labels = segmenter.segment(sequence, context)?;
    let pixels = labels.maps.iter().map(|m| m.data.len()).sum();
    let (mut labels, completed) = complete(labels, sequence, geometry, context.progress, context.cancel)?;
    // Networks and files may label what is attached to the camera; it is no object.
    for (map, frame) in labels.maps.iter_mut().zip(&sequence.frames) {
        let attached = map.data.iter_mut().enumerate().filter(|(i, _)| !frame.shows_scene(*i));
        attached.for_each(|(_, label)| *label = BACKGROUND);
    }
    Ok(ObjectMasks { labels, completed, pixels })
}

impl ObjectMasks {
    /// Returns the metrics `masks.*`; `source` names the segmenter.
    pub fn metrics(&self, source: &str) -> Metrics {
        let mut metrics = Metrics::new();
        metrics.set("masks.objects", self.labels.objects.len()).set("masks.source", source);
        if let Some(moved) = self.completed.moved_pixels {
            metrics.set("masks.refined_share", moved as f64 / self.pixels.max(1) as f64);
        }
        if let Some(unknown) = self.completed.unknown {
            metrics.set("masks.unknown", unknown);
        }
        metrics
    }

    /// Returns one line with the number of objects, their source and the corrections.
    pub fn summary(&self, source: &str) -> String {
        let mut line =
            format!("masks: {} from {source}", counted(self.labels.objects.len(), "object", "objects"));
        if let Some(unknown @ 1..) = self.completed.unknown {
            line += &format!(", {unknown} of them unknown to it (masks.add_unknown)");
        }
        if let Some(moved) = self.completed.moved_pixels {
            let percent = 100.0 * moved as f64 / self.pixels.max(1) as f64;
            line += &format!(
                "; borders refined in 3-D, {percent:.2} % of the pixels changed (masks.refine_edges)"
            );
        }
        line
    }
}
