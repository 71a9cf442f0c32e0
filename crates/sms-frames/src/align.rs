//! World alignment: the up direction from the support plane of an unaligned recording.

use crate::{Align, DepthNoise, Frame, Recording};
use glamx::{DMat3, DPose3, DQuat, DVec3};
use sms_core::{Seed, Warnings};

mod planes;

pub(crate) use planes::SupportCandidate;
use planes::{FusedCells, find_planes};

/// Recordings beyond this distance from the origin (metres) are moved there in f64 before any conversion to f32.
const FAR_M: f64 = 100.0;
/// Maximum tilt of a support plane against a given up direction.
const UP_TOLERANCE_RAD: f64 = 0.35;

/// Below this cosine between a plane's normal and the images' up, a table seen from straight above and a wall cannot
/// be told apart by the images.
const AMBIGUOUS_IMAGE_UP: f64 = 0.15;
/// Maximum angle between a plane's normal and an axis of the recording's world that it counts as.
const NORMAL_TOLERANCE_RAD: f64 = 0.15;
/// Maximum angle between the images' mean upward direction and the axis that it counts as; cameras look down a little.
const IMAGE_UP_TOLERANCE_RAD: f64 = 0.35;

/// Computes the transform from the recording's world to ours. The cameras of `views` are still in the recording's world.
pub(crate) fn align(
    recording: &Recording,
    align: Align,
    noise: &DepthNoise,
    views: &[Frame],
    warnings: &Warnings,
) -> DPose3 {
    let stated_up_r = match align {
        Align::None => return recenter(views, warnings),
        Align::Auto if recording.world_is_aligned => return recenter(views, warnings),
        Align::Auto => recording.world_up_r,
        Align::Up(up) => DVec3::from(up).try_normalize(),
    };
    let origin_r = views.first().map_or(DVec3::ZERO, |v| v.camera.x_wc.translation);
    let cells = FusedCells::gather(views, origin_r);
    let planes = find_planes(&cells, noise, Seed(0).derive("align"));
    let mut up_r = stated_up_r;
    let mut chosen = choose(&planes, &cells, views, origin_r, up_r);
    if up_r.is_none()
        && let Some(plane) = chosen
        && camera_up_r(views).dot(plane.normal) < AMBIGUOUS_IMAGE_UP
    {
        up_r = axis_held_upright(views, plane);
        warnings.add(
            "scan",
            "ambiguous_up",
            match up_r {
                Some(_) => "the largest plane faces the cameras like a wall and the images' up is an axis of the \
                            recording's world; that axis is taken as up",
                None => "the largest plane faces the cameras: it is taken as a table seen from straight above, and \
                         could be a wall",
            },
            "state the up direction of the recording's world (`--up x,y,z`)",
        );
        if up_r.is_some() {
            chosen = choose(&planes, &cells, views, origin_r, up_r);
        }
    }
    let up = match (up_r, chosen) {
        (Some(up), _) => up,
        (None, Some(plane)) => plane.normal,
        (None, None) => {
            warnings.add(
                "scan",
                "no_support_plane",
                "no support plane was found; the cameras' mean upward direction is used as up",
                "state the up direction of the recording's world (`--up x,y,z`), or record the table or floor too",
            );
            camera_up_r(views)
        }
    };
    let (height, center) = match chosen {
        Some(plane) => (plane.center.dot(up), plane.center),
        None => {
            let mut heights: Vec<f64> = cells.points.iter().map(|p| p.dot(up)).collect();
            heights.sort_by(f64::total_cmp);
            let low = heights.get(heights.len() / 100).copied().unwrap_or(0.0);
            (low, cells.points.iter().sum::<DVec3>() / (cells.points.len().max(1) as f64))
        }
    };
    // World x along the first camera's right, so that the first view shows the world upright and unmirrored.
    let right = views.first().map_or(DVec3::X, |v| v.camera.x_wc.rotation * DVec3::X);
    let x = (right - up * right.dot(up)).try_normalize().unwrap_or_else(|| up.any_orthonormal_vector());
    let y = up.cross(x);
    let rotation = crate::rigid::nearest_rotation(DMat3::from_cols(x, y, up).transpose());
    let foot = center + up * (height - center.dot(up));
    DPose3::from_parts(-(rotation * (origin_r + foot)), rotation)
}

/// Returns the identity for worlds near the origin, a translation by whole metres for far ones.
fn recenter(views: &[Frame], warnings: &Warnings) -> DPose3 {
    let n = views.len().max(1) as f64;
    let mean = views.iter().fold(DVec3::ZERO, |s, v| s + v.camera.x_wc.translation / n);
    if mean.abs().max_element() < FAR_M {
        return DPose3::identity();
    }
    let shift = DVec3::from_array(mean.to_array().map(|v| if v.abs() < FAR_M { 0.0 } else { v.round() }));
    warnings.add(
        "scan",
        "world_recentred",
        format!(
            "the recording lies {:.0} m from its origin and was moved by ({}, {}, {})",
            mean.length(),
            -shift.x,
            -shift.y,
            -shift.z
        ),
        "",
    );
    DPose3::from_parts(-shift, DQuat::IDENTITY)
}

/// Returns the mean upward direction of the images in the recording's world.
fn camera_up_r(views: &[Frame]) -> DVec3 {
    let sum = views.iter().fold(DVec3::ZERO, |s, v| s - v.camera.x_wc.rotation * DVec3::Y);
    sum.try_normalize().unwrap_or(DVec3::Z)
}

/// Returns the axis of the recording's world (z, or y as in ARKit) that is up in the images and lies in the ambiguous
/// plane; `None` when the plane's own normal is such an axis, or no axis is up in the images.
fn axis_held_upright(views: &[Frame], plane: &SupportCandidate) -> Option<DVec3> {
    for axis in [DVec3::Z, DVec3::Y] {
        if plane.normal.angle_between(axis) < NORMAL_TOLERANCE_RAD {
            return None;
        }
        if camera_up_r(views).angle_between(axis) < IMAGE_UP_TOLERANCE_RAD {
            return Some(axis);
        }
    }
    None
}

/// Chooses the plane that supports the scene: large, with the cameras and nearly everything else above it, and upright in
/// the images (cameras are held with little roll). With a given up direction, only planes across it are candidates.
fn choose<'a>(
    planes: &'a [SupportCandidate],
    cells: &FusedCells,
    views: &[Frame],
    origin_r: DVec3,
    up_r: Option<DVec3>,
) -> Option<&'a SupportCandidate> {
    planes
        .iter()
        .filter(|p| up_r.is_none_or(|up| p.normal.angle_between(up) < UP_TOLERANCE_RAD))
        .map(|p| (score(p, cells, views, origin_r, up_r.is_some()), p))
        .filter(|(score, _)| *score > 0.0)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, p)| p)
}

fn score(
    plane: &SupportCandidate,
    cells: &FusedCells,
    views: &[Frame],
    origin_r: DVec3,
    up_known: bool,
) -> f64 {
    let n = views.len().max(1) as f64;
    let cameras_above =
        views.iter().filter(|v| plane.height(v.camera.x_wc.translation - origin_r) > 0.0).count() as f64 / n;
    let margin = 4.0 * plane.tolerance;
    let below = cells.points.iter().filter(|p| plane.height(**p) < -margin).count() as f64;
    let below = below / cells.points.len().max(1) as f64;
    let supports = cameras_above * (1.0 - below).powi(4);
    let upright = if up_known {
        1.0
    } else {
        let mean = |axis: DVec3| {
            views.iter().map(|v| (v.camera.x_wc.rotation * axis).dot(plane.normal)).sum::<f64>() / n
        };
        let roll =
            views.iter().map(|v| (v.camera.x_wc.rotation * DVec3::X).dot(plane.normal).powi(2)).sum::<f64>()
                / n;
        // A wall faces the camera and has no component along the image's up; a table seen from straight above has
        // none either, so this only halves the score.
        let image_up = (-mean(DVec3::Y)).clamp(0.0, 1.0);
        (-roll / (2.0 * 0.35f64.powi(2))).exp() * (0.4 + 0.6 * image_up)
    };
    plane.support as f64 * supports * upright
}
