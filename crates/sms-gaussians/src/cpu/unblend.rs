//! The gradient of blending, replayed front to back with two numbers per pixel (design, section 6): with s_k =
//! F_k·∂L/∂out, transmittance T and remainder rem = Σ_{j≥k} w_j s_j, ∂L/∂α_k = T s_k − rem_{>k}/(1 − α_k). The
//! background acts as a last, opaque splat. Its share T_final·b is part of the output, and so of every remainder.
//!
//! Sums over the pixels of a patch are matrix products: the weights w of the splats times the gradients of a pixel's
//! channels, and v = ∂L/∂(ln α) times the powers of its coordinates. The resulting moments are then moved to the centre
//! of the splat.

use super::lanes::{Chunk, Lanes, NONE, WIDTH, by_simd};
use super::prefetch::prefetch;
use super::tile::{
    AFFINITY_CHANNEL, CHANNELS, DEPTH_CHANNEL, DEPTH_COLUMN, MOMENTS, OPACITY_CHANNEL, PatchGradient,
    PatchImage, PatchPlace, Splat, SplatGradient, TRANSMITTANCE_MIN, alpha,
};
use crate::AFFINITY_DIM;

/// Splats per block of the passes.
const BLOCK: usize = 16;

/// Intermediate results per splat and pixel.
#[repr(C, align(64))]
struct UnblendBlock {
    /// α·T.
    weight: [Chunk; BLOCK],
    /// α·T, zero where alpha was cut off.
    free_weight: [Chunk; BLOCK],
    /// α/(1 − α), zero where alpha was cut off.
    ratio: [Chunk; BLOCK],
    /// The pixel-dependent part of s: depth and opacity.
    score: [Chunk; BLOCK],
    /// v.
    slope: [Chunk; BLOCK],
    splat: [u32; BLOCK],
}

const EMPTY: UnblendBlock = UnblendBlock {
    weight: [NONE; BLOCK],
    free_weight: [NONE; BLOCK],
    ratio: [NONE; BLOCK],
    score: [NONE; BLOCK],
    slope: [NONE; BLOCK],
    splat: [0; BLOCK],
};

/// Factors of one pixel: first the row of [`SplatGradient::geometry`], then affinity.
#[repr(C, align(64))]
struct PixelFactors {
    geometry: [Chunk; WIDTH],
    affinity: [Chunk; WIDTH],
}

/// Adds the gradients of a patch to those of its splats. `list` must hold the splats that reach a pixel, and `gradient`
/// ∂L/∂(channels) of the blended `image`. Without `affinity`, the affinity channels of `gradient` count as zero.
#[inline(always)]
fn unblend<L: Lanes>(
    splats: &[Splat],
    list: &[u32],
    place: PatchPlace,
    affinity: bool,
    image: &PatchImage,
    gradient: &PatchGradient,
    gradients: &mut [SplatGradient],
) {
    let centers = place.centers::<L>();
    let factors = factors::<L>(gradient, affinity);
    let mut remainder = L::splat(0.0);
    for c in 0..CHANNELS {
        if affinity || !(AFFINITY_CHANNEL..AFFINITY_CHANNEL + AFFINITY_DIM).contains(&c) {
            remainder = L::load(&image.channels[c]).mul_add(L::load(&gradient.channels[c]), remainder);
        }
    }
    let mut transmittance = place.inside::<L>();
    let mut block = EMPTY;
    for first in (0..list.len()).step_by(BLOCK) {
        let (list, next) = list[first..].split_at(BLOCK.min(list.len() - first));
        for position in list {
            prefetch(&gradients[*position as usize]);
        }
        weights::<L>(splats, list, centers, gradient, &mut transmittance, &mut block);
        for position in &next[..BLOCK.min(next.len())] {
            prefetch(&splats[*position as usize]);
        }
        match (L::MANY_REGISTERS, affinity) {
            (true, true) => slopes::<L, 8, FULL>(splats, list.len(), gradient, &mut remainder, &mut block),
            (true, false) => slopes::<L, 8, SHORT>(splats, list.len(), gradient, &mut remainder, &mut block),
            (false, true) => slopes::<L, 4, FULL>(splats, list.len(), gradient, &mut remainder, &mut block),
            (false, false) => slopes::<L, 4, SHORT>(splats, list.len(), gradient, &mut remainder, &mut block),
        }
        match (L::MANY_REGISTERS, affinity) {
            (true, true) => sums::<L, 4, 2>(splats, list.len(), place, &factors, &block, gradients),
            (true, false) => sums::<L, 8, 1>(splats, list.len(), place, &factors, &block, gradients),
            (false, true) => sums::<L, 2, 2>(splats, list.len(), place, &factors, &block, gradients),
            (false, false) => sums::<L, 4, 1>(splats, list.len(), place, &factors, &block, gradients),
        }
    }
}

/// Number of channels in s besides depth and opacity, with and without affinity.
const FULL: usize = DEPTH_CHANNEL;
const SHORT: usize = AFFINITY_CHANNEL;

/// Powers of a pixel's coordinates relative to the patch's centre: 1, x, y, x², xy, y².
const POWERS: [Chunk; 6] = {
    let mut powers = [NONE; 6];
    let mut i = 0;
    while i < WIDTH {
        let (x, y) = ((i % 8) as f32 - 3.5, (i / 8) as f32 - 0.5);
        let values = [1.0, x, y, x * x, x * y, y * y];
        let mut k = 0;
        while k < 6 {
            powers[k][i] = values[k];
            k += 1;
        }
        i += 1;
    }
    powers
};

#[inline(always)]
fn factors<L: Lanes>(gradient: &PatchGradient, affinity: bool) -> PixelFactors {
    let mut rows = [L::splat(0.0); WIDTH];
    for c in 0..AFFINITY_CHANNEL {
        rows[c] = L::load(&gradient.channels[c]);
    }
    rows[DEPTH_COLUMN] = L::load(&gradient.channels[DEPTH_CHANNEL]);
    for k in 0..POWERS.len() {
        rows[MOMENTS + k] = L::load(&POWERS[k]);
    }
    let mut factors = PixelFactors { geometry: [NONE; WIDTH], affinity: [NONE; WIDTH] };
    for (row, to) in L::transpose(rows).into_iter().zip(&mut factors.geometry) {
        row.store(to);
    }
    if affinity {
        for c in 0..AFFINITY_DIM {
            rows[c] = L::load(&gradient.channels[AFFINITY_CHANNEL + c]);
        }
        for (row, to) in L::transpose(rows).into_iter().zip(&mut factors.affinity) {
            row.store(to);
        }
    }
    factors
}

/// First pass: recomputes the forward pass. Entries beyond the list are cleared, so that whole groups can be
/// computed.
#[inline(always)]
fn weights<L: Lanes>(
    splats: &[Splat],
    list: &[u32],
    centers: (L, L),
    gradient: &PatchGradient,
    transmittance: &mut L,
    block: &mut UnblendBlock,
) {
    let (one, least) = (L::splat(1.0), L::splat(TRANSMITTANCE_MIN));
    let d_depth = L::load(&gradient.channels[DEPTH_CHANNEL]);
    let d_opacity = L::load(&gradient.channels[OPACITY_CHANNEL]);
    for (i, &position) in list.iter().enumerate() {
        let splat = &splats[position as usize];
        let alpha = alpha::<L>(splat, centers);
        let value = alpha.value.keep(L::both(alpha.enough, transmittance.gt(least)));
        let weight = value * *transmittance;
        *transmittance = *transmittance - weight;
        weight.store(&mut block.weight[i]);
        weight.keep(alpha.free).store(&mut block.free_weight[i]);
        (value.keep(alpha.free) * (one - value).reciprocal()).store(&mut block.ratio[i]);
        alpha.depth.mul_add(d_depth, d_opacity).store(&mut block.score[i]);
        block.splat[i] = position;
    }
    for i in list.len()..BLOCK {
        for of in [&mut block.weight, &mut block.free_weight, &mut block.ratio, &mut block.score] {
            of[i] = NONE;
        }
        block.splat[i] = block.splat[0];
    }
}

/// Second pass: computes s of `GROUP` splats at a time, then v in the order of the splats.
#[inline(always)]
fn slopes<L: Lanes, const GROUP: usize, const COUNT: usize>(
    splats: &[Splat],
    count: usize,
    gradient: &PatchGradient,
    remainder: &mut L,
    block: &mut UnblendBlock,
) {
    for first in (0..count).step_by(GROUP) {
        let features: [&[f32; COUNT]; GROUP] = std::array::from_fn(|i| {
            let splat = &splats[block.splat[first + i] as usize];
            splat.features.first_chunk().expect("no more than there are")
        });
        let mut score = [L::splat(0.0); GROUP];
        for i in 0..GROUP {
            score[i] = L::load(&block.score[first + i]);
        }
        for c in 0..COUNT {
            let g = L::load(&gradient.channels[c]);
            for i in 0..GROUP {
                score[i] = L::splat(features[i][c]).mul_add(g, score[i]);
            }
        }
        for i in 0..GROUP {
            let k = first + i;
            *remainder = L::load(&block.weight[k]).neg_mul_add(score[i], *remainder);
            let back = *remainder * L::load(&block.ratio[k]);
            (L::load(&block.free_weight[k]) * score[i] - back).store(&mut block.slope[k]);
        }
    }
}

/// Third pass: the sums over pixels, `GROUP` splats at a time; `PARTS` is 2 with affinity, 1 without.
#[inline(always)]
fn sums<L: Lanes, const GROUP: usize, const PARTS: usize>(
    splats: &[Splat],
    count: usize,
    place: PatchPlace,
    factors: &PixelFactors,
    block: &UnblendBlock,
    gradients: &mut [SplatGradient],
) {
    for first in (0..count).step_by(GROUP) {
        let mut sums = [[L::splat(0.0); PARTS]; GROUP];
        let weight: &[Chunk; GROUP] = block.weight[first..].first_chunk().expect("whole groups");
        let slope: &[Chunk; GROUP] = block.slope[first..].first_chunk().expect("whole groups");
        for pixel in 0..WIDTH {
            let geometry = L::load(&factors.geometry[pixel]);
            for i in 0..GROUP {
                let by = L::joined(weight[i][pixel], slope[i][pixel]);
                sums[i][0] = geometry.mul_add(by, sums[i][0]);
            }
            if PARTS > 1 {
                let affinity = L::load(&factors.affinity[pixel]);
                for i in 0..GROUP {
                    sums[i][PARTS - 1] = affinity.mul_add(L::splat(weight[i][pixel]), sums[i][PARTS - 1]);
                }
            }
        }
        for i in 0..GROUP.min(count - first) {
            let position = block.splat[first + i] as usize;
            let mut geometry = NONE;
            sums[i][0].store(&mut geometry);
            let mean = splats[position].mean;
            move_moments(&mut geometry, place.x + 4.0 - mean[0], place.y + 1.0 - mean[1]);
            let gradient = &mut gradients[position];
            (L::load(&gradient.geometry) + L::load(&geometry)).store(&mut gradient.geometry);
            if PARTS > 1 {
                (L::load(&gradient.affinity) + sums[i][PARTS - 1]).store(&mut gradient.affinity);
            }
        }
    }
}

/// Moves the origin of the moments to a point at (−x, −y).
#[inline(always)]
fn move_moments(geometry: &mut Chunk, x: f32, y: f32) {
    let moments: &mut [f32; 6] = geometry.last_chunk_mut().expect("no more than there are");
    let [v, vx, vy, vxx, vxy, vyy] = *moments;
    let (moved_x, moved_y) = (vx + x * v, vy + y * v);
    *moments =
        [v, moved_x, moved_y, vxx + x * (vx + moved_x), vxy + x * vy + y * moved_x, vyy + y * (vy + moved_y)];
}

by_simd! {
    /// The gradient of one blended patch: see the module.
    fn unblend_patch = unblend(
        splats: &[Splat], list: &[u32], place: PatchPlace, affinity: bool, image: &PatchImage,
        gradient: &PatchGradient, gradients: &mut [SplatGradient],
    )
}
