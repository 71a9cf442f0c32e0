//! Cells of space with the frames that may show them.
//!
//! Of a room's thousand frames, a point is in the image of a few hundred at most. Questions about a point ask only those
//! whose image may contain its cell: the answers are those of all frames.

use glamx::DVec3;
use rayon::prelude::*;
use sms_core::Aabb;
use sms_frames::Sequence;
use sms_mesh::quantile;

/// Approximate number of cells: 875 frames of a room take a second and 20 MB.
const MOST_CELLS: f64 = 32_768.0;
/// Approximate number of pairs of a cell and a frame; each takes up to four bytes.
const MOST_PAIRS: f64 = 32e6;
/// Smallest side of a cell, metres. Neighbouring points of a small object share their frames.
const LEAST_SIDE_M: f64 = 0.1;
/// Cells also count what is this far outside them, metres.
const AROUND_M: f64 = 0.02;
/// Share of the samples on each side of each axis that may be outside the cells.
const OUTLIERS: f64 = 0.005;
/// Samples of a frame's depth in each direction, for the extent of the scene.
const SAMPLES: usize = 16;

/// The frames whose image may contain a point, by the point's cell.
#[derive(Debug)]
pub(crate) struct FrameCells {
    origin_w: DVec3,
    side_m: f64,
    count: [usize; 3],
    /// Frames of each cell, x fastest, in their order.
    cells: Vec<Vec<u32>>,
    /// All frames, for points outside all cells.
    all: Vec<u32>,
}

impl FrameCells {
    /// Returns cells around most of what was measured.
    pub(crate) fn of(sequence: &Sequence) -> Self {
        let all: Vec<u32> = (0..sequence.len() as u32).collect();
        let bounds = extent(sequence).unwrap_or(Aabb { min: DVec3::ZERO, max: DVec3::ZERO });
        let size = bounds.max - bounds.min + 2.0 * LEAST_SIDE_M;
        let most = MOST_CELLS.min(MOST_PAIRS / sequence.len().max(1) as f64);
        let side_m = (size.element_product() / most).cbrt().max(LEAST_SIDE_M);
        let count = size.to_array().map(|s| (s / side_m).ceil() as usize);
        let origin_w = bounds.min - LEAST_SIDE_M;
        let radius = 0.5 * side_m * 3f64.sqrt() + AROUND_M;
        let cell = |i: usize| {
            let at = [i % count[0], i / count[0] % count[1], i / count[0] / count[1]];
            let center_w = origin_w + side_m * DVec3::from_array(at.map(|k| k as f64 + 0.5));
            let shows = |f: &u32| sequence.frames[*f as usize].camera.may_see(center_w, radius);
            let mut frames: Vec<u32> = all.iter().copied().filter(shows).collect();
            frames.shrink_to_fit();
            frames
        };
        let cells = (0..count.iter().product()).into_par_iter().map(cell).collect();
        Self { origin_w, side_m, count, cells, all }
    }

    /// Returns, in their order, all frames whose image contains a point of the ball, and others.
    pub(crate) fn around(&self, center_w: DVec3, radius: f64) -> &[u32] {
        // The rest is for rounding.
        if radius < AROUND_M - 1e-6 { self.at(center_w) } else { &self.all }
    }

    /// Returns, in their order, all frames whose image contains `p_w`, and others.
    pub(crate) fn at(&self, p_w: DVec3) -> &[u32] {
        let at = (p_w - self.origin_w) / self.side_m;
        let limit = DVec3::from_array(self.count.map(|n| n as f64));
        if !(at.cmpge(DVec3::ZERO).all() && at.cmplt(limit).all()) {
            return &self.all;
        }
        let [x, y, z] = at.to_array().map(|v| v as usize);
        &self.cells[(z * self.count[1] + y) * self.count[0] + x]
    }
}

/// Returns the box around most of a sample of the measured points, or `None` if nothing was measured.
fn extent(sequence: &Sequence) -> Option<Aabb> {
    let points = sequence.frames.iter().flat_map(|frame| {
        let (width, height) = frame.depth.size();
        let (dx, dy) = (width.div_ceil(SAMPLES).max(1), height.div_ceil(SAMPLES).max(1));
        let pixels = (0..height).step_by(dy).flat_map(move |y| (0..width).step_by(dx).map(move |x| (x, y)));
        pixels.filter_map(|(x, y)| {
            let depth = f64::from(frame.depth[(x, y)]);
            (depth > 0.0).then(|| frame.camera.unproject_pixel(x, y, depth))
        })
    });
    let points: Vec<DVec3> = points.collect();
    if points.is_empty() {
        return None;
    }
    // A single false depth would make all cells wide.
    let at =
        |share: f64| DVec3::from([0, 1, 2].map(|k| quantile(points.iter().map(|p| p[k]).collect(), share)));
    Some(Aabb { min: at(OUTLIERS), max: at(1.0 - OUTLIERS) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::over_plate;
    use rand::RngExt;
    use sms_core::Seed;

    #[test]
    fn every_frame_that_shows_a_point_is_among_those_of_its_cell() {
        let (mut sequence, _) = over_plate(6, 80);
        for (i, frame) in sequence.frames.iter_mut().enumerate() {
            let turn =
                glamx::DQuat::from_rotation_x(0.5 * i as f64) * glamx::DQuat::from_rotation_y(0.3 * i as f64);
            frame.camera.x_wc.rotation = turn * frame.camera.x_wc.rotation;
        }
        let cells = FrameCells::of(&sequence);
        let mut rng = Seed(3).rng();
        let (mut seen, mut asked) = (0, 0);
        for _ in 0..20_000 {
            let p_w = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-3.0..3.0)));
            let shows = |f: &usize| {
                let camera = &sequence.frames[*f].camera;
                camera.project(p_w).is_some_and(|(u, v, _)| camera.pixel_at(u, v).is_some())
            };
            let near = cells.at(p_w);
            assert!(near.is_sorted());
            asked += near.len();
            for f in (0..sequence.len()).filter(shows) {
                seen += 1;
                assert!(near.contains(&(f as u32)), "{f} at {p_w}");
            }
        }
        assert!(seen > 1000 && asked < 20_000 * sequence.len(), "{seen} {asked}");
    }
}
