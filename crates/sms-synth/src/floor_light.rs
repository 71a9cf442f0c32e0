//! Light on the floor, computed once per scene: it does not depend on the camera, and most pixels show floor.

use glamx::Vec3;
use rayon::prelude::*;

/// Visible shares of the two lamps and of the sky on a grid of floor points, interpolated in between.
#[derive(Debug, Clone)]
pub(crate) struct FloorLight {
    low: [f32; 2],
    size: [usize; 2],
    values: Vec<[f32; 3]>,
}

/// Spacing of the grid, metres: about the size of a pixel of a full-size frame.
const CELL_M: f32 = 0.0025;

impl FloorLight {
    /// Evaluates `light` over the rectangle from `low` to `high` (metres in the world's xy plane). Outside of it, light
    /// is evaluated directly, so the rectangle decides speed only.
    pub(crate) fn compute(low: [f32; 2], high: [f32; 2], light: impl Fn(Vec3) -> [f32; 3] + Sync) -> Self {
        let size = [0, 1].map(|a| ((high[a] - low[a]) / CELL_M).ceil().max(1.0) as usize + 1);
        let mut values = vec![[1.0; 3]; size[0] * size[1]];
        values.par_chunks_mut(size[0]).enumerate().for_each(|(j, row)| {
            for (i, value) in row.iter_mut().enumerate() {
                *value = light(Vec3::new(low[0] + i as f32 * CELL_M, low[1] + j as f32 * CELL_M, 0.0));
            }
        });
        Self { low, size, values }
    }

    /// The shares at a floor point, or `None` outside the rectangle.
    pub(crate) fn at(&self, p: Vec3) -> Option<[f32; 3]> {
        let (u, v) = ((p.x - self.low[0]) / CELL_M, (p.y - self.low[1]) / CELL_M);
        if !(u >= 0.0 && v >= 0.0) {
            return None;
        }
        let (i, j) = (u as usize, v as usize);
        if i + 1 >= self.size[0] || j + 1 >= self.size[1] {
            return None;
        }
        let (fu, fv) = (u - i as f32, v - j as f32);
        let row = |j: usize| {
            let (a, b) = (self.values[j * self.size[0] + i], self.values[j * self.size[0] + i + 1]);
            [0, 1, 2].map(|c| a[c] + (b[c] - a[c]) * fu)
        };
        let (a, b) = (row(j), row(j + 1));
        Some([0, 1, 2].map(|c| a[c] + (b[c] - a[c]) * fv))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_linear_light_is_interpolated_exactly_and_outside_is_unknown() {
        let light = |p: Vec3| [p.x, 2.0 * p.y, 0.5 + p.x - p.y];
        let map = FloorLight::compute([-0.1, 0.2], [0.3, 0.4], light);
        for p in [Vec3::new(-0.1, 0.2, 0.0), Vec3::new(0.123, 0.3456, 0.0), Vec3::new(0.2999, 0.3999, 0.0)] {
            let (found, expected) = (map.at(p).unwrap(), light(p));
            assert!((0..3).all(|c| (found[c] - expected[c]).abs() < 1e-5), "{found:?} {expected:?}");
        }
        assert!(map.at(Vec3::new(-0.11, 0.3, 0.0)).is_none());
        assert!(map.at(Vec3::new(0.1, 0.41, 0.0)).is_none());
    }
}
