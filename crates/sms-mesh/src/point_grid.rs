//! Neighbour queries on a uniform grid. Results are ordered by distance, then index, even in degenerate cases.

use glamx::DVec3;

/// Points sorted into cubic cells.
pub struct PointGrid<'a> {
    points: &'a [DVec3],
    min: DVec3,
    cell: f64,
    size: [usize; 3],
    /// Start of each cell in `order`.
    starts: Vec<u32>,
    order: Vec<u32>,
}

impl<'a> PointGrid<'a> {
    /// Sorts points into cells of about `cell` metres (coarser if there would be too many).
    pub fn new(points: &'a [DVec3], cell: f64) -> Self {
        let bounds = sms_core::Aabb::of_points(points.iter().copied())
            .unwrap_or(sms_core::Aabb { min: DVec3::ZERO, max: DVec3::ZERO });
        let extents = bounds.extents();
        let budget = (8 * points.len()).max(4096) as f64;
        let mut cell = cell.max(1e-9);
        while (extents / cell + DVec3::ONE).to_array().iter().product::<f64>() > budget {
            cell *= 1.3;
        }
        let size = (extents / cell).to_array().map(|v| v as usize + 1);
        let mut grid = Self { points, min: bounds.min, cell, size, starts: Vec::new(), order: Vec::new() };
        let cells: Vec<usize> = points.iter().map(|&p| grid.index(grid.coordinates(p))).collect();
        let mut starts = vec![0u32; size.iter().product::<usize>() + 1];
        for &c in &cells {
            starts[c + 1] += 1;
        }
        for c in 1..starts.len() {
            starts[c] += starts[c - 1];
        }
        let mut next = starts.clone();
        let mut order = vec![0u32; points.len()];
        for (i, &c) in cells.iter().enumerate() {
            order[next[c] as usize] = i as u32;
            next[c] += 1;
        }
        grid.starts = starts;
        grid.order = order;
        grid
    }

    fn coordinates(&self, p: DVec3) -> [usize; 3] {
        let at = (p - self.min) / self.cell;
        std::array::from_fn(|k| (at[k].max(0.0) as usize).min(self.size[k] - 1))
    }

    fn index(&self, c: [usize; 3]) -> usize {
        (c[2] * self.size[1] + c[1]) * self.size[0] + c[0]
    }

    /// Iterates over index and squared distance of the points within `radius`, cell by cell.
    fn iter_within(&self, p: DVec3, radius: f64) -> impl Iterator<Item = (usize, f64)> {
        let low = self.coordinates(p - DVec3::splat(radius));
        let high = self.coordinates(p + DVec3::splat(radius));
        let limit = radius * radius;
        let rows = (low[2]..=high[2]).flat_map(move |z| (low[1]..=high[1]).map(move |y| [0, y, z]));
        rows.flat_map(move |row| {
            let row = self.index(row);
            &self.order[self.starts[row + low[0]] as usize..self.starts[row + high[0] + 1] as usize]
        })
        .map(move |&i| (i as usize, self.points[i as usize].distance_squared(p)))
        .filter(move |&(_, d)| d <= limit)
    }

    /// Calls `visit(index, squared distance)` for every point within `radius`, cell by cell.
    pub fn for_each_within(&self, p: DVec3, radius: f64, mut visit: impl FnMut(usize, f64)) {
        self.iter_within(p, radius).for_each(|(i, d)| visit(i, d));
    }

    /// Returns `(squared distance, index)` of the points within `radius`, nearest first.
    pub fn within(&self, p: DVec3, radius: f64) -> Vec<(f64, usize)> {
        let mut found = Vec::new();
        self.for_each_within(p, radius, |i, d| found.push((d, i)));
        found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        found
    }

    /// Returns whether any point is within `radius`.
    pub fn is_near(&self, p: DVec3, radius: f64) -> bool {
        self.iter_within(p, radius).next().is_some()
    }

    /// Returns an upper bound of the distance to any point.
    fn reach(&self, p: DVec3) -> f64 {
        let sides = (0..3).map(|a| {
            (p[a] - self.min[a]).abs().max((p[a] - self.min[a] - self.size[a] as f64 * self.cell).abs())
        });
        sides.fold(0.0, f64::max) * 2.0
    }

    /// Returns the `k` nearest points, nearest first, or all if there are fewer.
    pub fn nearest_k(&self, p: DVec3, k: usize) -> Vec<(f64, usize)> {
        let reach = self.reach(p);
        let mut radius = self.cell;
        loop {
            let mut found = self.within(p, radius);
            if found.len() >= k || radius > reach {
                found.truncate(k);
                return found;
            }
            radius *= 2.0;
        }
    }

    /// Returns the nearest point as `(distance, index)`.
    pub fn nearest(&self, p: DVec3) -> Option<(f64, usize)> {
        let reach = self.reach(p);
        let mut radius = self.cell;
        loop {
            let mut best: Option<(f64, usize)> = None;
            self.for_each_within(p, radius, |i, d| {
                if best.is_none_or(|b| d < b.0 || (d == b.0 && i < b.1)) {
                    best = Some((d, i));
                }
            });
            if best.is_some() || radius > reach {
                return best.map(|(d, i)| (d.sqrt(), i));
            }
            radius *= 2.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::RngExt;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn queries_agree_with_brute_force(seed in 0u64..500, n in 1usize..300, flat in proptest::bool::ANY) {
            let mut rng = sms_core::Seed(seed).rng();
            let points: Vec<DVec3> = (0..n)
                .map(|_| DVec3::new(rng.random(), rng.random(), if flat { 0.5 } else { rng.random() }))
                .collect();
            let grid = PointGrid::new(&points, 0.1);
            let q = DVec3::new(rng.random(), rng.random(), rng.random()) * 3.0 - DVec3::ONE;
            let mut brute: Vec<(f64, usize)> =
                points.iter().enumerate().map(|(i, p)| (p.distance_squared(q), i)).collect();
            brute.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            prop_assert_eq!(grid.nearest_k(q, 10), brute[..n.min(10)].to_vec());
            brute.retain(|b| b.0 <= 0.36);
            prop_assert_eq!(grid.within(q, 0.6), brute);
        }
    }
}
