//! The CPU back end: [`CpuTrainer`].
//!
//! A step runs over fixed bands of 8×8 tiles in parallel (`engine`); the kernels are written once against sixteen lanes
//! (`lanes`) and compiled for the baseline, for AVX2 with FMA and for AVX-512. Sums are taken in a fixed order, so that
//! results do not depend on the number of threads; they do differ in rounding from form to form.

mod adam;
#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod bands;
mod blend;
mod engine;
mod lanes;
pub mod limits;
mod losses;
mod median;
mod perceptron;
mod planes;
mod portable;
mod prefetch;
mod project;
mod ssim;
mod target;
mod tile;
mod times;
mod unblend;
mod unproject;

use crate::parameters::{LOGIT_OPACITY, POSITION, Parameters, sigmoid};
use crate::{
    FrameId, GaussianModel, LearningRates, LossTerms, RenderedMaps, Seedling, StepStats, TrainConfig,
    TrainFrame, TrainState, Trainer, TrainerError,
};
use engine::Engine;
use glamx::Vec3;
use lanes::Simd;
pub use lanes::SimdForm;
use project::CameraView;
use rayon::prelude::*;
use sms_core::{Camera, Seed};
use std::time::Instant;
use target::TiledTarget;
use tile::{
    BAND_TILES, COLOR_CHANNEL, NORMAL_CHANNEL, OPACITY_CHANNEL, PATCH_ROWS, TILE, TileImage, TilePlane,
};
pub use times::StepTimes;

/// Gaussians handled at once by the optimiser.
const GAUSSIANS: usize = 256;

/// [`Trainer`] on the CPU.
///
/// A step updates only Gaussians that reach a pixel of its view. Those out of view keep their parameters, moments and
/// step counts, and add nothing to the regularisers.
///
/// ```
/// use sms_core::glamx::{DPose3, Quat, Vec3};
/// use sms_core::{Camera, Intrinsics, Seed};
/// use sms_gaussians::{AFFINITY_DIM, CpuTrainer, Seedling, TrainConfig, TrainFrame, Trainer};
///
/// let camera = Camera::new(Intrinsics::from_fov(32, 24, 1.0), DPose3::identity());
/// let mut trainer = CpuTrainer::new(&TrainConfig::default(), 2, Seed(1));
/// trainer.insert(&[Seedling {
///     position_w: Vec3::new(0.0, 0.0, 1.0),
///     rotation_wg: Quat::IDENTITY,
///     scale: Vec3::new(0.1, 0.1, 0.01),
///     opacity: 0.5,
///     color: [0.5; 3],
///     harmonics: sms_gaussians::harmonics::CONSTANT,
///     affinity: [0.1; AFFINITY_DIM],
/// }]);
/// let red = TrainFrame {
///     camera,
///     color: vec![[1.0, 0.0, 0.0]; 32 * 24],
///     depth: vec![1.0; 32 * 24],
///     normal_w: vec![[0.0, 0.0, -1.0]; 32 * 24],
///     label: vec![1; 32 * 24],
/// };
/// let frame = trainer.add_frame(red);
/// let first = trainer.steps(&[frame]).loss.total;
/// trainer.steps(&[frame; 50]);
/// assert!(trainer.steps(&[frame]).loss.total < first);
/// ```
pub struct CpuTrainer {
    config: TrainConfig,
    parameters: Parameters,
    targets: Vec<TiledTarget>,
    engine: Engine,
    times: StepTimes,
}

impl CpuTrainer {
    /// A trainer without Gaussians for `classes` classes, the background included; the classifier starts from `seed`.
    pub fn new(config: &TrainConfig, classes: usize, seed: Seed) -> Self {
        Self::with_simd(config, classes, seed, Simd::detect())
    }

    /// Like [`CpuTrainer::new`], with kernels of a given form, for comparison; `None` if this CPU cannot run it.
    pub fn with_form(config: &TrainConfig, classes: usize, seed: Seed, form: SimdForm) -> Option<Self> {
        Simd::of(form).map(|simd| Self::with_simd(config, classes, seed, simd))
    }

    fn with_simd(config: &TrainConfig, classes: usize, seed: Seed, simd: Simd) -> Self {
        let classes = classes.max(1);
        Self {
            config: *config,
            parameters: Parameters::new(classes, seed),
            targets: Vec::new(),
            engine: Engine::new(simd, classes),
            times: StepTimes::default(),
        }
    }

    /// CPU seconds spent in each part of all steps so far.
    pub fn times(&self) -> StepTimes {
        self.times
    }

    /// Returns the loss terms of a frame; the gradients remain in the engine.
    fn differentiate(&mut self, frame: FrameId) -> LossTerms {
        self.engine.differentiate(&self.parameters, &self.targets[frame], &self.config)
    }

    fn step(&mut self, frame: FrameId) -> LossTerms {
        if self.targets[frame].tiles.is_empty() {
            return LossTerms::default();
        }
        let terms = self.differentiate(frame);
        let start = Instant::now();
        let Parameters { rows, first, second, steps, classifier } = &mut self.parameters;
        let Engine { simd, gradients, seen, classifier_gradient, .. } = &self.engine;
        let (rates, off_plane) = (adam::rates_of_row(&self.config.rates), self.config.rates.off_plane);
        rows.par_chunks_mut(GAUSSIANS)
            .zip(first.par_chunks_mut(GAUSSIANS))
            .zip(second.par_chunks_mut(GAUSSIANS))
            .zip(steps.par_chunks_mut(GAUSSIANS))
            .zip(gradients.par_chunks(GAUSSIANS))
            .zip(seen.par_chunks(GAUSSIANS))
            .for_each(|(((((rows, first), second), steps), gradients), seen)| {
                let rates = (&rates, off_plane);
                adam::descend_rows(*simd, rows, first, second, steps, gradients, seen, rates);
            });
        if self.config.weights.segmentation > 0.0 && self.targets[frame].labelled > 0 {
            adam::descend_classifier(classifier, classifier_gradient, self.config.rates.classifier);
        }
        self.times.add(&self.engine.times);
        self.times.adam += start.elapsed().as_secs_f64();
        terms
    }
}

impl Trainer for CpuTrainer {
    /// # Panics
    /// If a buffer of the frame has another size than the camera's image.
    fn add_frame(&mut self, frame: TrainFrame) -> FrameId {
        self.targets.push(TiledTarget::new(&frame, self.parameters.classifier.classes));
        self.targets.len() - 1
    }

    fn len(&self) -> usize {
        self.parameters.rows.len()
    }

    fn insert(&mut self, seedlings: &[Seedling]) {
        self.parameters.insert(seedlings);
    }

    fn retain(&mut self, mask: &[bool]) {
        self.parameters.retain(mask);
    }

    /// # Panics
    /// If a frame was not added.
    fn steps(&mut self, frames: &[FrameId]) -> StepStats {
        let mut stats = StepStats::default();
        for &frame in frames {
            let terms = self.step(frame);
            stats.loss.add(&terms, 1.0 / frames.len() as f32);
            stats.steps += 1;
        }
        stats
    }

    fn render(&mut self, camera: &Camera) -> RenderedMaps {
        let view = CameraView::new(camera);
        let mut maps = RenderedMaps::default();
        maps.resize(view.width, view.height);
        if maps.color.is_empty() {
            return maps;
        }
        self.engine.blend(&self.parameters, &view, None);
        let Engine { simd, grid, tiles, bands, classifier, .. } = &mut self.engine;
        let (simd, grid) = (*simd, *grid);
        classifier.set(self.parameters.classifier.classes, &self.parameters.classifier.values);
        let weights = &*classifier;
        let mut found = vec![([0u16; TILE * TILE], TilePlane::ZERO); tiles.len()];
        bands
            .par_iter_mut()
            .zip(tiles.par_chunks(BAND_TILES * grid.columns))
            .zip(found.par_chunks_mut(BAND_TILES * grid.columns))
            .enumerate()
            .for_each(|(index, ((band, tiles), found))| {
                let first = index * BAND_TILES * grid.columns;
                for (i, (image, (labels, depths))) in tiles.iter().zip(found).enumerate() {
                    let corner = grid.corner(first + i);
                    for (p, depths) in depths.0.iter_mut().enumerate() {
                        let (list, place) = (band.lists.used(grid.patch(i, p)), grid.place(corner, p));
                        median::median_patch(simd, &band.splats, list, place, &image[p], depths);
                    }
                    perceptron::tile_labels(simd, weights, image, &mut band.perceptron, labels);
                }
            });
        for (tile, (image, (labels, depths))) in tiles.iter().zip(&mut found).enumerate() {
            let corner = grid.corner(tile);
            for y in 0..TILE.min(view.height - corner.1) {
                for x in 0..TILE.min(view.width - corner.0) {
                    let i = (corner.1 + y) * view.width + corner.0 + x;
                    read_pixel(image, (x, y), i, &mut maps);
                    maps.label[i] = labels[y * TILE + x];
                    maps.depth[i] = *depths.at_mut(x, y);
                }
            }
        }
        maps
    }

    fn set_rates(&mut self, rates: &LearningRates) {
        self.config.rates = *rates;
    }

    fn set_background(&mut self, rgb: [f32; 3]) {
        self.engine.background = rgb.map(|v| if v.is_finite() { v.clamp(0.0, 1.0) } else { 0.0 });
    }

    fn opacities(&self) -> Vec<f32> {
        self.parameters.rows.iter().map(|r| sigmoid(r.0[LOGIT_OPACITY])).collect()
    }

    fn positions_w(&self) -> Vec<Vec3> {
        self.parameters.rows.iter().map(|r| Vec3::from_slice(&r.0[POSITION..])).collect()
    }

    fn model(&self) -> GaussianModel {
        GaussianModel { background: self.engine.background, ..self.parameters.model() }
    }

    fn snapshot(&self) -> TrainState {
        self.parameters.encode()
    }

    fn restore(&mut self, state: &TrainState) -> Result<(), TrainerError> {
        self.parameters = Parameters::decode_for(self.parameters.classifier.classes, state)?;
        Ok(())
    }

    fn edit(&mut self, change: &mut dyn FnMut(&mut Parameters)) -> Result<(), TrainerError> {
        change(&mut self.parameters);
        if self.parameters.is_finite() { Ok(()) } else { Err(TrainerError::not_finite()) }
    }
}

/// Copies one pixel of a tile into the maps.
fn read_pixel(image: &TileImage, (x, y): (usize, usize), i: usize, maps: &mut RenderedMaps) {
    let patch = &image[y / PATCH_ROWS];
    let channel = |c: usize| patch.channels[c][y % PATCH_ROWS * TILE + x];
    maps.color[i] = [0, 1, 2].map(|c| channel(COLOR_CHANNEL + c));
    maps.normal_w[i] = [0, 1, 2].map(|c| channel(NORMAL_CHANNEL + c));
    maps.alpha[i] = channel(OPACITY_CHANNEL);
}

#[cfg(test)]
mod poisoned_tests;
#[cfg(test)]
mod stepping_tests;
#[cfg(test)]
mod tests;
