//! The classifier on the blended affinities of one tile, cross-entropy, and all gradients (paper, Section "Scan").

use super::lanes::{Chunk, Lanes, by_simd};
use super::raster::{AFFINITY_CHANNEL, Plane, TILE, TileGradient, TileImage};
use crate::{AFFINITY_DIM, HIDDEN_DIM};

/// The classifier with its outputs padded to whole blocks of four.
pub(super) struct Weights {
    classes: usize,
    w1: [[f32; AFFINITY_DIM]; HIDDEN_DIM],
    b1: [f32; HIDDEN_DIM],
    w2: Vec<[f32; HIDDEN_DIM]>,
    b2: Vec<f32>,
}

impl Weights {
    /// From the flat array of [`crate::parameters::ClassifierState`].
    pub(super) fn new(classes: usize, values: &[f32]) -> Self {
        let padded = classes.next_multiple_of(4);
        let (w1, rest) = values.split_at(HIDDEN_DIM * AFFINITY_DIM);
        let (b1, rest) = rest.split_at(HIDDEN_DIM);
        let (w2, b2) = rest.split_at(classes * HIDDEN_DIM);
        let mut weights = Self {
            classes,
            w1: [[0.0; AFFINITY_DIM]; HIDDEN_DIM],
            b1: b1.try_into().expect("one bias per hidden value"),
            w2: vec![[0.0; HIDDEN_DIM]; padded],
            b2: vec![0.0; padded],
        };
        weights.w1.as_flattened_mut().copy_from_slice(w1);
        weights.w2.as_flattened_mut()[..w2.len()].copy_from_slice(w2);
        weights.b2[..classes].copy_from_slice(b2);
        weights
    }
}

/// Working memory of one band, and its share of the classifier's gradient (one sum per lane).
pub(super) struct Scratch {
    hidden: [Plane; HIDDEN_DIM],
    d_hidden: [Plane; HIDDEN_DIM],
    logits: Vec<Plane>,
    w1: [[Chunk; AFFINITY_DIM]; HIDDEN_DIM],
    b1: [Chunk; HIDDEN_DIM],
    w2: Vec<[Chunk; HIDDEN_DIM]>,
    b2: Vec<Chunk>,
}

const NONE: Chunk = [0.0; TILE];

impl Scratch {
    pub(super) fn new(classes: usize) -> Self {
        let padded = classes.next_multiple_of(4);
        Self {
            hidden: [Plane::ZERO; HIDDEN_DIM],
            d_hidden: [Plane::ZERO; HIDDEN_DIM],
            logits: vec![Plane::ZERO; padded],
            w1: [[NONE; AFFINITY_DIM]; HIDDEN_DIM],
            b1: [NONE; HIDDEN_DIM],
            w2: vec![[NONE; HIDDEN_DIM]; padded],
            b2: vec![NONE; padded],
        }
    }

    /// Forgets the gradient.
    pub(super) fn clear(&mut self) {
        self.w1 = [[NONE; AFFINITY_DIM]; HIDDEN_DIM];
        self.b1 = [NONE; HIDDEN_DIM];
        self.w2.fill([NONE; HIDDEN_DIM]);
        self.b2.fill(NONE);
    }

    /// Adds the gradient to a flat array like the one of [`crate::parameters::ClassifierState`].
    pub(super) fn add_gradient(&self, classes: usize, flat: &mut [f32]) {
        let sums = self.w1.as_flattened().iter().chain(&self.b1);
        let sums = sums.chain(self.w2[..classes].as_flattened()).chain(&self.b2[..classes]);
        for (to, lanes) in flat.iter_mut().zip(sums) {
            *to += lanes.iter().fold(0.0, |sum, v| sum + v);
        }
    }
}

/// `out[j] = bias[j] + Σ_c w[j][c] · x[c]`, four outputs by two rows at a time.
#[inline(always)]
fn layer<L: Lanes, const N: usize>(w: &[[f32; N]], bias: &[f32], x: &[Plane], out: &mut [Plane]) {
    let x = &x[..N];
    for j in (0..w.len()).step_by(4) {
        let (w, b) = (&w[j..j + 4], &bias[j..j + 4]);
        for y in (0..TILE).step_by(2) {
            let mut p = [L::splat(b[0]), L::splat(b[1]), L::splat(b[2]), L::splat(b[3])];
            let mut q = p;
            for c in 0..N {
                let (u, v) = (L::load(&x[c].0[y]), L::load(&x[c].0[y + 1]));
                for k in 0..4 {
                    let weight = L::splat(w[k][c]);
                    p[k] = weight.mul_add(u, p[k]);
                    q[k] = weight.mul_add(v, q[k]);
                }
            }
            for k in 0..4 {
                p[k].store(&mut out[j + k].0[y]);
                q[k].store(&mut out[j + k].0[y + 1]);
            }
        }
    }
}

/// `out[c] = Σ_j w[j][c] · x[j]`.
#[inline(always)]
fn layer_transposed<L: Lanes, const N: usize>(w: &[[f32; N]], x: &[Plane], out: &mut [Plane]) {
    let out = &mut out[..N];
    for c in (0..N).step_by(4) {
        for y in (0..TILE).step_by(2) {
            let mut p = [L::splat(0.0); 4];
            let mut q = p;
            for (row, x) in w.iter().zip(x) {
                let (u, v) = (L::load(&x.0[y]), L::load(&x.0[y + 1]));
                for k in 0..4 {
                    let weight = L::splat(row[c + k]);
                    p[k] = weight.mul_add(u, p[k]);
                    q[k] = weight.mul_add(v, q[k]);
                }
            }
            for k in 0..4 {
                p[k].store(&mut out[c + k].0[y]);
                q[k].store(&mut out[c + k].0[y + 1]);
            }
        }
    }
}

/// `sum[j][c] += Σ over pixels of d[j] · x[c]`, lane by lane, and the same for the biases with x = 1.
#[inline(always)]
fn layer_gradient<L: Lanes, const N: usize>(
    d: &[Plane],
    x: &[Plane],
    sum: &mut [[Chunk; N]],
    bias: &mut [Chunk],
) {
    let x = &x[..N];
    for j in (0..sum.len()).step_by(4) {
        let (d, sum) = (&d[j..j + 4], &mut sum[j..j + 4]);
        for c in (0..N).step_by(2) {
            let mut p = [L::splat(0.0); 4];
            let mut q = p;
            for y in 0..TILE {
                let (u, v) = (L::load(&x[c].0[y]), L::load(&x[c + 1].0[y]));
                for k in 0..4 {
                    let g = L::load(&d[k].0[y]);
                    p[k] = g.mul_add(u, p[k]);
                    q[k] = g.mul_add(v, q[k]);
                }
            }
            for k in 0..4 {
                (L::load(&sum[k][c]) + p[k]).store(&mut sum[k][c]);
                (L::load(&sum[k][c + 1]) + q[k]).store(&mut sum[k][c + 1]);
            }
        }
        for k in 0..4 {
            let mut p = L::load(&bias[j + k]);
            for y in 0..TILE {
                p = p + L::load(&d[k].0[y]);
            }
            p.store(&mut bias[j + k]);
        }
    }
}

/// Fills `scratch.hidden` and `scratch.logits`.
#[inline(always)]
fn forward<L: Lanes>(weights: &Weights, image: &TileImage, scratch: &mut Scratch) {
    layer::<L, AFFINITY_DIM>(
        &weights.w1,
        &weights.b1,
        &image.channels[AFFINITY_CHANNEL..],
        &mut scratch.hidden,
    );
    for plane in &mut scratch.hidden {
        for row in &mut plane.0 {
            L::load(row).max(L::splat(0.0)).store(row);
        }
    }
    layer::<L, HIDDEN_DIM>(&weights.w2, &weights.b2, &scratch.hidden, &mut scratch.logits);
}

/// Cross-entropy summed over the labelled pixels (nats); writes the affinity channels of `gradient` and adds to the
/// classifier's gradient, both times `scale`.
#[inline(always)]
fn cross_entropy<L: Lanes>(
    weights: &Weights,
    image: &TileImage,
    labels: &[u16; TILE * TILE],
    scale: f32,
    scratch: &mut Scratch,
    gradient: &mut TileGradient,
) -> f64 {
    let channels = &mut gradient.channels[AFFINITY_CHANNEL..AFFINITY_CHANNEL + AFFINITY_DIM];
    if labels.iter().all(|&l| l == u16::MAX) {
        channels.fill(Plane::ZERO);
        return 0.0;
    }
    forward::<L>(weights, image, scratch);
    let logits = &mut scratch.logits;
    let mut loss = 0.0;
    for y in 0..TILE {
        let mut largest = L::load(&logits[0].0[y]);
        for plane in &logits[1..weights.classes] {
            largest = largest.max(L::load(&plane.0[y]));
        }
        let mut sum = L::splat(0.0);
        for plane in &mut logits[..weights.classes] {
            let e = (L::load(&plane.0[y]) - largest).exp_nonpositive();
            e.store(&mut plane.0[y]);
            sum = sum + e;
        }
        // Turn exponentials into ∂L/∂logits: (softmax − one-hot)·scale, zero where there is no label.
        let mut used = NONE;
        let mut likelihood = 1.0f64;
        let mut sums = NONE;
        sum.store(&mut sums);
        for x in 0..TILE {
            let label = labels[y * TILE + x];
            if label != u16::MAX {
                used[x] = scale;
                // Eight factors of at least 1e-38 stay within f64.
                likelihood *= f64::from((logits[usize::from(label)].0[y][x] / sums[x]).max(1e-38));
            }
        }
        loss -= likelihood.ln();
        let factor = L::load(&used) / sum;
        for plane in &mut logits[..weights.classes] {
            (L::load(&plane.0[y]) * factor).store(&mut plane.0[y]);
        }
        for x in 0..TILE {
            let label = labels[y * TILE + x];
            if label != u16::MAX {
                logits[usize::from(label)].0[y][x] -= scale;
            }
        }
    }
    logits[weights.classes..].fill(Plane::ZERO);

    layer_gradient::<L, HIDDEN_DIM>(logits, &scratch.hidden, &mut scratch.w2, &mut scratch.b2);
    layer_transposed::<L, HIDDEN_DIM>(&weights.w2, logits, &mut scratch.d_hidden);
    for (d, h) in scratch.d_hidden.iter_mut().zip(&scratch.hidden) {
        for (d, h) in d.0.iter_mut().zip(&h.0) {
            L::load(d).and(L::load(h).gt(L::splat(0.0))).store(d);
        }
    }
    let inputs = &image.channels[AFFINITY_CHANNEL..];
    layer_gradient::<L, AFFINITY_DIM>(&scratch.d_hidden, inputs, &mut scratch.w1, &mut scratch.b1);
    layer_transposed::<L, AFFINITY_DIM>(&weights.w1, &scratch.d_hidden, channels);
    loss
}

by_simd! {
    /// Segmentation term of one tile.
    fn tile_cross_entropy = cross_entropy(
        weights: &Weights, image: &TileImage, labels: &[u16; TILE * TILE], scale: f32, scratch: &mut Scratch,
        gradient: &mut TileGradient,
    ) -> f64
}

#[inline(always)]
fn most_likely<L: Lanes>(
    weights: &Weights,
    image: &TileImage,
    scratch: &mut Scratch,
    labels: &mut [u16; TILE * TILE],
) {
    forward::<L>(weights, image, scratch);
    for (i, label) in labels.iter_mut().enumerate() {
        let logit = |k: usize| scratch.logits[k].0[i / TILE][i % TILE];
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
        weights: &Weights, image: &TileImage, scratch: &mut Scratch, labels: &mut [u16; TILE * TILE],
    )
}
