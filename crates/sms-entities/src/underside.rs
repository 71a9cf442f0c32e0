//! Closing what no camera saw: the contact area on the surface below.

use crate::grid::quantile;
use crate::outline::{convex_outline, is_within};
use crate::support::{Plane, Rest};
use crate::views::{Sight, Views};
use glamx::{DVec2, DVec3};
use sms_core::PointCloud;

/// Points on the resting plane, a `spacing` apart, where the object's foot may touch it: inside the outline of the
/// object's lowest part, and where no camera saw the plane itself. Without any such place, the surroundings of the
/// lowest point.
pub(crate) fn contact_points(
    cloud: &PointCloud,
    rest: &Rest,
    views: &Views,
    label: u16,
    spacing: f64,
) -> Vec<DVec3> {
    let plane = rest.plane;
    let u = plane.normal.any_orthonormal_vector();
    let v = plane.normal.cross(u);
    let heights: Vec<f64> = cloud.points_w.iter().map(|&p| plane.height_over(p)).collect();
    if heights.is_empty() {
        return Vec::new();
    }
    let top = quantile(heights.clone(), 0.98).max(0.0);
    let low = quantile(heights.clone(), 0.02).max(0.0);
    let limit = (low + 0.3 * (top - low)).max(low + 2.0 * spacing);
    let foot: Vec<DVec2> = cloud
        .points_w
        .iter()
        .zip(&heights)
        .filter(|(_, h)| **h <= limit)
        .map(|(p, _)| DVec2::new(p.dot(u), p.dot(v)))
        .collect();
    let outline = convex_outline(&foot);
    let on_plane = |s: f64, t: f64| u * s + v * t + plane.normal * plane.offset;
    // Under a table's top cameras look from the side: where they look past the object there is none of it.
    let is_open = |p: DVec3| {
        UNDER_SHARES.iter().any(|share| is_looked_past(views, p + plane.normal * (share * top), label))
    };
    let mut points = Vec::new();
    if outline.len() >= 3 {
        let min = outline.iter().fold(DVec2::MAX, |m, p| m.min(*p));
        let max = outline.iter().fold(DVec2::MIN, |m, p| m.max(*p));
        let count = |k: usize| (((max[k] - min[k]) / spacing) as usize).min(400) + 1;
        for i in 0..count(0) {
            for j in 0..count(1) {
                // Every other row is shifted: an exact grid is needlessly degenerate.
                let s = min[0] + spacing * (i as f64 + 0.5 * (j % 2) as f64);
                let t = min[1] + spacing * j as f64;
                if is_within(&outline, DVec2::new(s, t), 0.0) && !is_open(on_plane(s, t)) {
                    points.push(on_plane(s, t));
                }
            }
        }
        for p in resample(&outline, spacing) {
            if !is_open(on_plane(p.x, p.y)) {
                points.push(on_plane(p.x, p.y));
            }
        }
    }
    if points.len() < 3 {
        let foot_height = low + 0.5 * spacing;
        let lowest: Vec<DVec3> = cloud
            .points_w
            .iter()
            .zip(&heights)
            .filter(|(_, h)| **h <= foot_height)
            .map(|(&p, _)| plane.project(p))
            .collect();
        let center = lowest.iter().sum::<DVec3>() / lowest.len().max(1) as f64;
        points.push(center);
        points.extend((0..6).map(|k| {
            let (sin, cos) = (std::f64::consts::TAU / 6.0 * f64::from(k)).sin_cos();
            center + (u * cos + v * sin) * spacing
        }));
    }
    points
}

/// The convex outline, grown by `margin`, of the points less than `band` above a plane: on the plane, counter-clockwise
/// seen from its normal.
pub(crate) fn outline_on_plane(points: &[DVec3], plane: &Plane, band: f64, margin: f64) -> Vec<DVec3> {
    let u = plane.normal.any_orthonormal_vector();
    let v = plane.normal.cross(u);
    let near = points.iter().filter(|&&p| plane.height_over(p) < band);
    let grown: Vec<DVec2> = near
        .flat_map(|p| {
            (0..8).map(move |k| {
                let (sin, cos) = (std::f64::consts::FRAC_PI_4 * f64::from(k)).sin_cos();
                DVec2::new(p.dot(u), p.dot(v)) + margin * DVec2::new(cos, sin)
            })
        })
        .collect();
    convex_outline(&grown).iter().map(|p| u * p.x + v * p.y + plane.normal * plane.offset).collect()
}

/// Whether `p` lies over the convex outline, seen along the plane's normal.
pub(crate) fn is_over(outline: &[DVec3], plane: &Plane, p: DVec3) -> bool {
    (0..outline.len()).all(|i| {
        let (a, b) = (outline[i], outline[(i + 1) % outline.len()]);
        (b - a).cross(p - a).dot(plane.normal) >= 0.0
    })
}

/// Heights over a possible contact point, as shares of the object's height, that cameras may look through.
const UNDER_SHARES: [f64; 4] = [0.0, 0.1, 0.2, 0.35];

/// Whether cameras see something else than the object at a point, or look through it at something else. What is inside a
/// bowl is looked through, too, but there the object itself is behind it.
fn is_looked_past(views: &Views, p_w: DVec3, label: u16) -> bool {
    let frames = views.sequence.frames.len();
    let needed = if frames < 6 { 1 } else { 2 };
    let past = |f: &usize| match views.sight(*f, p_w, 0.0) {
        Sight::Surface(there) => there != label,
        Sight::Free => views.label_at(*f, p_w) != Some(label),
        _ => false,
    };
    (0..frames).filter(past).take(needed).count() >= needed
}

/// Points along the outline about `spacing` apart.
fn resample(outline: &[DVec2], spacing: f64) -> Vec<DVec2> {
    let mut out = Vec::new();
    for i in 0..outline.len() {
        let (a, b) = (outline[i], outline[(i + 1) % outline.len()]);
        let steps = ((b - a).length() / spacing).ceil().max(1.0);
        out.extend((0..steps as usize).map(|k| a + k as f64 / steps * (b - a)));
    }
    out
}
