//! Minimum-cost assignment of reconstructed to reference objects.

use crate::evaluate::KnownSurface;
use crate::surface_index::{SurfaceIndex, sample_surface};
use glamx::DVec3;
use rayon::prelude::*;
use sms_core::Seed;

/// Returns the column of each row of a square cost matrix in an assignment of least cost (Kuhn's "Hungarian method",
/// with shortest augmenting paths).
///
/// ```
/// // Column 0 is the cheapest of both rows, but row 0 has no comparable alternative.
/// assert_eq!(sms_eval::least_cost_assignment(&[vec![1.0, 9.0], vec![0.5, 2.0]]), [0, 1]);
/// ```
pub fn least_cost_assignment(cost: &[Vec<f64>]) -> Vec<usize> {
    let n = cost.len();
    let (mut u, mut v) = (vec![0.0; n + 1], vec![0.0; n + 1]);
    // Row of each column, counted from 1; column 0 is the start of the path.
    let mut row_of = vec![0; n + 1];
    for i in 1..=n {
        row_of[0] = i;
        let mut at = 0;
        let (mut least, mut from, mut done) =
            (vec![f64::INFINITY; n + 1], vec![0; n + 1], vec![false; n + 1]);
        loop {
            done[at] = true;
            let row = row_of[at];
            let (mut step, mut next) = (f64::INFINITY, 0);
            for j in 1..=n {
                if done[j] {
                    continue;
                }
                let reduced = cost[row - 1][j - 1] - u[row] - v[j];
                if reduced < least[j] {
                    (least[j], from[j]) = (reduced, at);
                }
                if least[j] < step {
                    (step, next) = (least[j], j);
                }
            }
            for j in 0..=n {
                if done[j] {
                    u[row_of[j]] += step;
                    v[j] -= step;
                } else {
                    least[j] -= step;
                }
            }
            at = next;
            if row_of[at] == 0 {
                break;
            }
        }
        while at != 0 {
            row_of[at] = row_of[from[at]];
            at = from[at];
        }
    }
    let mut column_of = vec![0; n];
    (1..=n).for_each(|j| column_of[row_of[j] - 1] = j - 1);
    column_of
}

struct PreparedSurface {
    samples: Vec<DVec3>,
    index: Option<SurfaceIndex>,
}

impl PreparedSurface {
    /// Enough samples to distinguish objects.
    const SAMPLES: usize = 400;

    fn new(surface: KnownSurface<'_>) -> Self {
        let samples = match surface {
            KnownSurface::Mesh(mesh) => sample_surface(mesh, Self::SAMPLES, Seed(0).derive("match")),
            KnownSurface::Cloud(cloud) => {
                let step = cloud.points_w.len().div_ceil(Self::SAMPLES).max(1);
                cloud.points_w.iter().step_by(step).copied().collect()
            }
        };
        Self { samples, index: surface.index() }
    }

    /// Mean of the distances between two surfaces, from samples of each; infinite if one has no samples.
    fn distance(&self, other: &Self) -> f64 {
        let to = |from: &Self, to: &Self| {
            let Some(index) = to.index.as_ref().filter(|_| !from.samples.is_empty()) else {
                return f64::INFINITY;
            };
            from.samples.iter().map(|&p| index.closest(p).distance).sum::<f64>() / from.samples.len() as f64
        };
        0.5 * (to(self, other) + to(other, self))
    }
}

/// Returns the index of the matching reconstruction of each known object, each reconstruction at most once. `given`
/// pairs of (known, found) are kept; the rest is assigned with the least sum of the distances between the surfaces
/// (mean of both directions). Pairs farther apart than `reach_m[known]` are not matched.
pub fn match_objects(
    known: &[KnownSurface<'_>],
    found: &[KnownSurface<'_>],
    given: &[(usize, usize)],
    reach_m: &[f64],
) -> Vec<Option<usize>> {
    let mut match_of: Vec<Option<usize>> = vec![None; known.len()];
    for &(k, f) in given {
        if match_of[k].is_none() && !match_of.contains(&Some(f)) {
            match_of[k] = Some(f);
        }
    }
    let free_known: Vec<usize> = (0..known.len()).filter(|&k| match_of[k].is_none()).collect();
    let free_found: Vec<usize> = (0..found.len()).filter(|&f| !match_of.contains(&Some(f))).collect();
    let prepare = |all: &[KnownSurface<'_>], of: &[usize]| -> Vec<PreparedSurface> {
        of.iter().map(|&i| PreparedSurface::new(all[i])).collect()
    };
    let (k, f) = (prepare(known, &free_known), prepare(found, &free_found));
    let size = k.len().max(f.len());
    let cost: Vec<Vec<f64>> = (0..size)
        .into_par_iter()
        .map(|row| {
            let at = |column: usize| match (k.get(row), f.get(column)) {
                // In units of the reach; a larger distance costs as much as no match.
                (Some(a), Some(b)) => (a.distance(b) / reach_m[free_known[row]]).min(1.0),
                _ => 1.0,
            };
            (0..size).map(at).collect()
        })
        .collect();
    for (row, column) in least_cost_assignment(&cost).into_iter().enumerate() {
        if row < k.len() && column < f.len() && cost[row][column] < 1.0 {
            match_of[free_known[row]] = Some(free_found[column]);
        }
    }
    match_of
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DPose3;
    use sms_core::{Mesh, PointCloud};

    #[test]
    fn the_assignment_is_the_best_of_all() {
        let value =
            |seed: usize, i: usize, j: usize| ((i * 7 + j * 13 + seed * 29) * 7919 % 101) as f64 / 101.0;
        for seed in 0..20 {
            let cost: Vec<Vec<f64>> = (0..4).map(|i| (0..4).map(|j| value(seed, i, j)).collect()).collect();
            let found = least_cost_assignment(&cost);
            let total: f64 = found.iter().enumerate().map(|(i, &j)| cost[i][j]).sum();
            let mut best = f64::INFINITY;
            for code in 0..256usize {
                let p = [code & 3, code >> 2 & 3, code >> 4 & 3, code >> 6 & 3];
                if (0..4).all(|k| p.contains(&k)) {
                    best = best.min((0..4).map(|i| cost[i][p[i]]).sum());
                }
            }
            assert!((total - best).abs() < 1e-12);
        }
    }

    fn ball(x: f64) -> Mesh {
        Mesh::icosphere(0.03, 2).transformed(&DPose3::from_translation(DVec3::X * x))
    }

    #[test]
    fn no_reconstruction_stands_for_two_objects() {
        // Both known balls are closest to the same reconstruction; the farther one gets the other.
        let (known, found) = ([ball(0.0), ball(0.07)], [ball(0.03), ball(-0.02)]);
        let meshes = |m: &[Mesh; 2]| m.clone();
        let (k, f) = (meshes(&known), meshes(&found));
        let k: Vec<KnownSurface> = k.iter().map(KnownSurface::Mesh).collect();
        let f: Vec<KnownSurface> = f.iter().map(KnownSurface::Mesh).collect();
        assert_eq!(match_objects(&k, &f, &[], &[0.1; 2]), [Some(1), Some(0)]);
        // With only one reconstruction, one object has no match.
        assert_eq!(match_objects(&k, &f[..1], &[], &[0.1; 2]), [Some(0), None]);
        // Given pairs are kept, and distant ones are not matched.
        assert_eq!(match_objects(&k, &f, &[(0, 0)], &[0.1; 2]), [Some(0), Some(1)]);
        assert_eq!(match_objects(&k, &f, &[(0, 0)], &[0.1, 0.02]), [Some(0), None]);
        // Points work as well as triangles.
        for (points_w, expected) in [(known[1].vertices.clone(), Some(0)), (Vec::new(), None)] {
            let cloud = PointCloud { points_w, ..PointCloud::default() };
            assert_eq!(match_objects(&[KnownSurface::Cloud(&cloud)], &f, &[], &[0.1]), [expected]);
        }
    }
}
