//! A closed surface for open, torn or self-intersecting meshes, which do not bound a volume.
//!
//! Space is inside if it cannot be reached from outside through openings wider than a few voxels. Within a voxel of the
//! surface, the direction of the nearest face decides, so that thin double walls stay thin and single sheets become
//! about a voxel thick on their back side. A single-sheet cup stays a cup.

use crate::convex::repair::TriangleSurface;
use glamx::DVec3;
use parry3d_f64::shape::TriMesh;
use rayon::prelude::*;

/// Limit of the work for nearest faces: the largest number of pairs of a voxel and a face whose box contains or touches
/// the voxel. Faces of a scan make a million pairs. Twenty thousand faces that cross the whole object exceed the limit
/// on any useful grid.
pub(crate) const MOST_PAIRS: f64 = 2e7;

/// Openings up to twice this number of voxels wide are sealed.
const SEAL: u16 = 2;

struct VoxelGrid {
    min: DVec3,
    cell: f64,
    size: [usize; 3],
}

impl VoxelGrid {
    fn len(&self) -> usize {
        self.size.iter().product()
    }

    fn at(&self, i: usize) -> [usize; 3] {
        let [nx, ny, _] = self.size;
        [i % nx, i / nx % ny, i / (nx * ny)]
    }

    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.size[1] + y) * self.size[0] + x
    }

    fn center(&self, i: usize) -> DVec3 {
        let [x, y, z] = self.at(i).map(|v| v as f64 + 0.5);
        self.min + DVec3::new(x, y, z) * self.cell
    }

    fn neighbors(&self, i: usize) -> impl Iterator<Item = usize> + '_ {
        let at = self.at(i);
        (0..6).filter_map(move |k| {
            let (axis, up) = (k / 2, k % 2 == 1);
            let mut to = at;
            to[axis] = if up { at[axis] + 1 } else { at[axis].wrapping_sub(1) };
            (to[axis] < self.size[axis]).then(|| self.index(to))
        })
    }

    /// Returns the number of steps from `start` through `open` voxels, at most `most`; `u16::MAX` for voxels out of
    /// reach.
    fn flood(&self, start: impl Iterator<Item = usize>, open: &dyn Fn(usize) -> bool, most: u16) -> Vec<u16> {
        let mut steps = vec![u16::MAX; self.len()];
        let mut queue: std::collections::VecDeque<usize> = Default::default();
        for i in start {
            steps[i] = 0;
            queue.push_back(i);
        }
        while let Some(i) = queue.pop_front() {
            if steps[i] >= most {
                continue;
            }
            for n in self.neighbors(i) {
                if steps[n] == u16::MAX && open(n) {
                    steps[n] = steps[i] + 1;
                    queue.push_back(n);
                }
            }
        }
        steps
    }
}

/// Returns the number of pairs of a face and a voxel inside or beside the face's box. The grid has `resolution` voxels
/// along the longest side.
pub(crate) fn pairs(surface: &TriangleSurface, resolution: usize) -> f64 {
    let cell = 2.0 / resolution as f64;
    let boxes = surface.triangles.iter().filter_map(|t| {
        let bounds = sms_core::Aabb::of_points(t.map(|i| surface.points[i as usize]))?;
        Some((bounds.extents() / cell + DVec3::splat(2.0)).element_product())
    });
    boxes.sum()
}

/// Returns a closed surface around the space that `surface` (any triangles, in unit coordinates) encloses, on a grid of
/// `resolution` voxels along the longest side. Returns `None` when this space is empty or the work too large.
pub(crate) fn remesh(surface: &TriangleSurface, resolution: usize) -> Option<TriangleSurface> {
    let cell = 2.0 / resolution as f64;
    if pairs(surface, resolution) > MOST_PAIRS {
        return None;
    }
    let shape = TriMesh::new(surface.points.clone(), surface.triangles.clone()).ok()?;
    let low = surface.points.iter().fold(DVec3::ONE, |m, p| m.min(*p));
    let high = surface.points.iter().fold(-DVec3::ONE, |m, p| m.max(*p));
    let pad = f64::from(SEAL) + 2.3;
    let min = low - DVec3::splat(pad * cell);
    let size = ((high - min) / cell).to_array().map(|v| (v + pad) as usize + 2);
    let grid = VoxelGrid { min, cell, size };
    let near = near_surface(surface, &grid);
    // Signed distances near the surface, from the direction of the nearest face.
    let sheet: Vec<f64> = (0..grid.len())
        .into_par_iter()
        .map(|i| {
            if !near[i] {
                return f64::INFINITY;
            }
            let p = grid.center(i);
            let (projection, location) =
                parry3d_f64::query::PointQueryWithLocation::project_local_point_and_get_location(
                    &shape, p, false,
                );
            let d = projection.point.distance(p);
            if d > 0.9 * cell {
                return f64::INFINITY;
            }
            let [a, b, c] = surface.triangles[location.0 as usize].map(|i| surface.points[i as usize]);
            if (b - a).cross(c - a).dot(p - projection.point) > 0.0 { d } else { -d }
        })
        .collect();
    // Flood from outside, except through voxels closer than the seal; then back up to the surface.
    let barrier: Vec<usize> = (0..grid.len()).filter(|&i| sheet[i].is_finite()).collect();
    let gap = grid.flood(barrier.into_iter(), &|_| true, SEAL);
    let far = grid.flood(std::iter::once(0), &|i| gap[i] == u16::MAX, u16::MAX);
    let outside =
        grid.flood((0..grid.len()).filter(|&i| far[i] != u16::MAX), &|i| !sheet[i].is_finite(), SEAL + 1);
    let field: Vec<f64> = (0..grid.len())
        .map(|i| match (sheet[i].is_finite(), outside[i] != u16::MAX) {
            (true, _) => sheet[i],
            (_, true) => cell,
            _ => -cell,
        })
        .collect();
    let closed = surface_net(&grid, &field);
    (closed.volume() > 1e-6).then_some(closed)
}

/// Marks voxels that intersect the surface, and their neighbours.
fn near_surface(surface: &TriangleSurface, grid: &VoxelGrid) -> Vec<bool> {
    let mut on = vec![false; grid.len()];
    for t in &surface.triangles {
        let [a, b, c] = t.map(|i| surface.points[i as usize]);
        let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
        let steps = (longest / (0.7 * grid.cell)).ceil().clamp(1.0, 400.0) as usize;
        for i in 0..=steps {
            for j in 0..=steps - i {
                let (u, v) = (i as f64 / steps as f64, j as f64 / steps as f64);
                let p = a * (1.0 - u - v) + b * u + c * v;
                on[grid.index(((p - grid.min) / grid.cell).to_array().map(|v| v as usize))] = true;
            }
        }
    }
    let mut near = vec![false; grid.len()];
    for i in (0..grid.len()).filter(|&i| on[i]) {
        // The grid extends beyond the surface by more than a voxel.
        let [x, y, z] = grid.at(i);
        for n in 0..27 {
            near[grid.index([x + n % 3 - 1, y + n / 3 % 3 - 1, z + n / 9 - 1])] = true;
        }
    }
    near
}

/// Returns the zero level of a field as quads across the edges that change sign, with one vertex per voxel cube (Gibson
/// 1998).
fn surface_net(grid: &VoxelGrid, field: &[f64]) -> TriangleSurface {
    let [nx, ny, nz] = grid.size;
    let mut vertex = vec![u32::MAX; grid.len()];
    let mut out = TriangleSurface::default();
    let corner = |at: [usize; 3], k: usize| [at[0] + (k & 1), at[1] + (k >> 1 & 1), at[2] + (k >> 2)];
    for z in 0..nz - 1 {
        for y in 0..ny - 1 {
            for x in 0..nx - 1 {
                let ids: [usize; 8] = std::array::from_fn(|k| grid.index(corner([x, y, z], k)));
                let (mut sum, mut count) = (DVec3::ZERO, 0.0);
                for k in 0..8usize {
                    for bit in [1usize, 2, 4] {
                        if k & bit != 0 {
                            continue;
                        }
                        let (i, j) = (ids[k], ids[k | bit]);
                        if (field[i] < 0.0) != (field[j] < 0.0) {
                            let t = field[i] / (field[i] - field[j]);
                            sum += grid.center(i).lerp(grid.center(j), t);
                            count += 1.0;
                        }
                    }
                }
                if count > 0.0 {
                    vertex[ids[0]] = out.points.len() as u32;
                    out.points.push(sum / count);
                }
            }
        }
    }
    for z in 1..nz - 1 {
        for y in 1..ny - 1 {
            for x in 1..nx - 1 {
                let i = grid.index([x, y, z]);
                for axis in 0..3 {
                    let mut to = [x, y, z];
                    to[axis] += 1;
                    let j = grid.index(to);
                    let (inside, beyond) = (field[i] < 0.0, field[j] < 0.0);
                    if inside == beyond {
                        continue;
                    }
                    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                    let cube = |du: usize, dv: usize| {
                        let mut at = [x, y, z];
                        at[u] -= du;
                        at[v] -= dv;
                        vertex[grid.index(at)]
                    };
                    let mut quad = [cube(1, 1), cube(0, 1), cube(0, 0), cube(1, 0)];
                    if !inside {
                        quad.reverse();
                    }
                    out.triangles.push([quad[0], quad[1], quad[2]]);
                    out.triangles.push([quad[0], quad[2], quad[3]]);
                }
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::convex::repair::clean;
    use sms_core::Mesh;

    #[test]
    fn a_ball_with_a_hole_is_a_ball_and_a_hemisphere_is_a_shell() {
        let ball = Mesh::icosphere(1.0, 4);
        let torn = TriangleSurface {
            points: ball.vertices.clone(),
            triangles: ball.triangles.iter().copied().skip(3).collect(),
        };
        let closed = remesh(&torn, 80).unwrap();
        assert!(closed.is_closed());
        assert!((closed.volume() / ball.volume() - 1.0).abs() < 0.01, "{}", closed.volume());
        let half: Vec<[u32; 3]> = ball
            .triangles
            .iter()
            .copied()
            .filter(|t| t.iter().all(|&i| ball.vertices[i as usize].z < 0.05))
            .collect();
        let cup = remesh(&clean(&ball.vertices, &half), 80).unwrap();
        assert!(cup.is_closed());
        assert!(cup.volume() < 0.15 * ball.volume(), "{}", cup.volume());
    }
}
