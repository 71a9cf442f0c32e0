//! Data of the raster kernels. The unit is a patch: two rows of eight pixels, one lane each, four patches to a tile
//! of 8×8 pixels.

use super::lanes::{Chunk, Lanes, NONE, WIDTH, array};
use crate::AFFINITY_DIM;

/// Side of a tile in pixels.
pub(super) const TILE: usize = 8;
/// Rows of pixels in a patch.
pub(super) const PATCH_ROWS: usize = WIDTH / TILE;
/// Patches of a tile, from the top.
pub(super) const PATCHES: usize = TILE / PATCH_ROWS;
/// Rows of tiles in a band. A constant, because it shapes the order of sums.
pub(super) const BAND_TILES: usize = 2;
/// Rows of pixels in a band.
pub(super) const BAND_ROWS: usize = BAND_TILES * TILE;

/// First colour channel.
pub(super) const COLOR_CHANNEL: usize = 0;
/// First normal channel.
pub(super) const NORMAL_CHANNEL: usize = 3;
/// First affinity channel.
pub(super) const AFFINITY_CHANNEL: usize = 6;
/// The depth channel.
pub(super) const DEPTH_CHANNEL: usize = AFFINITY_CHANNEL + AFFINITY_DIM;
/// The channel of accumulated opacity.
pub(super) const OPACITY_CHANNEL: usize = DEPTH_CHANNEL + 1;
/// Channels of a blended pixel: colour 3, normal 3, affinity 16, depth, opacity.
pub(super) const CHANNELS: usize = OPACITY_CHANNEL + 1;
/// Channels with a constant feature over the pixels of a splat: all except depth and opacity, which come last. The
/// depth feature is that of a plane, the opacity feature is one.
pub(super) const FLAT: usize = DEPTH_CHANNEL;

/// Least alpha of a splat at a pixel; fainter contributions are skipped.
pub const ALPHA_MIN: f32 = 1.0 / 255.0;
/// Greatest alpha, to bound the division by 1 − α.
pub const ALPHA_MAX: f32 = 0.99;
/// A pixel is finished once its transmittance is at most this.
pub const TRANSMITTANCE_MIN: f32 = 1e-4;

/// One value per pixel of a tile, patch by patch.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct TilePlane(pub(super) [Chunk; PATCHES]);

impl TilePlane {
    pub(super) const ZERO: Self = Self([NONE; PATCHES]);

    /// The value at a pixel of the tile.
    pub(super) fn at_mut(&mut self, x: usize, y: usize) -> &mut f32 {
        &mut self.0[y / PATCH_ROWS][y % PATCH_ROWS * TILE + x]
    }
}

/// A Gaussian in the view of one camera. Alpha is 2^t, t = log₂ o + p₀·dx² + p₁·dx·dy + p₂·dy² ≤ log₂ o.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C, align(64))]
pub(super) struct Splat {
    /// Centre in the image, pixels.
    pub(super) mean: [f32; 2],
    /// Quadratic form of the exponent, log₂ per pixel²: −½·log₂e times the inverse of the 2-D covariance, its xx, 2·xy
    /// and yy.
    pub(super) power: [f32; 3],
    /// log₂ of the opacity.
    pub(super) log2_opacity: f32,
    /// Depth at the centre, metres.
    pub(super) depth: f32,
    /// Change of depth per pixel to the right and down, metres.
    pub(super) depth_slope: [f32; 2],
    pub(super) _padding: f32,
    /// Blended features, in the order of the channels.
    pub(super) features: [f32; FLAT],
}

impl Splat {
    pub(super) const ZERO: Self = Self {
        mean: [0.0; 2],
        power: [0.0; 3],
        log2_opacity: 0.0,
        depth: 0.0,
        depth_slope: [0.0; 2],
        _padding: 0.0,
        features: [0.0; FLAT],
    };
}

/// First column of [`SplatGradient::geometry`] with moments.
pub(super) const MOMENTS: usize = 10;
/// Column of [`SplatGradient::geometry`] with ∂L/∂depth.
pub(super) const DEPTH_COLUMN: usize = 6;

/// Gradient of the loss with respect to a [`Splat`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C, align(64))]
pub(super) struct SplatGradient {
    /// ∂L/∂(colour 3, normal 3, depth), three unused columns, then from [`MOMENTS`] the moments Σv, Σv·dx, Σv·dy,
    /// Σv·dx², Σv·dx·dy, Σv·dy² of v = ∂L/∂(ln α) over the pixels.
    pub(super) geometry: Chunk,
    /// ∂L/∂affinity.
    pub(super) affinity: [f32; AFFINITY_DIM],
}

impl SplatGradient {
    pub(super) const ZERO: Self = Self { geometry: NONE, affinity: [0.0; AFFINITY_DIM] };

    /// Adds another.
    #[inline(always)]
    pub(super) fn add<L: Lanes>(&mut self, other: &Self) {
        (L::load(&self.geometry) + L::load(&other.geometry)).store(&mut self.geometry);
        (L::load(&self.affinity) + L::load(&other.affinity)).store(&mut self.affinity);
    }
}

/// A blended patch.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct PatchImage {
    pub(super) channels: [Chunk; CHANNELS],
}

/// A blended tile.
pub(super) type TileImage = [PatchImage; PATCHES];

impl PatchImage {
    pub(super) const EMPTY: Self = Self { channels: [NONE; CHANNELS] };
}

/// ∂L/∂(blended channels) of a patch.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct PatchGradient {
    pub(super) channels: [Chunk; CHANNELS],
}

impl PatchGradient {
    pub(super) const ZERO: Self = Self { channels: [NONE; CHANNELS] };
}

/// Position of a patch: its first pixel, and the numbers of its columns and rows inside the image.
#[derive(Debug, Clone, Copy)]
pub(super) struct PatchPlace {
    pub(super) x: f32,
    pub(super) y: f32,
    pub(super) columns: usize,
    pub(super) rows: usize,
}

/// Horizontal pixel centres relative to the patch's first pixel.
pub(super) const CENTERS_X: Chunk =
    [0.5, 1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 7.5, 0.5, 1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 7.5];

impl PatchPlace {
    /// Pixel centres.
    #[inline(always)]
    pub(super) fn centers<L: Lanes>(&self) -> (L, L) {
        (L::load(&CENTERS_X) + L::splat(self.x), L::halves(self.y + 0.5, self.y + 1.5))
    }

    /// One inside the image, zero outside.
    #[inline(always)]
    pub(super) fn inside<L: Lanes>(&self) -> L {
        let column = L::splat(self.columns as f32).gt(L::load(&CENTERS_X));
        L::splat(1.0).keep(L::both(column, L::splat(self.rows as f32).gt(L::halves(0.5, 1.5))))
    }
}

/// The alpha of one splat at the pixels of a patch, before transmittance.
pub(super) struct Alpha<L: Lanes> {
    /// Alpha, not yet zeroed where it is below [`ALPHA_MIN`].
    pub(super) value: L,
    /// Where alpha is at least [`ALPHA_MIN`].
    pub(super) enough: L::Mask,
    /// Where alpha is below [`ALPHA_MAX`], so that it depends on the exponent.
    pub(super) free: L::Mask,
    /// Depth of the plane through the splat's centre, metres.
    pub(super) depth: L,
}

/// Alpha of a splat at the given pixel centres.
#[inline(always)]
pub(super) fn alpha<L: Lanes>(splat: &Splat, (x, y): (L, L)) -> Alpha<L> {
    let (dx, dy) = (x - L::splat(splat.mean[0]), y - L::splat(splat.mean[1]));
    let [p0, p1, p2] = array!(3, |i| L::splat(splat.power[i]));
    let opacity = L::splat(splat.log2_opacity);
    let slant = p1.mul_add(dy, p0 * dx);
    let t = dx.mul_add(slant, (p2 * dy).mul_add(dy, opacity));
    // Rounding can lift the exponent of a very eccentric splat above its maximum.
    let t = t.min(opacity);
    let most = L::splat(LOG2_ALPHA_MAX);
    let [right, down] = array!(2, |i| L::splat(splat.depth_slope[i]));
    let depth = right.mul_add(dx, down.mul_add(dy, L::splat(splat.depth)));
    Alpha { value: t.min(most).exp2(), enough: t.ge(L::splat(LOG2_ALPHA_MIN)), free: most.gt(t), depth }
}

/// log₂ of [`ALPHA_MIN`].
pub(super) const LOG2_ALPHA_MIN: f32 = -7.994_353_4;
/// log₂ of [`ALPHA_MAX`].
const LOG2_ALPHA_MAX: f32 = -0.014_499_555;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constants_are_the_logarithms_of_the_limits() {
        assert_eq!(LOG2_ALPHA_MIN, f64::from(ALPHA_MIN).log2() as f32);
        assert_eq!(LOG2_ALPHA_MAX, f64::from(ALPHA_MAX).log2() as f32);
        assert_eq!(std::mem::size_of::<Splat>(), 128);
        assert_eq!(std::mem::size_of::<SplatGradient>(), 128);
    }
}
