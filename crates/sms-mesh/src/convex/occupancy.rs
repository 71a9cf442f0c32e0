//! Inside test for points of the unit cube and a closed surface, on a grid.

use crate::convex::repair::TriangleSurface;
use glamx::DVec3;

/// Voxels of a solid in unit coordinates.
pub(crate) struct InsideVoxels {
    min: DVec3,
    cell: f64,
    size: [usize; 3],
    inside: Vec<bool>,
    /// Total length of the columns with positive and with negative winding number, in cells.
    forwards: f64,
    backwards: f64,
}

/// Crossings of one column: height in cells, and −1 if the column enters through the back of an upward face.
type Crossings = Vec<(f64, i32)>;

impl InsideVoxels {
    /// Builds a grid of `resolution` voxels along each side of length 2. A voxel is inside if the winding number at its
    /// centre is not zero.
    pub(crate) fn new(surface: &TriangleSurface, resolution: usize) -> Self {
        let cell = 2.0 / resolution as f64;
        let low = surface.points.iter().fold(DVec3::ONE, |m, p| m.min(*p));
        let high = surface.points.iter().fold(-DVec3::ONE, |m, p| m.max(*p));
        // Columns through the corners of axis-aligned meshes would count twice, so the grid is shifted by a fraction of
        // a cell.
        let min = low - DVec3::new(0.3713, 0.2917, 0.3291) * cell;
        let size = ((high - min) / cell).max(DVec3::ZERO).to_array().map(|v| v as usize + 2);
        let mut grid = Self {
            min,
            cell,
            size,
            inside: vec![false; size.iter().product()],
            forwards: 0.0,
            backwards: 0.0,
        };
        let columns = grid.crossings(surface);
        for (xy, mut column) in columns.into_iter().enumerate() {
            column.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let (mut winding, mut from) = (0, 0.0);
            let mut last = 0.0;
            for (z, sign) in column {
                if winding == 0 {
                    from = z;
                }
                *(if winding >= 0 { &mut grid.forwards } else { &mut grid.backwards }) +=
                    if winding == 0 { 0.0 } else { z - last };
                last = z;
                winding += sign;
                if winding == 0 {
                    for k in from.ceil().max(0.0) as usize..=(z.floor().max(-1.0) as isize).max(0) as usize {
                        if k as f64 >= from && k as f64 <= z && k < size[2] {
                            grid.inside[k * size[0] * size[1] + xy] = true;
                        }
                    }
                }
            }
        }
        grid
    }

    fn crossings(&self, surface: &TriangleSurface) -> Vec<Crossings> {
        let [nx, ny, _] = self.size;
        let mut columns: Vec<Crossings> = vec![Vec::new(); nx * ny];
        for t in &surface.triangles {
            let [a, b, c] =
                t.map(|i| (surface.points[i as usize] - self.min) / self.cell - DVec3::splat(0.5));
            let area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
            if area == 0.0 {
                continue;
            }
            let range = |k: usize, n: usize| {
                let (low, high) = (a[k].min(b[k]).min(c[k]), a[k].max(b[k]).max(c[k]));
                low.ceil().max(0.0) as usize..((high.floor() + 1.0).max(0.0) as usize).min(n)
            };
            for y in range(1, ny) {
                for x in range(0, nx) {
                    let (px, py) = (x as f64, y as f64);
                    // Both triangles at an edge compute the same number, up to the sign.
                    let side = |p: DVec3, q: DVec3| {
                        if (p.x, p.y) < (q.x, q.y) {
                            (p.x - px) * (q.y - py) - (p.y - py) * (q.x - px)
                        } else {
                            -((q.x - px) * (p.y - py) - (q.y - py) * (p.x - px))
                        }
                    };
                    let w = [side(b, c), side(c, a), side(a, b)];
                    let sum = w[0] + w[1] + w[2];
                    let within =
                        if area > 0.0 { w.iter().all(|&w| w >= 0.0) } else { w.iter().all(|&w| w < 0.0) };
                    if within && sum != 0.0 {
                        let z = (w[0] * a.z + w[1] * b.z + w[2] * c.z) / sum;
                        columns[y * nx + x].push((z, if area > 0.0 { -1 } else { 1 }));
                    }
                }
            }
        }
        columns
    }

    /// Returns whether the voxel around a point is inside.
    pub(crate) fn contains(&self, p: DVec3) -> bool {
        let q = (p - self.min) / self.cell;
        if q.min_element() < 0.0 {
            return false;
        }
        let ([x, y, z], [nx, ny, nz]) = (q.to_array().map(|v| v as usize), self.size);
        x < nx && y < ny && z < nz && self.inside[(z * ny + y) * nx + x]
    }

    /// Returns whether a large part of the solid lies behind inverted faces.
    pub(crate) fn is_tangled(&self) -> bool {
        self.backwards > 0.03 * self.forwards
    }

    /// Returns the volume of the inside voxels.
    #[cfg(test)]
    pub(crate) fn volume(&self) -> f64 {
        self.inside.iter().filter(|&&i| i).count() as f64 * self.cell.powi(3)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::convex::repair::clean;
    use sms_core::Mesh;

    #[test]
    fn volumes_and_hollows_are_found() {
        let ball = Mesh::icosphere(1.0, 4);
        let grid = InsideVoxels::new(&clean(&ball.vertices, &ball.triangles), 64);
        assert!((grid.volume() / ball.volume() - 1.0).abs() < 0.01);
        // A box with a cavity, all faces inverted: the winding number in the wall is still not zero.
        let mut mesh = Mesh::cuboid(DVec3::ONE);
        let hole = Mesh::cuboid(DVec3::splat(0.5));
        let n = mesh.vertices.len() as u32;
        mesh.vertices.extend(&hole.vertices);
        mesh.triangles.extend(hole.triangles.iter().map(|&[a, b, c]| [a + n, c + n, b + n]));
        let grid = InsideVoxels::new(&clean(&mesh.vertices, &mesh.triangles), 64);
        assert!((grid.volume() - 7.0).abs() < 0.2, "{}", grid.volume());
        assert!(!grid.contains(DVec3::splat(0.1)) && grid.contains(DVec3::splat(0.8)));
        assert!(!grid.contains(DVec3::splat(1.2)) && !grid.contains(DVec3::splat(-1.2)));
    }
}
