//! The schedule's reports: to progress and observer while it runs, and its result with the agreement of all views.

use super::{ScanResult, Schedule};
use crate::scan::ScanError;
use crate::scan::evaluate::{Confusion, ViewScore, add_metrics, score_view};
use crate::scan::observer::{BatchDone, SlotDone};
use crate::scan::ply::write_ply;
use crate::{GaussianModel, RenderedMaps};
use rayon::prelude::*;
use sms_core::metrics::Metrics;
use sms_core::{BACKGROUND, Status, atomic};
use sms_frames::Frame;
use std::path::Path;
use std::time::Instant;

/// Greatest number of rendered views scored together.
const VIEWS_AT_ONCE: usize = 16;

/// A finished slot that has not been reported.
pub(super) struct UnreportedSlot<'a> {
    slot: usize,
    /// Steps since the start of the scan.
    step: u64,
    frame: &'a Frame,
    rendered: RenderedMaps,
}

impl UnreportedSlot<'_> {
    pub(super) fn score(&self) -> ViewScore {
        score_view(self.frame, &self.rendered, false)
    }
}

impl Schedule<'_> {
    /// Reports the last batch to progress and observer.
    pub(super) fn report_batch(&mut self) {
        let (slot, frames, step) = (self.place.slot, self.trained.len(), self.place.step);
        let Some(&sample) = self.place.losses.last() else { return };
        let steps = self.pace.steps(slot);
        let seconds_left = self.pace.seconds_left(slot, step);
        self.observer.batch(&BatchDone { sample, slot, frames, step, steps, seconds_left });

        let (loss, count) = (sample.loss, sample.gaussians);
        let place =
            if slot < frames { format!("frame {}/{frames}", slot + 1) } else { "all frames".to_owned() };
        let psnr = self.last_psnr_db.map(|p| format!(", {p:.1} dB")).unwrap_or_default();
        let message = format!(
            "{place}, step {step}/{steps}, colour {:.4}, depth {:.2} mm, labels {:.3}, loss {:.4}{psnr}, \
             {count} Gaussians",
            loss.color_l1,
            1e3 * loss.depth,
            loss.segmentation,
            loss.total
        );
        let number = |v: f32| f64::from(v);
        let mut values = vec![
            ("frame", (slot + 1).min(frames) as f64),
            ("frames", frames as f64),
            ("refining", f64::from(u8::from(slot == frames))),
            ("step", step as f64),
            ("steps", steps as f64),
            ("color_l1", number(loss.color_l1)),
            ("depth_m", number(loss.depth)),
            ("segmentation", number(loss.segmentation)),
            ("loss", number(loss.total)),
            ("gaussians", count as f64),
        ];
        values.extend(self.last_psnr_db.map(|p| ("psnr_db", p)));
        let done = self.pace.done(slot, step);
        self.progress.status(&Status { done, message: &message, seconds_left, values: &values });
    }

    /// Renders the finished slot (after the refinement its last frame) for its report, before anything changes.
    pub(super) fn render_slot(&mut self) {
        let (slot, frames) = (self.place.slot, self.trained.len());
        let frame = &self.sequence.frames[self.trained[slot.min(frames - 1)]];
        let began = Instant::now();
        let rendered = self.trainer.render(&frame.camera);
        self.pace.rendered(began.elapsed().as_secs_f64());
        self.stages.add("rendering", began);
        self.unreported = Some(UnreportedSlot { slot, step: self.place.total_steps, frame, rendered });
    }

    /// Reports the finished slot, once.
    pub(super) fn report_slot(&mut self) {
        let Some(unreported) = self.unreported.take() else { return };
        let began = Instant::now();
        let score = unreported.score();
        self.stages.add("scoring", began);
        self.tell(unreported, score);
    }

    pub(super) fn tell(&mut self, unreported: UnreportedSlot<'_>, score: ViewScore) {
        self.last_psnr_db = Some(score.psnr_db);
        let (trainer, measured) = (&*self.trainer, self.place.measured);
        self.observer.slot(&SlotDone {
            slot: unreported.slot,
            frames: self.trained.len(),
            step: unreported.step,
            frame: unreported.frame,
            rendered: &unreported.rendered,
            score,
            model: &|| {
                let mut model = trainer.model();
                mark_unmeasured(&mut model, measured);
                model
            },
        });
        self.trainer.recycle(unreported.rendered);
    }

    /// Measures the result and writes it.
    pub(super) fn finish(mut self, work_dir: &Path) -> Result<ScanResult, ScanError> {
        let trained = self.trained.clone();
        let held_out = self.sequence.held_out(self.config.holdout);
        let (mut train_views, train_miou) = self.measure(&trained, false)?;
        let (held_out_views, held_out_miou) = self.measure(&held_out, true)?;
        let mut metrics = Metrics::new();
        metrics
            .set("scan.frames", trained.len())
            .set("scan.gaussians", self.trainer.len())
            .set("scan.steps", self.place.total_steps);
        add_metrics(&mut metrics, "train", &train_views, train_miou);
        add_metrics(&mut metrics, "holdout", &held_out_views, held_out_miou);
        train_views.extend(held_out_views);
        train_views.sort_by_key(|v| v.frame_index);

        let began = Instant::now();
        let mut model = self.trainer.model();
        self.check_device()?;
        mark_unmeasured(&mut model, self.place.measured);
        atomic::write_json(&work_dir.join("losses.json"), &self.place.losses)?;
        atomic::write_json(&work_dir.join("views.json"), &train_views)?;
        write_ply(&model, &work_dir.join("scene.ply"))?;
        self.saver.written()?;
        self.so_far.remove();
        self.stages.add("writing", began);
        self.progress.end(&format!("{} Gaussians, {} steps", model.len(), self.place.total_steps));
        Ok(ScanResult {
            model,
            metrics,
            losses: std::mem::take(&mut self.place.losses),
            views: train_views,
            seconds: self.so_far.seconds(),
            stages: std::mem::take(&mut self.stages),
        })
    }

    fn measure(
        &mut self,
        indices: &[usize],
        held_out: bool,
    ) -> Result<(Vec<ViewScore>, Option<f64>), ScanError> {
        let classes = self.labels.class_count();
        let mut confusion = Confusion::new(classes);
        let mut views = Vec::with_capacity(indices.len());
        // Scores one view per thread at a time.
        for part in indices.chunks(rayon::current_num_threads().clamp(1, VIEWS_AT_ONCE)) {
            let began = Instant::now();
            let mut shown = Vec::with_capacity(part.len());
            for &i in part {
                self.cancel.check()?;
                shown.push(self.trainer.render(&self.sequence.frames[i].camera));
            }
            self.stages.add("rendering", began);
            let began = Instant::now();
            let score = |(&i, maps): (&usize, &RenderedMaps)| {
                let mut own = Confusion::new(classes);
                own.add(&self.sequence.frames[i], maps, &self.labels.maps[i]);
                let score = score_view(&self.sequence.frames[i], maps, held_out);
                (ViewScore { frame_index: i, ..score }, own)
            };
            let scored: Vec<_> = part.par_iter().zip(&shown).map(score).collect();
            for (view, own) in scored {
                confusion.merge(&own);
                views.push(view);
            }
            shown.into_iter().for_each(|maps| self.trainer.recycle(maps));
            self.stages.add("scoring", began);
        }
        Ok((views, confusion.mean_iou()))
    }
}

/// Marks all but the first `measured` Gaussians as not on a measured surface; they are parts of no object.
fn mark_unmeasured(model: &mut GaussianModel, measured: Option<usize>) {
    let Some(measured) = measured.filter(|measured| *measured < model.len()) else { return };
    model.measured = (0..model.len()).map(|i| i < measured).collect();
    model.labels[measured..].fill(BACKGROUND);
}
