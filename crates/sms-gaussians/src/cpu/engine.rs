//! The passes of a step over all bands: project, bin, blend, SSIM, losses, gradients.

use super::bands::{Band, BandSums, Slots, Span, bin_band};
use super::blend::blend_patch;
use super::lanes::Simd;
use super::losses::{BandGradient, PixelWeights, tile_losses, tile_rows};
use super::perceptron::{PaddedClassifier, PatchSample, tile_cross_entropy};
use super::planes::{PaddedPlanes, RowLayout};
use super::prefetch::prefetch;
use super::project::{CameraView, Projected, project_rows};
use super::ssim::{DERIVATIVES, ssim_band, ssim_gradient_band};
use super::target::{TileGrid, TiledTarget};
use super::tile::{BAND_ROWS, BAND_TILES, PATCHES, PatchImage, SplatGradient, TILE, TileImage};
use super::times::StepTimes;
use super::unblend::unblend_patch;
use super::unproject::{GradientInputs, RegularizerSums, unproject_rows};
use crate::parameters::{Parameters, Row};
use crate::{LossTerms, LossWeights, TrainConfig};
use rayon::prelude::*;
use std::time::Instant;

/// Gaussians handled at once in the passes over Gaussians. A constant, because it shapes the order of sums.
const GAUSSIANS: usize = 256;

/// Buffers of a step, with the results of the last one.
#[derive(Default)]
pub(super) struct Engine {
    pub(super) simd: Simd,
    pub(super) grid: TileGrid,
    /// Colour behind all Gaussians.
    pub(super) background: [f32; 3],
    pub(super) bands: Vec<Band>,
    pub(super) tiles: Vec<TileImage>,
    /// ∂L/∂parameters of the last step, zero for invisible Gaussians.
    pub(super) gradients: Vec<Row>,
    /// Gaussians that reached a pixel in the last step.
    pub(super) seen: Vec<bool>,
    /// ∂L/∂classifier of the last step, flat.
    pub(super) classifier_gradient: Vec<f32>,
    pub(super) classifier: PaddedClassifier,
    pub(super) times: StepTimes,
    classes: usize,
    projected: Vec<Projected>,
    slots: Slots,
    /// Rendered colours row by row.
    rendered: PaddedPlanes,
    derivatives: PaddedPlanes,
    regularizers: Vec<RegularizerSums>,
}

/// Output of blending beside the image.
#[derive(Clone, Copy)]
pub(super) struct Observed<'a> {
    target: &'a TiledTarget,
    /// Patches whose affinities are blended.
    sample: Option<PatchSample>,
}

impl Engine {
    pub(super) fn new(simd: Simd, classes: usize) -> Self {
        Self { simd, classes, ..Self::default() }
    }

    fn resize(&mut self, grid: TileGrid) {
        self.grid = grid;
        self.tiles.resize(grid.len(), [PatchImage::EMPTY; PATCHES]);
        let classes = self.classes;
        self.bands.resize_with(grid.rows.div_ceil(BAND_TILES), || Band::new(classes));
        let (columns, rows) = (grid.columns * TILE, grid.rows * TILE);
        self.rendered.resize(3, columns, rows);
        self.derivatives.resize(3 * DERIVATIVES, columns, rows);
    }

    /// Blends all tiles of a view; with a target also fills the planes that SSIM reads.
    pub(super) fn blend(
        &mut self,
        parameters: &Parameters,
        view: &CameraView,
        observed: Option<Observed<'_>>,
    ) {
        self.resize(TileGrid::new(view.width, view.height));
        let start = Instant::now();
        let (simd, bands) = (self.simd, self.bands.len());
        self.projected.resize(parameters.rows.len(), Projected::UNSEEN);
        self.slots.spans.resize(parameters.rows.len(), Span::default());
        let projected = self.projected.par_chunks_mut(GAUSSIANS);
        let rows = parameters.rows.par_chunks(GAUSSIANS);
        rows.zip(projected)
            .zip(self.slots.spans.par_chunks_mut(GAUSSIANS))
            .for_each(|((rows, projected), spans)| project_rows(simd, rows, view, bands, projected, spans));
        self.slots.assign(bands);
        self.times.project += start.elapsed().as_secs_f64();

        let Self { grid, background, projected, slots, rendered, .. } = self;
        let (grid, background) = (*grid, *background);
        let (layout, inside, length) = rendered.inside_mut(BAND_ROWS);
        self.bands
            .par_iter_mut()
            .zip(self.tiles.par_chunks_mut(BAND_TILES * grid.columns))
            .zip(inside.par_chunks_mut(length))
            .enumerate()
            .for_each(|(index, ((band, tiles), rendered))| {
                let start = Instant::now();
                band.times = StepTimes::default();
                band.sums = BandSums::default();
                bin_band(
                    simd,
                    band,
                    slots.members(index),
                    projected,
                    &parameters.rows,
                    view,
                    &grid,
                    index * BAND_ROWS,
                );
                let binned = Instant::now();
                band.times.bin = (binned - start).as_secs_f64();
                let first = index * BAND_TILES * grid.columns;
                for (i, image) in tiles.iter_mut().enumerate() {
                    let affinity = match observed {
                        Some(Observed { sample, .. }) => sample.map_or(0, |s| s.patches(first + i)),
                        None => PatchSample::ALL.patches(first + i),
                    };
                    let corner = grid.corner(first + i);
                    for (p, image) in image.iter_mut().enumerate() {
                        let place = grid.place(corner, p);
                        let (list, used) = band.lists.candidates(grid.patch(i, p));
                        let affinity = affinity >> p & 1 != 0;
                        let reached = &mut band.reached;
                        *used = blend_patch(
                            simd,
                            &band.splats,
                            list,
                            place,
                            background,
                            affinity,
                            image,
                            reached,
                        ) as u32;
                    }
                }
                let blended = Instant::now();
                band.times.blend = (blended - binned).as_secs_f64();
                if let Some(Observed { target, .. }) = observed {
                    let observed = &target.tiles[first..first + tiles.len()];
                    let rows = tiles.chunks(grid.columns).zip(observed.chunks(grid.columns));
                    for (row, (images, observed)) in rows.enumerate() {
                        tile_rows(simd, images, observed, (layout, &mut *rendered, row * TILE));
                    }
                    band.times.ssim = blended.elapsed().as_secs_f64();
                }
            });
    }

    /// Loss and gradients for one observed view.
    pub(super) fn differentiate(
        &mut self,
        parameters: &Parameters,
        target: &TiledTarget,
        config: &TrainConfig,
    ) -> LossTerms {
        self.times = StepTimes::default();
        let segmented = config.weights.segmentation > 0.0 && target.labelled > 0;
        let sample =
            segmented.then(|| PatchSample::new(config.segmentation_share, parameters.classifier.steps));
        self.blend(parameters, &target.view, Some(Observed { target, sample }));
        self.similarities(target, &config.weights);
        self.pixels(parameters, target, config, sample);
        let flats = self.gaussians(parameters, &target.view, config);
        for band in &self.bands {
            self.times.add(&band.times);
        }
        self.terms(target, &config.weights, sample, flats)
    }

    /// SSIM and its derivatives with respect to the window's moments.
    fn similarities(&mut self, target: &TiledTarget, weights: &LossWeights) {
        let Self { simd, rendered, derivatives, .. } = self;
        let (simd, rendered) = (*simd, &*rendered);
        let size = (target.grid.width, target.grid.height);
        // 1 − SSIM falls as SSIM rises.
        let scale = -weights.color * weights.ssim / (3 * size.0 * size.1).max(1) as f32;
        let (layout, inside, length) = derivatives.inside_mut(BAND_ROWS);
        self.bands.par_iter_mut().zip(inside.par_chunks_mut(length)).enumerate().for_each(
            |(index, (band, rows))| {
                let start = Instant::now();
                let (first, scratch) = (index * BAND_ROWS, &mut band.ssim);
                band.sums.ssim =
                    ssim_band(simd, rendered, &target.color, first, size, scale, layout, rows, scratch);
                band.times.ssim += start.elapsed().as_secs_f64();
            },
        );
    }

    /// The losses of all pixels and the gradients of all splats.
    fn pixels(
        &mut self,
        parameters: &Parameters,
        target: &TiledTarget,
        config: &TrainConfig,
        sample: Option<PatchSample>,
    ) {
        let Self { simd, grid, rendered, derivatives, tiles, classifier, .. } = self;
        let (simd, grid, rendered, derivatives) = (*simd, *grid, &*rendered, &*derivatives);
        classifier.set(self.classes, &parameters.classifier.values);
        let classifier = &*classifier;
        let share = |weight: f32, pixels: usize| weight / pixels.max(1) as f32;
        let weights = &config.weights;
        let pixel_weights = PixelWeights {
            color: share(weights.color * (1.0 - weights.ssim), 3 * target.colored),
            depth: share(weights.depth, target.deep),
            normal: share(weights.normal, target.oriented),
            depth_term: config.depth_term,
        };
        let label_weight =
            share(weights.segmentation, target.labelled) / sample.map_or(1.0, PatchSample::share);
        let size = (grid.width, grid.height);
        let layout = RowLayout::new(3, grid.columns * TILE);
        self.bands.par_iter_mut().zip(tiles.par_chunks(BAND_TILES * grid.columns)).enumerate().for_each(
            |(index, (band, tiles))| {
                let mut last = Instant::now();
                let mut lap = || {
                    let now = Instant::now();
                    let seconds = (now - last).as_secs_f64();
                    last = now;
                    seconds
                };
                let Band { color_gradient, tile_gradient, gradients, perceptron, ssim, sums, times, .. } =
                    band;
                let first_row = index * BAND_ROWS;
                color_gradient.resize(layout.row_len() * BAND_ROWS);
                ssim_gradient_band(
                    simd,
                    rendered,
                    &target.color,
                    derivatives,
                    first_row,
                    size,
                    layout,
                    color_gradient.get_mut(),
                    ssim,
                );
                times.ssim += lap();
                gradients.clear();
                gradients.resize(band.splats.len(), SplatGradient::ZERO);
                perceptron.clear();
                let first = index * BAND_TILES * grid.columns;
                for (i, image) in tiles.iter().enumerate() {
                    let observed = &target.tiles[first + i];
                    let corner = grid.corner(first + i);
                    let ssim = BandGradient { layout, rows: color_gradient.get(), first: first_row };
                    tile_losses(
                        simd,
                        image,
                        observed,
                        &target.color,
                        corner,
                        pixel_weights,
                        ssim,
                        tile_gradient,
                        sums,
                    );
                    times.pixels += lap();
                    if i + 1 < tiles.len() {
                        prefetch(&target.tiles[first + i + 1]);
                    }
                    let affinity = sample.map_or(0, |sample| sample.patches(first + i));
                    if affinity != 0 {
                        sums.segmentation += tile_cross_entropy(
                            simd,
                            classifier,
                            image,
                            &observed.label,
                            affinity,
                            label_weight,
                            perceptron,
                            tile_gradient,
                        );
                        times.segmentation += lap();
                    }
                    for p in 0..PATCHES {
                        // Prefetch for the next tile.
                        if let Some(next) = tiles.get(i + 1) {
                            prefetch(&next[p]);
                        }
                        let list = band.lists.used(grid.patch(i, p));
                        unblend_patch(
                            simd,
                            &band.splats,
                            list,
                            grid.place(corner, p),
                            affinity >> p & 1 != 0,
                            &image[p],
                            &tile_gradient[p],
                            gradients,
                        );
                    }
                    times.unblend += lap();
                }
            },
        );
        self.classifier_gradient.clear();
        self.classifier_gradient.resize(parameters.classifier.values.len(), 0.0);
        for band in &self.bands {
            band.perceptron.add_gradient(self.classes, &mut self.classifier_gradient);
        }
    }

    /// Gradients of all Gaussians, regularisers included; returns the isotropic and the flatness term.
    fn gaussians(&mut self, parameters: &Parameters, view: &CameraView, config: &TrainConfig) -> [f64; 2] {
        let start = Instant::now();
        let count = parameters.rows.len();
        self.gradients.resize(count, Row::ZERO);
        self.seen.resize(count, false);
        self.regularizers.resize(count.div_ceil(GAUSSIANS), [0.0; 2]);
        let (simd, bands, slots) = (self.simd, &self.bands[..], &self.slots);
        let in_view: usize = self
            .seen
            .par_chunks_mut(GAUSSIANS)
            .enumerate()
            .map(|(chunk, seen)| {
                for (i, seen) in seen.iter_mut().enumerate() {
                    let mut splats = slots.of(chunk * GAUSSIANS + i);
                    *seen = splats.any(|(band, position)| bands[band].reached[position]);
                }
                seen.iter().filter(|s| **s).count()
            })
            .sum();
        let shared = GradientInputs { bands, slots, view, config, share: 1.0 / in_view.max(1) as f32 };
        self.gradients
            .par_chunks_mut(GAUSSIANS)
            .zip(parameters.rows.par_chunks(GAUSSIANS))
            .zip(self.seen.par_chunks(GAUSSIANS))
            .zip(self.regularizers.par_iter_mut())
            .enumerate()
            .for_each(|(chunk, (((gradients, rows), seen), sums))| {
                *sums = unproject_rows(simd, shared, chunk * GAUSSIANS, rows, seen, gradients);
            });
        let [mut isotropic, mut flat] = [0.0; 2];
        for sums in &self.regularizers {
            isotropic += sums[0];
            flat += sums[1];
        }
        self.times.unproject += start.elapsed().as_secs_f64();
        [isotropic, flat].map(|sum| sum / in_view.max(1) as f64)
    }

    fn terms(
        &self,
        target: &TiledTarget,
        weights: &LossWeights,
        sample: Option<PatchSample>,
        [isotropic, flat]: [f64; 2],
    ) -> LossTerms {
        // Without pixels, the mean is zero.
        let mean = |of_band: fn(&BandSums) -> f64, pixels: usize| {
            let sum: f64 = self.bands.iter().map(|band| of_band(&band.sums)).sum();
            if pixels > 0 { (sum / pixels as f64) as f32 } else { 0.0 }
        };
        let pixels = 3 * target.grid.width * target.grid.height;
        LossTerms {
            color_l1: mean(|s| s.color, 3 * target.colored),
            dssim: if pixels > 0 { 1.0 - mean(|s| s.ssim, pixels) } else { 0.0 },
            isotropic: isotropic as f32,
            depth: mean(|s| s.depth, target.deep),
            normal: mean(|s| s.normal, target.oriented),
            flat: flat as f32,
            segmentation: mean(|s| s.segmentation, target.labelled) / sample.map_or(1.0, PatchSample::share),
            total: 0.0,
        }
        .with_total(weights)
    }
}
