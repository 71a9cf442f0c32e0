//! Colours of surface points: each is the mean of the few views that see it best.
//!
//! A room is in hundreds of frames, of which a point needs three. Neighbouring points order the frames together, by the best
//! that each can be for any of them, and look only at the first.

use crate::views::Views;
use glamx::DVec3;
use sms_core::{ColorImage, Entity};

/// Least cosine between a surface and the direction to a camera that colours it.
const LEAST_FACING: f64 = 0.2;
/// A surface is smooth at a vertex if the cosine between the vertex normal and the face normal is at least this.
const SHARP: f64 = 0.9;
/// Largest number of views that are averaged.
const MOST: usize = 8;

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
        Self { entity, normals: entity.mesh.vertex_normals(), views, images, keep: keep.clamp(1, MOST) }
    }

    /// Returns the colours at points of triangle `t`, which are given by the weights of its corners.
    pub(crate) fn of_block(&self, t: usize, weights: &[[f64; 3]]) -> Vec<[u8; 3]> {
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
        let n = points.len().max(1) as f64;
        let center_w = points.iter().map(|p| p.p_w).sum::<DVec3>() / n;
        let normal = points.iter().map(|p| p.normal).sum::<DVec3>().normalize_or_zero();
        let radius = points.iter().map(|p| p.p_w.distance(center_w)).fold(0.0, f64::max);
        let turned = points.iter().map(|p| p.normal.distance(normal)).fold(0.0, f64::max);
        let mut candidates: Vec<Candidate> = self
            .views
            .frames_around(center_w, radius)
            .filter_map(|frame| {
                let towards = self.views.sequence.frames[frame].camera.center_w() - center_w;
                let distance = towards.length();
                let nearest = distance - radius;
                if nearest <= 0.0 {
                    return Some(Candidate { frame, most: f64::INFINITY });
                }
                // The cosine changes by at most the lengths by which normal and direction do.
                let facing = normal.dot(towards) / distance + turned + 2.0 * radius / distance;
                let most = quality(facing.min(1.0), nearest);
                (facing >= LEAST_FACING).then_some(Candidate { frame, most })
            })
            .collect();
        candidates.sort_unstable_by(|a, b| b.most.total_cmp(&a.most).then(a.frame.cmp(&b.frame)));
        candidates
    }

    /// Returns the mean colour of the best views of a point; `None` if no frame sees it.
    fn seen(&self, point: &SurfacePoint, candidates: &[Candidate]) -> Option<[u8; 3]> {
        let mut best: [BestView; MOST] = [(0.0, 0, (0.0, 0.0)); MOST];
        let best = &mut best[..self.keep];
        for candidate in candidates {
            let (frame, worst) = (candidate.frame, best[self.keep - 1].0);
            if candidate.most <= worst {
                break;
            }
            let towards = self.views.sequence.frames[frame].camera.center_w() - point.p_w;
            let distance = towards.length();
            let facing = point.normal.dot(towards) / distance;
            let quality = quality(facing, distance);
            if facing < LEAST_FACING || quality <= worst {
                continue;
            }
            let Some(uv) = self.views.image_point(frame, point.p_w, self.entity.label) else { continue };
            let at = (0..self.keep).find(|&i| quality > best[i].0).unwrap_or(self.keep - 1);
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
