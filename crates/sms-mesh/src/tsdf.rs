//! Truncated signed distances fused from depth (Curless and Levoy 1996) in sparse blocks, and their zero surface by
//! marching tetrahedra.

use glamx::DVec3;
use rayon::prelude::*;
use sms_core::{Aabb, Camera, DepthImage, Mesh};
use std::collections::BTreeMap;

const SIDE: i32 = 8;
const COUNT: usize = (SIDE * SIDE * SIDE) as usize;
/// Smallest number of agreeing frames for a sample that carries surface.
const MIN_WEIGHT: f32 = 2.0;

struct VoxelBlock {
    at: [i32; 3],
    value: Vec<f32>,
    weight: Vec<f32>,
}

/// Signed distances to the surface, in units of the truncation, positive in free space.
pub struct Tsdf {
    voxel: f64,
    blocks: Vec<VoxelBlock>,
    index: BTreeMap<[i32; 3], usize>,
}

/// Use of a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PixelUse {
    /// The pixel is not used.
    Unusable,
    /// Free space up to its depth.
    FreeOnly,
    /// Free space up to its depth, and the surface at its depth.
    Surface,
}

/// A depth image to be fused.
pub struct TsdfFrame<'a> {
    /// Camera that took it.
    pub camera: &'a Camera,
    /// Depth in metres; 0 where nothing was measured.
    pub depth: &'a DepthImage,
    /// Use of each pixel, row by row.
    pub pixels: Vec<PixelUse>,
}

impl Tsdf {
    /// Fuses the frames' pixels within `region`. Points accepted by `skip` do not create blocks.
    pub fn fuse(frames: &[TsdfFrame], region: &Aabb, voxel: f64, skip: impl Fn(DVec3) -> bool) -> Self {
        let mut index = BTreeMap::new();
        let size = voxel * f64::from(SIDE);
        for frame in frames {
            let width = frame.depth.width;
            for (i, &pixel) in frame.pixels.iter().enumerate() {
                if pixel != PixelUse::Surface {
                    continue;
                }
                let p = frame.camera.unproject_pixel(i % width, i / width, f64::from(frame.depth.data[i]));
                let inside = p.cmpge(region.min).all() && p.cmple(region.max).all();
                if !inside || skip(p) {
                    continue;
                }
                for corner in 0..8 {
                    let offset = DVec3::from_array([0, 1, 2].map(|a| f64::from(corner >> a & 1) * 2.0 - 1.0));
                    let at = ((p + offset * 2.0 * voxel) / size).floor().to_array().map(|v| v as i32);
                    index.entry(at).or_insert(0usize);
                }
            }
        }
        let mut blocks = Vec::with_capacity(index.len());
        for (at, slot) in &mut index {
            *slot = blocks.len();
            blocks.push(VoxelBlock { at: *at, value: vec![1.0; COUNT], weight: vec![0.0; COUNT] });
        }
        blocks.par_iter_mut().for_each(|block| integrate(block, frames, voxel));
        Self { voxel, blocks, index }
    }

    /// Returns the zero surface; triangles face free space.
    pub fn surface(&self) -> Mesh {
        let mut mesh = Mesh::default();
        let mut vertex_on: BTreeMap<(u64, u64), u32> = BTreeMap::new();
        for block in &self.blocks {
            // The far corners of a block's last cells belong to neighbouring blocks.
            let near: [Option<&VoxelBlock>; 8] = std::array::from_fn(|k| {
                let at = std::array::from_fn(|a| block.at[a] + (k as i32 >> a & 1));
                self.index.get(&at).map(|&i| &self.blocks[i])
            });
            for z in 0..SIDE {
                for y in 0..SIDE {
                    for x in 0..SIDE {
                        self.cell([x, y, z], block, &near, &mut mesh, &mut vertex_on);
                    }
                }
            }
        }
        mesh
    }

    fn cell(
        &self,
        at: [i32; 3],
        block: &VoxelBlock,
        near: &[Option<&VoxelBlock>; 8],
        mesh: &mut Mesh,
        vertex_on: &mut BTreeMap<(u64, u64), u32>,
    ) {
        let mut value = [0.0f32; 8];
        let mut corner = [DVec3::ZERO; 8];
        let mut id = [0u64; 8];
        for k in 0..8 {
            let p: [i32; 3] = std::array::from_fn(|a| at[a] + (k as i32 >> a & 1));
            let which = (0..3).map(|a| usize::from(p[a] >= SIDE) << a).sum::<usize>();
            let Some(owner) = near[which] else { return };
            let local = p.map(|v| v % SIDE);
            let i = ((local[2] * SIDE + local[1]) * SIDE + local[0]) as usize;
            if owner.weight[i] < MIN_WEIGHT {
                return;
            }
            value[k] = owner.value[i];
            let global: [i64; 3] =
                std::array::from_fn(|a| i64::from(block.at[a]) * i64::from(SIDE) + i64::from(p[a]));
            corner[k] = DVec3::from_array(global.map(|v| v as f64)) * self.voxel;
            id[k] = global.iter().fold(0u64, |key, &v| key << 21 | ((v + (1 << 20)) as u64 & 0x1F_FFFF));
        }
        if value.iter().all(|&v| v >= 0.0) || value.iter().all(|&v| v < 0.0) {
            return;
        }
        let mut crossing = |a: usize, b: usize, mesh: &mut Mesh| -> u32 {
            let (a, b) = if id[a] < id[b] { (a, b) } else { (b, a) };
            *vertex_on.entry((id[a], id[b])).or_insert_with(|| {
                let w = f64::from(value[a] / (value[a] - value[b])).clamp(0.02, 0.98);
                mesh.vertices.push(corner[a] + (corner[b] - corner[a]) * w);
                (mesh.vertices.len() - 1) as u32
            })
        };
        // Six tetrahedra along the cell's diagonal (Kuhn): neighbouring cells split their shared face in the same way.
        for [a, b] in [[0, 1], [0, 2], [1, 0], [1, 2], [2, 0], [2, 1]] {
            let tet = [0usize, 1 << a, 1 << a | 1 << b, 7];
            let (solid, free): (Vec<usize>, Vec<usize>) = tet.iter().partition(|&&k| value[k] < 0.0);
            let ring: Vec<u32> = match (solid.len(), free.len()) {
                (1, 3) => free.iter().map(|&f| crossing(solid[0], f, mesh)).collect(),
                (3, 1) => solid.iter().map(|&s| crossing(s, free[0], mesh)).collect(),
                (2, 2) => {
                    [(0, 0), (0, 1), (1, 1), (1, 0)].map(|(s, f)| crossing(solid[s], free[f], mesh)).to_vec()
                }
                _ => continue,
            };
            let mean = |set: &[usize]| set.iter().map(|&k| corner[k]).sum::<DVec3>() / set.len() as f64;
            let outwards = mean(&free) - mean(&solid);
            for k in 1..ring.len() - 1 {
                let mut t = [ring[0], ring[k], ring[k + 1]];
                let [p, q, r] = t.map(|v| mesh.vertices[v as usize]);
                if (q - p).cross(r - p).dot(outwards) < 0.0 {
                    t.swap(1, 2);
                }
                mesh.triangles.push(t);
            }
        }
    }
}

fn integrate(block: &mut VoxelBlock, frames: &[TsdfFrame], voxel: f64) {
    let (front, back) = (3.0 * voxel, 2.0 * voxel);
    let size = voxel * f64::from(SIDE);
    let base = DVec3::from_array(block.at.map(f64::from)) * size;
    let (center, radius) = (base + DVec3::splat(0.5 * size), 0.9 * size);
    for frame in frames {
        let camera = frame.camera;
        let k = &camera.intrinsics;
        let Some((u, v, z)) = camera.project(center) else { continue };
        let reach = radius * k.fx.max(k.fy) / (z - radius).max(1e-3);
        let outside = u < -reach || v < -reach || u > k.width as f64 + reach || v > k.height as f64 + reach;
        if outside || z < radius {
            continue;
        }
        // Before the division, camera coordinates are affine in the voxel indices.
        let x_cw = camera.x_wc.inverse();
        let origin = x_cw.transform_point(base);
        let axes = DVec3::AXES.map(|a| x_cw.rotation * a * voxel);
        for i in 0..COUNT {
            let (x, y, zz) = (i as i32 % SIDE, i as i32 / SIDE % SIDE, i as i32 / (SIDE * SIDE));
            let p = origin + axes[0] * f64::from(x) + axes[1] * f64::from(y) + axes[2] * f64::from(zz);
            let (u, v) = (k.fx * p.x / p.z + k.cx, k.fy * p.y / p.z + k.cy);
            let Some((px, py)) = camera.pixel_at(u, v) else { continue };
            let at = py * k.width + px;
            let gap = f64::from(frame.depth.data[at]) - p.z;
            let value = match frame.pixels[at] {
                PixelUse::Unusable => continue,
                PixelUse::FreeOnly if gap > front => 1.0,
                PixelUse::FreeOnly => continue,
                PixelUse::Surface if gap < -back => continue,
                PixelUse::Surface => (gap / front).min(1.0) as f32,
            };
            let weight = &mut block.weight[i];
            block.value[i] += (value - block.value[i]) / (*weight + 1.0);
            *weight += 1.0;
        }
    }
}
