//! Recorded frames of a run for its report: photographs, and pairs with the rendered views.

use super::Run;
use crate::Error;
use crate::origin::staleness_of;
use sms_core::{InputError, Labels, RunFolder};
use sms_entities::load_entities;
use sms_frames::{ReadOptions, Sequence, evenly_spread, recorded_colors};
use sms_gaussians::{GaussianModel, render_views};
use sms_masks::load_labels;
use sms_report::{RecordedView, ViewPair};

/// Number of compared views, spread over the recording; held-out ones if there are any.
const VIEWS: usize = 3;
/// Number of photographs, spread over the recording. Twelve views of a round trip are 30° apart.
const PHOTOGRAPHS: usize = 12;
/// Longer side of the photographs, pixels: half a desktop page.
const PHOTO_SIDE: usize = 640;

/// The frames of a run with their masks.
pub(super) struct RecordedFrames {
    pub(super) sequence: Sequence,
    pub(super) labels: Labels,
}

impl RecordedFrames {
    pub(super) fn of(run: &RunFolder) -> Result<Self, Error> {
        let sequence = Sequence::load(&run.stage_dir("frames", "scan DIR --out")?)?;
        let masks_dir = run.stage_dir("masks", "scan DIR --out")?;
        let labels = load_labels(&masks_dir)?;
        if labels.maps.len() != sequence.len() {
            let what = format!("there are {} masks for {} frames", labels.maps.len(), sequence.len());
            return Err(InputError::new(what, &masks_dir, "run `sms scan` again with the same folder").into());
        }
        Ok(Self { sequence, labels })
    }

    /// Returns label and name of the objects of the masks.
    pub(super) fn names(&self) -> Vec<(u16, String)> {
        self.labels.objects.iter().map(|o| (o.id, o.name.clone())).collect()
    }

    /// Returns photographs spread over the recording, the first frame first, with the labels of the scene's bodies if there
    /// are entities of these masks.
    pub(super) fn photographs(
        &self,
        of: &Run<'_>,
        run: &RunFolder,
        holdout: usize,
    ) -> Result<Vec<RecordedView>, Error> {
        let chosen = evenly_spread(self.sequence.len(), PHOTOGRAPHS);
        let part = Sequence {
            frames: chosen.iter().map(|&i| self.sequence.frames[i].clone()).collect(),
            x_world_recording: self.sequence.x_world_recording,
            source: self.sequence.source.clone(),
        };
        let mut labels = Labels {
            maps: chosen.iter().map(|&i| self.labels.maps[i].clone()).collect(),
            objects: self.labels.objects.clone(),
            source: self.labels.source,
        };
        // The pieces that earlier entities joined may have other labels in these masks.
        let are_current = staleness_of(run, "entities").replaced.is_empty();
        if let Some(dir) = run.stage_dir("entities", "materialize").ok().filter(|_| are_current) {
            load_entities(&dir)?.relabel(&mut labels);
        }
        let read = of.context.settings.section("read", ReadOptions::default())?;
        let photos = recorded_colors(&part, &read, PHOTO_SIDE, &of.context.cancel)?;
        let frames = part.frames.into_iter().zip(labels.maps).zip(photos);
        Ok(frames
            .zip(chosen)
            .map(|(((frame, labels), photo), frame_index)| RecordedView {
                frame_index,
                held_out: Sequence::is_held_out(frame_index, holdout),
                camera: frame.camera,
                photo: photo.unwrap_or(frame.color),
                depth: frame.depth,
                labels,
            })
            .collect())
    }

    /// Returns observed and rendered frames.
    pub(super) fn views(&self, model: &GaussianModel, holdout: usize) -> Vec<ViewPair> {
        let (sequence, labels) = (&self.sequence, &self.labels);
        let mut candidates = sequence.held_out(holdout);
        if candidates.is_empty() {
            candidates = (0..sequence.len()).collect();
        }
        let count = VIEWS.min(candidates.len());
        let chosen: Vec<usize> =
            (0..count).map(|i| candidates[(2 * i + 1) * candidates.len() / (2 * count)]).collect();
        let renders = render_views(model, sequence, &chosen);
        renders
            .into_iter()
            .map(|view| {
                let frame = &sequence.frames[view.frame_index];
                ViewPair {
                    frame_index: view.frame_index,
                    held_out: Sequence::is_held_out(view.frame_index, holdout),
                    camera: frame.camera,
                    observed_color: frame.color.clone(),
                    observed_depth: frame.depth.clone(),
                    observed_label: labels.maps[view.frame_index].clone(),
                    rendered_color: view.color,
                    rendered_depth: view.depth,
                    rendered_label: view.label,
                }
            })
            .collect()
    }
}
