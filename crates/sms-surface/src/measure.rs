//! Measurements of surface elements by frames.

use crate::config::{SurfaceConfig, SurfaceTolerance};
use crate::nearby::map_nearby;
use crate::surfel::Surfel;
use glamx::{DVec3, Vec3};
use rayon::prelude::*;
use sms_core::{Cancel, CoreError};
use sms_frames::Frame;

/// Least cosine between the normal of an element and the normals of its surface.
pub const SAME_SURFACE_COSINE: f64 = 0.7;

/// The face of a thin wall that an element belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WallSide {
    /// The one that the normal of the element points out of.
    Normal,
    /// The one with more measurements: for discs, whose normals may point either way.
    MostMeasured,
}

/// Moves every element along its normal to the mean of the measurements of `frames`, and turns it to their mean normal.
/// A thin wall is measured from both sides, and the mean of both would lie inside the wall: only those of `side` count.
/// Elements without measurements on that side remain unchanged.
///
/// # Errors
/// [`CoreError::Interrupted`] when cancelled; the elements are then unchanged.
pub fn settle(
    surfels: &mut Vec<Surfel>,
    frames: &[&Frame],
    config: &SurfaceConfig,
    side: WallSide,
    cancel: &Cancel,
) -> Result<(), CoreError> {
    let positions_w: Vec<Vec3> = surfels.par_iter().map(|s| s.p_w.as_vec3()).collect();
    let settled = map_nearby(&positions_w, |group| {
        let mut group: Vec<Surfel> = group.iter().map(|&i| surfels[i as usize]).collect();
        for least_alike in [config.first_alike, SAME_SURFACE_COSINE] {
            let mut sums: Vec<[SideMeasurement; 2]> = group.iter().map(|_| Default::default()).collect();
            if cancel.is_cancelled() {
                break;
            }
            for frame in frames {
                for (surfel, sides) in group.iter().zip(&mut sums) {
                    add_frame(sides, frame, surfel, least_alike, config);
                }
            }
            for (surfel, [front, back]) in group.iter_mut().zip(sums) {
                let is_back = side == WallSide::MostMeasured && back.weight > front.weight;
                adjust(surfel, if is_back { back } else { front });
            }
        }
        group
    });
    cancel.check()?;
    *surfels = settled;
    Ok(())
}

/// Weighted sums over frames.
#[derive(Default)]
pub(crate) struct SideMeasurement {
    /// Sum of signed distances from the element along its normal, metres.
    pub(crate) offset: f64,
    pub(crate) weight: f64,
    /// Sum of unit normals, which face the cameras.
    pub(crate) normal_w: DVec3,
}

/// Moves and turns the element to the measurements.
fn adjust(surfel: &mut Surfel, sum: SideMeasurement) {
    if sum.weight > 0.0 {
        surfel.p_w += surfel.n_w * (sum.offset / sum.weight);
        surfel.sigma_m = sum.weight.sqrt().recip();
    }
    if sum.normal_w.length() > 0.0 {
        surfel.n_w = sum.normal_w.normalize();
    }
}

/// Adds the measurements of one frame to the side of the element that faces the camera. Uses the four pixels around the
/// projected centre, weighted bilinearly, by the cosine of the viewing angle, and by the inverse variance of the depth noise.
pub(crate) fn add_frame(
    sides: &mut [SideMeasurement; 2],
    frame: &Frame,
    surfel: &Surfel,
    least_alike: f64,
    config: &SurfaceConfig,
) {
    let Surfel { p_w, n_w: axis_w, .. } = *surfel;
    let Some((u, v, z)) = frame.camera.project(p_w) else { return };
    let rotation_wc = frame.camera.x_wc.rotation;
    let (x, y) = ((u - 0.5).floor(), (v - 0.5).floor());
    let (fx, fy) = (u - 0.5 - x, v - 0.5 - y);
    let gate = config.tolerance.at(&frame.depth_noise, z);
    // Computed on demand: most frames do not see the surface.
    let mut precision_and_direction = None;
    for (dx, dy, share) in
        [(0, 0, (1.0 - fx) * (1.0 - fy)), (1, 0, fx * (1.0 - fy)), (0, 1, (1.0 - fx) * fy), (1, 1, fx * fy)]
    {
        let (px, py) = (x as i64 + dx, y as i64 + dy);
        let Some(&depth) = frame.depth.get(px, py) else { continue };
        let normal_c = frame.normal_c[(px as usize, py as usize)];
        if !(depth > 0.0 && (f64::from(depth) - z).abs() <= gate) || normal_c == [0.0; 3] {
            continue;
        }
        let (precision, to_camera) = *precision_and_direction.get_or_insert_with(|| {
            (frame.depth_noise.sigma_m(z).powi(-2), (frame.camera.center_w() - p_w).normalize())
        });
        let normal_w = rotation_wc * DVec3::from_array(normal_c.map(f64::from));
        let (alike, facing) = (normal_w.dot(axis_w), normal_w.dot(to_camera));
        if facing < config.min_cosine || alike.abs() < least_alike {
            continue;
        }
        let measured_w = frame.camera.unproject_pixel(px as usize, py as usize, f64::from(depth));
        let weight = share * precision * facing;
        let side = &mut sides[usize::from(alike < 0.0)];
        side.offset += weight * axis_w.dot(measured_w - p_w);
        side.weight += weight;
        side.normal_w += normal_w * weight;
    }
}

/// The relation of a point to the depth of one frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PointVisibility {
    /// Every measured neighbour is behind the point.
    Through,
    /// A measured neighbour is at the point.
    Surface,
    /// Hidden, outside the image, or with too few measurements.
    Unknown,
}

/// Classifies a point by all of the 3 × 3 pixels around it in one frame: next to a silhouette, a single pixel may show
/// the background.
pub fn visibility(frame: &Frame, p_w: DVec3, tolerance: &SurfaceTolerance) -> PointVisibility {
    let Some((u, v, z)) = frame.camera.project(p_w) else { return PointVisibility::Unknown };
    let Some((x, y)) = frame.camera.pixel_at(u, v) else { return PointVisibility::Unknown };
    let (mut measured, mut behind) = (0, 0);
    for dy in -1..=1 {
        for dx in -1..=1 {
            let Some(&depth) = frame.depth.get(x as i64 + dx, y as i64 + dy) else { continue };
            if !(depth > 0.0 && depth.is_finite()) {
                continue;
            }
            measured += 1;
            let (depth, tolerance) = (f64::from(depth), tolerance.at(&frame.depth_noise, f64::from(depth)));
            if (depth - z).abs() <= tolerance {
                return PointVisibility::Surface;
            }
            behind += usize::from(depth - z > tolerance);
        }
    }
    if measured >= 5 && behind == measured { PointVisibility::Through } else { PointVisibility::Unknown }
}

/// Marks the points with at least `least` frames that measure a surface near them, and not more frames that see through
/// them.
pub fn standing(
    positions_w: &[Vec3],
    frames: &[&Frame],
    least: usize,
    tolerance: &SurfaceTolerance,
) -> Vec<bool> {
    // Counts frames that see through a point, and frames that measure a surface near it.
    let add = |(through, surface): &mut (usize, usize), frame: &Frame, p_w: Vec3| {
        let sight = visibility(frame, p_w.as_dvec3(), tolerance);
        *through += usize::from(sight == PointVisibility::Through);
        *surface += usize::from(sight == PointVisibility::Surface);
    };
    let stands = |(through, surface): (usize, usize)| surface >= through.max(least);
    if let [frame] = frames {
        // Frame by frame, so that the depth image stays in the caches.
        let of_point = |p_w: &Vec3| {
            let mut counts = (0, 0);
            add(&mut counts, frame, *p_w);
            stands(counts)
        };
        return positions_w.par_iter().with_min_len(1024).map(of_point).collect();
    }
    map_nearby(positions_w, |group| {
        let mut counts = vec![(0, 0); group.len()];
        for frame in frames {
            for (&i, counts) in group.iter().zip(&mut counts) {
                add(counts, frame, positions_w[i as usize]);
            }
        }
        counts.into_iter().map(stands).collect()
    })
}

/// Least cosine between the normal of an element and the direction to a camera that should see it.
const FACING: f64 = 0.3;
/// Multiple of the tolerance by which the surface in front of an element may be the same surface, measured elsewhere.
const LAYERS: f64 = 4.0;

/// Marks the elements with at least one frame that measures them, and not more frames that contradict them: that see through
/// them, or that measure the surface just in front of them.
pub(crate) fn supported(surfels: &[Surfel], frames: &[&Frame], tolerance: &SurfaceTolerance) -> Vec<bool> {
    let positions_w: Vec<Vec3> = surfels.par_iter().map(|s| s.p_w.as_vec3()).collect();
    map_nearby(&positions_w, |group| {
        let mut votes = vec![(0usize, 0usize); group.len()];
        for frame in frames {
            for (&i, (surface, against)) in group.iter().zip(&mut votes) {
                let surfel = &surfels[i as usize];
                match visibility(frame, surfel.p_w, tolerance) {
                    PointVisibility::Surface => *surface += 1,
                    PointVisibility::Through => *against += 1,
                    PointVisibility::Unknown => {
                        *against += usize::from(is_shadowed(frame, surfel, tolerance))
                    }
                }
            }
        }
        votes.into_iter().map(|(surface, against)| surface >= against.max(1)).collect()
    })
}

/// Whether a frame that the element faces measures a surface just in front of it.
fn is_shadowed(frame: &Frame, surfel: &Surfel, tolerance: &SurfaceTolerance) -> bool {
    let Some((u, v, z)) = frame.camera.project(surfel.p_w) else { return false };
    let Some(pixel) = frame.camera.pixel_at(u, v) else { return false };
    let depth = f64::from(frame.depth[pixel]);
    let facing = surfel.n_w.dot((frame.camera.center_w() - surfel.p_w).normalize());
    let gap = (z - depth) * facing;
    depth > 0.0 && facing > FACING && gap > 0.0 && gap <= LAYERS * tolerance.at(&frame.depth_noise, z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::config;
    use glamx::DPose3;
    use sms_core::{Camera, Image, Intrinsics};

    /// A camera at the origin before a wall at 1 m with a step to 0.5 m in the left half.
    fn frame() -> Frame {
        let k = Intrinsics::from_fov(32, 20, 1.0);
        let mut depth = Image::filled(32, 20, 1.0f32);
        for y in 0..20 {
            for x in 0..16 {
                depth[(x, y)] = 0.5;
            }
        }
        Frame::new(
            Camera::new(k, DPose3::identity()),
            Image::filled(32, 20, [0; 3]),
            depth,
            Image::filled(32, 20, [0.0, 0.0, -1.0]),
        )
    }

    #[test]
    fn a_point_is_seen_through_only_when_all_that_is_measured_round_it_lies_behind() {
        let (frame, tolerance) = (frame(), config().tolerance);
        let at = |x: usize, z: f64| visibility(&frame, frame.camera.unproject_pixel(x, 10, z), &tolerance);
        assert_eq!(at(24, 0.5), PointVisibility::Through);
        assert_eq!(at(24, 1.002), PointVisibility::Surface);
        assert_eq!(at(24, 1.1), PointVisibility::Unknown, "hidden by the wall");
        assert_eq!(at(16, 0.5), PointVisibility::Surface, "one pixel beside the step");
        let mut sparse = frame.clone();
        sparse.depth.data.iter_mut().enumerate().filter(|(i, _)| i % 2 == 0).for_each(|(_, z)| *z = 0.0);
        let p_w = sparse.camera.unproject_pixel(24, 10, 0.5);
        assert_ne!(visibility(&sparse, p_w, &tolerance), PointVisibility::Surface);
        assert_eq!(visibility(&sparse, DVec3::NEG_Z, &tolerance), PointVisibility::Unknown);
    }
}
