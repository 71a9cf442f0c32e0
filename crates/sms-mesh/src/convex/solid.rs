//! The solid as the reference for parts.

use crate::convex::occupancy::InsideVoxels;
use crate::convex::repair::TriangleSurface;
use crate::convex::work::{QUERY, Work};
use glamx::DVec3;
use parry3d_f64::query::PointQuery;
use parry3d_f64::shape::TriMesh;

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
    pub(crate) fn distance(&self, p: DVec3) -> f64 {
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
    /// the first distance above `enough`. Samples lie about `spacing` apart.
    pub(crate) fn reach(
        &self,
        hull: impl Iterator<Item = [DVec3; 3]>,
        spacing: f64,
        enough: f64,
        work: &Work,
    ) -> f64 {
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
            if area2 < 0.02 * spacing * spacing {
                continue;
            }
            worst = worst.max(distance((t[0] + t[1] + t[2]) / 3.0));
            if worst > enough {
                return worst;
            }
        }
        for &(t, area2) in &faces {
            let k = (0..3)
                .max_by(|&i, &j| edge(&t, i).length_squared().total_cmp(&edge(&t, j).length_squared()))
                .unwrap_or(0);
            let (a, b, c) = (t[k], t[(k + 1) % 3], t[(k + 2) % 3]);
            let longest = a.distance(b);
            if longest < spacing {
                continue;
            }
            // Narrow faces get few rows of samples.
            let rows = (area2 / longest / spacing).ceil().clamp(1.0, 64.0) as usize;
            for r in 0..rows {
                let v = (r as f64 + 0.4) / rows as f64;
                let columns = (longest * (1.0 - v) / spacing).ceil().clamp(1.0, 64.0) as usize;
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

fn edge(t: &[DVec3; 3], k: usize) -> DVec3 {
    t[(k + 1) % 3] - t[k]
}
