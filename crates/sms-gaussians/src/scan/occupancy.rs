//! Which space is taken: a hash grid of points that answers "is there one within a radius?".

use glamx::Vec3;
use std::collections::HashMap;

/// Points in cells; looked up, never iterated, so that the hasher's order does not matter.
pub(crate) struct Occupancy {
    cell: f32,
    cells: HashMap<[i32; 3], Vec<Vec3>>,
}

impl Occupancy {
    /// For queries of at most `radius` metres.
    pub(crate) fn new(radius: f32) -> Self {
        Self { cell: radius.max(1e-6), cells: HashMap::new() }
    }

    fn cell_of(&self, p: Vec3) -> [i32; 3] {
        (p / self.cell).to_array().map(|v| v.floor() as i32)
    }

    pub(crate) fn insert(&mut self, p: Vec3) {
        self.cells.entry(self.cell_of(p)).or_default().push(p);
    }

    /// Whether a point lies nearer than `radius` to `p`. `radius` must not exceed that of [`Occupancy::new`].
    pub(crate) fn any_within(&self, p: Vec3, radius: f32) -> bool {
        debug_assert!(radius <= self.cell * 1.0001);
        let [x, y, z] = self.cell_of(p);
        let offsets = (0..27).map(|k| [x + k % 3 - 1, y + k / 3 % 3 - 1, z + k / 9 - 1]);
        offsets
            .filter_map(|c| self.cells.get(&c))
            .flatten()
            .any(|q| (*q - p).length_squared() < radius * radius)
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
            let mut occupancy = Occupancy::new(0.05);
            points.iter().for_each(|p| occupancy.insert(Vec3::from_array(*p)));
            let query = Vec3::from_array(query);
            let expected = points.iter().any(|p| (Vec3::from_array(*p) - query).length() < radius);
            prop_assert_eq!(occupancy.any_within(query, radius), expected);
        }
    }
}
