//! Alpha blending of depth-ordered splats over one 8×8 tile, and its gradient (Kerbl et al. 2023).
//!
//! The inner loops take four splats by two rows of pixels at a time, so that each loaded value is used several times
//! from registers. The gradient replays the tile front to back with two numbers per pixel (design, section 6):
//! with s_k = F_k·∂L/∂out, transmittance T and remainder rem = Σ_{j≥k} w_j s_j, ∂L/∂α_k = T s_k − rem_{>k}/(1 − α_k).
//! The background acts as a last, opaque splat: its share T_final·b is part of the output, hence of the remainder, and
//! is never taken from it.

use super::lanes::{Chunk, Lanes, by_simd};

/// Side of a tile in pixels.
pub(super) const TILE: usize = 8;
/// Blended channels: colour 3, normal 3, affinity 16, depth 1.
pub(super) const CHANNELS: usize = 23;
/// Channels of a gradient: the blended ones, then opacity.
pub(super) const PADDED: usize = 24;
/// First colour channel.
pub(super) const COLOR_CHANNEL: usize = 0;
/// First normal channel.
pub(super) const NORMAL_CHANNEL: usize = 3;
/// First affinity channel.
pub(super) const AFFINITY_CHANNEL: usize = 6;
/// The depth channel, the only one that varies over a splat: those before it are constant.
pub(super) const DEPTH_CHANNEL: usize = 22;
/// The gradient of the accumulated opacity.
pub(super) const OPACITY_CHANNEL: usize = 23;

/// A splat is skipped where its alpha is below this.
pub const ALPHA_MIN: f32 = 1.0 / 255.0;
/// Alpha is cut off here, so that the division by 1 − α stays bounded.
pub const ALPHA_MAX: f32 = 0.99;
/// A pixel is finished when its transmittance is no more than this.
pub const TRANSMITTANCE_MIN: f32 = 1e-4;

/// One value per pixel of a tile, row by row.
#[derive(Clone, Copy)]
#[repr(C, align(32))]
pub(super) struct Plane(pub(super) [Chunk; TILE]);

impl Plane {
    pub(super) const ZERO: Self = Self([[0.0; TILE]; TILE]);
}

/// A Gaussian as one camera sees it.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
#[repr(C, align(64))]
pub(super) struct Splat {
    /// Centre in the image, pixels.
    pub(super) mean: [f32; 2],
    /// Inverse of the 2-D covariance: xx, xy, yy.
    pub(super) conic: [f32; 3],
    pub(super) opacity: f32,
    /// Half height in pixels of the box around the pixels where alpha reaches [`ALPHA_MIN`].
    pub(super) extent_y: f32,
    /// Change of depth per pixel to the right and down, metres.
    pub(super) depth_slope: [f32; 2],
    /// What is blended; depth is that at the centre.
    pub(super) features: [f32; CHANNELS],
}

const _: () = assert!(size_of::<Splat>() == 128, "two cache lines");

/// Gradient of the loss with respect to a [`Splat`], before it is carried to the Gaussian.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C, align(64))]
pub(super) struct SplatGradient {
    /// Moments Σv, Σv·dx, Σv·dy, Σv·dx², Σv·dx·dy, Σv·dy² of v = ∂L/∂power over the pixels, then two zeros.
    pub(super) moments: [f32; 8],
    /// ∂L/∂features, and one more place for whole vectors.
    pub(super) features: [f32; PADDED],
}

impl SplatGradient {
    pub(super) const ZERO: Self = Self { moments: [0.0; 8], features: [0.0; PADDED] };

    /// Adds another.
    pub(super) fn add(&mut self, other: &Self) {
        for (a, b) in self.moments.iter_mut().zip(&other.moments) {
            *a += b;
        }
        for (a, b) in self.features.iter_mut().zip(&other.features) {
            *a += b;
        }
    }
}

/// A blended tile.
#[derive(Clone)]
#[repr(C, align(64))]
pub(super) struct TileImage {
    /// What is left of the light, T.
    pub(super) transmittance: Plane,
    pub(super) channels: [Plane; CHANNELS],
    /// Length of the part of the tile's list that was needed.
    pub(super) visited: u32,
}

impl TileImage {
    pub(super) const EMPTY: Self =
        Self { transmittance: Plane::ZERO, channels: [Plane::ZERO; CHANNELS], visited: 0 };
}

/// ∂L/∂(blended channels and opacity) of a tile.
#[derive(Clone)]
#[repr(C, align(64))]
pub(super) struct TileGradient {
    pub(super) channels: [Plane; PADDED],
    by_pixel: [[[Chunk; 3]; TILE]; TILE],
    remainder: Plane,
}

impl TileGradient {
    pub(super) const ZERO: Self = Self {
        channels: [Plane::ZERO; PADDED],
        by_pixel: [[[[0.0; TILE]; 3]; TILE]; TILE],
        remainder: Plane::ZERO,
    };
}

/// Where a tile lies: first pixel, and how many of its columns and rows are inside the image.
#[derive(Debug, Clone, Copy)]
pub(super) struct TilePlace {
    pub(super) x: f32,
    pub(super) y: f32,
    pub(super) columns: usize,
    pub(super) rows: usize,
}

/// Pixel centres relative to the tile's first pixel.
const CENTERS: Chunk = [0.5, 1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 7.5];

/// Up to four splats that take part in a tile.
struct Batch {
    len: usize,
    /// Position of each splat in the band's list.
    index: [usize; 4],
    /// Rows that any of them touches.
    rows: (usize, usize),
    weight: [Plane; 4],
}

impl Batch {
    const EMPTY: Self = Self { len: 0, index: [0; 4], rows: (TILE, 0), weight: [Plane::ZERO; 4] };

    /// Rows as whole pairs.
    #[inline(always)]
    fn row_pairs(&self) -> (usize, usize) {
        (self.rows.0 & !1, self.rows.1)
    }

    /// Clears the unused places so that full blocks can be computed.
    #[inline(always)]
    fn complete(&mut self) {
        for j in self.len..4 {
            self.weight[j] = Plane::ZERO;
            self.index[j] = self.index[0];
        }
    }

    #[inline(always)]
    fn clear(&mut self) {
        self.len = 0;
        self.rows = (TILE, 0);
    }
}

/// Rows of the tile whose pixel centres lie within the splat's box.
#[inline(always)]
fn row_range(splat: &Splat, tile_y: f32) -> (usize, usize) {
    let center = splat.mean[1] - tile_y - 0.5;
    // Conversion to an integer rounds down what the clamp leaves; a row too many does no harm.
    let whole = |y: f32| (y + 1.0).clamp(0.0, TILE as f32) as usize;
    (whole(center - splat.extent_y), whole(center + splat.extent_y))
}

/// Alpha in the given rows (zero where the splat does not take part); returns the rows between the first and the last
/// in which it reaches a pixel.
#[inline(always)]
fn alphas<L: Lanes>(
    splat: &Splat,
    place: TilePlace,
    rows: (usize, usize),
    transmittance: &Plane,
    alpha: &mut Plane,
) -> (usize, usize) {
    let dx = L::load(&CENTERS) + L::splat(place.x - splat.mean[0]);
    let [a, b, c] = splat.conic;
    let xx = dx * dx * L::splat(-0.5 * a);
    let (smallest, largest) = (L::splat(ALPHA_MIN), L::splat(ALPHA_MAX));
    let opacity = L::splat(splat.opacity);
    let mut reached = 0u32;
    for y in rows.0..rows.1 {
        let dy = place.y + y as f32 + 0.5 - splat.mean[1];
        let power = L::splat(-b * dy).mul_add(dx, xx + L::splat(-0.5 * c * dy * dy));
        // Rounding can lift the power of a very eccentric splat above zero.
        let value = (opacity * power.min(L::splat(0.0)).exp_nonpositive()).min(largest);
        let live = L::load(&transmittance.0[y]).gt(L::splat(TRANSMITTANCE_MIN));
        let taken = value.ge(smallest).and(live);
        reached |= u32::from(taken.any()) << y;
        value.and(taken).store(&mut alpha.0[y]);
    }
    // Without a branch in the loop: whether a row is reached is hard to predict.
    (reached.trailing_zeros() as usize, (u32::BITS - reached.leading_zeros()) as usize)
}

/// Blends the splats of `list` (indices into `splats`, nearest first) over the background and marks those that reached
/// a pixel.
#[inline(always)]
fn blend<L: Lanes>(
    splats: &[Splat],
    list: &[u32],
    place: TilePlace,
    background: [f32; 3],
    image: &mut TileImage,
    reached: &mut [bool],
) {
    let TileImage { transmittance, channels, visited } = image;
    *channels = [Plane::ZERO; CHANNELS];
    *transmittance = Plane::ZERO;
    for row in &mut transmittance.0[..place.rows] {
        row[..place.columns].fill(1.0);
    }
    let mut batch = Batch::EMPTY;
    let mut alpha = Plane::ZERO;
    let mut next = 0;
    loop {
        if batch.len == 4 || (next == list.len() && batch.len > 0) {
            batch.complete();
            add_weighted::<L>(splats, &batch, channels);
            batch.clear();
            let mut most = L::load(&transmittance.0[0]);
            for row in &transmittance.0[1..] {
                most = most.max(L::load(row));
            }
            if !most.gt(L::splat(TRANSMITTANCE_MIN)).any() {
                break;
            }
        }
        let Some(&index) = list.get(next) else {
            break;
        };
        next += 1;
        let splat = &splats[index as usize];
        let rows = row_range(splat, place.y);
        let rows = alphas::<L>(splat, place, rows, transmittance, &mut alpha);
        if rows.0 >= rows.1 {
            continue;
        }
        reached[index as usize] = true;
        let weight = &mut batch.weight[batch.len];
        *weight = Plane::ZERO;
        let (first, down) = depth_rows::<L>(splat, place);
        let mut depth = down.mul_add(L::splat(rows.0 as f32), first);
        for y in rows.0..rows.1 {
            let t = L::load(&transmittance.0[y]);
            let w = L::load(&alpha.0[y]) * t;
            w.store(&mut weight.0[y]);
            (t - w).store(&mut transmittance.0[y]);
            let out = &mut channels[DEPTH_CHANNEL].0[y];
            depth.mul_add(w, L::load(out)).store(out);
            depth = depth + down;
        }
        batch.index[batch.len] = index as usize;
        batch.rows = (batch.rows.0.min(rows.0), batch.rows.1.max(rows.1));
        batch.len += 1;
    }
    *visited = next as u32;
    for (channel, b) in channels[COLOR_CHANNEL..].iter_mut().zip(background) {
        for (out, left) in channel.0.iter_mut().zip(&transmittance.0) {
            L::load(left).mul_add(L::splat(b), L::load(out)).store(out);
        }
    }
}

/// Depths of a splat at the pixel centres of the tile's first row, from the plane through its centre, and their change
/// from row to row.
#[inline(always)]
pub(super) fn depth_rows<L: Lanes>(splat: &Splat, place: TilePlace) -> (L, L) {
    let [right, down] = splat.depth_slope;
    let first = right * (place.x - splat.mean[0]) + down * (place.y + 0.5 - splat.mean[1]);
    let first = L::splat(splat.features[DEPTH_CHANNEL] + first);
    (L::load(&CENTERS).mul_add(L::splat(right), first), L::splat(down))
}

/// channels += Σ over the batch of weight · feature, but for depth.
#[inline(always)]
fn add_weighted<L: Lanes>(splats: &[Splat], batch: &Batch, channels: &mut [Plane; CHANNELS]) {
    let [f0, f1, f2, f3] = batch.index.map(|i| &splats[i].features);
    let [w0, w1, w2, w3] = &batch.weight;
    let (first, end) = batch.row_pairs();
    let mut y = first;
    while y < end {
        let z = y + 1;
        let (a0, a1, a2, a3) = (L::load(&w0.0[y]), L::load(&w1.0[y]), L::load(&w2.0[y]), L::load(&w3.0[y]));
        let (b0, b1, b2, b3) = (L::load(&w0.0[z]), L::load(&w1.0[z]), L::load(&w2.0[z]), L::load(&w3.0[z]));
        for c in 0..DEPTH_CHANNEL {
            let out = &mut channels[c].0;
            let (mut p, mut q) = (L::load(&out[y]), L::load(&out[z]));
            let f = L::splat(f0[c]);
            (p, q) = (f.mul_add(a0, p), f.mul_add(b0, q));
            let f = L::splat(f1[c]);
            (p, q) = (f.mul_add(a1, p), f.mul_add(b1, q));
            let f = L::splat(f2[c]);
            (p, q) = (f.mul_add(a2, p), f.mul_add(b2, q));
            let f = L::splat(f3[c]);
            (p, q) = (f.mul_add(a3, p), f.mul_add(b3, q));
            p.store(&mut out[y]);
            q.store(&mut out[z]);
        }
        y += 2;
    }
}

/// Adds the tile's share to the gradients of its splats. `gradient.channels` must hold ∂L/∂out of the blended `image`.
#[inline(always)]
fn unblend<L: Lanes>(
    splats: &[Splat],
    list: &[u32],
    place: TilePlace,
    image: &TileImage,
    gradient: &mut TileGradient,
    gradients: &mut [SplatGradient],
) {
    prepare::<L>(image, gradient);
    let mut transmittance = Plane::ZERO;
    for row in &mut transmittance.0[..place.rows] {
        row[..place.columns].fill(1.0);
    }
    let mut batch = Batch::EMPTY;
    let mut ranges = [(0, 0); 4];
    let mut alpha = [Plane::ZERO; 4];
    let mut before = [Plane::ZERO; 4];
    let mut score = [Plane::ZERO; 4];
    let list = &list[..image.visited as usize];
    let mut next = 0;
    loop {
        if batch.len == 4 || (next == list.len() && batch.len > 0) {
            batch.complete();
            scores::<L>(splats, &batch, &gradient.channels, &mut score);
            for j in 0..batch.len {
                moments::<L>(
                    &splats[batch.index[j]],
                    place,
                    ranges[j],
                    (&batch.weight[j], &alpha[j], &before[j], &score[j]),
                    &gradient.channels[DEPTH_CHANNEL],
                    &mut gradient.remainder,
                    &mut gradients[batch.index[j]].moments,
                );
            }
            feature_gradients::<L>(&batch, &gradient.by_pixel, gradients);
            batch.clear();
        }
        let Some(&index) = list.get(next) else {
            break;
        };
        next += 1;
        let splat = &splats[index as usize];
        let rows = row_range(splat, place.y);
        let j = batch.len;
        let rows = alphas::<L>(splat, place, rows, &transmittance, &mut alpha[j]);
        if rows.0 >= rows.1 {
            continue;
        }
        batch.weight[j] = Plane::ZERO;
        for y in rows.0..rows.1 {
            let t = L::load(&transmittance.0[y]);
            let w = L::load(&alpha[j].0[y]) * t;
            w.store(&mut batch.weight[j].0[y]);
            t.store(&mut before[j].0[y]);
            (t - w).store(&mut transmittance.0[y]);
        }
        batch.index[j] = index as usize;
        ranges[j] = rows;
        batch.rows = (batch.rows.0.min(rows.0), batch.rows.1.max(rows.1));
        batch.len += 1;
    }
}

/// Fills the starting remainder Σ_c out_c·g_c and the pixel-major copy of the gradient.
#[inline(always)]
fn prepare<L: Lanes>(image: &TileImage, gradient: &mut TileGradient) {
    let TileGradient { channels, by_pixel, remainder } = gradient;
    for y in 0..TILE {
        let opacity = L::splat(1.0) - L::load(&image.transmittance.0[y]);
        let mut sum = opacity * L::load(&channels[OPACITY_CHANNEL].0[y]);
        for c in 0..CHANNELS {
            sum = L::load(&image.channels[c].0[y]).mul_add(L::load(&channels[c].0[y]), sum);
        }
        sum.store(&mut remainder.0[y]);
        for group in 0..3 {
            let mut rows = [L::splat(0.0); TILE];
            for c in 0..TILE {
                rows[c] = L::load(&channels[group * TILE + c].0[y]);
            }
            let columns = L::transpose(rows);
            for x in 0..TILE {
                columns[x].store(&mut by_pixel[y][x][group]);
            }
        }
    }
}

/// s_k = F_k·∂L/∂out at every pixel of the batch's rows, but for depth's part.
#[inline(always)]
fn scores<L: Lanes>(splats: &[Splat], batch: &Batch, channels: &[Plane; PADDED], score: &mut [Plane; 4]) {
    let [f0, f1, f2, f3] = batch.index.map(|i| &splats[i].features);
    let (first, end) = batch.row_pairs();
    let mut y = first;
    while y < end {
        let z = y + 1;
        // Every splat blends the constant one into opacity.
        let (g, h) = (L::load(&channels[OPACITY_CHANNEL].0[y]), L::load(&channels[OPACITY_CHANNEL].0[z]));
        let (mut p0, mut p1, mut p2, mut p3) = (g, g, g, g);
        let (mut q0, mut q1, mut q2, mut q3) = (h, h, h, h);
        for c in 0..DEPTH_CHANNEL {
            let (g, h) = (L::load(&channels[c].0[y]), L::load(&channels[c].0[z]));
            let f = L::splat(f0[c]);
            (p0, q0) = (f.mul_add(g, p0), f.mul_add(h, q0));
            let f = L::splat(f1[c]);
            (p1, q1) = (f.mul_add(g, p1), f.mul_add(h, q1));
            let f = L::splat(f2[c]);
            (p2, q2) = (f.mul_add(g, p2), f.mul_add(h, q2));
            let f = L::splat(f3[c]);
            (p3, q3) = (f.mul_add(g, p3), f.mul_add(h, q3));
        }
        let [s0, s1, s2, s3] = score;
        p0.store(&mut s0.0[y]);
        q0.store(&mut s0.0[z]);
        p1.store(&mut s1.0[y]);
        q1.store(&mut s1.0[z]);
        p2.store(&mut s2.0[y]);
        q2.store(&mut s2.0[z]);
        p3.store(&mut s3.0[y]);
        q3.store(&mut s3.0[z]);
        y += 2;
    }
}

/// Adds depth's part to the score, advances the remainder past one splat and adds its moments of v = ∂L/∂power.
#[inline(always)]
fn moments<L: Lanes>(
    splat: &Splat,
    place: TilePlace,
    rows: (usize, usize),
    (weight, alpha, before, score): (&Plane, &Plane, &Plane, &Plane),
    depth_gradient: &Plane,
    remainder: &mut Plane,
    out: &mut Chunk,
) {
    let (zero, one, largest) = (L::splat(0.0), L::splat(1.0), L::splat(ALPHA_MAX));
    let (mut v0, mut v1, mut v2) = (zero, zero, zero);
    let (first, down) = depth_rows::<L>(splat, place);
    let mut depth = down.mul_add(L::splat(rows.0 as f32), first);
    for y in rows.0..rows.1 {
        let dy = L::splat(place.y + y as f32 + 0.5 - splat.mean[1]);
        let (s, a, t) = (L::load(&score.0[y]), L::load(&alpha.0[y]), L::load(&before.0[y]));
        let s = depth.mul_add(L::load(&depth_gradient.0[y]), s);
        depth = depth + down;
        let left = L::load(&remainder.0[y]) - L::load(&weight.0[y]) * s;
        left.store(&mut remainder.0[y]);
        let d_alpha = t * s - left / (one - a);
        // Where alpha was cut off it no longer depends on the power.
        let v = (d_alpha * a).and(largest.gt(a));
        let vy = v * dy;
        v0 = v0 + v;
        v1 = v1 + vy;
        v2 = vy.mul_add(dy, v2);
    }
    let dx = L::load(&CENTERS) + L::splat(place.x - splat.mean[0]);
    let vx = v0 * dx;
    // All sums over lanes at once.
    let [a, b, c, d, e, f, g, h] = L::transpose([v0, vx, v1, vx * dx, v1 * dx, v2, zero, zero]);
    (L::load(out) + (((a + b) + (c + d)) + ((e + f) + (g + h)))).store(out);
}

/// ∂L/∂features += Σ over pixels of weight · ∂L/∂out.
#[inline(always)]
fn feature_gradients<L: Lanes>(
    batch: &Batch,
    by_pixel: &[[[Chunk; 3]; TILE]; TILE],
    gradients: &mut [SplatGradient],
) {
    let mut sum = [[L::splat(0.0); 3]; 4];
    for y in batch.rows.0..batch.rows.1 {
        for x in 0..TILE {
            let pixel = &by_pixel[y][x];
            let (g0, g1, g2) = (L::load(&pixel[0]), L::load(&pixel[1]), L::load(&pixel[2]));
            for j in 0..4 {
                let w = L::splat(batch.weight[j].0[y][x]);
                sum[j][0] = w.mul_add(g0, sum[j][0]);
                sum[j][1] = w.mul_add(g1, sum[j][1]);
                sum[j][2] = w.mul_add(g2, sum[j][2]);
            }
        }
    }
    for j in 0..batch.len {
        let (groups, _) = gradients[batch.index[j]].features.as_chunks_mut::<TILE>();
        for (group, add) in groups.iter_mut().zip(sum[j]) {
            (L::load(group) + add).store(group);
        }
    }
}

by_simd! {
    /// Blends one tile: see the module.
    fn blend_tile = blend(
        splats: &[Splat], list: &[u32], place: TilePlace, background: [f32; 3], image: &mut TileImage,
        reached: &mut [bool],
    )
}

by_simd! {
    /// The gradient of one blended tile: see the module.
    fn unblend_tile = unblend(
        splats: &[Splat], list: &[u32], place: TilePlace, image: &TileImage, gradient: &mut TileGradient,
        gradients: &mut [SplatGradient],
    )
}
