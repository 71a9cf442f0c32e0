//! The solid as the reference for parts.

use crate::convex::occupancy::InsideVoxels;
use crate::convex::repair::TriangleSurface;
use crate::convex::sweep::GrowingHull;
use crate::convex::work::{QUERY, Work};
use glamx::DVec3;
use parry3d_f64::query::PointQuery;
use parry3d_f64::shape::TriMesh;

/// Distance of the samples on a hull's surface, in half sizes of the object.
const SPACING: f64 = 0.04;

/// One decomposition: the solid, the limit for its parts, and the work so far.
#[derive(Clone, Copy)]
pub(crate) struct Decomposition<'a> {
    pub(crate) solid: &'a Solid,
    /// Largest concavity of a part, in half sizes of the object.
    pub(crate) threshold: f64,
    pub(crate) work: &'a Work,
}

impl Decomposition<'_> {
    /// Returns whether a hull that adds `surplus` to its piece is within the threshold; the volume may use a `share` of
    /// it.
    pub(crate) fn is_convex(&self, hull: &GrowingHull, surplus: f64, share: f64) -> bool {
        rv(surplus) <= share * self.threshold
            && self.solid.reach(hull.triangles(), self.threshold, self.work) <= self.threshold
    }
}

/// Returns CoACD's measure of a surplus volume: 0.3 times the radius of a ball of that volume (its `R_v`, k = 0.3).
pub(crate) fn rv(surplus: f64) -> f64 {
    0.3 * (surplus.max(0.0) * 3.0 / (4.0 * std::f64::consts::PI)).cbrt()
}

/// Returns the volume with [`rv`] equal to `threshold`.
pub(crate) fn rv_volume(threshold: f64) -> f64 {
    4.0 / 3.0 * std::f64::consts::PI * (threshold / 0.3).powi(3)
}

/// A closed surface with distance queries, in unit coordinates.
pub(crate) struct Solid {
    surface: TriMesh,
    inside: InsideVoxels,
}

impl Solid {
    pub(crate) fn new(surface: &TriangleSurface) -> Option<Self> {
        let inside = InsideVoxels::new(surface, 96);
        let surface = TriMesh::new(surface.points.clone(), surface.triangles.clone()).ok()?;
        Some(Self { surface, inside })
    }

    /// Returns the distance of an outside point; 0 for points inside or in a voxel (0.02) that is partly inside.
    fn distance(&self, p: DVec3) -> f64 {
        if self.inside.contains(p) {
            return 0.0;
        }
        self.surface.project_local_point(p, false).point.distance(p)
    }

    /// Returns whether a point lies inside: first by voxels, then exactly near the surface, because walls may be
    /// thinner than voxels.
    pub(crate) fn contains(&self, p: DVec3, work: &Work) -> bool {
        work.add(QUERY);
        self.distance(p) < 0.004
    }

    /// Returns the largest distance of a hull's surface outside the solid (the boundary part of CoACD's concavity), or
    /// the first distance above `enough`.
    fn reach(&self, hull: impl Iterator<Item = [DVec3; 3]>, enough: f64, work: &Work) -> f64 {
        let distance = |p| {
            work.add(QUERY);
            self.distance(p)
        };
        let mut faces: Vec<([DVec3; 3], f64)> =
            hull.map(|t| (t, (t[1] - t[0]).cross(t[2] - t[0]).length())).collect();
        // Large faces span hollows, so they show early that a hull is too concave.
        faces.sort_by(|a, b| b.1.total_cmp(&a.1));
        let mut worst = 0.0f64;
        for &(t, area2) in &faces {
            if area2 < 0.02 * SPACING * SPACING {
                continue;
            }
            worst = worst.max(distance((t[0] + t[1] + t[2]) / 3.0));
            if worst > enough {
                return worst;
            }
        }
        for &(t, area2) in &faces {
            let length2 = |k: usize| (t[(k + 1) % 3] - t[k]).length_squared();
            let k = (0..3).max_by(|&i, &j| length2(i).total_cmp(&length2(j))).unwrap_or(0);
            let (a, b, c) = (t[k], t[(k + 1) % 3], t[(k + 2) % 3]);
            let longest = a.distance(b);
            if longest < SPACING {
                continue;
            }
            // Narrow faces get few rows of samples.
            let rows = (area2 / longest / SPACING).ceil().clamp(1.0, 64.0) as usize;
            for r in 0..rows {
                let v = (r as f64 + 0.4) / rows as f64;
                let columns = (longest * (1.0 - v) / SPACING).ceil().clamp(1.0, 64.0) as usize;
                for s in 0..columns {
                    let u = (s as f64 + 0.5) / columns as f64 * (1.0 - v);
                    worst = worst.max(distance(a * (1.0 - u - v) + b * u + c * v));
                    if worst > enough {
                        return worst;
                    }
                }
            }
        }
        worst
    }
}
