//! The classifier on the blended affinities of one tile, cross-entropy, and all gradients (paper, Section "Scan").
//!
//! A step may use only a random share of the patches: the estimate of the term and of its gradients is unbiased.

use super::lanes::{Chunk, Lanes, NONE, WIDTH, by_simd};
use super::tile::{AFFINITY_CHANNEL, PATCHES, PatchGradient, TILE, TileImage, TilePlane};
use crate::{AFFINITY_DIM, HIDDEN_DIM};

/// The classifier with its outputs padded to whole blocks of eight.
#[derive(Default)]
pub(super) struct PaddedClassifier {
    classes: usize,
    w1: Vec<[f32; AFFINITY_DIM]>,
    b1: Vec<f32>,
    w2: Vec<[f32; HIDDEN_DIM]>,
    b2: Vec<f32>,
}

/// Outputs that are computed together.
const OUTPUTS: usize = 8;

impl PaddedClassifier {
    /// Copies the flat array of [`crate::parameters::ClassifierState`].
    pub(super) fn set(&mut self, classes: usize, values: &[f32]) {
        let padded = classes.next_multiple_of(OUTPUTS);
        let (w1, rest) = values.split_at(HIDDEN_DIM * AFFINITY_DIM);
        let (b1, rest) = rest.split_at(HIDDEN_DIM);
        let (w2, b2) = rest.split_at(classes * HIDDEN_DIM);
        self.classes = classes;
        self.w1.resize(HIDDEN_DIM, [0.0; AFFINITY_DIM]);
        self.b1.resize(HIDDEN_DIM, 0.0);
        self.w2.resize(padded, [0.0; HIDDEN_DIM]);
        self.b2.resize(padded, 0.0);
        self.w1.as_flattened_mut().copy_from_slice(w1);
        self.b1.copy_from_slice(b1);
        self.w2.as_flattened_mut()[..w2.len()].copy_from_slice(w2);
        self.b2[..classes].copy_from_slice(b2);
    }
}

/// Selection of each tile's patches for a step's segmentation term. Systematic sampling: all patches have the same
/// probability, and all tiles nearly the same number of patches.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PatchSample {
    share: f32,
    seed: u64,
}

impl PatchSample {
    /// All patches.
    pub(super) const ALL: Self = Self { share: 1.0, seed: 0 };

    /// A `share` of the patches, different for every `step`.
    pub(super) fn new(share: f32, step: u32) -> Self {
        let share = if share.is_finite() { share.clamp(0.01, 1.0) } else { 1.0 };
        Self { share, seed: u64::from(step) }
    }

    /// Returns the divisor of the sampled patches' terms.
    pub(super) fn share(self) -> f32 {
        self.share
    }

    /// Returns the sampled patches of a tile as bits.
    pub(super) fn patches(self, tile: usize) -> u8 {
        if self.share >= 1.0 {
            return (1 << PATCHES) - 1;
        }
        // The mixer of SplitMix64 (Steele et al. 2014).
        let mut z = (self.seed << 32 | tile as u64).wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        z = (z ^ z >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ z >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
        let z = z ^ z >> 31;
        // Walks in steps of `share` from a random start and samples a patch where a step passes an integer. The first
        // patch of the walk is random as well.
        let start = (z >> 40) as f32 / (1u64 << 24) as f32;
        let first = z as usize % PATCHES;
        let mut bits = 0;
        for k in 0..PATCHES {
            let passed = |k: usize| (start + self.share * k as f32).floor();
            if passed(k + 1) > passed(k) {
                bits |= 1 << ((first + k) % PATCHES);
            }
        }
        bits
    }
}

/// Working memory of one band, and its share of the classifier's gradient.
pub(super) struct PerceptronScratch {
    hidden: [TilePlane; HIDDEN_DIM],
    d_hidden: [TilePlane; HIDDEN_DIM],
    logits: Vec<TilePlane>,
    inputs_by_pixel: PerceptronFactors<{ AFFINITY_DIM / WIDTH }>,
    hidden_by_pixel: PerceptronFactors<{ HIDDEN_DIM / WIDTH }>,
    w1: [[Chunk; AFFINITY_DIM / WIDTH]; HIDDEN_DIM],
    b1: [Chunk; HIDDEN_DIM],
    w2: Vec<[Chunk; HIDDEN_DIM / WIDTH]>,
    b2: Vec<Chunk>,
}

/// Values pixel by pixel.
#[repr(C, align(64))]
struct PerceptronFactors<const N: usize>([[Chunk; N]; TILE * TILE]);

impl PerceptronScratch {
    pub(super) fn new(classes: usize) -> Self {
        let padded = classes.next_multiple_of(OUTPUTS);
        Self {
            hidden: [TilePlane::ZERO; HIDDEN_DIM],
            d_hidden: [TilePlane::ZERO; HIDDEN_DIM],
            logits: vec![TilePlane::ZERO; padded],
            inputs_by_pixel: PerceptronFactors([[NONE; AFFINITY_DIM / WIDTH]; TILE * TILE]),
            hidden_by_pixel: PerceptronFactors([[NONE; HIDDEN_DIM / WIDTH]; TILE * TILE]),
            w1: [[NONE; AFFINITY_DIM / WIDTH]; HIDDEN_DIM],
            b1: [NONE; HIDDEN_DIM],
            w2: vec![[NONE; HIDDEN_DIM / WIDTH]; padded],
            b2: vec![NONE; padded],
        }
    }

    /// Clears the gradient.
    pub(super) fn clear(&mut self) {
        self.w1.as_flattened_mut().fill(NONE);
        self.b1.fill(NONE);
        self.w2.as_flattened_mut().fill(NONE);
        self.b2.fill(NONE);
    }

    /// Adds the gradient to a flat array like the one of [`crate::parameters::ClassifierState`].
    pub(super) fn add_gradient(&self, classes: usize, flat: &mut [f32]) {
        let sum = |lanes: &Chunk| lanes.iter().fold(0.0, |sum, v| sum + v);
        let w1 = self.w1.as_flattened().as_flattened().iter().copied();
        let w2 = self.w2[..classes].as_flattened().as_flattened().iter().copied();
        let values = w1.chain(self.b1.iter().map(sum)).chain(w2).chain(self.b2[..classes].iter().map(sum));
        for (to, value) in flat.iter_mut().zip(values) {
            *to += value;
        }
    }
}

/// `out[j] = bias[j] + Σ_c w[j][c] · x(c)` for patch `p`, `J` outputs at a time.
#[inline(always)]
fn layer<L: Lanes, const N: usize, const J: usize>(
    w: &[[f32; N]],
    bias: &[f32],
    x: &[Chunk; N],
    out: &mut [TilePlane],
    p: usize,
) {
    for ((w, bias), out) in w.chunks_exact(J).zip(bias.chunks_exact(J)).zip(out.chunks_exact_mut(J)) {
        let mut sums = [L::splat(0.0); J];
        for k in 0..J {
            sums[k] = L::splat(bias[k]);
        }
        for c in 0..N {
            let x = L::load(&x[c]);
            for k in 0..J {
                sums[k] = L::splat(w[k][c]).mul_add(x, sums[k]);
            }
        }
        for k in 0..J {
            sums[k].store(&mut out[k].0[p]);
        }
    }
}

/// Σ_j w[j][c] · x[j] for patch `p` and `C` values of c, from `first` on.
#[inline(always)]
fn layer_transposed<L: Lanes, const N: usize, const C: usize>(
    w: &[[f32; N]],
    x: &[TilePlane],
    first: usize,
    p: usize,
) -> [L; C] {
    let mut sums = [L::splat(0.0); C];
    for (row, x) in w.iter().zip(x) {
        let x = L::load(&x.0[p]);
        let row = &row[first..first + C];
        for k in 0..C {
            sums[k] = L::splat(row[k]).mul_add(x, sums[k]);
        }
    }
    sums
}

/// Computes `sum[j] += Σ over pixels of d[j] · x(pixel)` for the taken patches, `J` rows at a time. The biases use x =
/// 1, lane by lane.
#[inline(always)]
fn layer_gradient<L: Lanes, const N: usize, const J: usize>(
    patches: u8,
    d: &[TilePlane],
    x: &PerceptronFactors<N>,
    sum: &mut [[Chunk; N]],
    bias: &mut [Chunk],
) {
    for ((d, sum), bias) in d.chunks_exact(J).zip(sum.chunks_exact_mut(J)).zip(bias.chunks_exact_mut(J)) {
        let mut sums = [[L::splat(0.0); N]; J];
        for k in 0..J {
            for n in 0..N {
                sums[k][n] = L::load(&sum[k][n]);
            }
        }
        for p in taken(patches) {
            for lane in 0..WIDTH {
                let x = &x.0[p * WIDTH + lane];
                for n in 0..N {
                    let x = L::load(&x[n]);
                    for k in 0..J {
                        sums[k][n] = L::splat(d[k].0[p][lane]).mul_add(x, sums[k][n]);
                    }
                }
            }
            for k in 0..J {
                (L::load(&bias[k]) + L::load(&d[k].0[p])).store(&mut bias[k]);
            }
        }
        for k in 0..J {
            for n in 0..N {
                sums[k][n].store(&mut sum[k][n]);
            }
        }
    }
}

fn taken(patches: u8) -> impl Iterator<Item = usize> {
    (0..PATCHES).filter(move |p| patches >> p & 1 != 0)
}

/// Affinity channels of a patch.
#[inline(always)]
fn inputs(image: &TileImage, p: usize) -> &[Chunk; AFFINITY_DIM] {
    image[p].channels[AFFINITY_CHANNEL..].first_chunk().expect("affinity channels follow")
}

/// Fills `scratch.hidden` and `scratch.logits` of one patch.
#[inline(always)]
fn forward<L: Lanes>(
    weights: &PaddedClassifier,
    image: &TileImage,
    scratch: &mut PerceptronScratch,
    p: usize,
) {
    let inputs = inputs(image, p);
    let PerceptronScratch { hidden, logits, .. } = scratch;
    if L::MANY_REGISTERS {
        layer::<L, AFFINITY_DIM, 8>(&weights.w1, &weights.b1, inputs, hidden, p);
    } else {
        layer::<L, AFFINITY_DIM, 4>(&weights.w1, &weights.b1, inputs, hidden, p);
    }
    let mut active = [NONE; HIDDEN_DIM];
    for (plane, active) in hidden.iter_mut().zip(&mut active) {
        let value = L::load(&plane.0[p]).max(L::splat(0.0));
        value.store(&mut plane.0[p]);
        value.store(active);
    }
    if L::MANY_REGISTERS {
        layer::<L, HIDDEN_DIM, 8>(&weights.w2, &weights.b2, &active, logits, p);
    } else {
        layer::<L, HIDDEN_DIM, 4>(&weights.w2, &weights.b2, &active, logits, p);
    }
}

/// Turns the logits of patch `p` into ∂L/∂logits = (softmax − one-hot)·scale, zero where there is no label; returns the
/// cross-entropy summed over its pixels.
#[inline(always)]
fn softmax<L: Lanes>(logits: &mut [TilePlane], labels: &[u16; WIDTH], scale: f32, p: usize) -> f64 {
    let mut largest = L::load(&logits[0].0[p]);
    for plane in &logits[1..] {
        largest = largest.max(L::load(&plane.0[p]));
    }
    let mut sum = L::splat(0.0);
    for plane in &mut *logits {
        let e = (L::load(&plane.0[p]) - largest).exp();
        e.store(&mut plane.0[p]);
        sum = sum + e;
    }
    let (mut used, mut likelihoods, mut sums) = (NONE, [1.0; WIDTH], NONE);
    sum.store(&mut sums);
    for (x, &label) in labels.iter().enumerate() {
        if label != u16::MAX {
            used[x] = scale;
            likelihoods[x] = (logits[usize::from(label)].0[p][x] / sums[x]).max(1e-38);
        }
    }
    // The product of eight factors of at least 1e-38 is representable in f64.
    let product = |half: &[f32]| half.iter().map(|v| f64::from(*v)).product::<f64>().ln();
    let loss = -product(&likelihoods[..8]) - product(&likelihoods[8..]);
    let factor = L::load(&used) / sum;
    for plane in &mut *logits {
        (L::load(&plane.0[p]) * factor).store(&mut plane.0[p]);
    }
    for (x, &label) in labels.iter().enumerate() {
        if label != u16::MAX {
            logits[usize::from(label)].0[p][x] -= scale;
        }
    }
    loss
}

/// Returns the cross-entropy (nats) summed over the labelled pixels of the sampled patches. Writes the affinity
/// channels of `gradient` and adds to the classifier's gradient, both times `scale`.
#[inline(always)]
fn cross_entropy<L: Lanes>(
    weights: &PaddedClassifier,
    image: &TileImage,
    labels: &[u16; TILE * TILE],
    patches: u8,
    scale: f32,
    scratch: &mut PerceptronScratch,
    gradient: &mut [PatchGradient; PATCHES],
) -> f64 {
    if labels.iter().all(|&l| l == u16::MAX) {
        for p in taken(patches) {
            gradient[p].channels[AFFINITY_CHANNEL..AFFINITY_CHANNEL + AFFINITY_DIM].fill(NONE);
        }
        return 0.0;
    }
    let mut loss = 0.0;
    let (labels, _) = labels.as_chunks::<WIDTH>();
    for p in taken(patches) {
        forward::<L>(weights, image, scratch, p);
        loss += softmax::<L>(&mut scratch.logits[..weights.classes], &labels[p], scale, p);
        for plane in &mut scratch.logits[weights.classes..] {
            plane.0[p] = NONE;
        }
        let PerceptronScratch { hidden, d_hidden, logits, inputs_by_pixel, hidden_by_pixel, .. } =
            &mut *scratch;
        for first in (0..HIDDEN_DIM).step_by(4) {
            let d: [L; 4] = layer_transposed::<L, HIDDEN_DIM, 4>(&weights.w2, logits, first, p);
            for (k, d) in d.into_iter().enumerate() {
                let active = L::load(&hidden[first + k].0[p]).gt(L::splat(0.0));
                d.keep(active).store(&mut d_hidden[first + k].0[p]);
            }
        }
        for first in (0..AFFINITY_DIM).step_by(4) {
            let d: [L; 4] = layer_transposed::<L, AFFINITY_DIM, 4>(&weights.w1, d_hidden, first, p);
            for (k, d) in d.into_iter().enumerate() {
                d.store(&mut gradient[p].channels[AFFINITY_CHANNEL + first + k]);
            }
        }
        let inputs = inputs(image, p);
        let mut rows = [L::splat(0.0); WIDTH];
        for c in 0..WIDTH {
            rows[c] = L::load(&inputs[c]);
        }
        for (lane, row) in L::transpose(rows).into_iter().enumerate() {
            row.store(&mut inputs_by_pixel.0[p * WIDTH + lane][0]);
        }
        for n in 0..HIDDEN_DIM / WIDTH {
            for j in 0..WIDTH {
                rows[j] = L::load(&hidden[n * WIDTH + j].0[p]);
            }
            for (lane, row) in L::transpose(rows).into_iter().enumerate() {
                row.store(&mut hidden_by_pixel.0[p * WIDTH + lane][n]);
            }
        }
    }
    let PerceptronScratch { d_hidden, logits, inputs_by_pixel, hidden_by_pixel, w1, b1, w2, b2, .. } =
        scratch;
    if L::MANY_REGISTERS {
        layer_gradient::<L, _, 8>(patches, logits, hidden_by_pixel, w2, b2);
        layer_gradient::<L, _, 16>(patches, d_hidden, inputs_by_pixel, w1, b1);
    } else {
        layer_gradient::<L, _, 2>(patches, logits, hidden_by_pixel, w2, b2);
        layer_gradient::<L, _, 4>(patches, d_hidden, inputs_by_pixel, w1, b1);
    }
    loss
}

const _: () = assert!(AFFINITY_DIM == WIDTH && HIDDEN_DIM.is_multiple_of(WIDTH));

by_simd! {
    /// Segmentation term of one tile.
    fn tile_cross_entropy = cross_entropy(
        weights: &PaddedClassifier, image: &TileImage, labels: &[u16; TILE * TILE], patches: u8, scale: f32,
        scratch: &mut PerceptronScratch, gradient: &mut [PatchGradient; PATCHES],
    ) -> f64
}

#[inline(always)]
fn most_likely<L: Lanes>(
    weights: &PaddedClassifier,
    image: &TileImage,
    scratch: &mut PerceptronScratch,
    labels: &mut [u16; TILE * TILE],
) {
    for p in 0..PATCHES {
        forward::<L>(weights, image, scratch, p);
    }
    for (i, label) in labels.iter_mut().enumerate() {
        let logit = |k: usize| scratch.logits[k].0[i / WIDTH][i % WIDTH];
        let mut best = 0;
        for k in 1..weights.classes {
            if logit(k) > logit(best) {
                best = k;
            }
        }
        *label = best as u16;
    }
}

by_simd! {
    /// The most likely label of each pixel of a tile.
    fn tile_labels = most_likely(
        weights: &PaddedClassifier, image: &TileImage, scratch: &mut PerceptronScratch, labels: &mut [u16; TILE * TILE],
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_patch_is_taken_as_often_as_the_share_says() {
        for share in [0.25, 0.4, 0.5, 1.0] {
            let mut taken = [[0; PATCHES]; 50];
            let steps = 4000;
            for step in 0..steps {
                for (tile, taken) in taken.iter_mut().enumerate() {
                    let bits = PatchSample::new(share, step).patches(tile);
                    let number = f64::from(bits.count_ones()) - f64::from(share) * PATCHES as f64;
                    assert!(number.abs() < 1.0, "nearly the same number in each tile");
                    (0..PATCHES).for_each(|p| taken[p] += u32::from(bits >> p & 1));
                }
            }
            for taken in taken.as_flattened() {
                let deviation = f64::from(*taken) / f64::from(steps) - f64::from(share);
                assert!(deviation.abs() < 0.04, "{share}: {deviation}");
            }
        }
        assert_eq!(PatchSample::new(f32::NAN, 3).share(), 1.0);
    }
}
