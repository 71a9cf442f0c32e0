//! Colours of surface points: each is the mean of the few views that see it best.
//!
//! A room is in hundreds of frames, of which a point needs three. Neighbouring points order the frames together, by the best
//! that each can be for any of them, and stop once no later frame can be better.

use crate::views::{NearPixel, Views};
use glamx::DVec3;
use sms_core::{ColorImage, Entity};

/// Least cosine between a surface and the direction to a camera that colours it.
const LEAST_FACING: f64 = 0.2;
/// A surface is smooth at a vertex if the cosine between the vertex normal and the face normal is at least this.
const SHARP: f64 = 0.9;
/// Largest number of views that are averaged.
const MOST_VIEWS: usize = 8;

/// The colours of an object's surface in its frames.
pub(crate) struct TexelColors<'a> {
    entity: &'a Entity,
    /// Normals of the mesh's vertices.
    normals: Vec<DVec3>,
    views: &'a Views<'a>,
    images: &'a [&'a ColorImage],
    /// Number of views averaged.
    keep: usize,
}

/// A point of the surface with its normal.
#[derive(Clone, Copy)]
struct SurfacePoint {
    p_w: DVec3,
    normal: DVec3,
}

/// A frame that may colour points of a block.
struct Candidate {
    frame: usize,
    /// Upper limit of its quality at any of the points.
    most: f64,
}

/// A view of a point: its quality, frame and image-plane coordinates.
type BestView = (f64, usize, (f64, f64));

/// Returns the quality of a view: that of a frontal one falls with the square of the distance.
fn quality(facing: f64, distance: f64) -> f64 {
    facing * facing / (distance * distance)
}

impl<'a> TexelColors<'a> {
    pub(crate) fn new(
        entity: &'a Entity,
        views: &'a Views<'a>,
        images: &'a [&'a ColorImage],
        keep: usize,
    ) -> Self {
        Self { entity, normals: entity.mesh.vertex_normals(), views, images, keep: keep.clamp(1, MOST_VIEWS) }
    }

    /// Returns the colours at points of triangle `t`, which are given by the weights of its corners.
    pub(crate) fn of_block(&self, t: usize, weights: &[[f64; 3]]) -> Vec<[u8; 3]> {
        if weights.is_empty() {
            return Vec::new();
        }
        let points: Vec<SurfacePoint> = weights.iter().map(|w| self.point(t, w)).collect();
        let candidates = self.candidates(&points);
        let colors = points.iter().zip(weights);
        colors.map(|(point, w)| self.seen(point, &candidates).unwrap_or_else(|| self.own(t, w))).collect()
    }

    fn point(&self, t: usize, weights: &[f64; 3]) -> SurfacePoint {
        let (triangle, corners) = (self.entity.mesh.triangles[t], self.entity.mesh.corners(t));
        let p_w = (0..3).map(|k| corners[k] * weights[k]).sum();
        let smooth = (0..3).map(|k| self.normals[triangle[k] as usize] * weights[k]).sum::<DVec3>();
        let smooth = smooth.normalize_or_zero();
        let flat = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
        // At a sharp edge, the mean of both normals would choose views of the other face.
        SurfacePoint { p_w, normal: if smooth.dot(flat) < SHARP { flat } else { smooth } }
    }

    /// Returns all frames that may colour one of the points, with the best possible first.
    fn candidates(&self, points: &[SurfacePoint]) -> Vec<Candidate> {
        /// Share by which bounds exceed their value, for rounding.
        const SLACK: f64 = 1e-9;
        let n = points.len() as f64;
        let center_w = points.iter().map(|p| p.p_w).sum::<DVec3>() / n;
        let normal = points.iter().map(|p| p.normal).sum::<DVec3>().normalize_or_zero();
        let radius = points.iter().map(|p| p.p_w.distance(center_w)).fold(0.0, f64::max) + SLACK;
        let turned = points.iter().map(|p| p.normal.distance(normal)).fold(0.0, f64::max);
        let (views, label) = (self.views, self.entity.label);
        let shows = |frame: usize| {
            let is_own = |pixel: NearPixel| pixel.label == label && pixel.may_be_on_surface();
            views.has_near_pixel(frame, center_w, radius, is_own)
        };
        let candidate = |frame: usize| {
            let towards = views.sequence.frames[frame].camera.center_w() - center_w;
            let distance = towards.length();
            let nearest = distance - radius;
            if nearest <= 0.0 {
                return Some(Candidate { frame, most: f64::INFINITY });
            }
            // The cosine changes by at most the lengths by which normal and direction do.
            let facing = normal.dot(towards) / distance + turned + 2.0 * radius / distance + SLACK;
            let most = quality(facing.min(1.0), nearest) * (1.0 + SLACK);
            (facing >= LEAST_FACING && shows(frame)).then_some(Candidate { frame, most })
        };
        let mut candidates: Vec<Candidate> =
            views.frames_around(center_w, radius).filter_map(candidate).collect();
        candidates.sort_unstable_by(|a, b| b.most.total_cmp(&a.most).then(a.frame.cmp(&b.frame)));
        candidates
    }

    /// Returns the mean colour of the best views of a point; `None` if no frame sees it.
    fn seen(&self, point: &SurfacePoint, candidates: &[Candidate]) -> Option<[u8; 3]> {
        let mut best: [BestView; MOST_VIEWS] = [(0.0, usize::MAX, (0.0, 0.0)); MOST_VIEWS];
        let best = &mut best[..self.keep];
        for candidate in candidates {
            let (frame, worst) = (candidate.frame, best[self.keep - 1]);
            if candidate.most < worst.0 {
                break;
            }
            let towards = self.views.sequence.frames[frame].camera.center_w() - point.p_w;
            let distance = towards.length();
            let facing = point.normal.dot(towards) / distance;
            let quality = quality(facing, distance);
            // Of equally good frames the earlier is better.
            let is_better = |other: &BestView| quality > other.0 || (quality == other.0 && frame < other.1);
            if facing < LEAST_FACING || !is_better(&worst) {
                continue;
            }
            let Some(uv) = self.views.image_point(frame, point.p_w, self.entity.label) else { continue };
            let at = (0..self.keep).find(|&i| is_better(&best[i])).unwrap_or(self.keep - 1);
            best[at..].rotate_right(1);
            best[at] = (quality, frame, uv);
        }
        let mut sum = [0.0; 3];
        for &(quality, frame, uv) in best.iter().filter(|b| b.0 > 0.0) {
            let color = self.color(frame, uv);
            sum.iter_mut().zip(color).for_each(|(s, c)| *s += quality * c);
        }
        let total: f64 = best.iter().map(|b| b.0).sum();
        (total > 0.0).then(|| sum.map(|s| (s / total).round().clamp(0.0, 255.0) as u8))
    }

    fn color(&self, frame: usize, (u, v): (f64, f64)) -> [f64; 3] {
        let k = &self.views.sequence.frames[frame].camera.intrinsics;
        let image = self.images[frame];
        sample(image, u * image.width as f64 / k.width as f64, v * image.height as f64 / k.height as f64)
    }

    /// Returns the mesh's own colour at a point of triangle `t`.
    fn own(&self, t: usize, weights: &[f64; 3]) -> [u8; 3] {
        let mesh = &self.entity.mesh;
        if mesh.colors.len() != mesh.vertices.len() {
            return self.entity.mean_color;
        }
        std::array::from_fn(|c| {
            let of = |k: usize| f64::from(mesh.colors[mesh.triangles[t][k] as usize][c]) * weights[k];
            (0..3).map(of).sum::<f64>().round() as u8
        })
    }
}

/// Bilinear sample at pixel coordinates (centres at half integers).
fn sample(image: &ColorImage, u: f64, v: f64) -> [f64; 3] {
    let (x, y) = (u - 0.5, v - 0.5);
    let (i, j) = (x.floor(), y.floor());
    let (fx, fy) = (x - i, y - j);
    let at = |dx: f64, dy: f64| {
        let x = (i + dx).clamp(0.0, image.width as f64 - 1.0) as usize;
        let y = (j + dy).clamp(0.0, image.height as f64 - 1.0) as usize;
        image[(x, y)]
    };
    let (a, b, c, d) = (at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0), at(1.0, 1.0));
    std::array::from_fn(|k| {
        let row = |p: [u8; 3], q: [u8; 3]| f64::from(p[k]) * (1.0 - fx) + f64::from(q[k]) * fx;
        row(a, b) * (1.0 - fy) + row(c, d) * fy
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{entity, over_plate};
    use rand::RngExt;
    use sms_core::{EntityShape, Mesh, Seed};

    #[test]
    fn the_views_of_a_block_are_the_best_of_all_frames() {
        let (mut sequence, labels) = over_plate(12, 70);
        let mut rng = Seed(11).rng();
        for (i, frame) in sequence.frames.iter_mut().enumerate() {
            // Some frames have the same pose, so that they are equally good.
            frame.camera.x_wc.translation += DVec3::new(0.11, -0.07, -0.02) * (i / 2) as f64;
            frame
                .depth
                .data
                .iter_mut()
                .filter(|z| **z > 0.0)
                .for_each(|z| *z += rng.random_range(-0.02..0.02));
            frame.color.data.iter_mut().for_each(|c| *c = rng.random());
        }
        let views = Views::new(&sequence, &labels);
        let mut mesh = Mesh::icosphere(0.3, 3);
        mesh.vertices.iter_mut().for_each(|v| v.z *= 0.05);
        let entity = entity("plate", mesh, EntityShape::Convex);
        let images: Vec<&ColorImage> = sequence.frames.iter().map(|f| &f.color).collect();
        let colors = TexelColors::new(&entity, &views, &images, 3);
        let mut seen = 0;
        for t in 0..entity.mesh.triangles.len() {
            let weights: Vec<[f64; 3]> = (0..20)
                .map(|_| {
                    let (a, b) = (rng.random::<f64>(), rng.random::<f64>());
                    [1.0 - a, a * (1.0 - b), a * b]
                })
                .collect();
            for (w, color) in weights.iter().zip(colors.of_block(t, &weights)) {
                let SurfacePoint { p_w, normal } = colors.point(t, w);
                let mut all: Vec<BestView> = Vec::new();
                for (f, frame) in sequence.frames.iter().enumerate() {
                    let towards = frame.camera.center_w() - p_w;
                    let facing = normal.dot(towards) / towards.length();
                    let Some(uv) = views.image_point(f, p_w, 1) else { continue };
                    if facing >= LEAST_FACING {
                        all.push((quality(facing, towards.length()), f, uv));
                    }
                }
                all.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
                all.truncate(3);
                seen += all.len();
                let total: f64 = all.iter().map(|v| v.0).sum();
                let mean =
                    |c: usize| all.iter().map(|v| v.0 * colors.color(v.1, v.2)[c]).sum::<f64>() / total;
                let expected =
                    if all.is_empty() { entity.mean_color } else { [0, 1, 2].map(|c| mean(c).round() as u8) };
                assert_eq!(color, expected, "triangle {t} at {p_w}");
            }
        }
        assert!(seen > 3000, "{seen}");
    }
}
