//! The per-pixel losses of one tile and their gradients: colour, depth, normals (paper, Section "Scan").

use super::lanes::{Lanes, WIDTH, by_simd};
use super::raster::{
    COLOR_CHANNEL, DEPTH_CHANNEL, NORMAL_CHANNEL, OPACITY_CHANNEL, TILE, TileGradient, TileImage,
};
use super::ssim::{RowLayout, STATISTICS};
use super::target::TargetTile;
use crate::DepthTerm;

/// Depth is divided by no less than this opacity: below it a pixel says little about depth.
pub const DEPTH_OPACITY_MIN: f64 = 0.05;

/// What one pixel's absolute error counts in the total: weight over number of pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct PixelWeights {
    /// Per colour value.
    pub(super) color: f32,
    pub(super) depth: f32,
    pub(super) normal: f32,
    pub(super) depth_term: DepthTerm,
}

/// Σ |error| of a tile.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PixelSums {
    pub(super) color: f64,
    pub(super) depth: f64,
    pub(super) normal: f64,
}

/// Mask of usable colours: all lanes but NaN.
#[inline(always)]
pub(super) fn usable<L: Lanes>(color: L) -> L {
    color.ge(color)
}

/// Writes the gradient of colour, depth, normal and opacity channels; `ssim` holds the colour gradient of SSIM from
/// row `row` and column `column` on.
#[inline(always)]
fn pixel_losses<L: Lanes>(
    image: &TileImage,
    target: &TargetTile,
    weights: PixelWeights,
    (layout, ssim, row, column): (RowLayout, &mut [f32], usize, usize),
    gradient: &mut TileGradient,
) -> PixelSums {
    let (zero, one) = (L::splat(0.0), L::splat(1.0));
    let (mut color_sum, mut depth_sum, mut normal_sum) = (zero, zero, zero);
    for y in 0..TILE {
        let color_weight = L::splat(weights.color);
        for c in 0..3 {
            let observed = L::load(&target.color[c].0[y]);
            let mask = usable(observed);
            let error = (L::load(&image.channels[COLOR_CHANNEL + c].0[y]) - observed).and(mask);
            color_sum = color_sum + error.abs();
            let similarity = L::load(layout.chunk_mut(ssim, row + y, c, column)).and(mask);
            let g = error.signum().mul_add(color_weight, similarity);
            g.store(&mut gradient.channels[COLOR_CHANNEL + c].0[y]);
        }

        let observed = L::load(&target.depth.0[y]);
        let mask = observed.gt(zero);
        let blended = L::load(&image.channels[DEPTH_CHANNEL].0[y]);
        let opacity = one - L::load(&image.transmittance.0[y]);
        let least = L::splat(DEPTH_OPACITY_MIN as f32);
        let divisor = match weights.depth_term {
            DepthTerm::Accumulated => one,
            DepthTerm::Detached | DepthTerm::Normalized => opacity.max(least),
        };
        let depth = blended / divisor;
        let error = (depth - observed).and(mask);
        depth_sum = depth_sum + error.abs();
        let g = error.signum() * L::splat(weights.depth) / divisor;
        g.store(&mut gradient.channels[DEPTH_CHANNEL].0[y]);
        let through_opacity = match weights.depth_term {
            DepthTerm::Normalized => (zero - g * depth).and(opacity.gt(least)),
            DepthTerm::Accumulated | DepthTerm::Detached => zero,
        };
        through_opacity.store(&mut gradient.channels[OPACITY_CHANNEL].0[y]);

        let normal = [0, 1, 2].map(|c| L::load(&target.normal[c].0[y]));
        let mask = (normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]).gt(zero);
        for c in 0..3 {
            let error = (L::load(&image.channels[NORMAL_CHANNEL + c].0[y]) - normal[c]).and(mask);
            normal_sum = normal_sum + error.abs();
            let g = error.signum() * L::splat(weights.normal);
            g.store(&mut gradient.channels[NORMAL_CHANNEL + c].0[y]);
        }
    }
    PixelSums {
        color: f64::from(color_sum.sum()),
        depth: f64::from(depth_sum.sum()),
        normal: f64::from(normal_sum.sum()),
    }
}

by_simd! {
    /// Colour, depth and normal terms of one tile.
    fn tile_losses = pixel_losses(
        image: &TileImage, target: &TargetTile, weights: PixelWeights,
        ssim: (RowLayout, &mut [f32], usize, usize), gradient: &mut TileGradient,
    ) -> PixelSums
}

/// Writes a row of tiles' colours, observed colours, their summed squares and products where SSIM reads them; zero
/// where the observed colour must not be used. Row by row of pixels, so that memory is written in order.
#[inline(always)]
fn moments_of_colors<L: Lanes>(
    images: &[TileImage],
    targets: &[TargetTile],
    (layout, band, row): (RowLayout, &mut [f32], usize),
) {
    for y in 0..TILE {
        for c in 0..3 {
            for (i, (image, target)) in images.iter().zip(targets).enumerate() {
                let observed = L::load(&target.color[c].0[y]);
                let mask = usable(observed);
                let observed = observed.and(mask);
                let rendered = L::load(&image.channels[COLOR_CHANNEL + c].0[y]).and(mask);
                let squares = rendered * rendered + observed * observed;
                let values = [rendered, observed, squares, rendered * observed];
                for (k, value) in values.into_iter().enumerate() {
                    value.store(layout.chunk_mut(band, row + y, STATISTICS * c + k, i * TILE));
                }
            }
        }
    }
}

by_simd! {
    /// Fills the planes that SSIM reads, for a row of tiles.
    fn tile_moments = moments_of_colors(
        images: &[TileImage], targets: &[TargetTile], to: (RowLayout, &mut [f32], usize),
    )
}

const _: () = assert!(TILE == WIDTH);
