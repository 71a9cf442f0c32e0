//! Posts: legs of tables and stools. Their load hides their upper ends from cameras that look down.

use super::extents::{extents, quantile};
use super::fuse::Surfel;
use glamx::{DVec2, DVec3};

/// Largest width of a post, and smallest ratio of its length to its width.
pub(crate) const WIDE_M: f64 = 0.12;
const SLENDER: f64 = 2.5;
/// Smallest height of a post as a share of its length.
const UPRIGHT: f64 = 0.85;
/// Largest hidden height at a post's upper end.
const HIDDEN_M: f64 = 0.12;
/// Largest overlap of a post's top with the lower edge of its load, due to noise.
const OVERLAP_M: f64 = 0.02;
/// Largest distance of a post's axis outside the outline of its load; the lower edge is searched within `AROUND_M`.
const OUTSIDE_M: f64 = 0.03;
const AROUND_M: f64 = 0.1;

/// A slender and upright object.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Post {
    /// Position of its axis at the upper end, and height of the upper end.
    pub(crate) axis_w: DVec2,
    pub(crate) top_m: f64,
    /// Width.
    pub(crate) width_m: f64,
}

impl Post {
    /// Returns a piece as a post, or `None` if it has another shape.
    pub(crate) fn of(surfels: &[Surfel], members: &[usize]) -> Option<Self> {
        let [_, width_m, long] = extents(surfels, members);
        let heights = || members.iter().map(|&i| surfels[i].p_w.z);
        let (low, top_m) = (quantile(heights(), 0.02), quantile(heights(), 0.98));
        if width_m > WIDE_M || long < SLENDER * width_m || top_m - low < UPRIGHT * long {
            return None;
        }
        let upper = members.iter().map(|&i| surfels[i].p_w).filter(|p| p.z > top_m - width_m);
        let (sum, count) = upper.fold((DVec3::ZERO, 0.0), |(s, n), p| (s + p, n + 1.0));
        Some(Self { axis_w: (sum / f64::max(count, 1.0)).truncate(), top_m, width_m })
    }

    /// Returns the piece with the lowest lower edge above the post's end, and the gap (see [`Post::reaches`]). Pieces
    /// are given with index, members and outline; of equals, the one with the smallest index wins.
    pub(crate) fn lowest_over<'a>(
        &self,
        surfels: &[Surfel],
        pieces: impl Iterator<Item = (usize, &'a [usize], &'a Footprint)>,
    ) -> Option<(f64, usize)> {
        pieces
            .filter_map(|(b, members, footprint)| Some((self.reaches(surfels, members, footprint)?, b)))
            .min_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)))
    }

    /// Returns the height of a piece's lower edge above the post's end (negative where they overlap) if the post can be
    /// a leg of the piece. The post must end under the piece or its rim, close enough that the rest is hidden.
    fn reaches(&self, surfels: &[Surfel], members: &[usize], footprint: &Footprint) -> Option<f64> {
        if !footprint.covers(self.axis_w, OUTSIDE_M) {
            return None;
        }
        let over = |p: &DVec3| p.z > self.top_m - OVERLAP_M;
        let near = |p: &DVec3| p.truncate().distance(self.axis_w) < 0.5 * self.width_m + AROUND_M;
        let points = || members.iter().map(|&i| surfels[i].p_w).filter(over);
        let edge = match points().filter(near).count() {
            // Everything near the axis is hidden, too.
            0 => quantile(points().map(|p| p.z), 0.02),
            _ => quantile(points().filter(near).map(|p| p.z), 0.02),
        };
        let gap = edge - self.top_m;
        (points().next().is_some() && gap < HIDDEN_M).then_some(gap)
    }
}

/// The convex outline of points in top view: their extent in each of some directions.
#[derive(Debug, Clone)]
pub(crate) struct Footprint([f64; Self::DIRECTIONS]);

impl Footprint {
    const DIRECTIONS: usize = 32;

    /// Returns the outline of a piece.
    pub(crate) fn of(surfels: &[Surfel], members: &[usize]) -> Self {
        let mut reach = [f64::NEG_INFINITY; Self::DIRECTIONS];
        for (k, reach) in reach.iter_mut().enumerate() {
            let direction = Self::direction(k);
            let along = members.iter().map(|&i| direction.dot(surfels[i].p_w.truncate()));
            *reach = along.fold(f64::NEG_INFINITY, f64::max);
        }
        Self(reach)
    }

    /// Returns whether a point lies within the outline, or at most `margin_m` outside it.
    pub(crate) fn covers(&self, p: DVec2, margin_m: f64) -> bool {
        self.0.iter().enumerate().all(|(k, reach)| Self::direction(k).dot(p) < reach + margin_m)
    }

    /// Returns the centre of the bounding box.
    pub(crate) fn center(&self) -> DVec2 {
        let middle = |k: usize| 0.5 * (self.0[k] - self.0[k + Self::DIRECTIONS / 2]);
        DVec2::new(middle(0), middle(Self::DIRECTIONS / 4))
    }

    /// Returns the width in direction `k`.
    fn width(&self, k: usize) -> f64 {
        self.0[k] + self.0[(k + Self::DIRECTIONS / 2) % Self::DIRECTIONS]
    }

    /// Returns the smallest width.
    pub(crate) fn narrowest(&self) -> f64 {
        (0..Self::DIRECTIONS).map(|k| self.width(k)).fold(f64::INFINITY, f64::min)
    }

    /// Returns whether the outline extends beyond another one, in some direction, by more than a share of the other's
    /// width in that direction.
    pub(crate) fn juts_out(&self, other: &Self, share: f64) -> bool {
        (0..Self::DIRECTIONS).any(|k| self.0[k] - other.0[k] > share * other.width(k))
    }

    fn direction(k: usize) -> DVec2 {
        DVec2::from_angle(std::f64::consts::TAU * k as f64 / Self::DIRECTIONS as f64)
    }
}
