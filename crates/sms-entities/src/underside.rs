//! Downward faces: unseen contact areas, and points with the wrong label at the edge between two objects.

use crate::draft::Draft;
use crate::support::{Carrier, RestingPlane, SIDE};
use crate::views::{Sight, Views};
use glamx::{DVec2, DVec3};
use sms_core::PointCloud;
use sms_mesh::{
    Plane, PointGrid, cloud,
    outline::{convex_outline, is_within},
    quantile,
};

/// Returns points on the resting plane, a `spacing` apart, where the object's foot may touch it. They lie inside the
/// outline of the object's lowest part, at places where no camera saw the plane. If there is no such place, returns the
/// surroundings of the lowest point.
pub(crate) fn contact_points(
    cloud: &PointCloud,
    rest: &RestingPlane,
    views: &Views,
    label: u16,
    spacing: f64,
) -> Vec<DVec3> {
    let plane = rest.plane;
    let u = plane.normal.any_orthonormal_vector();
    let v = plane.normal.cross(u);
    let heights: Vec<f64> = cloud.points_w.iter().map(|&p| plane.height(p)).collect();
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
    // Cameras look under a table from the side: where they see past the object, there is no foot.
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

/// A side continues another one within this distance, metres, if their normals are within 60°.
const CONTINUES_M: f64 = 0.02;

/// Returns the plane on which an object stands and the index of its carrier. Balls are excluded: they touch at a point,
/// and their labels bleed differently.
fn carried(drafts: &[Draft], upper: usize) -> Option<(Plane, usize)> {
    let RestingPlane { plane, carrier: Carrier::Object(carrier), .. } = drafts[upper].rest else {
        return None;
    };
    let lower = drafts.iter().position(|d| d.info.id == carrier).filter(|&i| i != upper)?;
    drafts[upper].sphere.is_none().then_some((plane, lower))
}

/// Moves sides below a supporting face from the upper object to its carrier. Masks err by centimetres where a camera
/// saw both edges behind each other; the height of the sides gives the true edge of the carrier.
pub(crate) fn return_sides(drafts: &mut [Draft]) {
    for upper in 0..drafts.len() {
        let below = std::mem::take(&mut drafts[upper].below);
        let Some((plane, lower)) = carried(drafts, upper) else { continue };
        let own = &drafts[lower].cloud;
        let grid = PointGrid::new(&own.points_w, CONTINUES_M);
        let is_side = |(p, normal): (&DVec3, &DVec3)| {
            let continues = |(_, k): &(f64, usize)| own.normals_w[*k].dot(*normal) > 0.5;
            normal.dot(plane.normal).abs() < SIDE && grid.within(*p, CONTINUES_M).iter().any(continues)
        };
        let moved: Vec<bool> = below.points_w.iter().zip(&below.normals_w).map(is_side).collect();
        cloud::extend(&mut drafts[lower].cloud, cloud::chosen(&below, &moved));
    }
}

/// Largest distances of underside points below and above the supporting face, metres.
const UNDERSIDE_M: [f64; 2] = [0.0025, 0.004];
/// Smallest cosine between the normal of an underside point and straight down.
const LOOKS_DOWN: f64 = 0.8;
/// Largest horizontal distance of an underside point from the object's outline, metres.
const BESIDE_M: f64 = 0.01;
/// Points this close to an upward surface of the carrier are excluded, metres.
const SHEET_M: f64 = 0.008;
/// Smallest number of points of an object.
const FEWEST: usize = 20;

/// Moves undersides that masks assigned to the carrier back to the object. The carrier ends at that height and has no
/// downward surface there; a few such points would extend its top.
pub(crate) fn return_undersides(drafts: &mut [Draft]) {
    for upper in 0..drafts.len() {
        let Some((plane, lower)) = carried(drafts, upper) else { continue };
        let u = plane.normal.any_orthonormal_vector();
        let v = plane.normal.cross(u);
        let on_plane = |p: DVec3| DVec2::new(p.dot(u), p.dot(v));
        let points = drafts[upper].cloud.points_w.iter();
        let outline = convex_outline(&points.map(|&p| on_plane(p)).collect::<Vec<_>>());
        let of = &drafts[lower].cloud;
        // The other side of a thin sheet was seen right above.
        let looks_up = |(_, n): &(&DVec3, &DVec3)| n.dot(plane.normal) > LOOKS_DOWN;
        let tops: Vec<DVec3> =
            of.points_w.iter().zip(&of.normals_w).filter(looks_up).map(|(p, _)| *p).collect();
        let tops = PointGrid::new(&tops, SHEET_M);
        let is_underside = |(&p, normal): (&DVec3, &DVec3)| {
            let (height, [below, above]) = (plane.height(p), UNDERSIDE_M);
            let is_there = height > -below && height < above && is_within(&outline, on_plane(p), BESIDE_M);
            is_there && normal.dot(plane.normal) < -LOOKS_DOWN && !tops.is_near(p, SHEET_M)
        };
        let moved: Vec<bool> = of.points_w.iter().zip(&of.normals_w).map(is_underside).collect();
        let stays: Vec<bool> = moved.iter().map(|moves| !moves).collect();
        if stays.iter().filter(|s| **s).count() < FEWEST {
            continue;
        }
        let moved = cloud::chosen(of, &moved);
        cloud::extend(&mut drafts[upper].cloud, moved);
        cloud::retain(&mut drafts[lower].cloud, &stays);
    }
}

/// Heights above a possible contact point where free space is tested, as shares of the object's height.
const UNDER_SHARES: [f64; 4] = [0.0, 0.1, 0.2, 0.35];

/// Returns whether cameras see a surface of another object at a point, or see through it past the object. Cameras also
/// see through the inside of a bowl, but see the bowl itself behind it.
fn is_looked_past(views: &Views, p_w: DVec3, label: u16) -> bool {
    let needed = views.enough_frames();
    let past = |f: &usize| match views.sight(*f, p_w) {
        Sight::Surface(there) => there != label,
        Sight::Free => views.label_at(*f, p_w) != Some(label),
        _ => false,
    };
    views.frames_near(p_w).filter(past).take(needed).count() >= needed
}

/// Returns points along the outline about `spacing` apart.
fn resample(outline: &[DVec2], spacing: f64) -> Vec<DVec2> {
    let mut out = Vec::new();
    for i in 0..outline.len() {
        let (a, b) = (outline[i], outline[(i + 1) % outline.len()]);
        let steps = ((b - a).length() / spacing).ceil().max(1.0);
        out.extend((0..steps as usize).map(|k| a + k as f64 / steps * (b - a)));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::LabelInfo;

    fn draft(id: u16, rest: RestingPlane, points: &[(DVec3, DVec3)]) -> Draft {
        let cloud = PointCloud {
            points_w: points.iter().map(|p| p.0).collect(),
            normals_w: points.iter().map(|p| p.1).collect(),
            colors: vec![[id as u8; 3]; points.len()],
        };
        let info = LabelInfo { id, name: id.to_string(), description: String::new() };
        Draft { info, cloud, below: PointCloud::default(), spacing: 0.004, rest, sphere: None, fixed: false }
    }

    #[test]
    fn a_side_that_has_the_label_of_what_stands_on_it_is_given_back() {
        let rest = |height: f64, carrier: Carrier| RestingPlane {
            plane: Plane::horizontal(height),
            carrier,
            noise_m: 1e-3,
        };
        let side = |z: f64, normal: DVec3| move |k: usize| (DVec3::new(0.0, 0.005 * k as f64, z), normal);
        let bin: Vec<_> = (0..30).map(side(0.47, DVec3::X)).collect();
        let board: Vec<_> = (0..30).map(side(0.506, DVec3::X)).collect();
        let mut drafts =
            [draft(1, rest(0.0, Carrier::Floor), &bin), draft(2, rest(0.5, Carrier::Object(1)), &board)];
        // The rim of the bin; a point in the air beside it; a point with another normal.
        let rim: Vec<_> = (0..30).map(side(0.485, DVec3::X)).collect();
        let others = [(DVec3::new(0.3, 0.0, 0.485), DVec3::X), (DVec3::new(0.0, 0.05, 0.48), DVec3::NEG_X)];
        let labelled: Vec<_> = rim.iter().chain(&others).copied().collect();
        drafts[1].below = draft(2, drafts[1].rest, &labelled).cloud;
        return_sides(&mut drafts);
        assert_eq!(drafts[0].cloud.points_w.len(), 60);
        assert!(drafts[0].cloud.points_w[30..].iter().all(|p| p.z == 0.485 && p.x == 0.0));
        assert_eq!(drafts[1].cloud.points_w.len(), 30);
    }

    #[test]
    fn an_underside_that_has_its_carriers_label_is_given_back() {
        let row = |z: f64, normal: DVec3| {
            move |k: usize| (DVec3::new(0.01 * k as f64, 0.05 * (k % 2) as f64, z), normal)
        };
        let rest = |height: f64, carrier: Carrier| RestingPlane {
            plane: Plane::horizontal(height),
            carrier,
            noise_m: 1e-3,
        };
        let board: Vec<_> = (0..40).map(row(0.512, DVec3::Z)).collect();
        // A stool: its side and top, 5 points of the board's underside, the edge of its seat 2 cm lower, and a shelf
        // beside the board.
        let mut stool: Vec<_> =
            (0..30).map(row(0.45, DVec3::X)).chain((0..8).map(row(0.5, DVec3::Z))).collect();
        stool.extend((20..25).map(row(0.501, DVec3::NEG_Z)));
        let lip: Vec<_> = (8..12).map(row(0.48, DVec3::NEG_Z)).collect();
        let shelf: Vec<_> = (60..64).map(row(0.5, DVec3::NEG_Z)).collect();
        // A sheet of 1 mm, seen from both sides.
        let sheet: Vec<_> = (30..34).map(row(0.499, DVec3::NEG_Z)).collect();
        let sheet: Vec<_> = sheet.into_iter().chain((30..34).map(row(0.5, DVec3::Z))).collect();
        stool.extend(lip.iter().chain(&shelf).chain(&sheet));
        let mut drafts =
            [draft(1, rest(0.0, Carrier::Floor), &stool), draft(2, rest(0.5, Carrier::Object(1)), &board)];
        return_undersides(&mut drafts);
        let [stool, board] = &drafts;
        assert_eq!((stool.cloud.points_w.len(), board.cloud.points_w.len()), (54, 45));
        assert_eq!(board.cloud.colors[40..], [[1; 3]; 5]);
        assert!(board.cloud.points_w[40..].iter().all(|p| p.z == 0.501));
        for (p, n) in lip.iter().chain(&shelf).chain(&sheet) {
            assert!(stool.cloud.points_w.iter().zip(&stool.cloud.normals_w).any(|own| own == (p, n)));
        }
    }
}
