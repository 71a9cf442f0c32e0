//! The per-pixel losses of one tile and their gradients: colour, depth, normals (paper, Section "Scan").

use super::bands::BandSums;
use super::lanes::{Lanes, array, by_simd};
use super::planes::{PaddedPlanes, RowLayout};
use super::target::TargetTile;
use super::tile::{
    COLOR_CHANNEL, DEPTH_CHANNEL, NORMAL_CHANNEL, OPACITY_CHANNEL, PATCH_ROWS, PATCHES, PatchGradient, TILE,
    TileImage,
};
use crate::DepthTerm;

/// Smallest opacity for the division of depth: below it a pixel has little information on depth.
pub const DEPTH_OPACITY_MIN: f64 = 0.05;

/// Weight of one pixel's absolute error in the total: the term's weight over the number of pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct PixelWeights {
    /// Per colour value.
    pub(super) color: f32,
    pub(super) depth: f32,
    pub(super) normal: f32,
    pub(super) depth_term: DepthTerm,
}

/// The gradient of SSIM with respect to the colours of a band, and the band's first row.
#[derive(Clone, Copy)]
pub(super) struct BandGradient<'a> {
    pub(super) layout: RowLayout,
    pub(super) rows: &'a [f32],
    /// First row of the band in the image.
    pub(super) first: usize,
}

/// Writes the gradient of the colour, depth, normal and opacity channels of the tile whose first pixel is at `corner`,
/// and adds Σ |error| to `sums`.
#[inline(always)]
fn pixel_losses<L: Lanes>(
    image: &TileImage,
    target: &TargetTile,
    observed: &PaddedPlanes,
    corner: (usize, usize),
    weights: PixelWeights,
    ssim: BandGradient<'_>,
    gradient: &mut [PatchGradient; PATCHES],
    sums: &mut BandSums,
) {
    let (zero, one) = (L::splat(0.0), L::splat(1.0));
    let (mut color_sum, mut depth_sum, mut normal_sum) = (zero, zero, zero);
    for p in 0..PATCHES {
        let (image, gradient) = (&image[p].channels, &mut gradient[p].channels);
        let (x, y) = (corner.0, corner.1 + p * PATCH_ROWS);
        let color_weight = L::splat(weights.color);
        let mask = L::mask(target.colored[p]);
        for c in 0..3 {
            let observed = L::load(&observed.patch((x, y), c));
            let error = (L::load(&image[COLOR_CHANNEL + c]) - observed).keep(mask);
            color_sum = color_sum + error.abs();
            let similarity = L::load(&ssim.layout.patch(ssim.rows, (x, y - ssim.first), c)).keep(mask);
            error.signum().mul_add(color_weight, similarity).store(&mut gradient[COLOR_CHANNEL + c]);
        }

        let observed = L::load(&target.depth.0[p]);
        let mask = observed.gt(zero);
        let blended = L::load(&image[DEPTH_CHANNEL]);
        let opacity = L::load(&image[OPACITY_CHANNEL]);
        let least = L::splat(DEPTH_OPACITY_MIN as f32);
        let share = match weights.depth_term {
            DepthTerm::Accumulated => one,
            DepthTerm::Detached | DepthTerm::Normalized => one / opacity.max(least),
        };
        let depth = blended * share;
        let error = (depth - observed).keep(mask);
        depth_sum = depth_sum + error.abs();
        let g = error.signum() * L::splat(weights.depth) * share;
        g.store(&mut gradient[DEPTH_CHANNEL]);
        let through_opacity = match weights.depth_term {
            DepthTerm::Normalized => (g * depth).negated().keep(opacity.gt(least)),
            DepthTerm::Accumulated | DepthTerm::Detached => zero,
        };
        through_opacity.store(&mut gradient[OPACITY_CHANNEL]);

        let normal = array!(3, |c| L::load(&target.normal[c].0[p]));
        let mask = (normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]).gt(zero);
        for c in 0..3 {
            let error = (L::load(&image[NORMAL_CHANNEL + c]) - normal[c]).keep(mask);
            normal_sum = normal_sum + error.abs();
            (error.signum() * L::splat(weights.normal)).store(&mut gradient[NORMAL_CHANNEL + c]);
        }
    }
    sums.color += f64::from(color_sum.sum());
    sums.depth += f64::from(depth_sum.sum());
    sums.normal += f64::from(normal_sum.sum());
}

by_simd! {
    /// Colour, depth and normal terms of one tile.
    fn tile_losses = pixel_losses(
        image: &TileImage, target: &TargetTile, observed: &PaddedPlanes, corner: (usize, usize), weights: PixelWeights,
        ssim: BandGradient<'_>, gradient: &mut [PatchGradient; PATCHES], sums: &mut BandSums,
    )
}

/// Writes the colours of a row of tiles for SSIM, starting at `row` of the band; zero where the observed colour must
/// not be used.
#[inline(always)]
fn rows_of_colors<L: Lanes>(
    images: &[TileImage],
    targets: &[TargetTile],
    (layout, band, row): (RowLayout, &mut [f32], usize),
) {
    for p in 0..PATCHES {
        for c in 0..3 {
            for (i, (image, target)) in images.iter().zip(targets).enumerate() {
                let mut color = image[p].channels[COLOR_CHANNEL + c];
                L::load(&color).keep(L::mask(target.colored[p])).store(&mut color);
                layout.set_patch(band, (i * TILE, row + p * PATCH_ROWS), c, &color);
            }
        }
    }
}

by_simd! {
    /// Fills the planes that SSIM reads, for a row of tiles.
    fn tile_rows = rows_of_colors(
        images: &[TileImage], targets: &[TargetTile], to: (RowLayout, &mut [f32], usize),
    )
}
