//! Volumes of the convex hulls on either side of many parallel planes, in one pass per direction.
//!
//! The hull of the part below a plane only grows as the plane rises. So one incremental hull that takes points by
//! ascending height gives the volume below every plane. The outline of a plane's cut lies inside the hull of every
//! higher plane, so its points can stay.

use crate::outline::{monotone_chain, sort};
use crate::predicates::{ACROSS, FACES};
use glamx::{DVec2, DVec3};

#[derive(Clone, Copy)]
struct SweptFace {
    corners: [u32; 3],
    /// The face across the edge from corner `k` to corner `k + 1`.
    across: [u32; 3],
    /// A corner, in integer steps.
    foot: DVec3,
    /// Normal with a length of twice the area, in square steps.
    normal: DVec3,
    alive: bool,
}

/// Points are rounded to this number of steps per unit. With coordinates of at most 2¹⁵ steps every determinant is a
/// whole number below 2⁵², which is exact in doubles. So there are no rounding errors, tolerances or tilted slivers.
const STEPS: f64 = 32_768.0;

/// Incremental convex hull of points with coordinates in [−1, 1], with its volume.
#[derive(Default)]
pub(crate) struct GrowingHull {
    points: Vec<DVec3>,
    /// The points in steps.
    steps: Vec<DVec3>,
    faces: Vec<SweptFace>,
    free: Vec<u32>,
    waiting: Vec<DVec3>,
    newest: Vec<u32>,
    visible: Vec<u32>,
    stamp: Vec<u32>,
    round: u32,
    horizon: Vec<(u32, u32, u32, u8)>,
    /// New face that starts at each vertex of the horizon.
    starting: Vec<u32>,
    volume: f64,
    slight: f64,
    /// Tests of points against faces since [`Self::take_steps`].
    steps_taken: u64,
}

const NONE: u32 = u32::MAX;

impl GrowingHull {
    /// Empties the hull. Points that protrude from it by less than `slight` will be left out.
    pub(crate) fn clear(&mut self, slight: f64) {
        self.slight = slight;
        self.points.clear();
        self.steps.clear();
        self.faces.clear();
        self.free.clear();
        self.waiting.clear();
        self.newest.clear();
        self.stamp.clear();
        self.starting.clear();
        self.round = 0;
        self.volume = 0.0;
    }

    /// Returns the steps of work since the last call.
    pub(crate) fn take_steps(&mut self) -> u64 {
        std::mem::take(&mut self.steps_taken)
    }

    pub(crate) fn push(&mut self, p: DVec3) {
        if self.faces.is_empty() {
            self.waiting.push(p);
        } else {
            self.insert(p);
        }
    }

    /// Returns the volume of the hull of all points so far; 0 while they are coplanar.
    pub(crate) fn volume(&mut self) -> f64 {
        if self.faces.is_empty() {
            self.start();
        }
        self.volume / (6.0 * STEPS * STEPS * STEPS)
    }

    /// Replaces the hull by that of `points`, as after [`Self::clear`], and returns its volume.
    pub(crate) fn refill<'a>(&mut self, slight: f64, points: impl IntoIterator<Item = &'a DVec3>) -> f64 {
        self.clear(slight);
        points.into_iter().for_each(|&p| self.push(p));
        self.volume()
    }

    fn start(&mut self) {
        let steps: Vec<DVec3> = self.waiting.iter().map(|p| (p * STEPS).round()).collect();
        let Some(simplex) = extreme_simplex(&steps) else { return };
        self.points.extend(simplex.map(|i| self.waiting[i]));
        self.steps.extend(simplex.map(|i| steps[i]));
        self.starting.resize(4, NONE);
        for (corners, across) in FACES.into_iter().zip(ACROSS) {
            self.add_face(corners.map(|k| k as u32), across);
        }
        let [a, b, c, d] = simplex.map(|i| steps[i]);
        self.volume = (b - a).cross(c - a).dot(d - a);
        let waiting = std::mem::take(&mut self.waiting);
        for &p in &waiting {
            self.insert(p);
        }
        self.waiting = waiting;
    }

    fn add_face(&mut self, corners: [u32; 3], across: [u32; 3]) -> u32 {
        let [a, b, c] = corners.map(|i| self.steps[i as usize]);
        let face = SweptFace { corners, across, foot: a, normal: (b - a).cross(c - a), alive: true };
        match self.free.pop() {
            Some(id) => {
                self.faces[id as usize] = face;
                id
            }
            None => {
                self.faces.push(face);
                self.stamp.push(0);
                self.faces.len() as u32 - 1
            }
        }
    }

    /// Returns six times the volume between a face and a point in steps; positive exactly when the point sees the face.
    fn height(&self, f: u32, q: DVec3) -> f64 {
        let face = &self.faces[f as usize];
        face.normal.dot(q - face.foot)
    }

    fn insert(&mut self, p: DVec3) {
        let q = (p * STEPS).round();
        let sees = |f: &u32| self.faces[*f as usize].alive && self.height(*f, q) > 0.0;
        let mut tests = 1;
        let first = self
            .newest
            .iter()
            .copied()
            .chain(0..self.faces.len() as u32)
            .inspect(|_| tests += 1)
            .find(|f| sees(f));
        self.steps_taken += tests;
        let Some(first) = first else { return };
        self.round += 1;
        let round = self.round;
        self.visible.clear();
        self.horizon.clear();
        self.visible.push(first);
        self.stamp[first as usize] = round;
        let (mut gained, mut highest) = (0.0, 0.0f64);
        let mut at = 0;
        while at < self.visible.len() {
            let f = self.visible[at];
            at += 1;
            let height = self.height(f, q);
            gained += height;
            highest = highest.max(height * height / self.faces[f as usize].normal.length_squared());
            for k in 0..3 {
                let g = self.faces[f as usize].across[k];
                if self.stamp[g as usize] == round {
                    continue;
                }
                if self.height(g, q) > 0.0 {
                    self.stamp[g as usize] = round;
                    self.visible.push(g);
                } else {
                    let c = self.faces[f as usize].corners;
                    let twin = self.faces[g as usize].corners;
                    let m = (0..3u8).find(|&m| twin[m as usize] == c[(k + 1) % 3]).unwrap_or(0);
                    self.horizon.push((c[k], c[(k + 1) % 3], g, m));
                }
            }
        }
        self.steps_taken += 3 * self.visible.len() as u64;
        // A point far beyond the rim of a flat hull is also low above every face that it sees, but adds volume.
        if highest < (self.slight * STEPS).powi(2) && gained < 5e-3 * self.slight * 6.0 * STEPS.powi(3) {
            return;
        }
        // The horizon must be one simple loop. Otherwise rounding has split the visible region.
        for (n, &(a, ..)) in self.horizon.iter().enumerate() {
            self.starting[a as usize] = n as u32;
        }
        let (mut n, mut steps) = (0usize, 0usize);
        loop {
            let end = self.horizon[n].1;
            let next = self.starting[end as usize];
            steps += 1;
            if next == NONE || self.horizon[next as usize].0 != end || steps > self.horizon.len() {
                self.forget_starts();
                return;
            }
            if next == 0 {
                break;
            }
            n = next as usize;
        }
        if steps != self.horizon.len() {
            self.forget_starts();
            return;
        }
        let apex = self.points.len() as u32;
        self.points.push(p);
        self.steps.push(q);
        self.starting.push(NONE);
        for i in 0..self.visible.len() {
            let f = self.visible[i];
            self.faces[f as usize].alive = false;
            self.free.push(f);
        }
        self.newest.clear();
        for i in 0..self.horizon.len() {
            let (a, b, g, m) = self.horizon[i];
            let id = self.add_face([a, b, apex], [g, NONE, NONE]);
            self.stamp[id as usize] = 0;
            self.faces[g as usize].across[m as usize] = id;
            self.newest.push(id);
        }
        for i in 0..self.horizon.len() {
            let next = self.newest[self.starting[self.horizon[i].1 as usize] as usize];
            let id = self.newest[i];
            self.faces[id as usize].across[1] = next;
            self.faces[next as usize].across[2] = id;
        }
        self.forget_starts();
        self.volume += gained;
    }

    fn forget_starts(&mut self) {
        for &(a, ..) in &self.horizon {
            self.starting[a as usize] = NONE;
        }
    }

    /// Returns whether a point lies outside by more than the tolerance.
    pub(crate) fn leaves_out(&self, p: DVec3) -> bool {
        let q = (p * STEPS).round();
        let least = self.slight * STEPS;
        self.faces.iter().any(|f| f.alive && f.normal.dot(q - f.foot) > least * f.normal.length())
    }

    /// Returns the corner points of the hull's faces.
    pub(crate) fn triangles(&self) -> impl Iterator<Item = [DVec3; 3]> + '_ {
        self.faces.iter().filter(|f| f.alive).map(|f| f.corners.map(|i| self.points[i as usize]))
    }

    /// Returns the hull's vertices, in the order of insertion.
    pub(crate) fn vertices(&self) -> Vec<DVec3> {
        let mut used = vec![false; self.points.len()];
        for f in self.faces.iter().filter(|f| f.alive) {
            for &c in &f.corners {
                used[c as usize] = true;
            }
        }
        self.points.iter().zip(used).filter(|(_, used)| *used).map(|(p, _)| *p).collect()
    }
}

/// Returns a positively oriented tetrahedron of far-apart points, in steps; `None` when all are within a step of a
/// plane.
fn extreme_simplex(points: &[DVec3]) -> Option<[usize; 4]> {
    let farthest = |measure: &dyn Fn(DVec3) -> f64| {
        let mut best: Option<(f64, usize)> = None;
        for (i, &p) in points.iter().enumerate() {
            let m = measure(p);
            if best.is_none_or(|b| m > b.0) {
                best = Some((m, i));
            }
        }
        best
    };
    let a = *points.first()?;
    let (_, i) = farthest(&|p| p.distance_squared(a))?;
    let b = points[i];
    let (wide, j) = farthest(&|p| (p - a).cross(b - a).length_squared())?;
    if wide == 0.0 {
        return None;
    }
    let normal = (b - a).cross(points[j] - a);
    let (high, k) = farthest(&|p| (p - a).dot(normal).abs())?;
    if high <= normal.length() {
        return None;
    }
    Some(if (points[k] - a).dot(normal) > 0.0 { [0, i, j, k] } else { [i, 0, j, k] })
}

/// Reduces coplanar points to their convex outline.
pub(crate) fn outline(points: &mut Vec<(DVec2, DVec3)>) {
    if points.len() < 4 {
        return;
    }
    sort(points, |p| p.0);
    *points = monotone_chain(points, |p| p.0, 1e-14);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::RngExt;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]
        #[test]
        fn volume_equals_the_exact_hull_s(seed in 0u64..10_000, grid in proptest::bool::ANY, sorted in proptest::bool::ANY) {
            let mut rng = sms_core::Seed(seed).rng();
            let mut points: Vec<DVec3> = (0..120)
                .map(|_| {
                    let p = DVec3::new(rng.random(), rng.random(), rng.random());
                    if grid { (p * 4.0).round() / 4.0 } else { p }
                })
                .collect();
            if sorted {
                points.sort_by(|a, b| a.z.total_cmp(&b.z));
            }
            let mut hull = GrowingHull::default();
            for round in 0..2 {
                hull.clear(1e-6);
                for (i, &p) in points.iter().enumerate() {
                    hull.push(p);
                    if i % 40 == 20 + round {
                        let _ = hull.volume();
                    }
                }
                let exact = crate::convex_hull(&points, usize::MAX, 0.0).unwrap().volume();
                // Rounding moves points by half a step: at most 2e-4 of the volume of such a small hull.
                prop_assert!((hull.volume() / exact - 1.0).abs() < 2e-4, "{} {exact}", hull.volume());
                let faces: f64 =
                    hull.triangles().map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum();
                prop_assert!((faces / hull.volume() - 1.0).abs() < 2e-4);
            }
        }
    }

    #[test]
    fn outline_of_a_grid_is_its_corners() {
        let mut points: Vec<(DVec2, DVec3)> = (0..25)
            .map(|i| {
                let p = DVec2::new(f64::from(i % 5), f64::from(i / 5));
                (p, p.extend(0.0))
            })
            .collect();
        outline(&mut points);
        assert_eq!(points.len(), 4);
    }
}
