//! Median depth of a patch: the depth of the splat at which the accumulated opacity reaches half of its final
//! value. For rendering only.
//!
//! Expected depth lies between the surfaces wherever several contribute: at silhouettes and behind faint splats.
//! The median is the depth of one of them.

use super::lanes::{Chunk, Lanes, by_simd};
use super::tile::{OPACITY_CHANNEL, PatchImage, PatchPlace, Splat, TRANSMITTANCE_MIN, alpha};

/// Replays the blending of `image` from the splats of `list` that reach a pixel and writes, at each pixel, the
/// depth of the splat at which 1 − T reaches half of the accumulated opacity; 0 where nothing is visible.
#[inline(always)]
fn median<L: Lanes>(splats: &[Splat], list: &[u32], place: PatchPlace, image: &PatchImage, out: &mut Chunk) {
    let centers = place.centers::<L>();
    let least = L::splat(TRANSMITTANCE_MIN);
    let half = L::splat(-0.5).mul_add(L::load(&image.channels[OPACITY_CHANNEL]), L::splat(1.0));
    let mut transmittance = place.inside::<L>();
    let mut depth = L::splat(0.0);
    for &position in list {
        let alpha = alpha::<L>(&splats[position as usize], centers);
        let taken = L::both(alpha.enough, transmittance.gt(least));
        let after = transmittance - alpha.value.keep(taken) * transmittance;
        let crossed = L::both(taken, L::both(transmittance.gt(half), half.ge(after)));
        depth = alpha.depth.or_where_not(crossed, depth);
        transmittance = after;
    }
    depth.store(out);
}

by_simd! {
    /// Median depth of one patch: see the module.
    fn median_patch = median(
        splats: &[Splat], list: &[u32], place: PatchPlace, image: &PatchImage, out: &mut Chunk,
    )
}
