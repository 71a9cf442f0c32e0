//! The solid of a closed mesh on a voxel grid, with the distance of every voxel to it.

use glamx::DVec3;
use sms_core::Mesh;

/// Voxels around a mesh; `distance` is 0 inside the solid (and on its surface), else metres to the nearest solid voxel.
pub(crate) struct VoxelSolid {
    min: DVec3,
    cell: f64,
    size: [usize; 3],
    distance: Vec<f32>,
}

impl VoxelSolid {
    /// Voxelises a closed mesh with about `resolution` cells along its longest side.
    pub(crate) fn new(mesh: &Mesh, resolution: usize) -> Option<Self> {
        let bounds = mesh.aabb()?;
        let cell = bounds.extents().max_element() / resolution.max(4) as f64;
        if !(cell > 0.0 && cell.is_finite()) {
            return None;
        }
        // Rays through cell centres would hit the edges of axis-aligned meshes: shift by an odd fraction of a cell.
        let min = bounds.min - DVec3::new(1.3713, 1.2917, 1.3291) * cell;
        let size = ((bounds.max - min) / cell).to_array().map(|v| v as usize + 2);
        let mut solid = Self { min, cell, size, distance: vec![f32::INFINITY; size.iter().product()] };
        solid.fill_inside(mesh);
        solid.mark_surface(mesh);
        solid.transform();
        Some(solid)
    }

    fn index(&self, x: usize, y: usize, z: usize) -> usize {
        (z * self.size[1] + y) * self.size[0] + x
    }

    /// Scan lines along z: between the odd and even crossings is inside.
    fn fill_inside(&mut self, mesh: &Mesh) {
        let mut crossings: Vec<Vec<f64>> = vec![Vec::new(); self.size[0] * self.size[1]];
        for t in 0..mesh.triangles.len() {
            let [a, b, c] = mesh.corners(t).map(|p| (p - self.min) / self.cell - DVec3::splat(0.5));
            let area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
            if area == 0.0 {
                continue;
            }
            let range = |k: usize| {
                let (low, high) = (a[k].min(b[k]).min(c[k]), a[k].max(b[k]).max(c[k]));
                low.ceil().max(0.0) as usize
                    ..=(high.floor().max(-1.0) as i64).min(self.size[k] as i64 - 1).max(-1) as usize
            };
            let (xs, ys) = (range(0), range(1));
            if *xs.end() > self.size[0] || *ys.end() > self.size[1] {
                continue;
            }
            for y in ys {
                for x in xs.clone() {
                    let (px, py) = (x as f64, y as f64);
                    let weight =
                        |p: DVec3, q: DVec3| ((p.x - px) * (q.y - py) - (p.y - py) * (q.x - px)) / area;
                    let w = [weight(b, c), weight(c, a), weight(a, b)];
                    if w.iter().all(|&w| w >= 0.0) {
                        crossings[y * self.size[0] + x].push(w[0] * a.z + w[1] * b.z + w[2] * c.z);
                    }
                }
            }
        }
        for y in 0..self.size[1] {
            for x in 0..self.size[0] {
                let line = &mut crossings[y * self.size[0] + x];
                line.sort_by(f64::total_cmp);
                for pair in line.chunks_exact(2) {
                    let mut z = pair[0].ceil().max(0.0) as usize;
                    while z < self.size[2] && z as f64 <= pair[1] {
                        let i = self.index(x, y, z);
                        self.distance[i] = 0.0;
                        z += 1;
                    }
                }
            }
        }
    }

    /// Voxels that the surface passes through are solid too: walls thinner than a voxel must not vanish.
    fn mark_surface(&mut self, mesh: &Mesh) {
        for t in 0..mesh.triangles.len() {
            let [a, b, c] = mesh.corners(t);
            let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
            let steps = (longest / (0.6 * self.cell)).ceil().clamp(1.0, 400.0) as usize;
            for i in 0..=steps {
                for j in 0..=steps - i {
                    let (u, v) = (i as f64 / steps as f64, j as f64 / steps as f64);
                    let p = a * (1.0 - u - v) + b * u + c * v;
                    let at = ((p - self.min) / self.cell).to_array().map(|v| v as usize);
                    let index = self.index(at[0], at[1], at[2]);
                    self.distance[index] = 0.0;
                }
            }
        }
    }

    /// Exact Euclidean distances, one axis after the other (Felzenszwalb and Huttenlocher 2012), in metres.
    fn transform(&mut self) {
        let (nx, ny, nz) = (self.size[0], self.size[1], self.size[2]);
        let strides = [1, nx, nx * ny];
        let lines = [(ny, nx, nz, nx * ny), (nx, 1, nz, nx * ny), (nx, 1, ny, nx)];
        for axis in 0..3 {
            let (outer, outer_stride, inner, inner_stride) = lines[axis];
            for i in 0..outer {
                for j in 0..inner {
                    let base = i * outer_stride + j * inner_stride;
                    squared_distance_line(&mut self.distance, base, strides[axis], self.size[axis]);
                }
            }
        }
        for d in &mut self.distance {
            *d = d.sqrt() * self.cell as f32;
        }
    }

    /// Voxel edge, metres.
    pub(crate) fn cell(&self) -> f64 {
        self.cell
    }

    /// Farthest that a convex mesh reaches out of the solid, metres, and where.
    pub(crate) fn concavity(&self, hull: &Mesh) -> (f64, DVec3) {
        let planes: Vec<(DVec3, f64)> = (0..hull.triangles.len())
            .filter_map(|t| {
                let [a, b, c] = hull.corners(t);
                let n = (b - a).cross(c - a).try_normalize()?;
                Some((n, n.dot(a)))
            })
            .collect();
        let Some(bounds) = hull.aabb() else { return (0.0, DVec3::ZERO) };
        let low = ((bounds.min - self.min) / self.cell).to_array().map(|v| v.max(0.0) as usize);
        let high = ((bounds.max - self.min) / self.cell).to_array().map(|v| v.max(0.0) as usize);
        let mut worst = (0.0, bounds.center());
        for y in low[1]..=high[1].min(self.size[1] - 1) {
            for x in low[0]..=high[0].min(self.size[0] - 1) {
                let foot = self.min + DVec3::new(x as f64 + 0.5, y as f64 + 0.5, 0.5) * self.cell;
                let (mut from, mut to) = (bounds.min.z, bounds.max.z);
                for &(n, d) in &planes {
                    let rest = d - n.x * foot.x - n.y * foot.y;
                    if n.z > 1e-12 {
                        to = to.min(rest / n.z);
                    } else if n.z < -1e-12 {
                        from = from.max(rest / n.z);
                    } else if rest < 0.0 {
                        to = f64::NEG_INFINITY;
                    }
                }
                let mut z = ((from - foot.z) / self.cell).ceil().max(0.0) as usize;
                while z < self.size[2] && foot.z + z as f64 * self.cell <= to {
                    let d = f64::from(self.distance[self.index(x, y, z)]);
                    if d > worst.0 {
                        worst = (d, foot + DVec3::Z * (z as f64 * self.cell));
                    }
                    z += 1;
                }
            }
        }
        worst
    }
}

/// Lower envelope of parabolas along one line, in cells squared.
fn squared_distance_line(values: &mut [f32], base: usize, stride: usize, n: usize) {
    let line: Vec<f64> = (0..n).map(|i| f64::from(values[base + i * stride])).collect();
    let mut apex: Vec<usize> = Vec::with_capacity(n);
    let mut from: Vec<f64> = Vec::with_capacity(n);
    for q in 0..n {
        if !line[q].is_finite() {
            continue;
        }
        loop {
            let Some(&p) = apex.last() else {
                apex.push(q);
                from.push(f64::NEG_INFINITY);
                break;
            };
            let s = ((line[q] + (q * q) as f64) - (line[p] + (p * p) as f64)) / (2.0 * (q - p) as f64);
            if s <= from[from.len() - 1] {
                apex.pop();
                from.pop();
            } else {
                apex.push(q);
                from.push(s);
                break;
            }
        }
    }
    if apex.is_empty() {
        return;
    }
    let mut k = 0;
    for q in 0..n {
        while k + 1 < apex.len() && from[k + 1] < q as f64 {
            k += 1;
        }
        let gap = q as f64 - apex[k] as f64;
        values[base + q * stride] = (gap * gap + line[apex[k]]) as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_exact_up_to_a_voxel() {
        let mesh = Mesh::icosphere(0.05, 4);
        let solid = VoxelSolid::new(&mesh, 40).unwrap();
        for z in 0..solid.size[2] {
            for y in 0..solid.size[1] {
                for x in 0..solid.size[0] {
                    let p =
                        solid.min + DVec3::new(x as f64 + 0.5, y as f64 + 0.5, z as f64 + 0.5) * solid.cell;
                    let exact = (p.length() - 0.05).max(0.0);
                    let found = f64::from(solid.distance[solid.index(x, y, z)]);
                    assert!((found - exact).abs() < 1.5 * solid.cell, "{found} {exact}");
                }
            }
        }
        let cube = Mesh::cuboid(DVec3::splat(0.05));
        let (reach, at) = solid.concavity(&cube);
        let exact = 0.05 * (3f64.sqrt() - 1.0);
        assert!((reach - exact).abs() < 2.0 * solid.cell && at.abs().min_element() > 0.04);
        assert!(solid.concavity(&mesh).0 < 1e-6);
    }
}
