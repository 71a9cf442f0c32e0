//! Corrections for masks of every source except the truth.

use crate::refine::scaled_margin_px;
use crate::{GeometryConfig, MasksError, add_unknown, refine_edges};
use sms_core::{Cancel, Labels, MaskSource, Progress};
use sms_frames::Sequence;

/// Effects of [`complete`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Completed {
    /// Number of pixels of all frames relabelled by the refinement of edges; `None` if it is switched off.
    pub moved_pixels: Option<usize>,
    /// Number of objects added; `None` if the search is switched off.
    pub unknown: Option<usize>,
}

/// Corrects the borders of masks ([`refine_edges`], with the paper's margin at the images' width) and adds missed
/// objects ([`add_unknown`]), as configured.
///
/// The truth remains unchanged, and masks from geometry gain no objects.
///
/// # Errors
/// As [`refine_edges`] and [`add_unknown`].
pub fn complete(
    mut labels: Labels,
    sequence: &Sequence,
    config: &GeometryConfig,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<(Labels, Completed), MasksError> {
    let mut done = Completed::default();
    let Some(first) = sequence.frames.first() else { return Ok((labels, done)) };
    if labels.source == MaskSource::Truth {
        return Ok((labels, done));
    }
    if config.refine_edges {
        cancel.check()?;
        let refined = refine_edges(&labels, sequence, scaled_margin_px(first.depth.width))?;
        let pairs = labels.maps.iter().zip(&refined.maps);
        let moved = pairs.map(|(a, b)| a.data.iter().zip(&b.data).filter(|(a, b)| a != b).count()).sum();
        done.moved_pixels = Some(moved);
        labels = refined;
    }
    if config.add_unknown && labels.source != MaskSource::Geometry {
        let given = labels.objects.len();
        labels = add_unknown(&labels, sequence, config, progress, cancel)?;
        done.unknown = Some(labels.objects.len() - given);
    }
    Ok((labels, done))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{Sensor, scene, table_scene};
    use sms_core::{BACKGROUND, LabelInfo, NoProgress};

    #[test]
    fn corrections_depend_on_source_and_settings() {
        let (sequence, truth) = scene(&table_scene(), Sensor { frames: 8, ..Sensor::default() }, 3);
        let maps = truth.iter().map(|map| {
            let mut map = map.clone();
            map.data.iter_mut().filter(|v| **v == 3).for_each(|v| *v = BACKGROUND);
            map
        });
        let info = |id| LabelInfo { id, name: format!("unknown_{id:02}"), description: String::new() };
        let given = Labels {
            maps: maps.collect(),
            objects: [1, 2, 4, 5].map(info).to_vec(),
            source: MaskSource::Files,
        };
        let run = |source, config: &GeometryConfig| {
            let labels = Labels { source, ..given.clone() };
            complete(labels, &sequence, config, &NoProgress, &Cancel::new()).unwrap()
        };
        let on = GeometryConfig::default();
        for source in [MaskSource::Files, MaskSource::Foundation] {
            let (labels, done) = run(source, &on);
            assert_eq!(done.unknown, Some(1));
            assert!(done.moved_pixels.is_some_and(|n| n > 0));
            // A name that the user already gave is not used again.
            assert_eq!(labels.objects[4].name, "unknown_01_2");
        }
        let (labels, done) = run(MaskSource::Geometry, &on);
        assert_eq!((labels.objects.len(), done.unknown), (4, None));
        assert!(done.moved_pixels.is_some());
        assert_eq!(
            run(MaskSource::Truth, &on),
            (Labels { source: MaskSource::Truth, ..given.clone() }, Completed::default())
        );
        let off = GeometryConfig { refine_edges: false, add_unknown: false, ..on };
        assert_eq!(run(MaskSource::Files, &off), (given.clone(), Completed::default()));
    }
}
