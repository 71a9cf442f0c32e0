//! Height map of surfaces, from above.

use glamx::{DVec2, DVec3};
use sms_core::Mesh;
use sms_scene::{BodyKind, Scene};

/// The surface of an object in the world.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectSurface {
    /// Name of the object.
    pub name: String,
    /// Its surface, metres, in the world.
    pub mesh_w: Mesh,
}

/// Returns the surfaces of the scene's movable bodies; the floor and walls are not landing targets.
pub fn surfaces_of(scene: &Scene) -> Vec<ObjectSurface> {
    let bodies = scene.bodies.iter().filter(|b| b.kind == BodyKind::Dynamic);
    bodies
        .flat_map(|b| {
            let seen = if b.visual.triangles.is_empty() { b.shape.meshes() } else { vec![b.visual.clone()] };
            seen.into_iter()
                .map(|mesh| ObjectSurface { name: b.name.clone(), mesh_w: mesh.transformed(&b.x_wb) })
        })
        .collect()
}

/// The highest surface at a cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Top {
    /// Height, metres.
    pub z: f64,
    /// Index of the surface.
    pub surface: usize,
}

/// Heights of the highest surfaces on a grid.
#[derive(Debug, Clone)]
pub(crate) struct TopMap {
    /// Corner of cell (0, 0).
    origin_w: DVec2,
    cell: f64,
    width: usize,
    height: usize,
    tops: Vec<Option<Top>>,
}

/// Cells around the surfaces, so that windows stay inside.
const MARGIN: f64 = 0.05;
/// Greatest number of cells on a side: larger scenes get larger cells.
const MOST_CELLS: f64 = 2000.0;

impl TopMap {
    pub(crate) fn new(surfaces: &[ObjectSurface], cell: f64) -> Self {
        let vertices = || surfaces.iter().flat_map(|s| &s.mesh_w.vertices).map(|v| v.truncate());
        let low = vertices().reduce(DVec2::min).unwrap_or_default() - MARGIN;
        let high = vertices().reduce(DVec2::max).unwrap_or_default() + MARGIN;
        let size = high - low;
        let cell = cell.max(size.max_element() / MOST_CELLS);
        let (width, height) = ((size.x / cell).ceil() as usize, (size.y / cell).ceil() as usize);
        let mut map = Self { origin_w: low, cell, width, height, tops: vec![None; width * height] };
        for (surface, s) in surfaces.iter().enumerate() {
            for t in 0..s.mesh_w.triangles.len() {
                map.rasterise(s.mesh_w.corners(t), surface);
            }
        }
        map
    }

    fn rasterise(&mut self, corners: [DVec3; 3], surface: usize) {
        let [a, b, c] = corners.map(|p| (p.truncate() - self.origin_w) / self.cell - 0.5);
        let double_area = (b - a).perp_dot(c - a);
        if double_area.abs() < 1e-12 {
            return;
        }
        let (low, high) = (a.min(b).min(c).ceil(), a.max(b).max(c).floor());
        // The map contains all vertices, with a margin: every cell is inside.
        for y in low.y as i64..=high.y as i64 {
            for x in low.x as i64..=high.x as i64 {
                let p = DVec2::new(x as f64, y as f64);
                let wa = (c - b).perp_dot(p - b) / double_area;
                let wb = (a - c).perp_dot(p - c) / double_area;
                let wc = 1.0 - wa - wb;
                if wa.min(wb).min(wc) < -1e-9 {
                    continue;
                }
                let z = wa * corners[0].z + wb * corners[1].z + wc * corners[2].z;
                let slot = &mut self.tops[y as usize * self.width + x as usize];
                if slot.is_none_or(|top| z > top.z) {
                    *slot = Some(Top { z, surface });
                }
            }
        }
    }

    /// Returns the centre of a cell.
    fn center_w(&self, x: i64, y: i64) -> DVec2 {
        self.origin_w + self.cell * DVec2::new(x as f64 + 0.5, y as f64 + 0.5)
    }

    /// Returns the centres and the tops of the cells with a surface, row by row.
    pub(crate) fn cells(&self) -> impl Iterator<Item = (DVec2, Top)> + '_ {
        self.tops.iter().enumerate().filter_map(|(i, top)| {
            let (x, y) = (i % self.width, i / self.width);
            Some((self.center_w(x as i64, y as i64), (*top)?))
        })
    }

    /// Returns the cells with centres within `half` metres of `p_w` along x and y; `None` for each beyond the grid.
    pub(crate) fn square(&self, p_w: DVec2, half: f64) -> impl Iterator<Item = (DVec2, Option<Top>)> + '_ {
        let low = ((p_w - half - self.origin_w) / self.cell - 0.5).ceil();
        let high = ((p_w + half - self.origin_w) / self.cell - 0.5).floor();
        let (columns, rows) = (low.x as i64..=high.x as i64, low.y as i64..=high.y as i64);
        rows.flat_map(move |y| columns.clone().map(move |x| (x, y))).map(move |(x, y)| {
            let inside = x >= 0 && y >= 0 && (x as usize) < self.width && (y as usize) < self.height;
            let top = if inside { self.tops[y as usize * self.width + x as usize] } else { None };
            (self.center_w(x, y), top)
        })
    }

    /// Fits a plane to the tops of one surface around a cell, by least squares. Returns its height at the cell
    /// (metres) and its upward unit normal, or `None` if fewer than half of the cells belong to that surface.
    pub(crate) fn plane(&self, p_w: DVec2, half: f64, surface: usize) -> Option<(f64, DVec3)> {
        let (mut n, mut all) = (0.0, 0.0);
        let (mut sum, mut moment) = (DVec3::ZERO, [0.0; 5]);
        for (q, top) in self.square(p_w, half) {
            all += 1.0;
            let Some(top) = top.filter(|t| t.surface == surface) else { continue };
            let d = q - p_w;
            n += 1.0;
            sum += d.extend(top.z);
            let products = [d.x * d.x, d.x * d.y, d.y * d.y, d.x * top.z, d.y * top.z];
            moment.iter_mut().zip(products).for_each(|(sum, product)| *sum += product);
        }
        if n < 6.0 || 2.0 * n < all {
            return None;
        }
        let mean = sum / n;
        let [xx, xy, yy, xz, yz] = moment;
        let (cxx, cxy, cyy) = (xx / n - mean.x * mean.x, xy / n - mean.x * mean.y, yy / n - mean.y * mean.y);
        let (cxz, cyz) = (xz / n - mean.x * mean.z, yz / n - mean.y * mean.z);
        let det = cxx * cyy - cxy * cxy;
        if det < 1e-6 * (half * half) * (half * half) {
            return None;
        }
        let slope = DVec2::new(cyy * cxz - cxy * cyz, cxx * cyz - cxy * cxz) / det;
        let z = mean.z - slope.dot(mean.truncate());
        Some((z, DVec3::new(-slope.x, -slope.y, 1.0).normalize()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::{DPose3, DQuat};

    #[test]
    fn the_highest_surface_counts_and_slopes_are_found() {
        let tilt = DQuat::from_rotation_y(0.1);
        let board = Mesh::cuboid(DVec3::new(0.5, 0.3, 0.01));
        let board = board.transformed(&DPose3::from_parts(DVec3::Z, tilt));
        let block =
            Mesh::cuboid(DVec3::new(0.05, 0.05, 0.05)).transformed(&DPose3::from_translation(DVec3::Z));
        let surfaces = [("board", board), ("block", block)]
            .map(|(name, mesh_w)| ObjectSurface { name: name.into(), mesh_w });
        let map = TopMap::new(&surfaces, 0.01);
        let (height, normal) = map.plane(DVec2::new(0.3, 0.1), 0.03, 0).unwrap();
        let expected = 1.0 + 0.01 / 0.1f64.cos() - 0.3 * 0.1f64.tan();
        assert!((height - expected).abs() < 1e-9, "{height} {expected}");
        assert!(normal.distance(tilt * DVec3::Z) < 1e-9);
        let over_block: Vec<_> = map.square(DVec2::ZERO, 0.02).map(|(_, top)| top.unwrap()).collect();
        assert!(
            over_block.len() >= 16 && over_block.iter().all(|t| t.surface == 1 && (t.z - 1.05).abs() < 1e-9)
        );
        assert_eq!(map.plane(DVec2::ZERO, 0.03, 0), None, "the board is below the block");
        assert!(map.square(DVec2::splat(9.0), 0.02).all(|(_, top)| top.is_none()));
    }
}
