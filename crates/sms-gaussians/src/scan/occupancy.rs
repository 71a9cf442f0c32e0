//! A hash grid of points for radius queries.

use glamx::Vec3;

/// End of a chain.
const NONE: u32 = u32::MAX;
/// Smallest number of chains.
const CHAINS_MIN: usize = 1 << 10;

/// Points in chains by the hash of their cell. The distance of every point of a chain is checked, so cells that share a
/// chain only cost time.
pub(crate) struct HashGrid {
    cell: f32,
    /// First point of each chain. The number of chains is a power of two.
    first: Vec<u32>,
    /// Next point in the chain of each point.
    next: Vec<u32>,
    points: Vec<Vec3>,
}

impl HashGrid {
    /// Creates a grid for queries of at most about `radius` metres; wider queries are slow.
    pub(crate) fn new(radius: f32) -> Self {
        // With this cell size, a query touches at most two cells along each axis.
        Self {
            cell: 2.1 * radius.max(1e-6),
            first: vec![NONE; CHAINS_MIN],
            next: Vec::new(),
            points: Vec::new(),
        }
    }

    /// Builds [`HashGrid::new`] with these points.
    pub(crate) fn of(radius: f32, points: &[Vec3]) -> Self {
        let mut occupancy = Self::new(radius);
        occupancy.points = points.to_vec();
        occupancy.chain_all();
        occupancy
    }

    fn cell_of(&self, p: Vec3) -> [i32; 3] {
        (p / self.cell).to_array().map(|v| v.floor() as i32)
    }

    fn chain_of(&self, cell: [i32; 3]) -> usize {
        const FACTORS: [u64; 3] = [0x9e37_79b9_7f4a_7c15, 0xc2b2_ae3d_27d4_eb4f, 0x1656_67b1_9e37_79f9];
        let mixed = (0..3).fold(0u64, |sum, k| sum.wrapping_add((cell[k] as u64).wrapping_mul(FACTORS[k])));
        // The upper bits are mixed best.
        (mixed >> 32) as usize & (self.first.len() - 1)
    }

    /// Rebuilds the chains, with twice as many chains as points.
    fn chain_all(&mut self) {
        let chains = (2 * self.points.len()).next_power_of_two().max(CHAINS_MIN);
        self.first = vec![NONE; chains];
        self.next.clear();
        for i in 0..self.points.len() {
            self.chain(i);
        }
    }

    fn chain(&mut self, i: usize) {
        let chain = self.chain_of(self.cell_of(self.points[i]));
        self.next.push(std::mem::replace(&mut self.first[chain], i as u32));
    }

    pub(crate) fn insert(&mut self, p: Vec3) {
        self.points.push(p);
        if self.points.len() > self.first.len() {
            self.chain_all();
        } else {
            self.chain(self.points.len() - 1);
        }
    }

    /// Whether a point lies nearer than `radius` to `p`.
    pub(crate) fn any_within(&self, p: Vec3, radius: f32) -> bool {
        !self.all_within(p, radius, |_, _| false)
    }

    /// Calls `f` with the index and the squared distance of every point nearer than `radius` to `p`, some of them twice, until it returns
    /// false. Returns whether it never did.
    pub(crate) fn all_within(&self, p: Vec3, radius: f32, mut f: impl FnMut(usize, f32) -> bool) -> bool {
        // Slightly enlarged because of rounding.
        let reach = Vec3::splat(1.001 * radius) + p.abs() * 1e-6;
        let (low, high) = (self.cell_of(p - reach), self.cell_of(p + reach));
        // A cell's chain also holds points of other cells.
        let mut all_near = |x, y, z| {
            let mut at = self.first[self.chain_of([x, y, z])];
            while at != NONE {
                let squared = (self.points[at as usize] - p).length_squared();
                if squared < radius * radius && !f(at as usize, squared) {
                    return false;
                }
                at = self.next[at as usize];
            }
            true
        };
        (low[2]..=high[2]).all(|z| (low[1]..=high[1]).all(|y| (low[0]..=high[0]).all(|x| all_near(x, y, z))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn answers_like_a_search_through_all_points(
            points in prop::collection::vec(prop::array::uniform3(-0.1f32..0.1), 0..60),
            query in prop::array::uniform3(-0.12f32..0.12),
            radius in 0.001f32..0.05,
        ) {
            let points: Vec<Vec3> = points.iter().map(|p| Vec3::from_array(*p)).collect();
            let mut occupancy = HashGrid::new(0.05);
            points.iter().for_each(|p| occupancy.insert(*p));
            let at_once = HashGrid::of(0.05, &points);
            let query = Vec3::from_array(query);
            let expected = points.iter().any(|p| (*p - query).length() < radius);
            let mut found = Vec::new();
            at_once.all_within(query, radius, |i, squared| {
                found.push((i, squared));
                true
            });
            found.sort_by_key(|(i, _)| *i);
            found.dedup();
            let near = points.iter().map(|p| (*p - query).length_squared()).enumerate();
            prop_assert_eq!(found, near.filter(|(_, squared)| *squared < radius * radius).collect::<Vec<_>>());
            prop_assert_eq!(occupancy.any_within(query, radius), expected);
            prop_assert_eq!(at_once.any_within(query, radius), expected);
            // Wider than the designed radius.
            let fine = HashGrid::of(0.004, &points);
            prop_assert_eq!(fine.any_within(query, radius), expected);
        }
    }

    #[test]
    fn more_points_than_chains_are_all_found() {
        let mut occupancy = HashGrid::new(0.5);
        let point = |i: usize| Vec3::new((i % 50) as f32, (i / 50) as f32, -3.0);
        (0..3 * CHAINS_MIN).for_each(|i| occupancy.insert(point(i)));
        for i in 0..3 * CHAINS_MIN {
            assert!(occupancy.any_within(point(i) + 0.1, 0.2));
            assert!(!occupancy.any_within(point(i) + 0.5, 0.5));
        }
    }
}
