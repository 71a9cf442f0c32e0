//! A map that grows while frames arrive: each frame extends the fused surface and is trained on together with earlier ones; the surface gets
//! Gaussians each time it has grown by a share. It shows the scene so far; [`scan`](super::schedule::scan) makes the result, from all frames at once.
//! Gaussians that were trained on few frames have scales that the other frames have to undo: a scan that continues from them takes as many
//! steps as one from new ones (experiments/studies/scan/following.md).
//!
//! Nothing depends on the clock: the same frames in the same order give the same map, however fast they arrive.

use super::ScanError;
use super::appearance::{Appearance, MeanColor, add_colors};
use super::background::background_color;
use super::config::ScanConfig;
use super::evaluate::score_view;
use super::frames::train_frame;
use super::losses::LossSample;
use super::observer::{BatchDone, ScanObserver, SlotDone};
use super::seeding::disc;
use super::thinning::thin;
use crate::parameters::{POSITION, ROTATION};
use crate::{AFFINITY_DIM, FrameId, StepBatch, Trainer, TrainerError};
use glamx::{DQuat, DVec3, Quat, Vec3};
use rand::RngExt;
use sms_core::{Image, StageContext};
use sms_frames::Frame;
use sms_surface::{RunningMean, Surfel, add_measurements, grow};
use std::collections::BTreeMap;

/// Gaussians are added once the surface has grown by this share since the last time: their distances depend on the whole surface, which is
/// not to be looked at for every frame.
const GROWTH: f64 = 0.05;
/// Steps on each frame, itself and earlier ones.
const STEPS: usize = 10;

/// Number of classes of a trainer for [`GrowingScan`]: objects are not known while the map grows.
pub const GROWING_CLASSES: usize = 1;

/// A map that grows frame by frame.
pub struct GrowingScan<'a> {
    config: &'a ScanConfig,
    trainer: &'a mut dyn Trainer,
    context: StageContext<'a>,
    ids: Vec<FrameId>,
    surfels: Vec<Surfel>,
    means: Vec<RunningMean>,
    colors: Vec<MeanColor>,
    /// The element of each Gaussian, and the state that it had when the Gaussian was last moved onto it.
    discs: Vec<PlacedDisc>,
    /// Number of elements when Gaussians were last added.
    looked_at: usize,
    steps: usize,
}

/// The element that a Gaussian lies on.
#[derive(Debug, Clone, Copy)]
struct PlacedDisc {
    element: usize,
    /// Distance to its neighbours, metres.
    spacing_m: f32,
    p_w: DVec3,
    n_w: DVec3,
}

impl<'a> GrowingScan<'a> {
    /// Returns an empty map. `trainer` is fresh, with [`GROWING_CLASSES`].
    ///
    /// # Errors
    /// [`ScanError::Input`] for a setting out of its range.
    pub fn new(
        config: &'a ScanConfig,
        trainer: &'a mut dyn Trainer,
        context: StageContext<'a>,
    ) -> Result<Self, ScanError> {
        config.validate()?;
        Ok(Self {
            config,
            trainer,
            context,
            ids: Vec::new(),
            surfels: Vec::new(),
            means: Vec::new(),
            colors: Vec::new(),
            discs: Vec::new(),
            looked_at: 0,
            steps: 0,
        })
    }

    /// Returns the number of frames so far.
    pub fn frames(&self) -> usize {
        self.ids.len()
    }

    /// Returns the number of Gaussians so far.
    pub fn gaussians(&self) -> usize {
        self.trainer.len()
    }

    /// Adds a frame to the surface, places Gaussians where it has grown, and takes the steps of the frame.
    ///
    /// # Errors
    /// [`sms_core::CoreError::Interrupted`] when cancelled, [`TrainerError::Device`] when the device fails.
    pub fn add(&mut self, frame: &Frame, observer: &mut dyn ScanObserver) -> Result<(), ScanError> {
        self.context.cancel.check()?;
        let slot = self.ids.len();
        if slot == 0 {
            self.trainer.set_background(background_color(&[frame]));
        }
        let (width, height) = frame.depth.size();
        let unlabelled = Image::filled(width, height, u16::MAX);
        self.ids.push(self.trainer.add_frame(train_frame(frame, &unlabelled)));
        let surface = self.config.surface();
        let seed = self.context.seed.derive("surface").derive_index("frame", slot as u64);
        grow(&mut self.surfels, frame, slot, &surface, seed);
        self.means.resize(self.surfels.len(), RunningMean::default());
        let added = self.surfels[self.colors.len()..].iter();
        self.colors.extend(added.map(|surfel| MeanColor::of(frame.color.data[surfel.seed.pixel])));
        add_measurements(&mut self.surfels, &mut self.means, frame, &surface);
        add_colors(&self.surfels, &mut self.colors, (frame, &unlabelled), self.config);
        self.check_device()?;
        self.follow_surface()?;
        if self.surfels.len() as f64 > (1.0 + GROWTH) * self.looked_at as f64 {
            self.place();
        }
        self.optimise(observer)?;
        if !self.trainer.is_empty() {
            self.report(frame, observer);
        }
        self.check_device()
    }

    /// Moves and turns the Gaussians as their elements have moved and turned.
    fn follow_surface(&mut self) -> Result<(), ScanError> {
        if self.discs.is_empty() {
            return Ok(());
        }
        let (discs, surfels) = (&mut self.discs, &self.surfels);
        self.trainer.edit(&mut |parameters| {
            for (row, disc) in parameters.rows.iter_mut().zip(discs.iter_mut()) {
                let element = &surfels[disc.element];
                let turn = DQuat::from_rotation_arc(disc.n_w, element.n_w);
                let p_w = Vec3::from_slice(&row.0[POSITION..]).as_dvec3();
                let moved_w = element.p_w + turn * (p_w - disc.p_w);
                let rotation_wg = (turn.as_quat() * Quat::from_slice(&row.0[ROTATION..])).normalize();
                row.0[POSITION..POSITION + 3].copy_from_slice(&moved_w.as_vec3().to_array());
                row.0[ROTATION..ROTATION + 4].copy_from_slice(&rotation_wg.to_array());
                (disc.p_w, disc.n_w) = (element.p_w, element.n_w);
            }
        })?;
        Ok(())
    }

    /// Adds Gaussians on the elements that none of the present ones draws.
    fn place(&mut self) {
        let seen: Vec<Appearance> = self.colors.iter().map(MeanColor::appearance).collect();
        let taken: BTreeMap<usize, f32> = self.discs.iter().map(|d| (d.element, d.spacing_m)).collect();
        let seed = self.context.seed.derive_index("growth", self.ids.len() as u64);
        let sparse = thin(&self.surfels, &seen, &taken, &self.config.seeding, seed);
        let mut seedlings = Vec::new();
        for element in sparse.iter().filter(|e| !taken.contains_key(&e.index)) {
            let surfel = &self.surfels[element.index];
            if !(surfel.p_w.is_finite() && surfel.n_w.is_finite()) {
                // The trainer would leave it out, and the rows after it would be taken for others.
                continue;
            }
            let color = seen[element.index].color;
            seedlings.push(disc(surfel, element.spacing_m, color, [0.0; AFFINITY_DIM], self.config));
            self.discs.push(PlacedDisc {
                element: element.index,
                spacing_m: element.spacing_m as f32,
                p_w: surfel.p_w,
                n_w: surfel.n_w,
            });
        }
        self.trainer.insert(&seedlings);
        self.looked_at = self.surfels.len();
    }

    /// Takes the steps of the newest frame: a share on itself, the others on earlier ones.
    fn optimise(&mut self, observer: &mut dyn ScanObserver) -> Result<(), ScanError> {
        let (config, slot) = (self.config, self.ids.len() - 1);
        let batch = config.batch_steps.max(1);
        if self.trainer.is_empty() {
            return Ok(());
        }
        let mut rng = self.context.seed.derive_index("replay", slot as u64).rng();
        for step in (0..STEPS).step_by(batch) {
            self.context.cancel.check()?;
            let count = batch.min(STEPS - step);
            let own = match slot {
                0 => count,
                _ => (count as f64 * config.current_share).round().clamp(1.0, count as f64) as usize,
            };
            let batch = StepBatch {
                rates: config.fused.rates,
                own: vec![self.ids[slot]; own],
                replayed: (own..count).map(|_| self.ids[rng.random_range(0..slot)]).collect(),
            };
            let (stats, _) = self.trainer.batches(&[batch], &|| None);
            self.check_device()?;
            self.steps += count;
            let Some(stats) = stats.first().filter(|stats| stats.loss.total.is_finite()) else { continue };
            let sample = LossSample {
                step: self.steps as u64,
                frame: Some(slot),
                loss: stats.loss,
                gaussians: self.trainer.len(),
            };
            let frames = slot + 1;
            let step = step + count;
            observer.batch(&BatchDone { sample, slot, frames, step, steps: STEPS, seconds_left: None });
        }
        Ok(())
    }

    /// Shows the newest frame to the observer.
    fn report(&mut self, frame: &Frame, observer: &mut dyn ScanObserver) {
        let rendered = self.trainer.render(&frame.camera);
        let score = score_view(frame, &rendered, false);
        let trainer = &*self.trainer;
        observer.slot(&SlotDone {
            slot: self.ids.len() - 1,
            frames: self.ids.len(),
            step: self.steps as u64,
            frame,
            rendered: &rendered,
            score,
            model: &|| trainer.model(),
        });
        self.trainer.recycle(rendered);
    }

    fn check_device(&self) -> Result<(), ScanError> {
        self.trainer.failure().map_or(Ok(()), |reason| Err(TrainerError::Device(reason).into()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::fixture::{BALL, BOX, Recorded, SMALL, record, signed_distance_m};
    use crate::{CpuTrainer, GaussianModel};
    use sms_core::{Cancel, CoreError, Seed, Warnings};
    use sms_frames::Sequence;

    const SEED: Seed = Seed(5);

    fn quick() -> ScanConfig {
        let mut config = ScanConfig::default();
        config.seeding.spacing_px = 4.0;
        config
    }

    /// Scores of the frames as they were added, and the model.
    #[derive(Default)]
    struct Seen {
        psnr_db: Vec<f64>,
        depth_mae_m: Vec<f64>,
        steps: Vec<u64>,
        model: GaussianModel,
    }

    impl ScanObserver for Seen {
        fn slot(&mut self, slot: &SlotDone<'_>) {
            self.psnr_db.push(slot.score.psnr_db);
            self.depth_mae_m.push(slot.score.depth_mae_m);
            self.steps.push(slot.step);
            self.model = (slot.model)();
        }
    }

    fn grown(sequence: &Sequence) -> Seen {
        let (config, mut seen) = (quick(), Seen::default());
        let (cancel, warnings) = (Cancel::new(), Warnings::new());
        let context = StageContext::quiet(&cancel, &warnings).with_seed(SEED);
        let mut trainer = CpuTrainer::new(&config.train, GROWING_CLASSES, SEED);
        let mut growing = GrowingScan::new(&config, &mut trainer, context).unwrap();
        for frame in &sequence.frames {
            growing.add(frame, &mut seen).unwrap();
        }
        assert_eq!((growing.frames(), growing.gaussians()), (sequence.len(), seen.model.len()));
        assert!(warnings.snapshot().is_empty());
        seen
    }

    #[test]
    fn a_map_shows_every_frame_and_lies_on_the_true_surface() {
        let (sequence, _) = record(Recorded { frames: 12, ..SMALL });
        let seen = grown(&sequence);
        assert_eq!(seen.steps, (1..=12).map(|frame| frame * STEPS as u64).collect::<Vec<_>>());
        assert!(seen.psnr_db[1..].iter().all(|psnr_db| *psnr_db > 20.0), "{:?}", seen.psnr_db);
        assert!(seen.depth_mae_m.iter().all(|error_m| *error_m < 0.003), "{:?}", seen.depth_mae_m);
        let distance_m = |p: &Vec3| {
            [0, BALL, BOX].map(|l| signed_distance_m(l, *p).abs()).into_iter().fold(f64::MAX, f64::min)
        };
        let squares: f64 = seen.model.positions_w.iter().map(|p| distance_m(p).powi(2)).sum();
        let error_m = (squares / seen.model.len() as f64).sqrt();
        assert!(error_m < 0.001, "{error_m}");
    }

    #[test]
    fn the_same_frames_give_the_same_map() {
        let (sequence, _) = record(Recorded { frames: 4, ..SMALL });
        assert_eq!(grown(&sequence).model, grown(&sequence).model);
    }

    #[test]
    fn a_map_of_frames_without_depth_is_empty() {
        let (mut sequence, _) = record(Recorded { frames: 2, ..SMALL });
        sequence.frames.iter_mut().for_each(|frame| frame.depth.data.fill(0.0));
        let seen = grown(&sequence);
        assert!(seen.model.is_empty() && seen.steps.is_empty());
    }

    #[test]
    fn it_can_be_cancelled() {
        let (sequence, _) = record(Recorded { frames: 1, ..SMALL });
        let (config, cancel, warnings) = (quick(), Cancel::new(), Warnings::new());
        let context = StageContext::quiet(&cancel, &warnings);
        let mut trainer = CpuTrainer::new(&config.train, GROWING_CLASSES, SEED);
        let mut growing = GrowingScan::new(&config, &mut trainer, context).unwrap();
        cancel.cancel();
        let error = growing.add(&sequence.frames[0], &mut ()).unwrap_err();
        assert!(matches!(error, ScanError::Core(CoreError::Interrupted)), "{error:?}");
    }
}
