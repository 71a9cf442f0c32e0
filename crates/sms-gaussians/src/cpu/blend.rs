//! Alpha blending of depth-ordered splats (Kerbl et al. 2023).
//!
//! Each patch processes its list in blocks. First come the weights α·T of the block's splats, with a short dependency
//! chain through the transmittance, then the channels, which stay in registers for the whole block.

use super::lanes::{Chunk, Lanes, NONE, by_simd};
use super::prefetch::prefetch;
use super::tile::{
    AFFINITY_CHANNEL, COLOR_CHANNEL, DEPTH_CHANNEL, FLAT, OPACITY_CHANNEL, PatchImage, PatchPlace, Splat,
    TRANSMITTANCE_MIN, alpha,
};

/// Number of splats in a block.
const BLOCK: usize = 32;
/// Distance of prefetching, in splats.
const AHEAD: usize = 8;

/// Weights of some splats of a patch.
#[repr(C, align(64))]
struct BlendBlock {
    weight: [Chunk; BLOCK],
    splat: [u32; BLOCK],
}

/// Blends the splats of `list` (indices into `splats`, nearest first) over the background. Compacts `list` to the
/// splats that reach a pixel, returns their number, and marks them in `reached`. Without `affinity`, the affinity
/// channels stay zero.
#[inline(always)]
fn blend<L: Lanes>(
    splats: &[Splat],
    list: &mut [u32],
    place: PatchPlace,
    background: [f32; 3],
    affinity: bool,
    image: &mut PatchImage,
    reached: &mut [bool],
) -> usize {
    let channels = &mut image.channels;
    channels[..FLAT].fill(NONE);
    let centers = place.centers::<L>();
    let least = L::splat(TRANSMITTANCE_MIN);
    let mut transmittance = place.inside::<L>();
    let mut depth = L::splat(0.0);
    let mut block = BlendBlock { weight: [NONE; BLOCK], splat: [0; BLOCK] };
    let mut used = 0;
    for first in (0..list.len()).step_by(BLOCK) {
        if !L::any(transmittance.gt(least)) {
            break;
        }
        let mut n = 0;
        for i in first..list.len().min(first + BLOCK) {
            if let Some(next) = list.get(i + AHEAD) {
                prefetch(&splats[*next as usize]);
            }
            let position = list[i];
            let splat = &splats[position as usize];
            let alpha = alpha::<L>(splat, centers);
            let taken = L::both(alpha.enough, transmittance.gt(least));
            let weight = alpha.value.keep(taken) * transmittance;
            transmittance = transmittance - weight;
            depth = weight.mul_add(alpha.depth, depth);
            // Branchless, since it is hard to predict whether a splat reaches the patch.
            let any = L::any(taken);
            weight.store(&mut block.weight[n]);
            block.splat[n] = position;
            list[used + n] = position;
            reached[position as usize] |= any;
            n += usize::from(any);
        }
        used += n;
        if !L::MANY_REGISTERS {
            accumulate::<L, 6>(splats, &block, n, COLOR_CHANNEL, channels);
            if affinity {
                accumulate::<L, 6>(splats, &block, n, AFFINITY_CHANNEL, channels);
                accumulate::<L, 6>(splats, &block, n, AFFINITY_CHANNEL + 6, channels);
                accumulate::<L, 4>(splats, &block, n, AFFINITY_CHANNEL + 12, channels);
            }
        } else if affinity {
            accumulate::<L, FLAT>(splats, &block, n, COLOR_CHANNEL, channels);
        } else {
            accumulate::<L, 6>(splats, &block, n, COLOR_CHANNEL, channels);
        }
    }
    for (channel, b) in channels[COLOR_CHANNEL..].iter_mut().zip(background) {
        transmittance.mul_add(L::splat(b), L::load(channel)).store(channel);
    }
    depth.store(&mut channels[DEPTH_CHANNEL]);
    // Pixels outside the image count as transparent too, but are never read.
    (L::splat(1.0) - transmittance).store(&mut channels[OPACITY_CHANNEL]);
    used
}

/// `channels[first..first + N] += Σ over the first `n` splats of the block of weight · feature`.
#[inline(always)]
fn accumulate<L: Lanes, const N: usize>(
    splats: &[Splat],
    block: &BlendBlock,
    n: usize,
    first: usize,
    channels: &mut [Chunk],
) {
    let channels: &mut [Chunk; N] =
        (&mut channels[first..first + N]).try_into().expect("a slice of that length");
    let mut sums = [L::splat(0.0); N];
    for (sum, channel) in sums.iter_mut().zip(&*channels) {
        *sum = L::load(channel);
    }
    for (weight, position) in block.weight[..n].iter().zip(&block.splat[..n]) {
        let weight = L::load(weight);
        let features = &splats[*position as usize].features[first..first + N];
        for (sum, feature) in sums.iter_mut().zip(features) {
            *sum = L::splat(*feature).mul_add(weight, *sum);
        }
    }
    for (sum, channel) in sums.iter().zip(channels) {
        sum.store(channel);
    }
}

by_simd! {
    /// Blends one patch: see the module.
    fn blend_patch = blend(
        splats: &[Splat], list: &mut [u32], place: PatchPlace, background: [f32; 3], affinity: bool,
        image: &mut PatchImage, reached: &mut [bool],
    ) -> usize
}
