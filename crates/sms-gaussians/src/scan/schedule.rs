//! The schedules: `sequential` (paper, Section "Scan"), where frame after frame is seeded and optimised while earlier frames
//! are replayed and then all frames are refined together; and `fused`, where all frames are fused into one surface first and the
//! Gaussians on it are refined together at once.

mod reporting;

use self::reporting::UnreportedSlot;
use super::ScanError;
use super::background::background_color;
use super::checkpoint::{self, FoundCheckpoint, SchedulePosition};
use super::config::{ScanConfig, ScanOrder, StopConfig};
use super::consensus::correct_labels;
use super::evaluate::ViewScore;
use super::frames::{check_inputs, train_frame};
use super::fusion::fuse;
use super::losses::{LossSample, stalled};
use super::observer::{ScanObserver, ScanResumed};
use super::pace::Pace;
use super::phases::{Phases, view_error};
use super::placement::place;
use super::pruning::{prune_all, prune_transparent};
use super::saving::Saver;
use super::seeding::{AffinityCodes, seed_frame};
use super::settings::{SettingsHash, settings_hash};
use super::so_far::SoFar;
use super::stages::StageSeconds;
use super::unmeasured::{seed_unmeasured, uncovered};
use crate::{FrameId, GaussianModel, StepBatch, StepStats, Trainer, TrainerError};
use glamx::Vec3;
use rand::RngExt;
use rand::seq::SliceRandom;
use sms_core::metrics::Metrics;
use sms_core::{Cancel, CoreError, LabelMap, Labels, Progress, Seed, StageContext, Warnings};
use sms_frames::{Frame, Sequence};
use std::path::Path;
use std::time::Instant;

/// Approximate longest time between checks of clock and cancellation, seconds.
const TOGETHER_S: f64 = 0.1;
/// The stage's name in warnings.
const STAGE: &str = "scan";

/// Result of a scan.
#[derive(Debug, Clone)]
pub struct ScanResult {
    /// The Gaussians, as written to `scene.ply`.
    pub model: GaussianModel,
    /// `scan.*` (see `docs/book/src/reference/metrics.md`), without times and device, which are not part of the result.
    pub metrics: Metrics,
    /// The history of the losses, as written to `losses.json`.
    pub losses: Vec<LossSample>,
    /// Agreement of every frame, in the order of the sequence.
    pub views: Vec<ViewScore>,
    /// Wall-clock seconds, including interrupted attempts.
    pub seconds: f64,
    /// Their breakdown, excluding interrupted attempts.
    pub stages: StageSeconds,
}

/// Runs the scan into `work_dir`: `scene.ply` with its classifier, `losses.json`, `views.json`, `checkpoint.bin`.
///
/// `trainer` is fresh: made from `config.train`, `labels.class_count()` and `seed`, without Gaussians or frames. A
/// checkpoint of the same settings, seed and data in `work_dir` is continued, and the result has the same bytes as
/// that of an undisturbed run. The held-out frames (`config.holdout`) are neither trained on nor used for seeding.
/// `&mut ()` is no observer.
///
/// # Errors
/// [`ScanError::Input`] when sequence and labels do not fit or there is no depth; [`CoreError::Interrupted`] after a
/// checkpoint was saved when cancelled, or during the fusion of the surface, which starts again; [`CoreError::Write`]
/// when the disk is full.
pub fn scan(
    sequence: &Sequence,
    labels: &Labels,
    config: &ScanConfig,
    work_dir: &Path,
    trainer: &mut dyn Trainer,
    observer: &mut dyn ScanObserver,
    context: StageContext<'_>,
) -> Result<ScanResult, ScanError> {
    let StageContext { progress, cancel, warnings, seed } = context;
    config.validate()?;
    check_inputs(sequence, labels, config.holdout)?;
    let trained = sequence.trained(config.holdout);
    let began = Instant::now();
    let background = background_color(&trained.iter().map(|&i| &sequence.frames[i]).collect::<Vec<_>>());
    trainer.set_background(background);
    let mut stages = StageSeconds::default();
    stages.add("background", began);
    let frames = trained.len();
    let limits = (0..=frames).map(|slot| slot_limit(config, slot, frames)).collect();
    std::thread::scope(|scope| {
        let hash = scope.spawn(move || settings_hash(sequence, labels, config, seed, background));
        let mut schedule = Schedule {
            sequence,
            labels,
            config,
            seed,
            settings: SettingsHash::of(hash),
            saver: Saver::new(work_dir.join("checkpoint.bin"), config.checkpoint_seconds),
            codes: AffinityCodes::new(labels.class_count(), seed),
            ids: Vec::with_capacity(trained.len()),
            positions_w: None,
            trained,
            phases: Phases::new(&config.fused),
            place: SchedulePosition { slot: config.first_slot(frames), ..SchedulePosition::default() },
            pace: Pace::new(limits, sequence.len()),
            last_psnr_db: None,
            unreported: None,
            so_far: SoFar::new(work_dir),
            stages,
            trainer,
            observer,
            progress,
            cancel,
            warnings,
        };
        schedule.resume();
        schedule.run()?;
        schedule.finish(work_dir)
    })
}

/// Returns the greatest number of steps of a slot; the one after the last frame is the refinement.
fn slot_limit(config: &ScanConfig, slot: usize, frames: usize) -> usize {
    match slot {
        _ if slot == frames => config.last_steps(),
        _ if slot < config.first_slot(frames) => 0,
        0 => config.steps_first,
        _ => config.steps_frame,
    }
}

struct Schedule<'a> {
    sequence: &'a Sequence,
    labels: &'a Labels,
    config: &'a ScanConfig,
    seed: Seed,
    settings: SettingsHash<'a>,
    saver: Saver,
    /// Sequence indices of the frames trained on; a slot is a position in this list.
    trained: Vec<usize>,
    codes: AffinityCodes,
    /// The trainer's ids of the slots reached so far, and of the next one once this one's steps have started.
    ids: Vec<FrameId>,
    /// Cached positions of the Gaussians, until they move.
    positions_w: Option<Vec<Vec3>>,
    /// Phases of the schedule `fused`.
    phases: Phases,
    place: SchedulePosition,
    /// For the remaining time, not for the result.
    pace: Pace,
    /// PSNR of the last finished frame.
    last_psnr_db: Option<f64>,
    /// The last finished slot until it is reported.
    unreported: Option<UnreportedSlot<'a>>,
    so_far: SoFar,
    stages: StageSeconds,
    trainer: &'a mut dyn Trainer,
    observer: &'a mut dyn ScanObserver,
    progress: &'a dyn Progress,
    cancel: &'a Cancel,
    warnings: &'a Warnings,
}

impl<'a> Schedule<'a> {
    fn resume(&mut self) {
        if !self.saver.path().exists() {
            return;
        }
        let settings = self.settings.hash();
        let damage = match checkpoint::load(self.saver.path(), &settings) {
            FoundCheckpoint::Nothing => return,
            FoundCheckpoint::Damaged(reason) => reason,
            FoundCheckpoint::Resume(place, state) => match self.trainer.restore(&state) {
                Ok(()) => {
                    self.place = place;
                    self.so_far.resume(STAGE, self.warnings);
                    self.recall_pace();
                    let (slot, frames, steps) = (self.place.slot, self.trained.len(), self.place.total_steps);
                    self.observer.resumed(&ScanResumed { slot, frames, steps });
                    return;
                }
                Err(error) => error.to_string(),
            },
        };
        self.warnings.add(
            STAGE,
            "checkpoint_damaged",
            format!("{} is damaged ({damage}); the scan starts again", self.saver.path().display()),
            "",
        );
    }

    /// Steps that the finished frames took, from the history.
    fn recall_pace(&mut self) {
        for slot in 0..self.place.slot.min(self.trained.len()) {
            let frame = Some(self.trained[slot]);
            let batches = self.place.losses.iter().filter(|l| l.frame == frame).count();
            self.pace.finished(slot, batches * self.batch(), None);
        }
        self.pace.ends(self.place.slot, self.end());
    }

    fn save(&mut self) -> Result<(), ScanError> {
        let began = Instant::now();
        let state = self.trainer.snapshot();
        // The state of a failed device must not replace a good checkpoint.
        self.check_device()?;
        self.so_far.save(self.warnings)?;
        let settings = self.settings.hash();
        self.saver.save(began, settings, self.place.clone(), state)?;
        self.stages.add("saving", began);
        Ok(())
    }

    fn check_device(&self) -> Result<(), ScanError> {
        match self.trainer.failure() {
            Some(reason) => Err(TrainerError::Device(reason).into()),
            None => Ok(()),
        }
    }

    fn run(&mut self) -> Result<(), ScanError> {
        let slots = self.trained.len();
        self.progress.begin("scan", self.pace.units());
        while self.place.slot <= slots {
            self.add_frames();
            self.slot()?;
            self.place = SchedulePosition {
                slot: self.place.slot + 1,
                total_steps: self.place.total_steps,
                measured: self.place.measured,
                losses: std::mem::take(&mut self.place.losses),
                ..SchedulePosition::default()
            };
            if self.saver.due_after_frame() || self.place.slot > slots {
                self.save()?;
            }
        }
        self.report_slot();
        Ok(())
    }

    /// Adds the frames up to the current slot to the trainer.
    fn add_frames(&mut self) {
        let began = Instant::now();
        while self.ids.len() < self.trained.len().min(self.place.slot + 1) {
            let index = self.trained[self.ids.len()];
            let frame = train_frame(&self.sequence.frames[index], &self.labels.maps[index]);
            self.ids.push(self.trainer.add_frame(frame));
        }
        self.stages.add("frames", began);
    }

    fn is_refinement(&self) -> bool {
        self.place.slot == self.trained.len()
    }

    /// Processes one frame, or the refinement over all of them, from the position in the schedule.
    fn slot(&mut self) -> Result<(), ScanError> {
        let (began, mut stepping_s) = (Instant::now(), 0.0);
        self.seed_slot()?;
        let mut stop = self.config.stop;
        if self.config.schedule == ScanOrder::Fused {
            stop.enabled = false;
        } else {
            self.place.fall = Some(0);
        }
        if self.is_refinement() {
            // Every frame is in both windows of the comparison.
            stop.window = stop.window.max(self.trained.len().div_ceil(self.batch()));
        }
        while self.place.step < self.end() && !stalled(&self.place.batch_losses, &stop) {
            if self.cancel.is_cancelled() {
                self.save()?;
                self.saver.written()?;
                return Err(CoreError::Interrupted.into());
            }
            if self.saver.due() {
                self.save()?;
            }
            let before = Instant::now();
            self.certain_batches(&stop)?;
            stepping_s += before.elapsed().as_secs_f64();
            self.stages.add("steps", before);
            if self.place.fall.is_none() {
                self.look()?;
            }
            if !self.place.pruned_midway && self.place.step >= self.midway() {
                let began = Instant::now();
                self.prune_transparent();
                self.place.pruned_midway = true;
                self.stages.add("pruning", began);
            }
        }
        let pruning = Instant::now();
        let seen = match self.trained.get(self.place.slot) {
            Some(i) => std::slice::from_ref(i),
            None => &self.trained,
        };
        let seen: Vec<&Frame> = seen.iter().map(|&i| &self.sequence.frames[i]).collect();
        if self.config.schedule == ScanOrder::Fused {
            self.prune_transparent();
        } else {
            let least = usize::from(self.is_refinement());
            self.positions_w = Some(prune_all(self.trainer, &seen, least, self.config));
        }
        self.stages.add("pruning", pruning);
        if self.is_refinement() {
            self.fuse_all()?;
        }
        self.render_slot();
        let beside_s = began.elapsed().as_secs_f64() - stepping_s;
        self.pace.finished(self.place.slot, self.place.step, Some(beside_s));
        Ok(())
    }

    /// Returns the number of steps of this slot, as far as it is known.
    fn end(&self) -> usize {
        match self.place.fall {
            Some(fall) if self.config.schedule == ScanOrder::Fused => self.phases.end(fall),
            _ => self.pace.limit(self.place.slot),
        }
    }

    /// Returns the step after which transparent Gaussians are removed within this slot.
    fn midway(&self) -> usize {
        match (self.config.schedule, self.place.fall) {
            (ScanOrder::Fused, fall) => fall.unwrap_or(usize::MAX),
            (ScanOrder::Sequential, _) => self.pace.limit(self.place.slot).div_ceil(2),
        }
    }

    /// Lets the rates fall from this step on if it is time, or if the errors of the frames that are not trained on have stalled.
    fn look(&mut self) -> Result<(), ScanError> {
        let validation = self.phases.validation(self.trained.len());
        if !validation.is_empty() && self.phases.is_look(self.place.step, self.place.validation_errors.len())
        {
            let began = Instant::now();
            let mut sum = 0.0;
            for slot in &validation {
                let frame = &self.sequence.frames[self.trained[*slot]];
                let maps = self.trainer.render(&frame.camera);
                sum += view_error(frame, &maps, &self.config.train.weights);
                self.trainer.recycle(maps);
            }
            self.check_device()?;
            let error = sum / validation.len() as f32;
            // Checkpoints hold finite numbers only.
            self.place.validation_errors.push(if error.is_finite() { error } else { f32::MAX });
            self.stages.add("rendering", began);
        }
        let falls = self.phases.falls(self.place.step, &self.place.validation_errors);
        self.place.fall = falls.then_some(self.place.step);
        self.pace.ends(self.place.slot, self.end());
        Ok(())
    }

    fn prune_transparent(&mut self) {
        let keep = prune_transparent(self.trainer, self.config);
        if let Some(measured) = &mut self.place.measured {
            *measured = keep[..*measured].iter().filter(|keep| **keep).count();
        }
        self.positions_w = None;
    }

    /// Returns the frames that are trained on, with their labels.
    fn labelled(&self) -> Vec<(&'a Frame, &'a LabelMap)> {
        self.trained.iter().map(|&i| (&self.sequence.frames[i], &self.labels.maps[i])).collect()
    }

    /// Makes geometry and labels consistent with all frames.
    fn fuse_all(&mut self) -> Result<(), ScanError> {
        let began = Instant::now();
        let labelled = self.labelled();
        let frames: Vec<&Frame> = labelled.iter().map(|(frame, _)| *frame).collect();
        let config = self.config;
        self.positions_w = None;
        if config.fuse_depth || config.correct_labels {
            self.trainer.edit(&mut |parameters| {
                // With the schedule `fused`, nothing moves after colours were trained.
                if config.fuse_depth && config.schedule == ScanOrder::Sequential {
                    fuse(parameters, &frames, config);
                }
                if config.correct_labels {
                    correct_labels(parameters, &labelled, config);
                }
            })?;
        }
        self.stages.add("fusion", began);
        Ok(())
    }

    /// Fuses all frames into one surface and places Gaussians on it.
    fn place_all(&mut self) -> Result<(), ScanError> {
        let began = Instant::now();
        let labelled = self.labelled();
        let frames: Vec<&Frame> = labelled.iter().map(|(frame, _)| *frame).collect();
        let surfels =
            sms_surface::fuse(&frames, &self.config.surface(), self.seed.derive("surface"), self.cancel)?;
        self.stages.add("fusion", began);
        let began = Instant::now();
        let seed = self.seed.derive("placement");
        let seedlings = place(&surfels, &labelled, &self.codes, self.config, seed, self.cancel)?;
        self.trainer.insert(&seedlings);
        if self.config.seeding.unmeasured {
            self.place.measured = Some(seedlings.len());
            let mut open = Vec::with_capacity(frames.len());
            for frame in &frames {
                self.cancel.check()?;
                let rendered = self.trainer.render(&frame.camera);
                open.push(uncovered(frame, &rendered, self.config));
                self.trainer.recycle(rendered);
            }
            for (slot, ((frame, labels), open)) in labelled.iter().zip(&open).enumerate() {
                if open.is_empty() {
                    continue;
                }
                self.cancel.check()?;
                let rendered = self.trainer.render(&frame.camera);
                let seed = self.seed.derive_index("unmeasured", slot as u64);
                let labels = (*labels, &self.codes);
                let seedlings = seed_unmeasured((frame, open), labels, &rendered, &frames, self.config, seed);
                self.trainer.recycle(rendered);
                self.trainer.insert(&seedlings);
            }
        }
        self.stages.add("seeding", began);
        Ok(())
    }

    /// Starts a slot, once: new Gaussians for a frame, fused depth for the refinement.
    fn seed_slot(&mut self) -> Result<(), ScanError> {
        if std::mem::replace(&mut self.place.seeded, true) {
            return Ok(());
        }
        let Some(&index) = self.trained.get(self.place.slot) else {
            self.report_slot();
            return match self.config.schedule {
                ScanOrder::Fused => self.place_all().or_else(|error| {
                    self.so_far.save(self.warnings)?;
                    Err(error)
                }),
                ScanOrder::Sequential => self.fuse_all(),
            };
        };
        let frame = &self.sequence.frames[index];
        let began = Instant::now();
        let rendered = (!self.trainer.is_empty()).then(|| self.trainer.render(&frame.camera));
        self.stages.add("rendering", began);
        let began = Instant::now();
        let positions_w = self.positions_w.take().unwrap_or_else(|| self.trainer.positions_w());
        let room = self.config.max_gaussians.saturating_sub(positions_w.len());
        let seed = self.seed.derive_index("seeding", self.place.slot as u64);
        let labels = (&self.labels.maps[index], &self.codes);
        let (config, unreported) = (self.config, self.unreported.take());
        // The previous slot is scored meanwhile.
        let (seedlings, score) = rayon::join(
            || seed_frame(frame, labels, rendered.as_ref(), &positions_w, room, config, seed),
            || unreported.as_ref().map(UnreportedSlot::score),
        );
        if let (Some(unreported), Some(score)) = (unreported, score) {
            self.tell(unreported, score);
        }
        if let Some(rendered) = rendered {
            self.trainer.recycle(rendered);
        }
        if !seedlings.is_empty() && seedlings.len() == room {
            self.warnings.add(
                STAGE,
                "max_gaussians",
                format!(
                    "the limit of {} Gaussians was reached; later views lack detail",
                    self.config.max_gaussians
                ),
                "raise `max_gaussians`, or `seeding.spacing_px` for fewer and larger ones",
            );
        }
        self.trainer.insert(&seedlings);
        self.stages.add("seeding", began);
        Ok(())
    }

    fn batch(&self) -> usize {
        self.config.batch_steps.max(1)
    }

    /// Returns the number of batches that are certain regardless of their losses: up to the end of the slot, the
    /// pruning midway, the next look, or the first check for stalled losses, and no longer than a moment.
    fn certain(&self, stop: &StopConfig) -> usize {
        let until = |step: usize| step.saturating_sub(self.place.step).div_ceil(self.batch());
        let mut count = until(self.end());
        if !self.place.pruned_midway {
            count = count.min(until(self.midway()));
        }
        if self.place.fall.is_none() {
            let validates = !self.phases.validation(self.trained.len()).is_empty();
            count = count.min(until(self.phases.next_look(self.place.step, validates)));
        }
        if stop.enabled {
            count = count.min((2 * stop.window.max(1)).saturating_sub(self.place.batch_losses.len()));
        }
        let seconds = self.pace.seconds_per_step().map(|s| s * self.batch() as f64);
        let moment = TOGETHER_S.min(self.config.checkpoint_seconds);
        count.min(seconds.map_or(1.0, |s| moment / s) as usize).max(1)
    }

    /// Takes the steps of these batches. The next slot's frame is added meanwhile.
    fn certain_batches(&mut self, stop: &StopConfig) -> Result<(), ScanError> {
        let (began, count, batch) = (Instant::now(), self.certain(stop), self.batch());
        let of_batch = |i: usize| self.batch_at(self.place.step + i * batch);
        let batches: Vec<StepBatch> = (0..count).map(of_batch).collect();
        let (sequence, labels) = (self.sequence, self.labels);
        let next = self.trained.get(self.ids.len()).filter(|_| self.ids.len() == self.place.slot + 1);
        let make = || next.map(|&i| train_frame(&sequence.frames[i], &labels.maps[i]));
        let (stats, added) = self.trainer.batches(&batches, &make);
        self.ids.extend(added);
        self.positions_w = None;
        self.check_device()?;
        self.pace.stepped(count * batch, began.elapsed().as_secs_f64());
        for (batch, stats) in batches.iter().zip(stats) {
            let taken = batch.own.len() + batch.replayed.len();
            self.place.step += taken;
            self.place.total_steps += taken as u64;
            self.note(&stats);
            self.report_batch();
        }
        Ok(())
    }

    /// Records the losses of a batch.
    fn note(&mut self, stats: &StepStats) {
        if !stats.loss.total.is_finite() {
            self.warnings.add(STAGE, "loss_not_finite", "a training loss was not a finite number", "");
            return;
        }
        self.place.batch_losses.push(stats.loss.total);
        self.place.losses.push(LossSample {
            step: self.place.total_steps,
            frame: self.trained.get(self.place.slot).copied(),
            loss: stats.loss,
            gaussians: self.trainer.len(),
        });
    }

    /// Returns the batch at this step of the slot: a function of the seed and the position alone. Learning rates of
    /// the refinement fall, so that it ends near the mean of the views' optima rather than at the last one's.
    fn batch_at(&self, step: usize) -> StepBatch {
        let mut rates = self.config.train.rates;
        if self.is_refinement() {
            rates = self.config.last_rates();
            if let Some(fall) = self.place.fall {
                let done = (step - fall) as f32 / (self.end() - fall).max(1) as f32;
                rates = rates.scaled(self.config.final_decay.powf(done.min(1.0)));
            }
        }
        let (own, replayed) = self.batch_frames(step);
        StepBatch { rates, own, replayed }
    }

    /// Returns the frames of the batch at this step: those whose losses are recorded, and replayed ones.
    fn batch_frames(&self, step: usize) -> (Vec<FrameId>, Vec<FrameId>) {
        let (slot, batch) = (self.place.slot, self.batch());
        if self.is_refinement() {
            let (seed, first, left_out) = match self.place.fall {
                None => (self.seed, 0, self.phases.validation(self.ids.len())),
                Some(0) => (self.seed, 0, Vec::new()),
                Some(fall) => (self.seed.derive("falling"), fall, Vec::new()),
            };
            let slots = (0..self.ids.len()).filter(|slot| !left_out.contains(slot));
            let ids: Vec<FrameId> = slots.map(|slot| self.ids[slot]).collect();
            let frame_at = |k: usize| {
                let mut order = ids.clone();
                order.shuffle(&mut seed.derive_index("epoch", (k / ids.len()) as u64).rng());
                order[k % ids.len()]
            };
            let from = step - first;
            return ((from..from + batch).map(frame_at).collect(), Vec::new());
        }
        if slot == 0 {
            return (vec![self.ids[0]; batch], Vec::new());
        }
        let own = (batch as f64 * self.config.current_share).round().clamp(1.0, batch as f64) as usize;
        let mut rng = self.seed.derive_index("replay", slot as u64).derive_index("step", step as u64).rng();
        let replayed = (own..batch).map(|_| self.ids[rng.random_range(0..slot)]).collect();
        (vec![self.ids[slot]; own], replayed)
    }
}
