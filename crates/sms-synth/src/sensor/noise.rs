//! Repeatable noise of images: every value depends on the pixel and the seed only, so that results do not depend on threads.

use crate::texture::hash;
use sms_core::Seed;

/// Noise over the pixels of one image.
pub(super) struct Noise {
    seed: u32,
    /// Lattice spacing in pixels; 0 for white noise.
    step: f64,
}

/// Share of the variance that is correlated within a patch.
const CORRELATED: f64 = 0.7;

impl Noise {
    pub(super) fn new(seed: Seed, correlation: f64) -> Self {
        Self {
            seed: (seed.0 ^ (seed.0 >> 32)) as u32,
            step: if correlation > 1.0 { correlation } else { 0.0 },
        }
    }

    /// Returns a number that is uniform in [0, 1); channels are independent.
    pub(super) fn uniform(&self, x: i32, y: i32, channel: i32) -> f64 {
        f64::from(hash(x, y, channel, self.seed)) / 4_294_967_296.0
    }

    /// Returns a standard normal value at a pixel.
    pub(super) fn normal(&self, x: usize, y: usize) -> f64 {
        let white = irwin_hall(self.seed, x as i32, y as i32, 1);
        if self.step == 0.0 {
            return white;
        }
        let (u, v) = (x as f64 / self.step, y as f64 / self.step);
        let (i, j) = (u.floor(), v.floor());
        let (fu, fv) = (u - i, v - j);
        let (mut sum, mut square) = (0.0, 0.0);
        for (di, dj, w) in [
            (0, 0, (1.0 - fu) * (1.0 - fv)),
            (1, 0, fu * (1.0 - fv)),
            (0, 1, (1.0 - fu) * fv),
            (1, 1, fu * fv),
        ] {
            sum += w * irwin_hall(self.seed, i as i32 + di, j as i32 + dj, 3);
            square += w * w;
        }
        // Dividing by the weights' norm keeps the variance the same between lattice points.
        CORRELATED.sqrt() * sum / square.sqrt() + (1.0 - CORRELATED).sqrt() * white
    }

    /// Returns the cell of an irregular tiling (the nearest of jittered lattice points, Worley 1996) that contains a pixel.
    /// Cells are `size_px` wide on average; at one pixel and below, every pixel is a cell.
    pub(super) fn cell(&self, x: usize, y: usize, size_px: f64) -> (i32, i32) {
        if size_px <= 1.0 {
            return (x as i32, y as i32);
        }
        let (u, v) = ((x as f64 + 0.5) / size_px, (y as f64 + 0.5) / size_px);
        let (i, j) = (u.floor() as i32, v.floor() as i32);
        let mut best = (f64::INFINITY, (i, j));
        for (a, b) in (-1..=1).flat_map(|b| (-1..=1).map(move |a| (i + a, j + b))) {
            let center = (f64::from(a) + self.uniform(a, b, 18), f64::from(b) + self.uniform(a, b, 19));
            let distance = (center.0 - u).powi(2) + (center.1 - v).powi(2);
            if distance < best.0 {
                best = (distance, (a, b));
            }
        }
        best.1
    }
}

/// Zero mean, unit variance, near normal up to 4.9 σ: the sum of eight bytes of two hashes.
pub(crate) fn irwin_hall(seed: u32, x: i32, y: i32, channel: i32) -> f64 {
    let sum: u32 = [hash(x, y, channel, seed), hash(x, y, channel + 1, seed)]
        .iter()
        .flat_map(|h| h.to_le_bytes())
        .map(u32::from)
        .sum();
    // Variance of one byte: (256² − 1) / 12.
    (f64::from(sum) - 8.0 * 127.5) / (8.0f64 * 65535.0 / 12.0).sqrt()
}
