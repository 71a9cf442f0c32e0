//! The sequential schedule (paper, Section "Scan"): frame after frame is seeded and optimised while earlier frames
//! are replayed, then all frames are refined together.

use super::ScanError;
use super::background::background_color;
use super::checkpoint::{self, Found, Place};
use super::config::ScanConfig;
use super::consensus::correct_labels;
use super::evaluate::{Confusion, ViewScore, add_metrics, score_view};
use super::frames::{check_inputs, held_out_frames, train_frame, trained_frames};
use super::fusion::fuse;
use super::losses::{LossSample, stalled};
use super::observer::{BatchDone, ScanObserver, SlotDone};
use super::pace::Pace;
use super::ply::write_ply;
use super::pruning::{prune_floaters, prune_transparent};
use super::seeding::{AffinityCodes, seed_frame, shuffle};
use super::so_far::SoFar;
use crate::{FrameId, GaussianModel, LearningRates, Trainer, TrainerError};
use rand::RngExt;
use sms_core::metrics::Metrics;
use sms_core::{Cancel, CoreError, Hash, Hasher, Labels, Progress, Seed, Status, Warnings, atomic};
use sms_frames::{Frame, Sequence};
use std::path::Path;
use std::time::Instant;

/// The stage's name in warnings.
const STAGE: &str = "scan";

/// What a scan makes.
#[derive(Debug, Clone)]
pub struct ScanResult {
    /// The Gaussians, as written to `scene.ply`.
    pub model: GaussianModel,
    /// `scan.*` (see `docs/metrics.md`), without times and device: they are no part of the result.
    pub metrics: Metrics,
    /// The history of the losses, as written to `losses.json`.
    pub losses: Vec<LossSample>,
    /// How every frame is reproduced, in the order of the sequence.
    pub views: Vec<ViewScore>,
    /// Wall-clock seconds, those of interrupted attempts included.
    pub seconds: f64,
}

/// Runs the scan into `work_dir`: `scene.ply` with its classifier, `losses.json`, `views.json`, `checkpoint.bin`.
///
/// `trainer` is fresh: made from `config.train`, `labels.class_count()` and `seed`, without Gaussians or frames. A
/// checkpoint of the same settings, seed and data in `work_dir` is continued, and the result has the same bytes as
/// that of an undisturbed run. The held-out frames (`config.holdout`) are neither trained on nor used for seeding.
///
/// # Errors
/// [`ScanError::Input`] when sequence and labels do not fit or there is no depth; [`CoreError::Interrupted`] after a
/// checkpoint was saved when cancelled; [`CoreError::Write`] when the disk is full.
pub fn scan(
    sequence: &Sequence,
    labels: &Labels,
    config: &ScanConfig,
    seed: Seed,
    work_dir: &Path,
    trainer: &mut dyn Trainer,
    progress: &dyn Progress,
    cancel: &Cancel,
    warnings: &Warnings,
) -> Result<ScanResult, ScanError> {
    scan_observed(sequence, labels, config, seed, work_dir, trainer, &mut (), progress, cancel, warnings)
}

/// [`scan`] with somebody watching.
///
/// # Errors
/// As [`scan`].
pub fn scan_observed(
    sequence: &Sequence,
    labels: &Labels,
    config: &ScanConfig,
    seed: Seed,
    work_dir: &Path,
    trainer: &mut dyn Trainer,
    observer: &mut dyn ScanObserver,
    progress: &dyn Progress,
    cancel: &Cancel,
    warnings: &Warnings,
) -> Result<ScanResult, ScanError> {
    config.validate()?;
    check_inputs(sequence, labels, config.holdout)?;
    let trained = trained_frames(sequence, config.holdout);
    let background = background_color(&trained.iter().map(|&i| &sequence.frames[i]).collect::<Vec<_>>());
    trainer.set_background(background);
    let limits = (0..=trained.len()).map(|slot| slot_limit(config, slot, trained.len())).collect();
    let mut schedule = Schedule {
        sequence,
        labels,
        config,
        seed,
        settings: settings_hash(sequence, labels, config, seed, background),
        checkpoint: work_dir.join("checkpoint.bin"),
        codes: AffinityCodes::new(labels.class_count(), seed),
        ids: Vec::with_capacity(trained.len()),
        trained,
        place: Place::default(),
        saved: Instant::now(),
        pace: Pace::new(limits, sequence.len()),
        last_psnr_db: None,
        so_far: SoFar::new(work_dir),
        trainer,
        observer,
        progress,
        cancel,
        warnings,
    };
    schedule.resume();
    schedule.run()?;
    schedule.finish(work_dir)
}

/// Most steps of a slot; the one after the last frame is the refinement.
fn slot_limit(config: &ScanConfig, slot: usize, frames: usize) -> usize {
    match slot {
        _ if slot == frames => config.final_steps,
        0 => config.steps_first,
        _ => config.steps_frame,
    }
}

/// Hash of everything that the result depends on.
fn settings_hash(
    sequence: &Sequence,
    labels: &Labels,
    config: &ScanConfig,
    seed: Seed,
    background: [f32; 3],
) -> Hash {
    // How often checkpoints are written changes nothing.
    let config = ScanConfig { checkpoint_seconds: 0.0, ..config.clone() };
    let mut hasher = Hasher::new();
    hasher.text(&sms_core::hash_serializable(&(config, seed, labels.class_count(), background)).0);
    for (frame, map) in sequence.frames.iter().zip(&labels.maps) {
        hasher.text(&sms_core::hash_serializable(&frame.camera).0);
        hasher.bytes(frame.color.data.as_flattened());
        hasher.bytes(&frame.depth.data.iter().flat_map(|z| z.to_le_bytes()).collect::<Vec<u8>>());
        let normals = frame.normal_c.data.as_flattened();
        hasher.bytes(&normals.iter().flat_map(|n| n.to_le_bytes()).collect::<Vec<u8>>());
        hasher.bytes(&map.data.iter().flat_map(|l| l.to_le_bytes()).collect::<Vec<u8>>());
    }
    hasher.finish()
}

struct Schedule<'a> {
    sequence: &'a Sequence,
    labels: &'a Labels,
    config: &'a ScanConfig,
    seed: Seed,
    settings: Hash,
    checkpoint: std::path::PathBuf,
    /// Sequence indices of the frames trained on; a slot is a position in this list.
    trained: Vec<usize>,
    codes: AffinityCodes,
    /// The trainer's ids of the slots reached so far.
    ids: Vec<FrameId>,
    place: Place,
    saved: Instant,
    /// For the time left, not for the result.
    pace: Pace,
    /// Of the frame done last.
    last_psnr_db: Option<f64>,
    so_far: SoFar,
    trainer: &'a mut dyn Trainer,
    observer: &'a mut dyn ScanObserver,
    progress: &'a dyn Progress,
    cancel: &'a Cancel,
    warnings: &'a Warnings,
}

impl Schedule<'_> {
    fn resume(&mut self) {
        let damage = match checkpoint::load(&self.checkpoint, &self.settings) {
            Found::Nothing => return,
            Found::Damaged(reason) => reason,
            Found::Resume(place, state) => match self.trainer.restore(&state) {
                Ok(()) => {
                    self.place = place;
                    self.so_far.resume(STAGE, self.warnings);
                    self.recall_pace();
                    return;
                }
                Err(error) => error.to_string(),
            },
        };
        self.warnings.add(
            STAGE,
            "checkpoint_damaged",
            format!("{} is damaged ({damage}); the scan starts again", self.checkpoint.display()),
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
    }

    fn save(&mut self) -> Result<(), ScanError> {
        self.saved = Instant::now();
        let state = self.trainer.snapshot();
        // What a failed device returns must not take the place of a good checkpoint.
        self.check_device()?;
        self.so_far.save(self.warnings)?;
        checkpoint::save(&self.checkpoint, &self.settings, &self.place, &state)?;
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
            self.place = Place {
                slot: self.place.slot + 1,
                total_steps: self.place.total_steps,
                losses: std::mem::take(&mut self.place.losses),
                ..Place::default()
            };
            // On a GPU frames are done faster than the state is read back and written.
            let recent = self.saved.elapsed().as_secs_f64() < (0.2 * self.config.checkpoint_seconds).min(1.0);
            if !recent || self.place.slot > slots {
                self.save()?;
            }
        }
        Ok(())
    }

    /// Makes the frames up to the current slot known to the trainer.
    fn add_frames(&mut self) {
        while self.ids.len() < self.trained.len().min(self.place.slot + 1) {
            let index = self.trained[self.ids.len()];
            let frame = train_frame(&self.sequence.frames[index], &self.labels.maps[index]);
            self.ids.push(self.trainer.add_frame(frame));
        }
    }

    fn is_refinement(&self) -> bool {
        self.place.slot == self.trained.len()
    }

    /// One frame, or the refinement over all of them, from wherever the place says.
    fn slot(&mut self) -> Result<(), ScanError> {
        let limit = self.pace.limit(self.place.slot);
        let (began, mut stepping_s) = (Instant::now(), 0.0);
        self.seed_slot()?;
        let mut stop = self.config.stop;
        if self.is_refinement() {
            // Every frame is in both of the windows compared.
            stop.window = stop.window.max(self.trained.len().div_ceil(self.batch()));
        }
        while self.place.step < limit && !stalled(&self.place.batch_losses, &stop) {
            if self.cancel.is_cancelled() {
                self.save()?;
                return Err(CoreError::Interrupted.into());
            }
            if self.saved.elapsed().as_secs_f64() > self.config.checkpoint_seconds {
                self.save()?;
            }
            let before = (Instant::now(), self.place.step);
            self.batch_of_steps();
            self.check_device()?;
            let seconds = before.0.elapsed().as_secs_f64();
            stepping_s += seconds;
            self.pace.stepped(self.place.step - before.1, seconds);
            self.report_batch();
            if !self.place.pruned_midway && 2 * self.place.step >= limit {
                prune_transparent(self.trainer, self.config);
                self.place.pruned_midway = true;
            }
        }
        prune_transparent(self.trainer, self.config);
        if self.config.pruning.floaters {
            let seen = match self.trained.get(self.place.slot) {
                Some(i) => std::slice::from_ref(i),
                None => &self.trained,
            };
            let seen: Vec<&Frame> = seen.iter().map(|&i| &self.sequence.frames[i]).collect();
            let least = usize::from(self.is_refinement());
            prune_floaters(self.trainer, &seen, least, self.config);
        }
        if self.is_refinement() {
            self.fuse_all()?;
        }
        self.report_slot();
        let beside_s = began.elapsed().as_secs_f64() - stepping_s;
        self.pace.finished(self.place.slot, self.place.step, Some(beside_s));
        Ok(())
    }

    /// Brings geometry and labels in line with all frames together.
    fn fuse_all(&mut self) -> Result<(), ScanError> {
        let frames = || self.trained.iter().map(|&i| &self.sequence.frames[i]);
        if self.config.fuse_depth {
            fuse(self.trainer, &frames().collect::<Vec<_>>(), self.config)?;
        }
        if self.config.correct_labels {
            let labelled: Vec<_> = frames().zip(self.trained.iter().map(|&i| &self.labels.maps[i])).collect();
            correct_labels(self.trainer, &labelled, self.config)?;
        }
        Ok(())
    }

    /// What a slot begins with, once: new Gaussians for a frame, fused depth for the refinement.
    fn seed_slot(&mut self) -> Result<(), ScanError> {
        if std::mem::replace(&mut self.place.seeded, true) {
            return Ok(());
        }
        let Some(&index) = self.trained.get(self.place.slot) else {
            return self.fuse_all();
        };
        let frame = &self.sequence.frames[index];
        let rendered = (!self.trainer.is_empty()).then(|| self.trainer.render(&frame.camera));
        let positions_w = self.trainer.positions_w();
        let room = self.config.max_gaussians.saturating_sub(positions_w.len());
        let seed = self.seed.derive_index("seeding", self.place.slot as u64);
        let labels = (&self.labels.maps[index], &self.codes);
        let seedlings = seed_frame(frame, labels, rendered.as_ref(), &positions_w, room, self.config, seed);
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
        Ok(())
    }

    fn batch(&self) -> usize {
        self.config.batch_steps.max(1)
    }

    fn batch_of_steps(&mut self) {
        let (own, replayed) = self.batch_frames();
        self.trainer.set_rates(&self.rates());
        let stats = self.trainer.steps(&own);
        if !replayed.is_empty() {
            self.trainer.steps(&replayed);
        }
        let taken = own.len() + replayed.len();
        self.place.step += taken;
        self.place.total_steps += taken as u64;
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

    /// Learning rates of the next batch: a function of the place alone. Those of the refinement fall, so that it ends
    /// near the mean of what the views ask for rather than where the last of them pulled.
    fn rates(&self) -> LearningRates {
        let rates = &self.config.train.rates;
        if !self.is_refinement() {
            return *rates;
        }
        let done = self.place.step as f32 / self.config.final_steps.max(1) as f32;
        rates.scaled(self.config.final_decay.powf(done.min(1.0)))
    }

    /// The frames of the next batch: those whose losses are recorded, and replayed ones. A function of the seed and
    /// the place alone.
    fn batch_frames(&self) -> (Vec<FrameId>, Vec<FrameId>) {
        let (slot, step, batch) = (self.place.slot, self.place.step, self.batch());
        if self.is_refinement() {
            let n = self.ids.len();
            let frame_at = |k: usize| {
                let mut order = self.ids.clone();
                shuffle(&mut order, &mut self.seed.derive_index("epoch", (k / n) as u64).rng());
                order[k % n]
            };
            return ((step..step + batch).map(frame_at).collect(), Vec::new());
        }
        if slot == 0 {
            return (vec![self.ids[0]; batch], Vec::new());
        }
        let own = (batch as f64 * self.config.current_share).round().clamp(1.0, batch as f64) as usize;
        let mut rng = self.seed.derive_index("replay", slot as u64).derive_index("step", step as u64).rng();
        let replayed = (own..batch).map(|_| self.ids[rng.random_range(0..slot)]).collect();
        (vec![self.ids[slot]; own], replayed)
    }

    /// Tells progress and observer of the last batch.
    fn report_batch(&mut self) {
        let (slot, frames, step) = (self.place.slot, self.trained.len(), self.place.step);
        let Some(&sample) = self.place.losses.last() else { return };
        let steps = self.pace.limit(slot);
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

    /// Tells of the slot that is done; after the refinement, by the last frame.
    fn report_slot(&mut self) {
        let (slot, frames) = (self.place.slot, self.trained.len());
        let frame = &self.sequence.frames[self.trained[slot.min(frames - 1)]];
        let began = Instant::now();
        let rendered = self.trainer.render(&frame.camera);
        self.pace.rendered(began.elapsed().as_secs_f64());
        let score = score_view(frame, &rendered, false);
        self.last_psnr_db = Some(score.psnr_db);
        let trainer = &*self.trainer;
        self.observer.slot(&SlotDone {
            slot,
            frames,
            step: self.place.total_steps,
            frame,
            rendered: &rendered,
            score,
            model: &|| trainer.model(),
        });
    }

    /// Measures the result and writes it.
    fn finish(mut self, work_dir: &Path) -> Result<ScanResult, ScanError> {
        let trained = self.trained.clone();
        let held_out = held_out_frames(self.sequence, self.config.holdout);
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

        let model = self.trainer.model();
        self.check_device()?;
        atomic::write_json(&work_dir.join("losses.json"), &self.place.losses)?;
        atomic::write_json(&work_dir.join("views.json"), &train_views)?;
        write_ply(&model, &work_dir.join("scene.ply"))?;
        self.so_far.remove();
        self.progress.end(&format!("{} Gaussians, {} steps", model.len(), self.place.total_steps));
        Ok(ScanResult {
            model,
            metrics,
            losses: std::mem::take(&mut self.place.losses),
            views: train_views,
            seconds: self.so_far.seconds(),
        })
    }

    fn measure(
        &mut self,
        indices: &[usize],
        held_out: bool,
    ) -> Result<(Vec<ViewScore>, Option<f64>), ScanError> {
        let mut confusion = Confusion::new(self.labels.class_count());
        let mut views = Vec::with_capacity(indices.len());
        for &i in indices {
            self.cancel.check()?;
            let frame = &self.sequence.frames[i];
            let maps = self.trainer.render(&frame.camera);
            confusion.add(&maps, &self.labels.maps[i]);
            views.push(ViewScore { frame_index: i, ..score_view(frame, &maps, held_out) });
        }
        Ok((views, confusion.mean_iou()))
    }
}
