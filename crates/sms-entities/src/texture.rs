//! Textures on meshes, baked from the frames.
//!
//! Every triangle gets half of a square of the atlas, as large as the triangle is on the surface. Seams cannot open,
//! and any mesh can be unwrapped. A texel is the mean of the few views that see its surface point best.

use crate::EntitySet;
use crate::config::TextureConfig;
use crate::texel_colors::TexelColors;
use crate::views::Views;
use rayon::prelude::*;
use sms_core::{ColorImage, Entity, EntityKind, Image, Labels, Mesh, MeshTexture};
use sms_frames::Sequence;

/// Empty texels around each triangle, so that filtering does not mix neighbours.
const PAD: usize = 1;
/// Side of the blocks of texels that choose their views together, texels.
const BLOCK: usize = 8;
/// Smallest square, texels.
const LEAST_SIDE: usize = 6;

/// Bakes a texture for the mesh of every object from the frames that saw it. `colors` are the frames' colour images at
/// any size, parallel to the sequence's frames; a missing image is replaced by the frame's own. Unseen places keep
/// their vertex colours.
pub fn bake_textures(
    set: &mut EntitySet,
    sequence: &Sequence,
    labels: &Labels,
    colors: &[Option<ColorImage>],
    config: &TextureConfig,
) {
    if !config.enabled {
        return;
    }
    let views = Views::new(sequence, labels);
    let images: Vec<&ColorImage> = sequence
        .frames
        .iter()
        .enumerate()
        .map(|(f, frame)| colors.get(f).and_then(Option::as_ref).unwrap_or(&frame.color))
        .collect();
    for entity in &mut set.entities {
        // The environment has only vertex colours: they are as fine as its points.
        let is_object = entity.kind == EntityKind::Dynamic || entity.label != sms_core::BACKGROUND;
        if is_object && !entity.mesh.triangles.is_empty() {
            entity.texture = Some(bake(entity, &views, &images, config));
        }
    }
}

/// Position of two triangles in the atlas.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Square {
    x: usize,
    y: usize,
    side: usize,
    /// Triangles in the lower left half and, if there is one, in the upper right half.
    triangles: (usize, Option<usize>),
}

impl Square {
    /// Returns the corners of the triangle of `half` in atlas pixels.
    fn corners(&self, half: usize) -> [[f64; 2]; 3] {
        let (x, y, s) = (self.x as f64, self.y as f64, self.side as f64);
        let (near, leg) = (PAD as f64, s - 4.0 * PAD as f64);
        if half == 0 {
            [[x + near, y + near], [x + near + leg, y + near], [x + near, y + near + leg]]
        } else {
            let (right, bottom) = (x + s - near, y + s - near);
            [[right, bottom], [right - leg, bottom], [right, bottom - leg]]
        }
    }
}

fn longest_edge(mesh: &Mesh, t: usize) -> f64 {
    let [a, b, c] = mesh.corners(t);
    a.distance(b).max(b.distance(c)).max(c.distance(a))
}

/// Returns the sum of the colour channels of a triangle's vertices.
fn brightness(mesh: &Mesh, t: usize) -> u32 {
    let corners = mesh.triangles[t].iter().filter_map(|&i| mesh.colors.get(i as usize));
    corners.flatten().map(|&c| u32::from(c)).sum()
}

/// Returns squares for all triangles and the size of the atlas.
fn pack(mesh: &Mesh, config: &TextureConfig) -> (Vec<Square>, usize, usize) {
    let mut texel = config.texel_m;
    loop {
        let side = |t: usize| {
            let texels = (longest_edge(mesh, t) / texel).ceil().clamp(0.0, 1e6) as usize;
            (texels + 4 * PAD).max(LEAST_SIDE).next_multiple_of(2)
        };
        let mut order: Vec<(usize, usize)> = (0..mesh.triangles.len()).map(|t| (side(t), t)).collect();
        // Renderers with mipmaps mix neighbouring squares, so that those of similar brightness are neighbours.
        order.sort_by_key(|&(side, t)| (std::cmp::Reverse(side), brightness(mesh, t), t));
        let total: usize = order.chunks(2).map(|pair| pair[0].0 * pair[0].0).sum();
        let widest = order.first().map_or(LEAST_SIDE, |o| o.0);
        let width = ((total as f64).sqrt().ceil() as usize).max(widest).next_power_of_two();
        let mut squares = Vec::with_capacity(order.len().div_ceil(2));
        let (mut x, mut y, mut row) = (0, 0, 0);
        for pair in order.chunks(2) {
            let side = pair[0].0;
            if x + side > width {
                (x, y) = (0, y + row);
                row = 0;
            }
            row = row.max(side);
            squares.push(Square { x, y, side, triangles: (pair[0].1, pair.get(1).map(|p| p.1)) });
            x += side;
        }
        let height = (y + row).next_multiple_of(4).max(4);
        if width.max(height) <= config.max_side.max(widest.min(64)) || widest <= LEAST_SIDE {
            return (squares, width, height);
        }
        texel *= 1.25;
    }
}

fn bake(entity: &Entity, views: &Views, images: &[&ColorImage], config: &TextureConfig) -> MeshTexture {
    let mesh = &entity.mesh;
    let (squares, width, height) = pack(mesh, config);
    let mut corner_uv = vec![[[0.0f32; 2]; 3]; mesh.triangles.len()];
    for square in &squares {
        for (half, t) in std::iter::once(square.triangles.0).chain(square.triangles.1).enumerate() {
            let corners = square.corners(half);
            corner_uv[t] =
                corners.map(|[x, y]| [(x / width as f64) as f32, (1.0 - y / height as f64) as f32]);
        }
    }
    let colors = TexelColors::new(entity, views, images, config.views);
    let pixels: Vec<Vec<[u8; 3]>> = squares
        .par_iter()
        .map(|square| {
            let side = square.side;
            let mut pixels = vec![entity.mean_color; side * side];
            for start in (0..side).step_by(BLOCK).flat_map(|y| (0..side).step_by(BLOCK).map(move |x| (x, y)))
            {
                bake_block(square, start, &colors, &mut pixels);
            }
            pixels
        })
        .collect();
    let mut image: ColorImage = Image::filled(width, height, entity.mean_color);
    for (square, pixels) in squares.iter().zip(pixels) {
        for (row, line) in pixels.chunks_exact(square.side).enumerate() {
            let start = (square.y + row) * width + square.x;
            image.data[start..start + square.side].copy_from_slice(line);
        }
    }
    MeshTexture { corner_uv, image }
}

/// Colours the texels of a square from `start` on, for each of its triangles together.
fn bake_block(square: &Square, start: (usize, usize), colors: &TexelColors, pixels: &mut [[u8; 3]]) {
    let side = square.side;
    let (right, bottom) = ((start.0 + BLOCK).min(side), (start.1 + BLOCK).min(side));
    // The upper right half belongs to the second triangle.
    let is_upper = |x: usize, y: usize| square.triangles.1.is_some() && x + y + 1 > side;
    for (half, t) in std::iter::once(square.triangles.0).chain(square.triangles.1).enumerate() {
        let all = (start.1..bottom).flat_map(|y| (start.0..right).map(move |x| (x, y)));
        let texels: Vec<(usize, usize)> = all.filter(|&(x, y)| usize::from(is_upper(x, y)) == half).collect();
        let corners = square.corners(half);
        let weights_at = |&(x, y): &(usize, usize)| {
            barycentric([(square.x + x) as f64 + 0.5, (square.y + y) as f64 + 0.5], corners)
        };
        let weights: Vec<[f64; 3]> = texels.iter().map(weights_at).collect();
        for (&(x, y), color) in texels.iter().zip(colors.of_block(t, &weights)) {
            pixels[y * side + x] = color;
        }
    }
}

/// Returns the weights of a triangle's corners at a point. Outside the triangle they are approximately those of the
/// nearest point on its boundary.
fn barycentric([x, y]: [f64; 2], [a, b, c]: [[f64; 2]; 3]) -> [f64; 3] {
    let (ab, ac, ap) = ([b[0] - a[0], b[1] - a[1]], [c[0] - a[0], c[1] - a[1]], [x - a[0], y - a[1]]);
    let area = ab[0] * ac[1] - ab[1] * ac[0];
    let v = (ap[0] * ac[1] - ap[1] * ac[0]) / area;
    let w = (ab[0] * ap[1] - ab[1] * ap[0]) / area;
    let weights = [1.0 - v - w, v, w].map(|k| k.max(0.0));
    let sum: f64 = weights.iter().sum();
    weights.map(|k| k / sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::{DPose3, DVec3};
    use proptest::prelude::*;
    use sms_core::{Camera, EntityShape, Intrinsics, LabelMap, MaskSource, PointCloud};
    use sms_frames::Frame;

    proptest! {
        /// Squares lie inside the atlas without overlap. Corners lie inside their square, and its halves are apart.
        #[test]
        fn triangles_keep_to_their_places(levels in 0usize..4, texel in 0.0005..0.02f64, stretch in 1.0..9.0f64) {
            let mut mesh = Mesh::icosphere(0.05, levels);
            mesh.vertices.iter_mut().for_each(|v| v.x *= stretch);
            let config = TextureConfig { texel_m: texel, max_side: 512, ..TextureConfig::default() };
            let (squares, width, height) = pack(&mesh, &config);
            let mut used = vec![false; width * height];
            let mut seen = vec![false; mesh.triangles.len()];
            for s in &squares {
                prop_assert!(s.x + s.side <= width && s.y + s.side <= height);
                for y in s.y..s.y + s.side {
                    for x in s.x..s.x + s.side {
                        prop_assert!(!std::mem::replace(&mut used[y * width + x], true));
                    }
                }
                for (half, t) in std::iter::once(s.triangles.0).chain(s.triangles.1).enumerate() {
                    prop_assert!(!std::mem::replace(&mut seen[t], true));
                    for [x, y] in s.corners(half) {
                        let (x, y) = (x - s.x as f64, y - s.y as f64);
                        let diagonal = x + y - s.side as f64;
                        prop_assert!(x >= 1.0 && y >= 1.0 && x <= s.side as f64 - 1.0 && y <= s.side as f64 - 1.0);
                        let apart = if half == 0 { -diagonal } else { diagonal };
                        prop_assert!(apart >= 1.0);
                    }
                }
            }
            prop_assert!(seen.iter().all(|s| *s));
            prop_assert!(width.max(height) <= 512 || texel < 0.001 || levels == 3);
        }
    }

    /// A square plate below a camera that looks straight down at four colours.
    #[test]
    fn a_plate_gets_the_picture_that_the_camera_saw() {
        let intrinsics = Intrinsics { fx: 100.0, fy: 100.0, cx: 50.0, cy: 50.0, width: 100, height: 100 };
        let eye = DVec3::new(0.0, 0.0, 1.0);
        let camera = Camera::look_at(intrinsics, eye, DVec3::ZERO, DVec3::Y);
        let quarter = |x: usize, y: usize| -> [u8; 3] {
            [if x < 50 { 200 } else { 20 }, if y < 50 { 180 } else { 40 }, 90]
        };
        let color =
            Image::from_vec(100, 100, (0..10_000).map(|i| quarter(i % 100, i / 100)).collect::<Vec<_>>());
        let frame = Frame::new(
            camera,
            Image::filled(100, 100, [0; 3]),
            Image::filled(100, 100, 1.0),
            Image::filled(100, 100, [0.0, 0.0, -1.0]),
        );
        let sequence =
            Sequence { frames: vec![frame], x_world_recording: DPose3::IDENTITY, source: "none".into() };
        let labels = Labels {
            maps: vec![LabelMap::filled(100, 100, 1)],
            objects: Vec::new(),
            source: MaskSource::Files,
        };
        let mut mesh = Mesh::cuboid(DVec3::new(0.3, 0.3, 0.05));
        mesh.vertices.iter_mut().for_each(|v| v.z -= 0.05);
        mesh.colors = vec![[7, 8, 9]; 8];
        let entity = Entity {
            label: 1,
            name: "plate".into(),
            description: String::new(),
            kind: EntityKind::Dynamic,
            shape: EntityShape::Convex,
            cloud: PointCloud::default(),
            mesh,
            texture: None,
            parts: Vec::new(),
            observed_share: 1.0,
            residual_m: 0.0,
            mean_color: [1, 2, 3],
        };
        let mut set = EntitySet { entities: vec![entity], support_height: None, joined: Vec::new() };
        bake_textures(&mut set, &sequence, &labels, &[Some(color)], &TextureConfig::default());
        let (mesh, texture) = (&set.entities[0].mesh, set.entities[0].texture.as_ref().unwrap());
        let lookup = |[u, v]: [f64; 2]| {
            let (w, h) = (texture.image.width as f64, texture.image.height as f64);
            texture.image[((u * w) as usize, ((1.0 - v) * h) as usize)]
        };
        for t in 0..mesh.triangles.len() {
            let corners = mesh.corners(t);
            let n = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
            for weights in [[0.6, 0.2, 0.2], [0.2, 0.6, 0.2], [0.15, 0.15, 0.7]] {
                let p: DVec3 = (0..3).map(|k| corners[k] * weights[k]).sum();
                let uv = [0, 1]
                    .map(|c| (0..3).map(|k| f64::from(texture.corner_uv[t][k][c]) * weights[k]).sum::<f64>());
                let (x, y, _) = camera.project(p).unwrap();
                let expected = if n.z > 0.9 { quarter(x as usize, y as usize) } else { [7, 8, 9] };
                assert_eq!(lookup(uv), expected, "triangle {t} at {p}");
            }
        }
    }
}
