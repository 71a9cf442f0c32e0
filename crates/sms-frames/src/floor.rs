//! Evidence of a floor at a place in a recording.

use glamx::DVec3;
use sms_core::{Camera, DepthImage};

/// A measured point within this height of the place counts as floor, metres.
const FLOOR_M: f64 = 0.02;

/// There is no floor if the frames that look through the place outnumber those that show a floor by this factor. Noise and
/// blurred edges of objects produce some of either.
const CLEARLY: usize = 4;

/// Evidence of a recording on the floor at one place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FloorAt {
    /// The floor was measured there.
    Seen,
    /// Cameras look through the place at something lower: beyond the edge of a table.
    Missing,
    /// An object stands there, or hides it in every frame.
    Hidden,
    /// No frame has a measurement in that direction.
    OutOfView,
}

/// Looks for the floor at `place_w`, a point of its surface in the world (z up), metres.
pub fn floor_at<'a>(
    frames: impl IntoIterator<Item = (&'a Camera, &'a DepthImage)>,
    place_w: DVec3,
) -> FloorAt {
    let (mut seen, mut through, mut hidden) = (0, 0, 0);
    for (camera, depth) in frames {
        let Some((u, v, _)) = camera.project(place_w) else { continue };
        let Some((x, y)) = camera.pixel_at(u, v) else { continue };
        let Some(&z) = depth.get(x as i64, y as i64).filter(|z| **z > 0.0 && z.is_finite()) else { continue };
        // Unlike depths along the ray, heights do not depend on the camera's elevation.
        let height_m = camera.unproject(u, v, f64::from(z)).z - place_w.z;
        match height_m {
            h if h < -FLOOR_M => through += 1,
            h if h > FLOOR_M => hidden += 1,
            _ => seen += 1,
        }
    }
    if through > CLEARLY * seen {
        FloorAt::Missing
    } else if seen > 0 {
        FloorAt::Seen
    } else if hidden > 0 {
        FloorAt::Hidden
    } else {
        FloorAt::OutOfView
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::{Image, Intrinsics};

    /// Frames around a table 1 m square and 0.7 m high with a post of 0.2 m × 0.2 m × 0.3 m in its middle, on a floor.
    fn frames() -> Vec<(Camera, DepthImage)> {
        let intrinsics = Intrinsics::from_fov(160, 120, 1.0);
        (0..6)
            .map(|k| {
                let turn = f64::from(k) * std::f64::consts::TAU / 6.0;
                let eye_w = DVec3::new(1.2 * turn.cos(), 1.2 * turn.sin(), 0.9);
                let camera = Camera::look_at(intrinsics, eye_w, DVec3::ZERO, DVec3::Z);
                let mut depth = Image::filled(160, 120, 0.0f32);
                for y in 0..120 {
                    for x in 0..160 {
                        let far_w = camera.unproject_pixel(x, y, 1.0) - eye_w;
                        depth.data[y * 160 + x] = depth_along(eye_w, far_w) as f32;
                    }
                }
                (camera, depth)
            })
            .collect()
    }

    /// Depth along a ray from `eye_w`, where `step_w` spans 1 m of depth, by marching: an oracle without geometry.
    fn depth_along(eye_w: DVec3, step_w: DVec3) -> f64 {
        let is_solid = |p: DVec3| {
            p.z < -0.7
                || (p.z < 0.0 && p.x.abs().max(p.y.abs()) < 0.5)
                || (p.z < 0.3 && p.x.abs().max(p.y.abs()) < 0.1)
        };
        (1..4000).map(|k| 0.001 * f64::from(k)).find(|z| is_solid(eye_w + *z * step_w)).unwrap_or(0.0)
    }

    #[test]
    fn a_table_has_an_edge_and_what_stands_on_it_hides_it() {
        let frames = frames();
        let at = |x: f64, y: f64| floor_at(frames.iter().map(|(c, d)| (c, d)), DVec3::new(x, y, 0.0));
        assert_eq!(at(0.3, -0.2), FloorAt::Seen);
        assert_eq!(at(0.45, 0.45), FloorAt::Seen);
        // Beside the table there is no floor at its height.
        assert_eq!(at(0.6, 0.1), FloorAt::Missing);
        assert_eq!(at(-0.2, -0.7), FloorAt::Missing);
        assert_eq!(at(0.0, 0.0), FloorAt::Hidden);
        assert_eq!(at(30.0, 5.0), FloorAt::OutOfView);
    }
}
