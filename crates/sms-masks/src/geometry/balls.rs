//! Detection of balls in connected pieces. A ball touches its neighbours at a point, but noise fills the gap around the
//! point, and patches of a few surfels merge across it. Only the ball as a whole is recognizably round.

use super::fuse::{Neighbors, Surfel};
use glamx::{DMat3, DVec3};
use rayon::prelude::*;
use sms_core::{Cancel, CoreError, even_directions};
use std::collections::{BTreeSet, HashSet};

/// A detected ball.
#[derive(Debug, Clone)]
pub(crate) struct Ball {
    /// Its surfels, sorted.
    pub(crate) members: Vec<usize>,
    #[cfg_attr(not(test), expect(dead_code, reason = "tests compare it"))]
    pub(crate) sphere: Sphere,
}

/// A sphere.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sphere {
    pub(crate) center_w: DVec3,
    pub(crate) radius_m: f64,
}

/// Radii of the search. A smaller ball covers too few cells; round objects larger than balls for games are furniture.
const RADII_M: std::ops::Range<f64> = 0.012..0.13;
/// Every `STRIDE`-th surfel starts a search, but at most `SEARCHES` per piece.
const STRIDE: usize = 29;
const SEARCHES: usize = 1000;
/// Number of searches that run at once; at most this many are wasted for each ball found.
const BATCH: usize = 64;
/// Smallest visible share of a ball's surface. Balls of 3 cm on a table and against a mug show 0.86 to 0.97; a band
/// around a cup or a rod shows 0.44 to 0.72.
const COVERED: f64 = 0.75;
/// Largest root mean square distance of the surfels from the sphere: this share of the radius, plus noise. Balls of 3
/// cm have 1 % of the radius alone on a table and 2 % against a mug. Round heads and bellies of toys, of 4 cm and more,
/// have at least 2.8 %; bands have 4 %.
const UNROUND: f64 = 0.015;
const NOISE_M: f64 = 3e-4;
/// Directions for measuring the visible share of the surface.
const DIRECTIONS: usize = 64;

impl Sphere {
    /// Fits positions and normals: the least squares of p = c + r n.
    fn from_normals(surfels: &[Surfel], of: &[usize]) -> Option<Self> {
        let count = of.len() as f64;
        let mean = |f: &dyn Fn(&Surfel) -> DVec3| of.iter().map(|&i| f(&surfels[i])).sum::<DVec3>() / count;
        let (p, n) = (mean(&|s| s.p_w), mean(&|s| s.n_w));
        let (mut both, mut own) = (0.0, 0.0);
        for s in of.iter().map(|&i| &surfels[i]) {
            both += (s.p_w - p).dot(s.n_w - n);
            own += (s.n_w - n).length_squared();
        }
        let radius_m = both / own.max(1e-12);
        RADII_M.contains(&radius_m).then(|| Self { center_w: p - radius_m * n, radius_m })
    }

    /// Fits positions only: the least squares of |p|² = 2 c·p + k, which is linear.
    fn from_positions(surfels: &[Surfel], of: &[usize]) -> Option<Self> {
        let count = of.len() as f64;
        let mean = of.iter().map(|&i| surfels[i].p_w).sum::<DVec3>() / count;
        let (mut spread, mut cubic, mut square) = (DMat3::ZERO, DVec3::ZERO, 0.0);
        for q in of.iter().map(|&i| surfels[i].p_w - mean) {
            spread += DMat3::from_cols(q * q.x, q * q.y, q * q.z);
            cubic += q * q.length_squared();
            square += q.length_squared();
        }
        if spread.determinant() <= 0.0 {
            return None;
        }
        let c = 0.5 * (spread.inverse() * cubic);
        let radius_m = (square / count + c.length_squared()).sqrt();
        RADII_M.contains(&radius_m).then(|| Self { center_w: mean + c, radius_m })
    }

    /// Returns the distance of a point from the surface, negative inside.
    fn height(&self, p_w: DVec3) -> f64 {
        p_w.distance(self.center_w) - self.radius_m
    }

    /// Returns whether a surfel lies within a distance of the surface and faces outwards.
    fn shows(&self, s: &Surfel, within_m: f64, aligned: f64) -> bool {
        self.height(s.p_w).abs() < within_m
            && (s.p_w - self.center_w).normalize_or_zero().dot(s.n_w) > aligned
    }

    /// Returns surfels on the sphere that are connected to the given ones.
    fn flood(
        &self,
        surfels: &[Surfel],
        graph: &Neighbors,
        from: &[usize],
        within_m: f64,
        holds: impl Fn(usize) -> bool,
    ) -> Vec<usize> {
        let admits = |i: usize| holds(i) && self.shows(&surfels[i], within_m, 0.7);
        let mut found: Vec<usize> = from.iter().copied().filter(|&i| admits(i)).collect();
        let mut seen: HashSet<usize> = found.iter().copied().collect();
        let mut next = 0;
        while next < found.len() {
            for j in graph.of(found[next]) {
                if seen.insert(j) && admits(j) {
                    found.push(j);
                }
            }
            next += 1;
        }
        found
    }

    /// Returns whether the surfels are round within noise and cover enough of the sphere.
    fn is_ball(&self, surfels: &[Surfel], on_it: &[usize], directions: &[DVec3]) -> bool {
        let square: f64 = on_it.iter().map(|&i| self.height(surfels[i].p_w).powi(2)).sum();
        let rms_m = (square / on_it.len() as f64).sqrt();
        rms_m <= NOISE_M + UNROUND * self.radius_m && self.covered(surfels, on_it, directions) >= COVERED
    }

    /// Returns the share of directions that contain one of the surfels.
    fn covered(&self, surfels: &[Surfel], of: &[usize], directions: &[DVec3]) -> f64 {
        let mut seen = vec![false; directions.len()];
        for &i in of {
            let d = surfels[i].p_w - self.center_w;
            let nearest =
                (0..directions.len()).max_by(|&a, &b| directions[a].dot(d).total_cmp(&directions[b].dot(d)));
            nearest.into_iter().for_each(|k| seen[k] = true);
        }
        seen.iter().filter(|s| **s).count() as f64 / seen.len() as f64
    }
}

/// Returns the balls among the surfels of a connected piece (sorted). Balls are disjoint and in the order of their
/// first surfels.
///
/// From every [`STRIDE`]-th surfel, a sphere is fitted to two rings of neighbours, then four times to all connected
/// surfels on the sphere. A fit that is round within noise and shows [`COVERED`] of its surface is a ball.
///
/// # Errors
/// [`CoreError::Interrupted`] once a stop was requested.
pub(crate) fn balls(
    surfels: &[Surfel],
    graph: &Neighbors,
    piece: &[usize],
    voxel_m: f64,
    cancel: &Cancel,
) -> Result<Vec<Ball>, CoreError> {
    let directions: Vec<DVec3> = even_directions(DIRECTIONS).collect();
    let seeds: Vec<usize> = piece.iter().copied().step_by(STRIDE.max(piece.len() / SEARCHES)).collect();
    let mut taken: HashSet<usize> = HashSet::new();
    let mut balls: Vec<Ball> = Vec::new();
    let mut next = 0;
    while next < seeds.len() {
        cancel.check()?;
        let free = |i: usize| !taken.contains(&i) && piece.binary_search(&i).is_ok();
        let search = |(at, &seed): (usize, &usize)| {
            if taken.contains(&seed) {
                return None;
            }
            let (sphere, on_it) = grown(surfels, graph, seed, voxel_m, free)?;
            sphere.is_ball(surfels, &on_it, &directions).then_some((at, sphere))
        };
        // A search depends only on earlier balls. In a batch, the first search that finds a ball counts, and later
        // searches are repeated.
        let batch = &seeds[next..seeds.len().min(next + BATCH)];
        let Some((at, sphere)) = batch.par_iter().enumerate().find_map_first(search) else {
            next += batch.len();
            continue;
        };
        next += at + 1;
        // Surfels right under the surface belong to the ball, even if noise turns their normals.
        let is_member = |&i: &usize| {
            let s = &surfels[i];
            let under = (-2.0 * voxel_m..0.0).contains(&sphere.height(s.p_w));
            !taken.contains(&i) && (under || sphere.shows(s, 1.2 * voxel_m, 0.5))
        };
        let members: Vec<usize> = piece.iter().copied().filter(is_member).collect();
        if !members.is_empty() {
            taken.extend(&members);
            balls.push(Ball { members, sphere });
        }
    }
    balls.sort_by_key(|b| b.members[0]);
    Ok(balls)
}

/// Fits a sphere around a surfel. Returns the sphere and the surfels on it.
fn grown(
    surfels: &[Surfel],
    graph: &Neighbors,
    seed: usize,
    voxel_m: f64,
    free: impl Fn(usize) -> bool,
) -> Option<(Sphere, Vec<usize>)> {
    let ring: BTreeSet<usize> = graph.of(seed).flat_map(|j| graph.of(j)).filter(|&j| free(j)).collect();
    let ring: Vec<usize> = ring.into_iter().collect();
    if ring.len() < 12 {
        return None;
    }
    let mut sphere = Sphere::from_normals(surfels, &ring)?;
    let mut on_it = ring;
    for share in [0.3, 0.2, 0.12, 0.1] {
        let within_m = (share * sphere.radius_m).max(0.6 * voxel_m);
        on_it = sphere.flood(surfels, graph, &on_it, within_m, &free);
        // A sphere with less than a third of its surface cannot become a ball.
        if 3.0 * on_it.len() as f64 * voxel_m.powi(2) < 2.0 * std::f64::consts::PI * sphere.radius_m.powi(2) {
            return None;
        }
        sphere = Sphere::from_positions(surfels, &on_it)?;
    }
    Some((sphere, on_it))
}

#[cfg(test)]
mod tests {
    use super::super::{GeometryConfig, fuse};
    use super::*;
    use crate::fixture::{Sensor, Solid, scene};

    /// Returns the balls of a scene without the table.
    fn found(solids: &[Solid], sensor: Sensor) -> Vec<Sphere> {
        let config = GeometryConfig::default();
        let (sequence, _) = scene(solids, sensor, 3);
        let (surfels, graph) = fuse::fuse(&sequence, &config, &Cancel::new()).unwrap();
        let pieces = graph.components(|i| surfels[i].p_w.z > 0.006);
        pieces
            .iter()
            .flat_map(|piece| balls(&surfels, &graph, piece, config.voxel_m, &Cancel::new()).unwrap())
            .map(|b| b.sphere)
            .collect()
    }

    fn ball(x: f64, y: f64, radius_m: f64) -> Solid {
        Solid::Sphere(DVec3::new(x, y, radius_m), radius_m)
    }

    #[test]
    fn balls_are_found_where_they_are_and_nothing_else() {
        // Two touching balls, one against a cup, a small and a large one; a rod with round sides, a box, a cup.
        let (cup, against) = (0.045, 0.0286);
        let solids = [
            ball(-0.15, 0.0, 0.0286),
            ball(-0.15, 0.0576, 0.0286),
            ball(cup + against + 0.001, 0.0, against),
            ball(-0.1, -0.15, 0.02),
            ball(0.05, 0.2, 0.06),
            Solid::Cup(DVec3::ZERO, cup, 0.11),
            Solid::Rod(DVec3::new(0.15, -0.15, 0.025), DVec3::new(0.04, 0.0, 0.0), 0.025),
            Solid::Box(DVec3::new(0.0, -0.22, 0.02), DVec3::splat(0.02), 0.3),
        ];
        for sensor in [Sensor { sigma_1m: 0.0, ..Sensor::default() }, Sensor::default()] {
            let found = found(&solids, sensor);
            println!("{found:.4?}");
            assert_eq!(found.len(), 5);
            for solid in &solids[..5] {
                let Solid::Sphere(center, radius) = *solid else { unreachable!() };
                let nearest = found
                    .iter()
                    .min_by(|a, b| a.center_w.distance(center).total_cmp(&b.center_w.distance(center)));
                let sphere = nearest.unwrap();
                let off = sphere.center_w.distance(center);
                assert!(off < 0.0015 && (sphere.radius_m - radius).abs() < 0.001, "{sphere:?}: {solid:?}");
            }
        }
    }

    #[test]
    fn a_search_stops_when_asked() {
        let config = GeometryConfig::default();
        let (sequence, _) = scene(&[ball(0.0, 0.0, 0.03)], Sensor::default(), 3);
        let (surfels, graph) = fuse::fuse(&sequence, &config, &Cancel::new()).unwrap();
        let piece = &graph.components(|i| surfels[i].p_w.z > 0.006)[0];
        let cancel = Cancel::new();
        cancel.cancel();
        let stopped = balls(&surfels, &graph, piece, config.voxel_m, &cancel);
        assert!(matches!(stopped, Err(CoreError::Interrupted)));
    }

    #[test]
    fn a_dome_is_no_ball() {
        // A half sphere shows 0.5 of the surface.
        assert!(found(&[Solid::Sphere(DVec3::ZERO, 0.05)], Sensor::default()).is_empty());
    }

    #[test]
    fn fits_are_exact_for_exact_points() {
        let (center_w, radius_m) = (DVec3::new(0.3, -0.2, 1.1), 0.04);
        let surfels: Vec<Surfel> = even_directions(50)
            .take(30)
            .map(|n_w| Surfel {
                p_w: center_w + radius_m * n_w,
                n_w,
                weight: 1.0,
                color: [0.0; 3],
                sigma_m: 0.0,
            })
            .collect();
        let of: Vec<usize> = (0..surfels.len()).collect();
        for fit in [Sphere::from_normals(&surfels, &of), Sphere::from_positions(&surfels, &of)] {
            let fit = fit.unwrap();
            assert!(fit.center_w.distance(center_w) < 1e-9 && (fit.radius_m - radius_m).abs() < 1e-9);
        }
        // The same points seen from inside are not a ball.
        let inside: Vec<Surfel> = surfels.iter().map(|s| Surfel { n_w: -s.n_w, ..*s }).collect();
        assert!(Sphere::from_normals(&inside, &of).is_none());
    }
}
