//! Closedness and orientation of meshes.

use crate::Mesh;
use std::collections::BTreeMap;

impl Mesh {
    /// Returns whether the surface is closed and consistently oriented: each directed edge occurs exactly once and its
    /// opposite exactly once, and no triangle is degenerate in its indices.
    pub fn is_closed_oriented(&self) -> bool {
        !self.triangles.is_empty() && self.boundary_edge_count() == 0
    }

    /// Returns the number of directed edges without exactly one opposite edge.
    pub fn boundary_edge_count(&self) -> usize {
        let mut directed: BTreeMap<(u32, u32), usize> = BTreeMap::new();
        for &[a, b, c] in &self.triangles {
            for (i, j) in [(a, b), (b, c), (c, a)] {
                *directed.entry((i, j)).or_default() += 1;
            }
        }
        directed
            .iter()
            .filter(|&(&(i, j), &n)| i == j || n != 1 || directed.get(&(j, i)).copied() != Some(1))
            .count()
    }

    /// Removes vertices that no triangle uses.
    pub fn compacted(&self) -> Self {
        self.part(self.triangles.iter().copied(), &mut vec![u32::MAX; self.vertices.len()])
    }

    /// Returns a mesh of some of the triangles. `new_index` is `u32::MAX` for each of their vertices, and receives the index of each in
    /// the result.
    fn part(&self, triangles: impl IntoIterator<Item = [u32; 3]>, new_index: &mut [u32]) -> Self {
        let mut out = Self::default();
        for t in triangles {
            let triangle = t.map(|i| {
                let slot = &mut new_index[i as usize];
                if *slot == u32::MAX {
                    *slot = out.vertices.len() as u32;
                    out.vertices.push(self.vertices[i as usize]);
                    if let Some(&color) = self.colors.get(i as usize) {
                        out.colors.push(color);
                    }
                }
                *slot
            });
            out.triangles.push(triangle);
        }
        out
    }

    /// Returns the triangle sets connected through shared vertices, largest first (by triangle count).
    pub fn components(&self) -> Vec<Self> {
        let mut parent: Vec<u32> = (0..self.vertices.len() as u32).collect();
        fn find(parent: &mut [u32], mut i: u32) -> u32 {
            while parent[i as usize] != i {
                parent[i as usize] = parent[parent[i as usize] as usize];
                i = parent[i as usize];
            }
            i
        }
        for &[a, b, c] in &self.triangles {
            for (i, j) in [(a, b), (b, c)] {
                let (ri, rj) = (find(&mut parent, i), find(&mut parent, j));
                let (low, high) = (ri.min(rj), ri.max(rj));
                parent[high as usize] = low;
            }
        }
        let mut groups: BTreeMap<u32, Vec<[u32; 3]>> = BTreeMap::new();
        for &t in &self.triangles {
            groups.entry(find(&mut parent, t[0])).or_default().push(t);
        }
        // Components share no vertex: one index serves them all.
        let mut new_index = vec![u32::MAX; self.vertices.len()];
        let mut parts: Vec<Self> =
            groups.into_values().map(|triangles| self.part(triangles, &mut new_index)).collect();
        parts.sort_by_key(|p| std::cmp::Reverse(p.triangles.len()));
        parts
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DVec3;

    #[test]
    fn a_missing_or_flipped_triangle_opens_the_surface() {
        let mut mesh = Mesh::cuboid(DVec3::ONE);
        mesh.triangles[0].swap(0, 1);
        assert!(!mesh.is_closed_oriented());
        mesh.triangles.remove(0);
        assert_eq!(mesh.boundary_edge_count(), 3);
    }

    #[test]
    fn components_are_separated_and_compact() {
        let a = Mesh::cuboid(DVec3::ONE);
        let mut both = Mesh::icosphere(1.0, 1);
        let offset = both.vertices.len() as u32;
        both.vertices.extend(a.vertices.iter().map(|&v| v + DVec3::X * 5.0));
        both.triangles.extend(a.triangles.iter().map(|t| t.map(|i| i + offset)));
        let parts = both.components();
        assert_eq!(parts.len(), 2);
        assert_eq!(parts[0].triangles.len(), 80);
        assert_eq!(parts[1].vertices.len(), 8);
        let moved = |t: usize| a.corners(t).map(|p| p + DVec3::X * 5.0);
        assert!((0..a.triangles.len()).all(|t| parts[1].corners(t) == moved(t)));
    }
}
