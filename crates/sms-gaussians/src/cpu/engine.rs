//! The passes of a step over all bands: project, bin, blend, SSIM, losses, gradients.

use super::bands::{BAND_ROWS, BAND_TILES, Band, BandSums, Slots, Span, StepTimes};
use super::lanes::Simd;
use super::losses::{PixelWeights, tile_losses, tile_moments};
use super::perceptron::{Weights, tile_cross_entropy};
use super::project::{Projected, View, project, smallest, unproject};
use super::raster::{Splat, SplatGradient, TILE, TileGradient, TileImage, blend_tile, unblend_tile};
use super::ssim::{DERIVATIVES, Planes, STATISTICS, gradient_layout, ssim_band, ssim_gradient_band};
use super::target::{Grid, Target};
use crate::parameters::{LOG_SCALE, Parameters, Row};
use crate::{LossTerms, LossWeights, TrainConfig};
use rayon::prelude::*;
use std::time::Instant;

/// Gaussians handled at once in the passes over Gaussians. A constant, because it shapes the order of sums.
const GAUSSIANS: usize = 256;

/// Buffers of a step, and what the last one left in them.
pub(super) struct Engine {
    pub(super) simd: Simd,
    pub(super) grid: Grid,
    /// Colour behind all Gaussians.
    pub(super) background: [f32; 3],
    pub(super) bands: Vec<Band>,
    pub(super) tiles: Vec<TileImage>,
    /// ∂L/∂parameters of the last step, zero where not seen.
    pub(super) gradients: Vec<Row>,
    /// Gaussians that reached a pixel in the last step.
    pub(super) seen: Vec<bool>,
    /// ∂L/∂classifier of the last step, flat.
    pub(super) classifier_gradient: Vec<f32>,
    pub(super) times: StepTimes,
    classes: usize,
    projected: Vec<Projected>,
    slots: Slots,
    statistics: Planes,
    derivatives: Planes,
    regularizers: Vec<[f64; 2]>,
}

const UNSEEN: Projected = Projected {
    splat: Splat {
        mean: [0.0; 2],
        conic: [0.0; 3],
        opacity: 0.0,
        extent_y: 0.0,
        depth_slope: [0.0; 2],
        features: [0.0; super::raster::CHANNELS],
    },
    gaussian: 0,
    z: 0.0,
    extent_x: 0.0,
    reach: 0.0,
    determinant: 0.0,
};

impl Engine {
    pub(super) fn new(simd: Simd, classes: usize) -> Self {
        Self {
            simd,
            grid: Grid::new(0, 0),
            background: [0.0; 3],
            bands: Vec::new(),
            tiles: Vec::new(),
            gradients: Vec::new(),
            seen: Vec::new(),
            classifier_gradient: Vec::new(),
            times: StepTimes::default(),
            classes,
            projected: Vec::new(),
            slots: Slots::default(),
            statistics: Planes::default(),
            derivatives: Planes::default(),
            regularizers: Vec::new(),
        }
    }

    fn resize(&mut self, grid: Grid) {
        self.grid = grid;
        self.tiles.resize(grid.len(), TileImage::EMPTY);
        let classes = self.classes;
        self.bands.resize_with(grid.rows.div_ceil(BAND_TILES), || Band::new(classes));
        let (columns, rows) = (grid.columns * TILE, grid.rows * TILE);
        self.statistics.resize(3 * STATISTICS, columns, rows);
        self.derivatives.resize(3 * DERIVATIVES, columns, rows);
    }

    /// Blends all tiles of a view; with a target also fills what SSIM reads.
    pub(super) fn blend(&mut self, parameters: &Parameters, view: &View, target: Option<&Target>) {
        self.resize(Grid::new(view.width, view.height));
        let start = Instant::now();
        let bands = self.bands.len();
        self.projected.resize(parameters.rows.len(), UNSEEN);
        self.slots.spans.resize(parameters.rows.len(), Span::default());
        let chunks = self.projected.par_chunks_mut(GAUSSIANS).zip(self.slots.spans.par_chunks_mut(GAUSSIANS));
        let rows = parameters.rows.par_chunks(GAUSSIANS);
        chunks.zip(rows).enumerate().for_each(|(chunk, ((projected, spans), rows))| {
            for (i, row) in rows.iter().enumerate() {
                spans[i] = Span::default();
                if let Some(p) = project(row, (chunk * GAUSSIANS + i) as u32, view) {
                    projected[i] = p;
                    spans[i] = Span::of(&p, bands);
                }
            }
        });
        self.slots.prepare();
        self.times.project += start.elapsed().as_secs_f64();

        let Self { simd, grid, background, projected, slots, statistics, .. } = self;
        let (simd, grid, background) = (*simd, *grid, *background);
        let (layout, inside, length) = statistics.inside_mut(BAND_ROWS);
        self.bands
            .par_iter_mut()
            .zip(self.tiles.par_chunks_mut(BAND_TILES * grid.columns))
            .zip(inside.par_chunks_mut(length))
            .enumerate()
            .for_each(|(index, ((band, tiles), statistics))| {
                let start = Instant::now();
                band.times = StepTimes::default();
                band.sums = BandSums::default();
                band.bin(index, &grid, projected, slots);
                let binned = Instant::now();
                band.times.bin = (binned - start).as_secs_f64();
                let first = index * BAND_TILES * grid.columns;
                for (i, image) in tiles.iter_mut().enumerate() {
                    let place = grid.place(first + i);
                    let mut reached = std::mem::take(&mut band.reached);
                    blend_tile(simd, &band.splats, band.list(i), place, background, image, &mut reached);
                    band.reached = reached;
                }
                let blended = Instant::now();
                band.times.blend = (blended - binned).as_secs_f64();
                if let Some(target) = target {
                    let observed = &target.tiles[first..first + tiles.len()];
                    let rows = tiles.chunks(grid.columns).zip(observed.chunks(grid.columns));
                    for (row, (images, observed)) in rows.enumerate() {
                        tile_moments(simd, images, observed, (layout, &mut *statistics, row * TILE));
                    }
                    band.times.ssim = blended.elapsed().as_secs_f64();
                }
            });
    }

    /// Loss and gradients for one observed view.
    pub(super) fn differentiate(
        &mut self,
        parameters: &Parameters,
        target: &Target,
        config: &TrainConfig,
    ) -> LossTerms {
        self.times = StepTimes::default();
        self.blend(parameters, &target.view, Some(target));
        self.similarities(target, &config.weights);
        self.pixels(parameters, target, config);
        let flats = self.gaussians(parameters, &target.view, &config.weights);
        for band in &self.bands {
            self.times.add(&band.times);
        }
        self.terms(target, &config.weights, flats)
    }

    /// SSIM and its derivatives with respect to the window's moments.
    fn similarities(&mut self, target: &Target, weights: &LossWeights) {
        let Self { simd, statistics, derivatives, .. } = self;
        let simd = *simd;
        let size = (target.grid.width, target.grid.height);
        // 1 − SSIM falls as SSIM rises.
        let scale = -weights.color * weights.ssim / (3 * size.0 * size.1).max(1) as f32;
        let (layout, inside, length) = derivatives.inside_mut(BAND_ROWS);
        let statistics = &*statistics;
        self.bands.par_iter_mut().zip(inside.par_chunks_mut(length)).enumerate().for_each(
            |(index, (band, rows))| {
                let start = Instant::now();
                let first = index * BAND_ROWS;
                band.sums.ssim =
                    ssim_band(simd, statistics, first, BAND_ROWS, size, scale, layout, rows, &mut band.ssim);
                band.times.ssim += start.elapsed().as_secs_f64();
            },
        );
    }

    /// The losses of all pixels and the gradients of all splats.
    fn pixels(&mut self, parameters: &Parameters, target: &Target, config: &TrainConfig) {
        let Self { simd, grid, statistics, derivatives, tiles, .. } = self;
        let (simd, grid, statistics, derivatives) = (*simd, *grid, &*statistics, &*derivatives);
        let classifier = Weights::new(self.classes, &parameters.classifier.values);
        let share = |weight: f32, pixels: usize| weight / pixels.max(1) as f32;
        let weights = &config.weights;
        let pixel_weights = PixelWeights {
            color: share(weights.color * (1.0 - weights.ssim), 3 * target.colored),
            depth: share(weights.depth, target.deep),
            normal: share(weights.normal, target.oriented),
            depth_term: config.depth_term,
        };
        let label_weight = share(weights.segmentation, target.labelled);
        let size = (grid.width, grid.height);
        let (layout, row_length) = gradient_layout(grid.columns * TILE);
        self.bands.par_iter_mut().zip(tiles.par_chunks(BAND_TILES * grid.columns)).enumerate().for_each(
            |(index, (band, tiles))| {
                let mut last = Instant::now();
                let mut lap = || {
                    let now = Instant::now();
                    let seconds = (now - last).as_secs_f64();
                    last = now;
                    seconds
                };
                band.color_gradient.resize(row_length * BAND_ROWS, 0.0);
                ssim_gradient_band(
                    simd,
                    statistics,
                    derivatives,
                    index * BAND_ROWS,
                    BAND_ROWS,
                    size,
                    layout,
                    &mut band.color_gradient,
                    &mut band.ssim,
                );
                band.times.ssim += lap();
                band.gradients.clear();
                band.gradients.resize(band.splats.len(), SplatGradient::ZERO);
                band.perceptron.clear();
                let mut gradient = TileGradient::ZERO;
                let first = index * BAND_TILES * grid.columns;
                for (i, image) in tiles.iter().enumerate() {
                    let observed = &target.tiles[first + i];
                    let (row, column) = (i / grid.columns * TILE, i % grid.columns * TILE);
                    let ssim = (layout, &mut band.color_gradient[..], row, column);
                    let sums = tile_losses(simd, image, observed, pixel_weights, ssim, &mut gradient);
                    band.sums.color += sums.color;
                    band.sums.depth += sums.depth;
                    band.sums.normal += sums.normal;
                    band.times.pixels += lap();
                    if label_weight > 0.0 {
                        band.sums.segmentation += tile_cross_entropy(
                            simd,
                            &classifier,
                            image,
                            &observed.label,
                            label_weight,
                            &mut band.perceptron,
                            &mut gradient,
                        );
                        band.times.segmentation += lap();
                    }
                    let mut gradients = std::mem::take(&mut band.gradients);
                    let place = grid.place(first + i);
                    let list = band.list(i);
                    unblend_tile(simd, &band.splats, list, place, image, &mut gradient, &mut gradients);
                    band.gradients = gradients;
                    band.times.unblend += lap();
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
    fn gaussians(&mut self, parameters: &Parameters, view: &View, weights: &LossWeights) -> [f64; 2] {
        let start = Instant::now();
        let count = parameters.rows.len();
        self.gradients.resize(count, Row::ZERO);
        self.seen.resize(count, false);
        self.regularizers.resize(count.div_ceil(GAUSSIANS), [0.0; 2]);
        let Self { bands, slots, projected, .. } = self;
        let (bands, slots, projected) = (&*bands, &*slots, &*projected);
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
        let per_gaussian = 1.0 / in_view.max(1) as f32;
        self.gradients
            .par_chunks_mut(GAUSSIANS)
            .zip(self.regularizers.par_iter_mut())
            .zip(self.seen.par_chunks(GAUSSIANS))
            .enumerate()
            .for_each(|(chunk, ((gradients, sums), seen))| {
                *sums = [0.0; 2];
                // First collect, then compute: the short first loop lets its scattered reads overlap.
                let mut collected = [SplatGradient::ZERO; GAUSSIANS];
                for (i, sum) in collected[..seen.len()].iter_mut().enumerate() {
                    for (band, position) in slots.of(chunk * GAUSSIANS + i) {
                        sum.add(&bands[band].gradients[position]);
                    }
                }
                for (i, gradient) in gradients.iter_mut().enumerate() {
                    if !seen[i] {
                        *gradient = Row::ZERO;
                        continue;
                    }
                    let gaussian = chunk * GAUSSIANS + i;
                    let row = &parameters.rows[gaussian];
                    *gradient = unproject(row, &projected[gaussian].splat, &collected[i], view);
                    let [isotropic, flat] = regularize(row, weights, per_gaussian, gradient);
                    sums[0] += f64::from(isotropic);
                    sums[1] += f64::from(flat);
                }
            });
        let [mut isotropic, mut flat] = [0.0; 2];
        for sums in &self.regularizers {
            isotropic += sums[0];
            flat += sums[1];
        }
        self.times.unproject += start.elapsed().as_secs_f64();
        [isotropic, flat].map(|sum| sum / in_view.max(1) as f64)
    }

    fn terms(&self, target: &Target, weights: &LossWeights, [isotropic, flat]: [f64; 2]) -> LossTerms {
        let mut sums = BandSums::default();
        for band in &self.bands {
            sums.color += band.sums.color;
            sums.ssim += band.sums.ssim;
            sums.depth += band.sums.depth;
            sums.normal += band.sums.normal;
            sums.segmentation += band.sums.segmentation;
        }
        let mean = |sum: f64, pixels: usize| if pixels > 0 { (sum / pixels as f64) as f32 } else { 0.0 };
        let pixels = 3 * target.grid.width * target.grid.height;
        let mut terms = LossTerms {
            color_l1: mean(sums.color, 3 * target.colored),
            dssim: if pixels > 0 { 1.0 - mean(sums.ssim, pixels) } else { 0.0 },
            isotropic: isotropic as f32,
            depth: mean(sums.depth, target.deep),
            normal: mean(sums.normal, target.oriented),
            flat: flat as f32,
            segmentation: mean(sums.segmentation, target.labelled),
            total: 0.0,
        };
        terms.total = total(&terms, weights);
        terms
    }
}

/// The weighted sum of the terms.
pub(super) fn total(terms: &LossTerms, weights: &LossWeights) -> f32 {
    weights.color * ((1.0 - weights.ssim) * terms.color_l1 + weights.ssim * terms.dssim)
        + weights.isotropic * terms.isotropic
        + weights.depth * terms.depth
        + weights.normal * terms.normal
        + weights.flat * terms.flat
        + weights.segmentation * terms.segmentation
}

/// Adds the gradient of the isotropic and flatness terms of one Gaussian, and returns their values in metres.
///
/// With the flatness term on, the isotropic term acts on the two larger scales only: the two would fight otherwise.
fn regularize(row: &Row, weights: &LossWeights, share: f32, gradient: &mut Row) -> [f32; 2] {
    let log_scale = [row.0[LOG_SCALE], row.0[LOG_SCALE + 1], row.0[LOG_SCALE + 2]];
    let scale = log_scale.map(f32::exp);
    let shortest = smallest(log_scale);
    let flattening = weights.flat > 0.0;
    let taken = |k: usize| !flattening || k != shortest;
    let number = if flattening { 2.0 } else { 3.0 };
    let mean = (0..3).filter(|&k| taken(k)).map(|k| scale[k]).sum::<f32>() / number;
    let sign = |k: usize| {
        let d = scale[k] - mean;
        if d > 0.0 {
            1.0
        } else if d < 0.0 {
            -1.0
        } else {
            0.0
        }
    };
    let mean_sign = (0..3).filter(|&k| taken(k)).map(sign).sum::<f32>() / number;
    let mut isotropic = 0.0;
    for k in (0..3).filter(|&k| taken(k)) {
        isotropic += (scale[k] - mean).abs();
        gradient.0[LOG_SCALE + k] += weights.isotropic * share * (sign(k) - mean_sign) * scale[k];
    }
    gradient.0[LOG_SCALE + shortest] += weights.flat * share * scale[shortest];
    [isotropic, scale[shortest]]
}
