//! Growth of the surface by one frame: elements are added where it measures what no element covers.

use crate::config::SurfaceConfig;
use crate::point::{MeasuredPoint, measured_point};
use crate::surfel::{SeedPixel, Surfel};
use rand::seq::SliceRandom;
use rayon::prelude::*;
use sms_core::Seed;
use sms_frames::Frame;
use std::ops::Range;

/// A frame adds elements to a surface that others cover if its own are denser by this factor.
const FINER: f64 = 2.0;

/// Adds elements for the pixels of `frame` that no element covers. Pixels are tried in random order, those on edges first.
/// `slot` is the position of the frame among those that are fused.
///
/// An element covers the measured points that lie within its distance to its neighbours in its plane, and within the tolerance
/// of its plane, if it faces the camera. Normals are not compared: those of single pixels are too noisy.
pub fn grow(surfels: &mut Vec<Surfel>, frame: &Frame, slot: usize, config: &SurfaceConfig, seed: Seed) {
    let pixels = FramePoints::of(frame, config);
    let windows: Vec<Option<Window>> =
        surfels.par_iter_mut().with_min_len(256).map(|surfel| pixels.see(surfel)).collect();
    let mut covered = pixels.covered_by(surfels, &windows);
    let mut rng = seed.derive("order").rng();
    let is_open =
        |i: &usize| !covered[*i] && pixels.points[*i].is_some_and(|p| p.cosine >= config.min_cosine);
    let is_edge = |i: &usize| pixels.points[*i].is_some_and(|p| p.is_edge);
    let (mut edges, mut others): (Vec<usize>, Vec<usize>) =
        (0..pixels.points.len()).filter(is_open).partition(is_edge);
    edges.shuffle(&mut rng);
    others.shuffle(&mut rng);
    for i in edges.into_iter().chain(others) {
        let Some(point) = pixels.points[i].filter(|_| !covered[i]) else { continue };
        let surfel = point.surfel(frame, config, SeedPixel { slot, pixel: i });
        let (columns, rows) = pixels.window((i % pixels.width, i / pixels.width), point.z_m, &surfel);
        for row in rows {
            let of_row = &mut covered[row * pixels.width..][..pixels.width];
            pixels.cover(row, columns.clone(), &surfel, of_row);
        }
        surfels.push(surfel);
    }
}

/// Columns and rows of the pixels that an element can cover.
type Window = (Range<usize>, Range<usize>);

/// The measured surface of a frame.
struct FramePoints<'a> {
    frame: &'a Frame,
    config: &'a SurfaceConfig,
    width: usize,
    height: usize,
    points: Vec<Option<MeasuredPoint>>,
}

impl<'a> FramePoints<'a> {
    fn of(frame: &'a Frame, config: &'a SurfaceConfig) -> Self {
        let (width, height) = frame.depth.size();
        let pixels = (0..width * height).into_par_iter().with_min_len(1024);
        Self {
            frame,
            config,
            width,
            height,
            points: pixels.map(|i| measured_point(frame, i, config)).collect(),
        }
    }

    /// Returns the pixels that an element can cover, if it faces the camera. If the frame resolves it better than those before, it is
    /// noted.
    fn see(&self, surfel: &mut Surfel) -> Option<Window> {
        let camera = &self.frame.camera;
        let (u, v, z) = camera.project(surfel.p_w)?;
        let (x, y) = camera.pixel_at(u, v)?;
        let to_camera_w = (camera.center_w() - surfel.p_w).normalize();
        if surfel.n_w.dot(to_camera_w) <= 0.0 {
            return None;
        }
        if let Some(point) = self.points[y * self.width + x].filter(|p| self.is_on(p, surfel)) {
            let pitch_m = point.pitch_m(self.config);
            if pitch_m < surfel.pitch_m {
                (surfel.pitch_m, surfel.to_camera_w) = (pitch_m, to_camera_w);
            }
        }
        Some(self.window((x, y), z, surfel))
    }

    /// Returns the pixels that an element at pixel (x, y) and depth `z_m` can cover.
    fn window(&self, (x, y): (usize, usize), z_m: f64, surfel: &Surfel) -> Window {
        let to_camera_w = self.frame.camera.center_w() - surfel.p_w;
        let facing = surfel.n_w.dot(to_camera_w.normalize());
        let footprint_m = self.frame.camera.intrinsics.pixel_footprint(z_m);
        let widest_m = self.config.spacing_px * self.config.edge_spacing.max(1.0) * footprint_m;
        let in_plane_m = surfel.spacing_m.clamp(widest_m, FINER * widest_m);
        // A point off the plane appears beside the element if the plane is seen obliquely.
        let gate_m = self.config.tolerance.at(&self.frame.depth_noise, z_m);
        let beside_m = gate_m * (1.0 - facing * facing).max(0.0).sqrt();
        // Away from the axis, pixels are smaller by the cosine of the ray.
        let pixel_m = footprint_m * z_m / to_camera_w.length();
        let reach = ((in_plane_m + beside_m) / pixel_m).ceil() as usize + 1;
        let around = |at: usize, end: usize| at.saturating_sub(reach)..(at + reach + 1).min(end);
        (around(x, self.width), around(y, self.height))
    }

    /// Whether a point lies within the tolerance of the plane of an element, on the same side of a wall.
    fn is_on(&self, point: &MeasuredPoint, surfel: &Surfel) -> bool {
        let gate_m = self.config.tolerance.at(&self.frame.depth_noise, point.z_m);
        point.n_w.dot(surfel.n_w) > 0.0 && (point.p_w - surfel.p_w).dot(surfel.n_w).abs() <= gate_m
    }

    /// Marks the points of one row that an element covers.
    fn cover(&self, row: usize, columns: Range<usize>, surfel: &Surfel, covered: &mut [bool]) {
        for column in columns {
            covered[column] = covered[column] || self.is_covered(row * self.width + column, surfel);
        }
    }

    /// Returns which points the elements cover, each in its window; row by row of the image in parallel.
    fn covered_by(&self, surfels: &[Surfel], windows: &[Option<Window>]) -> Vec<bool> {
        let mut of_rows = vec![Vec::new(); self.height];
        for (surfel, window) in surfels.iter().zip(windows) {
            let Some((columns, rows)) = window else { continue };
            rows.clone().for_each(|row| of_rows[row].push((columns, surfel)));
        }
        let mut covered = vec![false; self.points.len()];
        let rows = covered.par_chunks_mut(self.width.max(1)).zip(&of_rows).enumerate();
        rows.for_each(|(row, (covered, of_row))| {
            of_row.iter().for_each(|(columns, surfel)| self.cover(row, (*columns).clone(), surfel, covered));
        });
        covered
    }

    /// Whether an element covers the measured point at a pixel.
    fn is_covered(&self, pixel: usize, surfel: &Surfel) -> bool {
        self.points[pixel].as_ref().is_some_and(|point| {
            let off = point.p_w - surfel.p_w;
            let along = off.dot(surfel.n_w);
            let most = surfel.spacing_m.clamp(point.spacing_m, FINER * point.spacing_m);
            off.length_squared() - along * along < most * most && self.is_on(point, surfel)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{config, facing_plane};
    use glamx::DVec3;
    use sms_core::{Camera, Image, Intrinsics};

    #[test]
    fn elements_cover_a_plane_at_the_spacing_of_its_pixels_and_a_second_view_adds_none() {
        let (frame, config) = (facing_plane(0.5, 0.0), config());
        let mut surfels = Vec::new();
        grow(&mut surfels, &frame, 0, &config, Seed(1));
        let spacing = config.spacing_px * frame.camera.intrinsics.pixel_footprint(0.5);
        for (i, a) in surfels.iter().enumerate() {
            assert!(a.p_w.z.abs() < 1e-7 && a.n_w.z > 0.999 && (a.spacing_m - spacing).abs() < 1e-7);
            assert!(surfels[..i].iter().all(|b| b.p_w.distance(a.p_w) >= spacing));
        }
        // Random elements at least a distance apart cover about 0.7 of its square each (random sequential packing).
        let area = frame.depth.data.len() as f64 * frame.camera.intrinsics.pixel_footprint(0.5).powi(2);
        let packing = surfels.len() as f64 * spacing * spacing / area;
        assert!((0.55..0.95).contains(&packing), "{packing}");
        let before = surfels.clone();
        grow(&mut surfels, &frame, 1, &config, Seed(2));
        assert_eq!(surfels, before);
    }

    #[test]
    fn a_closer_frame_adds_elements_once_it_is_finer_by_the_factor() {
        let config = config();
        let added = |eye_z_m: f64| {
            let mut surfels = Vec::new();
            grow(&mut surfels, &facing_plane(1.0, 0.0), 0, &config, Seed(1));
            let before = surfels.len();
            grow(&mut surfels, &facing_plane(eye_z_m, 0.0), 1, &config, Seed(2));
            surfels.len() - before
        };
        // Between pixel centres of the first frame, few places are farther than the spacing from all elements.
        let (coarser, finer) = (added(0.7), added(0.3));
        assert!(finer > 100 && 4 * coarser < finer, "{coarser} {finer}");
    }

    /// A camera that looks down on the plane z = 0 obliquely, with errors of depth near the tolerance and small pixels.
    fn oblique_plane() -> Frame {
        let (width, height) = (96, 64);
        let (mut frame, eye_w) = (facing_plane(0.5, 0.0), DVec3::new(0.1, -0.4, 0.2));
        frame.camera =
            Camera::look_at(Intrinsics::from_fov(width, height, 0.2), eye_w, DVec3::ZERO, DVec3::Z);
        let normal_c = frame.camera.x_wc.rotation.inverse() * DVec3::Z;
        frame.normal_c = Image::filled(width, height, normal_c.as_vec3().to_array());
        frame.color = Image::filled(width, height, [0; 3]);
        frame.depth = Image::filled(width, height, 0.0);
        for (i, z) in frame.depth.data.iter_mut().enumerate() {
            let ray_w = frame.camera.unproject_pixel(i % width, i / width, 1.0) - eye_w;
            *z = (-eye_w.z / ray_w.z) as f32 + [0.0, 0.004, -0.004, 0.002, -0.001][i % 5];
        }
        frame
    }

    #[test]
    fn an_element_covers_nothing_outside_of_its_window() {
        for spacing_px in [1.0, 2.5, 12.0] {
            let (frame, config) = (oblique_plane(), SurfaceConfig { spacing_px, ..config() });
            let mut surfels = Vec::new();
            grow(&mut surfels, &frame, 0, &config, Seed(1));
            let pixels = FramePoints::of(&frame, &config);
            let windows: Vec<Option<Window>> = surfels.iter_mut().map(|s| pixels.see(s)).collect();
            let mut everywhere = vec![false; pixels.points.len()];
            for (surfel, window) in surfels.iter().zip(&windows) {
                let (columns, rows) = window.as_ref().unwrap();
                for i in (0..everywhere.len()).filter(|&i| pixels.is_covered(i, surfel)) {
                    let (x, y) = (i % pixels.width, i / pixels.width);
                    assert!(columns.contains(&x) && rows.contains(&y), "{spacing_px} px: {x} {y} {window:?}");
                    everywhere[i] = true;
                }
            }
            assert!(everywhere.iter().filter(|c| **c).count() > 2000);
            assert_eq!(pixels.covered_by(&surfels, &windows), everywhere);
        }
    }

    #[test]
    fn the_other_side_of_a_thin_wall_gets_elements_of_its_own() {
        let config = config();
        let mut surfels = Vec::new();
        grow(&mut surfels, &facing_plane(0.5, 0.001), 0, &config, Seed(1));
        let front = surfels.len();
        grow(&mut surfels, &facing_plane(-0.5, -0.001), 1, &config, Seed(2));
        assert!(surfels.len() > 3 * front / 2, "{front} {}", surfels.len());
        assert!(surfels[front..].iter().all(|s| s.n_w.z < -0.999 && (s.p_w.z + 0.001).abs() < 1e-7));
    }
}
