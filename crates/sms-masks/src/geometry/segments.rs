//! Segments of a connected piece: patches that merge pairwise, with evidence at their borders.

use super::balls::Ball;
use super::fuse::{Neighbors, Surfel};
use super::linalg::{outer, symmetric_eigen};
use super::seams::{LevelSeam, between};
use crate::voxels::key_of;
use glamx::{DMat3, DVec3};
use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap, HashSet};

/// Surfels of one coarse cell that face about the same way.
#[derive(Debug, Clone)]
struct SurfelPatch {
    members: Vec<usize>,
    p_w: DVec3,
    n_w: DVec3,
    look: FacingColors,
}

/// Returns which of the six axis directions is nearest to a normal.
fn facing(n: DVec3) -> usize {
    let a = n.abs();
    let axis = if a.x >= a.y && a.x >= a.z {
        0
    } else if a.y >= a.z {
        1
    } else {
        2
    };
    2 * axis + usize::from(n[axis] < 0.0)
}

/// Count, sum and sum of squares of colours.
#[derive(Debug, Clone, Copy, Default)]
struct ColorMoments {
    count: f64,
    sum: DVec3,
    squares: DVec3,
}

impl ColorMoments {
    fn add(&mut self, color: [f32; 3]) {
        let c = DVec3::from_array(color.map(f64::from));
        self.count += 1.0;
        self.sum += c;
        self.squares += c * c;
    }

    fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.sum += other.sum;
        self.squares += other.squares;
    }

    /// Returns the distance of the means in units of the spreads and of the effect of light alone (`light`, 8-bit
    /// levels).
    fn distance(&self, other: &Self, light: f64) -> f64 {
        let (m, n) = (self.sum / self.count.max(1.0), other.sum / other.count.max(1.0));
        let variance =
            (self.squares / self.count.max(1.0) - m * m) + (other.squares / other.count.max(1.0) - n * n);
        let d = m - n;
        (d * d / (variance.max(DVec3::ZERO) + DVec3::splat(2.0 * light * light))).element_sum().sqrt()
    }
}

/// Colours by facing. Surfaces that face the same way are lit alike, so their colours are comparable.
#[derive(Debug, Clone, Copy, Default)]
struct FacingColors([ColorMoments; 6]);

/// Change of colour by light, in levels, between surfaces that face the same way.
const SAME_LIGHT: f64 = 15.0;
/// Change of colour by light between larger surfaces that face different ways.
const OTHER_LIGHT: f64 = 40.0;
/// Largest number of surfels of a patch.
const FEW: f64 = 48.0;

impl FacingColors {
    fn merge(&mut self, other: &Self) {
        self.0.iter_mut().zip(&other.0).for_each(|(a, b)| a.merge(b));
    }

    /// Returns the distance between two sets of colours; between patches, `light` is the change of colour due to light.
    fn distance(&self, other: &Self, light: f64) -> f64 {
        let (own, others) = (self.whole(), other.whole());
        // Adjacent patches are lit alike, whole segments are not.
        if own.count.min(others.count) < FEW {
            return own.distance(&others, light);
        }
        self.shared_distance(other).unwrap_or_else(|| own.distance(&others, OTHER_LIGHT))
    }

    /// Returns the distance of the colours of surfaces that face the same way, if there are enough of them.
    fn shared_distance(&self, other: &Self) -> Option<f64> {
        let (mut sum, mut weight) = (0.0, 0.0);
        for (a, b) in self.0.iter().zip(&other.0) {
            let shared = a.count.min(b.count);
            if shared >= 6.0 {
                sum += shared * a.distance(b, SAME_LIGHT);
                weight += shared;
            }
        }
        (weight >= 0.5 * FEW).then(|| sum / weight)
    }

    fn whole(&self) -> ColorMoments {
        let mut all = ColorMoments::default();
        self.0.iter().for_each(|m| all.merge(m));
        all
    }
}

/// Moments of a set of points.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PointMoments {
    count: f64,
    sum: DVec3,
    squares: DMat3,
}

impl Default for PointMoments {
    fn default() -> Self {
        // The default matrix is the identity.
        Self { count: 0.0, sum: DVec3::ZERO, squares: DMat3::ZERO }
    }
}

impl PointMoments {
    fn add(&mut self, p: DVec3) {
        self.count += 1.0;
        self.sum += p;
        self.squares += outer(p, 1.0);
    }

    fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.sum += other.sum;
        self.squares += other.squares;
    }

    pub(crate) fn center(&self) -> DVec3 {
        self.sum / self.count.max(1.0)
    }

    /// Returns the lengths, increasing, of a box with the same spread.
    pub(crate) fn extents(&self) -> [f64; 3] {
        symmetric_eigen(self.covariance()).0.map(|v| (12.0 * v.max(0.0)).sqrt())
    }

    /// Returns the direction of the smallest spread.
    pub(crate) fn normal(&self) -> DVec3 {
        symmetric_eigen(self.covariance()).1[0]
    }

    /// Returns the direction of the largest spread.
    pub(crate) fn axis(&self) -> DVec3 {
        symmetric_eigen(self.covariance()).1[2]
    }

    /// Returns the height of a box with the same vertical spread.
    pub(crate) fn height(&self) -> f64 {
        (12.0 * self.covariance().z_axis.z.max(0.0)).sqrt()
    }

    fn covariance(&self) -> DMat3 {
        self.squares * (1.0 / self.count.max(1.0)) - outer(self.center(), 1.0)
    }
}

/// Evidence at the border between two segments.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Border {
    /// Number of pairs of neighbouring surfels across it.
    pub(crate) pairs: f64,
    /// Number of pairs, weighted by how sharply each bends inwards (0 to 1).
    pub(crate) crease: f64,
    /// Number of pairs across a level seam with the first surfel above it, minus the number with the second above it.
    pub(crate) over: f64,
    /// Number of pairs with only one surfel on a ball.
    round: f64,
    /// Positions of the border.
    pub(crate) spread: PointMoments,
}

impl Border {
    /// Returns whether the border runs along a level seam.
    pub(crate) fn is_seam(&self) -> bool {
        2.0 * self.over.abs() > self.pairs
    }

    /// Returns whether a ball ends at the border.
    pub(crate) fn is_round(&self) -> bool {
        2.0 * self.round > self.pairs
    }

    /// Returns whether larger-scale evidence says that two objects meet at the border.
    fn is_parted(&self) -> bool {
        self.is_seam() || self.is_round()
    }

    /// Returns the border seen from the other side.
    fn reversed(self) -> Self {
        Self { over: -self.over, ..self }
    }
}

/// Segments that merge pairwise, with their borders.
#[derive(Clone)]
pub(crate) struct Segments {
    members: Vec<Option<Vec<usize>>>,
    looks: Vec<FacingColors>,
    spreads: Vec<PointMoments>,
    /// Sums of the normals.
    normals: Vec<DVec3>,
    /// Borders of each segment; each border has an entry under both of its segments.
    borders: Vec<BTreeMap<usize, Border>>,
    /// Patches from this index on are balls.
    first_ball: usize,
    /// Number of merges of each segment.
    stamps: Vec<u32>,
    /// The segment of each patch.
    roots: Vec<usize>,
    /// The patches of each segment.
    patches: Vec<Vec<usize>>,
}

/// Score of a border in the merge queue. The highest score comes first, then the first segments.
#[derive(PartialEq)]
struct Score(f64);

impl Eq for Score {}

impl PartialOrd for Score {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Score {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.0.total_cmp(&other.0)
    }
}

impl Segments {
    /// Makes one segment for each patch of a connected piece: the surfels of a cell of size `cell_m` that face one way.
    /// Surfels closer than `near_m` to each other are neighbours. Borders begin to bend inwards at `crease_rad / 2`,
    /// and bend fully at three times that. No patch lies on both sides of one of the `seams`, and each of the `balls`
    /// is one patch.
    pub(crate) fn patches(
        surfels: &[Surfel],
        graph: &Neighbors,
        piece: &[usize],
        cell_m: f64,
        near_m: f64,
        crease_rad: f64,
        seams: &[LevelSeam],
        balls: &[Ball],
    ) -> Self {
        let patches = patches(surfels, piece, cell_m, seams, balls);
        let first_ball = patches.len() - balls.len();
        let mut patch_of = BTreeMap::new();
        for (k, patch) in patches.iter().enumerate() {
            patch.members.iter().for_each(|&i| {
                patch_of.insert(i, k);
            });
        }
        let mut borders: Vec<BTreeMap<usize, Border>> = vec![BTreeMap::new(); patches.len()];
        for &i in piece {
            let a = patch_of[&i];
            for j in graph.of(i) {
                let Some(&b) = patch_of.get(&j) else { continue };
                if a < b && surfels[i].p_w.distance_squared(surfels[j].p_w) < near_m * near_m {
                    let border = borders[a].entry(b).or_default();
                    border.pairs += 1.0;
                    border.over += between(seams, &surfels[i], &surfels[j]);
                    border.spread.add(0.5 * (surfels[i].p_w + surfels[j].p_w));
                }
            }
        }
        for a in 0..patches.len() {
            let one_sided: Vec<(usize, Border)> = borders[a].range(a + 1..).map(|(&b, &x)| (b, x)).collect();
            for (b, mut border) in one_sided {
                let is_ball = b >= first_ball;
                border.round = if is_ball { border.pairs } else { 0.0 };
                // Outside of a ball everything bends inwards; a ball has no facing.
                let bend = if is_ball { 1.0 } else { inward_bend(&patches[a], &patches[b], crease_rad) };
                border.crease = border.pairs * bend;
                borders[a].insert(b, border);
                borders[b].insert(a, border.reversed());
            }
        }
        let spread = |members: &[usize]| {
            let mut spread = PointMoments::default();
            members.iter().for_each(|&i| spread.add(surfels[i].p_w));
            spread
        };
        Self {
            spreads: patches.iter().map(|p| spread(&p.members)).collect(),
            looks: patches.iter().map(|p| p.look).collect(),
            normals: patches
                .iter()
                .enumerate()
                .map(|(k, p)| {
                    if k < first_ball {
                        p.n_w * p.members.len() as f64
                    } else {
                        p.members.iter().map(|&i| surfels[i].n_w).sum()
                    }
                })
                .collect(),
            first_ball,
            stamps: vec![0; patches.len()],
            roots: (0..patches.len()).collect(),
            patches: (0..patches.len()).map(|k| vec![k]).collect(),
            members: patches.into_iter().map(|p| Some(p.members)).collect(),
            borders,
        }
    }

    /// Number of surfels of a segment.
    pub(crate) fn size(&self, a: usize) -> usize {
        self.members[a].as_ref().map_or(0, Vec::len)
    }

    /// Surfels of a segment; empty once it was merged into another one.
    pub(crate) fn members(&self, a: usize) -> &[usize] {
        self.members[a].as_deref().unwrap_or_default()
    }

    /// Returns whether one of a segment's patches is a ball.
    fn holds_ball(&self, a: usize) -> bool {
        self.patches[a].iter().any(|&k| k >= self.first_ball)
    }

    /// Returns the remaining segments.
    pub(crate) fn left(&self) -> Vec<usize> {
        (0..self.members.len()).filter(|&a| self.members[a].is_some()).collect()
    }

    /// The neighbours of a segment.
    pub(crate) fn borders(&self, a: usize) -> &BTreeMap<usize, Border> {
        &self.borders[a]
    }

    /// Extents of a segment; see [`PointMoments::extents`].
    pub(crate) fn spread(&self, a: usize) -> &PointMoments {
        &self.spreads[a]
    }

    /// Returns the mean of a segment's normals, of length 1 or less: shorter the more the normals vary.
    pub(crate) fn facing(&self, a: usize) -> DVec3 {
        self.normals[a] / self.size(a).max(1) as f64
    }

    /// Returns the difference between the colours of two segments, in spreads.
    pub(crate) fn contrast(&self, a: usize, b: usize) -> f64 {
        self.looks[a].distance(&self.looks[b], OTHER_LIGHT)
    }

    /// Returns the colour difference between the surfaces of two segments that face the same way, in spreads; `None` if
    /// there are none.
    pub(crate) fn shared_contrast(&self, a: usize, b: usize) -> Option<f64> {
        self.looks[a].shared_distance(&self.looks[b])
    }

    /// Number of neighbour pairs across a border, in units of the smaller segment's length (square root of its surfel
    /// count).
    pub(crate) fn width(&self, a: usize, b: usize, border: &Border) -> f64 {
        border.pairs / (self.size(a).min(self.size(b)) as f64).sqrt()
    }

    /// Merges locally convex segments of one colour, starting with the border that bends inwards least, until every
    /// border bends by at least `crease_share`. `light` is the colour difference between neighbouring patches that
    /// light alone may cause, in 8-bit levels: a smaller value gives colour more weight. Segments connected by a
    /// thread, the sides of a level seam, and balls stay apart.
    pub(crate) fn merge_convex(
        &mut self,
        crease_share: f64,
        light: f64,
        is_thread: impl Fn(&Self, usize, usize, &Border) -> bool,
    ) {
        let score = |s: &Self, a: usize, b: usize, border: &Border| {
            if border.is_parted() || is_thread(s, a, b, border) {
                return 0.0;
            }
            1.0 - border.crease / border.pairs - 0.1 * s.looks[a].distance(&s.looks[b], light).min(2.0)
        };
        self.merge_while(score, 1.0 - crease_share);
    }

    /// Merges patches that both partitions keep together.
    pub(crate) fn merge_agreed(&mut self, one: &Self, other: &Self) {
        let group: Vec<(usize, usize)> = one.roots.iter().copied().zip(other.roots.iter().copied()).collect();
        let together = |a: usize, b: usize, border: &Border| group[a] == group[b] && !border.is_parted();
        self.merge_while(|_, a, b, border| if together(a, b, border) { 1.0 } else { 0.0 }, 0.0);
    }

    /// Merges the pair with the highest border score (the first of equals) until no score is above `least`.
    pub(crate) fn merge_while(&mut self, score: impl Fn(&Self, usize, usize, &Border) -> f64, least: f64) {
        let mut queue = BinaryHeap::new();
        let push = |s: &Self, queue: &mut BinaryHeap<_>, a: usize, b: usize, border: &Border| {
            let value = score(s, a, b, border);
            if value > least {
                queue.push((Score(value), Reverse((a, b)), (s.stamps[a], s.stamps[b])));
            }
        };
        for a in 0..self.borders.len() {
            for (&b, border) in self.borders[a].range(a + 1..) {
                push(self, &mut queue, a, b, border);
            }
        }
        while let Some((_, Reverse((a, b)), stamps)) = queue.pop() {
            if stamps != (self.stamps[a], self.stamps[b]) {
                continue;
            }
            self.merge(a, b);
            for (&c, border) in &self.borders[a] {
                push(self, &mut queue, a.min(c), a.max(c), border);
            }
        }
    }

    /// Merges segments that are too small into the neighbour with the longest border, smallest first. A ball is never
    /// too small.
    pub(crate) fn merge_small(&mut self, is_small: impl Fn(&[usize]) -> bool) {
        // A segment that is large enough stays so as it grows.
        let mut open: std::collections::BTreeSet<(usize, usize)> = (0..self.members.len())
            .filter(|&a| !self.holds_ball(a) && self.members[a].as_ref().is_some_and(|m| is_small(m)))
            .map(|a| (self.size(a), a))
            .collect();
        while let Some((size, a)) = open.pop_first() {
            if size != self.size(a) || self.borders[a].is_empty() {
                continue;
            }
            let longest = self.borders[a]
                .iter()
                .filter(|(_, border)| !border.is_seam())
                // The border between a ball and the remaining surfels near it is not round.
                .max_by(|x, y| {
                    let flat = (!x.1.is_round()).cmp(&!y.1.is_round());
                    flat.then(x.1.pairs.total_cmp(&y.1.pairs)).then(y.0.cmp(x.0))
                });
            let Some((&b, _)) = longest else { continue };
            let (keep, gone) = (a.min(b), a.max(b));
            self.merge(keep, gone);
            if !self.holds_ball(keep) && self.members[keep].as_ref().is_some_and(|m| is_small(m)) {
                open.insert((self.size(keep), keep));
            }
        }
    }

    /// Merges `b` into `a`.
    pub(crate) fn merge(&mut self, a: usize, b: usize) {
        if let Some(moved) = self.members[b].take() {
            self.members[a].get_or_insert_default().extend(moved);
        }
        let (look, spread) = (self.looks[b], self.spreads[b]);
        self.looks[a].merge(&look);
        let normal = self.normals[b];
        self.normals[a] += normal;
        self.spreads[a].merge(&spread);
        for k in std::mem::take(&mut self.patches[b]) {
            self.roots[k] = a;
            self.patches[a].push(k);
        }
        self.stamps[a] += 1;
        self.stamps[b] += 1;
        for (c, border) in std::mem::take(&mut self.borders[b]) {
            self.borders[c].remove(&b);
            if c != a {
                for (x, y, border) in [(a, c, border), (c, a, border.reversed())] {
                    let sum = self.borders[x].entry(y).or_default();
                    sum.pairs += border.pairs;
                    sum.crease += border.crease;
                    sum.over += border.over;
                    sum.round += border.round;
                    sum.spread.merge(&border.spread);
                }
            }
        }
    }

    /// Returns the members of each segment, sorted.
    pub(crate) fn into_members(self) -> Vec<Vec<usize>> {
        let mut all: Vec<Vec<usize>> = self.members.into_iter().flatten().collect();
        all.iter_mut().for_each(|m| m.sort_unstable());
        all
    }
}

/// Returns the patches of a piece, with balls last.
fn patches(
    surfels: &[Surfel],
    piece: &[usize],
    cell_m: f64,
    seams: &[LevelSeam],
    balls: &[Ball],
) -> Vec<SurfelPatch> {
    let round: HashSet<usize> = balls.iter().flat_map(|b| b.members.iter().copied()).collect();
    let mut cells: BTreeMap<(u64, usize, usize), Vec<usize>> = BTreeMap::new();
    for &i in piece.iter().filter(|i| !round.contains(i)) {
        if let Some(key) = key_of(surfels[i].p_w, cell_m) {
            let above = seams.iter().filter(|s| s.is_above(&surfels[i])).count();
            cells.entry((key, facing(surfels[i].n_w), above)).or_default().push(i);
        }
    }
    cells
        .into_values()
        .chain(balls.iter().map(|b| b.members.clone()))
        .map(|members| {
            let mean = |f: &dyn Fn(&Surfel) -> DVec3| members.iter().map(|&i| f(&surfels[i])).sum::<DVec3>();
            let p_w = mean(&|s| s.p_w) / members.len() as f64;
            let n_w = mean(&|s| s.n_w).normalize_or(DVec3::Z);
            let mut look = FacingColors::default();
            members.iter().for_each(|&i| look.0[facing(surfels[i].n_w)].add(surfels[i].color));
            SurfelPatch { members, p_w, n_w, look }
        })
        .collect()
}

/// Returns 0 for borders that are flat or bend outwards, rising to 1 for inward bends of 1.5 times the crease angle.
fn inward_bend(a: &SurfelPatch, b: &SurfelPatch, crease_rad: f64) -> f64 {
    let d = (a.p_w - b.p_w).normalize_or(DVec3::X);
    let angle = a.n_w.angle_between(b.n_w);
    let inward = (a.n_w - b.n_w).dot(d) < 0.0;
    if inward { ((angle - 0.5 * crease_rad) / crease_rad).clamp(0.0, 1.0) } else { 0.0 }
}
