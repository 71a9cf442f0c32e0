//! Light on the floor, computed once per scene, since it does not depend on the camera.

use glamx::Vec3;
use rayon::prelude::*;

/// `N` values on a grid of floor points, with interpolation.
#[derive(Debug, Clone)]
pub(crate) struct FloorLight<const N: usize> {
    low: [f32; 2],
    cell_m: f32,
    size: [usize; 2],
    values: Vec<[f32; N]>,
}

impl<const N: usize> FloorLight<N> {
    /// Evaluates `light` over the rectangle from `low` to `high` (metres in the world's xy plane), every `cell_m`.
    pub(crate) fn compute(
        low: [f32; 2],
        high: [f32; 2],
        cell_m: f32,
        light: impl Fn(Vec3) -> [f32; N] + Sync,
    ) -> Self {
        let size = [0, 1].map(|a| ((high[a] - low[a]) / cell_m).ceil().max(1.0) as usize + 1);
        let mut values = vec![[0.0; N]; size[0] * size[1]];
        values.par_chunks_mut(size[0]).enumerate().for_each(|(j, row)| {
            for (i, value) in row.iter_mut().enumerate() {
                *value = light(Vec3::new(low[0] + i as f32 * cell_m, low[1] + j as f32 * cell_m, 0.0));
            }
        });
        Self { low, cell_m, size, values }
    }

    /// Returns the corners of the rectangle.
    pub(crate) fn rectangle(&self) -> ([f32; 2], [f32; 2]) {
        (self.low, [0, 1].map(|a| self.low[a] + (self.size[a] - 1) as f32 * self.cell_m))
    }

    /// Returns the values at a floor point, or `None` outside the rectangle.
    pub(crate) fn at(&self, p: Vec3) -> Option<[f32; N]> {
        let (u, v) = ((p.x - self.low[0]) / self.cell_m, (p.y - self.low[1]) / self.cell_m);
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
            std::array::from_fn::<f32, N, _>(|c| a[c] + (b[c] - a[c]) * fu)
        };
        let (a, b) = (row(j), row(j + 1));
        Some(std::array::from_fn(|c| a[c] + (b[c] - a[c]) * fv))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_linear_light_is_interpolated_exactly_and_outside_is_unknown() {
        let light = |p: Vec3| [p.x, 2.0 * p.y, 0.5 + p.x - p.y];
        let map = FloorLight::compute([-0.1, 0.2], [0.3, 0.4], 0.0025, light);
        for p in [Vec3::new(-0.1, 0.2, 0.0), Vec3::new(0.123, 0.3456, 0.0), Vec3::new(0.2999, 0.3999, 0.0)] {
            let (found, expected) = (map.at(p).unwrap(), light(p));
            assert!((0..3).all(|c| (found[c] - expected[c]).abs() < 1e-5), "{found:?} {expected:?}");
        }
        assert!(map.at(Vec3::new(-0.11, 0.3, 0.0)).is_none());
        assert!(map.at(Vec3::new(0.1, 0.41, 0.0)).is_none());
    }
}
