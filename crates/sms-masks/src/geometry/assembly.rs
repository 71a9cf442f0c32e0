//! Free-standing assemblies larger than an object: furniture, containers, and objects stacked on them.

use super::GeometryConfig;
use super::extents::{extents, is_ragged, quantile};
use super::fuse::{Neighbors, Surfel};
use super::posts::{Footprint, Post};
use super::seams::{LevelSeam, OTHER_HUE, between, hue_contrast, sector, share_around};
use super::segments::{Border, Segments};
use glamx::{DVec2, DVec3};
use std::cmp::Reverse;
use std::collections::BTreeMap;

/// Smallest thickness as a share of the largest object length. Thinner pieces are walls or lips, even if free-standing.
const THICK: f64 = 0.25;
/// Largest length of an assembly as a multiple of the largest structure: a board may jut out from a stool.
pub(crate) const OVER: f64 = 1.5;
/// Smallest height of an assembly, or smallest share of it that was classified as static. Lower assemblies are groups
/// of objects on a table that hardly touch; other rules separate them.
const HIGH_M: f64 = 0.35;
const FACES: f64 = 0.05;
/// Largest height of the lowest cells above the ground.
pub(crate) const FOOT_M: f64 = 0.04;
/// Upright surface must face away from the centre by at least this (mean cosine); walls of a bin or a shelf face
/// inwards.
const OUTWARD: f64 = 0.1;
/// Length of the mean horizontal part of upright normals, relative to their mean length: 0 for a piece visible from all
/// around, 1 for a single side.
const ONE_SIDED: f64 = 0.5;
/// Largest share of an assembly that may lie beside large planes outside it, including the ground.
const TOUCHING: f64 = 0.05;

/// Returns connected pieces of cells above the ground that are free-standing as a whole, as sorted cells.
///
/// `heights` are the cells' heights above the ground (not finite if there is no ground), `is_ground` marks cells of the
/// ground, and `is_static` cells of other large planes. Faces of the returned pieces are not static, regardless of
/// their size.
pub(crate) fn free_standing(
    coarse: &[Surfel],
    graph: &Neighbors,
    heights: &[f64],
    is_ground: &[bool],
    is_static: &[bool],
    config: &GeometryConfig,
) -> Vec<Vec<usize>> {
    let mut pieces = graph.components(|i| !is_ground[i]);
    pieces.retain(|members| stands_free(coarse, graph, members, heights, is_static, config));
    pieces
}

fn stands_free(
    coarse: &[Surfel],
    graph: &Neighbors,
    members: &[usize],
    heights: &[f64],
    is_static: &[bool],
    config: &GeometryConfig,
) -> bool {
    let [thin, _, long] = extents(coarse, members);
    if long < config.max_object_m
        || long > OVER * config.max_structure_m
        || thin < THICK * config.max_object_m
    {
        return false;
    }
    let lowest = members.iter().map(|&i| heights[i]).fold(f64::INFINITY, f64::min);
    let center = members.iter().map(|&i| coarse[i].p_w).sum::<DVec3>() / members.len() as f64;
    let (mut outward, mut sum, mut total) = (0.0, DVec3::ZERO, 0.0);
    for &i in members {
        let n = coarse[i].n_w.with_z(0.0);
        outward += n.dot((coarse[i].p_w - center).with_z(0.0).normalize_or_zero());
        sum += n;
        total += n.length();
    }
    let inside = |j: usize| members.binary_search(&j).is_ok();
    let beside = |&&i: &&usize| graph.of(i).any(|j| is_static[j] && !inside(j));
    let touching = members.iter().filter(beside).count() as f64;
    let (low, high) = members
        .iter()
        .map(|&i| coarse[i].p_w.z)
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), z| (l.min(z), h.max(z)));
    let faces = members.iter().filter(|&&i| is_static[i]).count() as f64;
    (high - low > HIGH_M || faces > FACES * members.len() as f64)
        && lowest < FOOT_M
        && outward > OUTWARD * total
        && sum.length() < ONE_SIDED * total
        && touching <= TOUCHING * members.len() as f64
}

/// Accuracy of the height of a contact.
const LEVEL_M: f64 = 0.02;
/// Colour contrasts between surfaces that face the same way, in spreads: above the first, two segments are never one
/// body; above the second, a flush seam separates two bodies.
const OTHER_COLOR: f64 = 2.0;
const FLUSH_COLOR: f64 = 2.4;
/// If the share of a border that bends inwards is below this, the border is smooth or an edge of one object.
const BENT: f64 = 0.25;
/// Largest height of a level seam, relative to its length.
const LEVEL: f64 = 0.2;
/// Sectors along or around a contact, and the share of them that its visible seam must reach. Four legs reach few.
const SECTORS: usize = 24;
const RUNNING: f64 = 0.5;
/// Share without a gap that is enough between two colours: one side of a board, if shade hides the others.
const SIDE: f64 = 0.25;
/// A seam narrower than this share of its length runs along a line.
const LINE: f64 = 0.2;
/// A segment with less than this share of the extent of the segment above is a foot of that segment.
const FOOT: f64 = 0.15;
/// A surface bounds a level face if it rises at least this far above the face; noise and rounded edges rise less.
const SUNK_M: f64 = 0.006;
/// It must do so within this distance of the face, metres, over this share of the way around the face; a ridge on one
/// side is not enough.
const RIM_M: f64 = 0.03;
const BOUNDED: f64 = 0.75;
/// A floating segment belongs to the nearest other segment up to this distance.
const HANGS_M: f64 = 0.1;

/// Relation between two touching segments.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Seam {
    /// The first stands on the second.
    On,
    /// The second stands on the first.
    Under,
    /// Both are one body. A larger value is more certain.
    One(f64),
    /// Two bodies side by side, if each stands by itself.
    Beside,
}

/// Merges the segments of an assembly into its bodies. `members` are all its surfels, `smallest` is the number of
/// surfels of the smallest object, `cell_m2` the area of a surfel.
///
/// Free-standing assemblies are stacks. Bodies meet where one stands on another: in a level seam around the contact,
/// with one body above and the other below. No body floats: a segment that neither reaches the ground nor stands on
/// another one belongs to the segment it touches, regardless of colour. A strip that is too ragged for an object
/// belongs to the segment below.
pub(crate) fn merge_bodies(
    s: &mut Segments,
    surfels: &[Surfel],
    graph: &Neighbors,
    members: &[usize],
    level_seams: &[LevelSeam],
    smallest: usize,
    cell_m2: f64,
) {
    let mut bodies = Bodies { owner: vec![usize::MAX; surfels.len()], surfels, graph, level_seams, cell_m2 };
    for a in s.left() {
        s.members(a).iter().for_each(|&i| bodies.owner[i] = a);
    }
    bodies.attach_crumbs(s, smallest);
    let ground = quantile(members.iter().map(|&i| surfels[i].p_w.z), 0.002);
    loop {
        let seams = bodies.seams(s, smallest);
        let surest = seams.iter().filter_map(|(&pair, seam)| match seam {
            Seam::One(sure) => Some((*sure, pair)),
            _ => None,
        });
        // The first of equal candidates.
        let surest = surest.fold(
            None,
            |best: Option<(f64, (usize, usize))>, x| {
                if best.is_none_or(|b| x.0 > b.0) { Some(x) } else { best }
            },
        );
        let pair = surest.map(|x| x.1).or_else(|| bodies.floating(s, &seams, ground, smallest));
        let leg = || bodies.hidden_leg(s, &seams, smallest);
        let ragged = || bodies.ragged(s, &seams, smallest);
        let Some((a, b)) = pair.or_else(leg).or_else(ragged) else { break };
        bodies.merge(s, a, b);
    }
}

/// The bodies of an assembly during merging.
struct Bodies<'a> {
    /// Segment of each surfel.
    owner: Vec<usize>,
    surfels: &'a [Surfel],
    graph: &'a Neighbors,
    level_seams: &'a [LevelSeam],
    /// Area of a surfel, m².
    cell_m2: f64,
}

impl Bodies<'_> {
    fn merge(&mut self, s: &mut Segments, a: usize, b: usize) {
        s.members(b).iter().for_each(|&i| self.owner[i] = a);
        s.merge(a, b);
    }

    /// Returns the height below which `share` of a segment lies.
    fn height(&self, s: &Segments, a: usize, share: f64) -> f64 {
        quantile(s.members(a).iter().map(|&i| self.surfels[i].p_w.z), share)
    }

    /// Merges crumbs (surfels of faces seen at grazing angles) into the segment with the most surfels near them.
    fn attach_crumbs(&mut self, s: &mut Segments, smallest: usize) {
        for _ in 0..4 {
            let mut joins = Vec::new();
            for a in s.left().into_iter().filter(|&a| s.size(a) < smallest) {
                let mut near: BTreeMap<usize, usize> = BTreeMap::new();
                let aside =
                    |i: usize, j: usize| between(self.level_seams, &self.surfels[i], &self.surfels[j]) == 0.0;
                let beside = |&i: &usize| self.graph.of(i).filter(move |&j| aside(i, j));
                for b in s.members(a).iter().flat_map(beside).map(|j| self.owner[j]) {
                    if b != usize::MAX && s.size(b) > s.size(a) {
                        *near.entry(b).or_default() += 1;
                    }
                }
                joins.extend(near.iter().max_by_key(|(b, n)| (**n, Reverse(**b))).map(|(&b, _)| (b, a)));
            }
            if joins.is_empty() {
                break;
            }
            for (b, a) in joins {
                // The neighbour may itself have been merged in this round.
                if s.size(b) > 0 {
                    self.merge(s, b, a);
                }
            }
        }
    }

    /// Classifies the seam between each pair of neighbours, with the smaller index first.
    fn seams(&self, s: &Segments, smallest: usize) -> BTreeMap<(usize, usize), Seam> {
        let mut seams = BTreeMap::new();
        for a in s.left().into_iter().filter(|&a| s.size(a) >= smallest) {
            for (&b, border) in s.borders(a).range(a + 1..).filter(|(b, _)| s.size(**b) >= smallest) {
                seams.insert((a, b), self.seam(s, a, b, border));
            }
        }
        seams
    }

    fn seam(&self, s: &Segments, a: usize, b: usize, border: &Border) -> Seam {
        if border.is_seam() {
            return if border.over > 0.0 { Seam::On } else { Seam::Under };
        }
        let z = border.spread.center().z;
        let above = |c: usize| self.height(s, c, 0.05) > z - LEVEL_M;
        let below = |c: usize| self.height(s, c, 0.95) < z + LEVEL_M;
        let contrast = s.shared_contrast(a, b);
        let bent = border.crease / border.pairs;
        let one = Seam::One(1.0 / (1.0 + contrast.unwrap_or(1.0)));
        // A face that looks down is the underside of the segment above it.
        let rests = |sheet: usize, other: usize| {
            self.is_underside(s, sheet) && below(other) && !self.is_underside(s, other)
        };
        if bent > BENT && rests(a, b) {
            return Seam::On;
        } else if bent > BENT && rests(b, a) {
            return Seam::Under;
        }
        let other_color = bent > BENT && contrast.is_some_and(|c| c > OTHER_COLOR);
        let beside = || if other_color { Seam::Beside } else { one };
        let lower = match (below(a) && above(b), below(b) && above(a)) {
            (true, _) => a,
            (_, true) => b,
            _ => return beside(),
        };
        let upper = a + b - lower;
        let [_, _, long] = border.spread.extents();
        let [_, width, height] = s.spread(lower).extents();
        let is_post = width < 0.12 && height > 2.5 * width && long < 2.0 * width;
        let is_foot = height < FOOT * s.spread(upper).extents()[2];
        let is_level = border.spread.height() < LEVEL * long;
        if is_post || is_foot || self.is_underside(s, lower) {
            return one;
        }
        let is_flush_color = contrast.is_some_and(|c| c > FLUSH_COLOR);
        let runs = || {
            let [all, in_one] = self.running(s, a, b, border);
            all >= RUNNING || is_flush_color && in_one >= SIDE
        };
        if !is_level || !runs() {
            return beside();
        }
        let parts = (bent > BENT || is_flush_color)
            && !self.is_rim(s, upper, lower)
            && !self.is_sunk(s, upper, lower);
        match parts {
            false => one,
            true if upper == a => Seam::On,
            true => Seam::Under,
        }
    }

    /// Returns whether a segment is the rim or the seat of the segment below: it is low, has the same hue, and lies
    /// right below a level seam. The load on it hides everything except its sides, and shades them.
    fn is_rim(&self, s: &Segments, rim: usize, lower: usize) -> bool {
        let [bottom, top] = [0.05, 0.95].map(|share| self.height(s, rim, share));
        let is_under = |seam: &LevelSeam| {
            (top - seam.height_m).abs() < LEVEL_M
                && top - bottom < LEVEL * seam.outline.narrowest()
                && seam.outline.covers(s.spread(rim).center().truncate(), LEVEL_M)
        };
        self.level_seams.iter().any(is_under)
            && hue_contrast(self.surfels, s.members(rim), s.members(lower)) < OTHER_HUE
    }

    /// Returns whether a level face that looks up is the bottom of a hollow, or a lid within its rim. The surface
    /// around such a face rises above it and has its hue. A body that stands on another one is nowhere below the top of
    /// the lower one.
    fn is_sunk(&self, s: &Segments, face: usize, around: usize) -> bool {
        if s.facing(face).z < 0.7
            || s.spread(face).height() > LEVEL_M
            || hue_contrast(self.surfels, s.members(face), s.members(around)) >= OTHER_HUE
        {
            return false;
        }
        let center = s.spread(face).center().truncate();
        let polar = |i: usize| {
            let d = self.surfels[i].p_w.truncate() - center;
            (sector(share_around(d), SECTORS), d.length())
        };
        let mut ends = [0.0f64; SECTORS];
        for (sector, radius) in s.members(face).iter().map(|&i| polar(i)) {
            ends[sector] = ends[sector].max(radius);
        }
        let level = self.height(s, face, 0.5);
        let mut bounded = [false; SECTORS];
        for &i in s.members(around) {
            let rise = self.surfels[i].p_w.z - level;
            let (sector, radius) = polar(i);
            bounded[sector] |= rise > SUNK_M && rise < HANGS_M && radius < ends[sector] + RIM_M;
        }
        bounded.iter().filter(|b| **b).count() as f64 >= BOUNDED * SECTORS as f64
    }

    /// Returns whether a segment is a level face that looks down.
    fn is_underside(&self, s: &Segments, a: usize) -> bool {
        s.facing(a).z < -0.7 && s.spread(a).height() < LEVEL_M
    }

    /// Returns the share of the sectors along or around a contact that contain its border, and the largest share
    /// without a gap.
    fn running(&self, s: &Segments, a: usize, b: usize, border: &Border) -> [f64; 2] {
        let (small, other) = if s.size(a) < s.size(b) { (a, b) } else { (b, a) };
        let touches = |&&i: &&usize| self.graph.of(i).any(|j| self.owner[j] == other);
        let points: Vec<DVec3> =
            s.members(small).iter().filter(touches).map(|&i| self.surfels[i].p_w).collect();
        let [_, middle, long] = border.spread.extents();
        let axis = border.spread.axis();
        let bounds = |f: &dyn Fn(&DVec3) -> f64| {
            points.iter().map(f).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)))
        };
        let (from, to) = bounds(&|p| axis.dot(*p));
        let center = {
            let ((xl, xh), (yl, yh)) = (bounds(&|p| p.x), bounds(&|p| p.y));
            DVec2::new(0.5 * (xl + xh), 0.5 * (yl + yh))
        };
        let mut reached = [false; SECTORS];
        let is_line = middle < LINE * long;
        for p in &points {
            let share = if is_line {
                (axis.dot(*p) - from) / (to - from).max(1e-9)
            } else {
                share_around(p.truncate() - center)
            };
            reached[sector(share, SECTORS)] = true;
        }
        // Around a contact, a run may wrap around.
        let rounds = if is_line { 1 } else { 2 };
        let (mut run, mut longest) = (0, 0);
        for &r in reached.iter().cycle().take(rounds * SECTORS) {
            run = if r { run + 1 } else { 0 };
            longest = longest.max(run.min(SECTORS));
        }
        [reached.iter().filter(|r| **r).count(), longest].map(|n| n as f64 / SECTORS as f64)
    }

    /// Finds a strip that is too ragged for an object: the rim of a bin or the sides of a seat, in the shade of its
    /// load. The strip belongs to the segment it stands on, or else to the touching segment of the most similar colour.
    fn ragged(
        &self,
        s: &Segments,
        seams: &BTreeMap<(usize, usize), Seam>,
        smallest: usize,
    ) -> Option<(usize, usize)> {
        let is_strip = |a: &usize| {
            let [_, middle, long] = extents(self.surfels, s.members(*a));
            s.size(*a) >= smallest && is_ragged(s.size(*a) as f64 * self.cell_m2, middle, long)
        };
        let strips: Vec<usize> = s.left().into_iter().filter(is_strip).collect();
        strips.iter().find_map(|&a| {
            let touched = seams.iter().filter_map(|(&(x, y), &seam)| match (x == a, y == a) {
                (true, _) => Some((y, seam == Seam::On)),
                (_, true) => Some((x, seam == Seam::Under)),
                _ => None,
            });
            let whole: Vec<(usize, bool)> =
                touched.filter(|(b, _)| !strips.contains(b) && !s.borders(a)[b].is_seam()).collect();
            let stands = whole.iter().any(|(_, carries)| *carries);
            let hosts = whole.iter().filter(|(_, carries)| *carries || !stands).map(|(b, _)| *b);
            let alike = hosts.map(|b| (s.contrast(a, b), b));
            alike.min_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1))).map(|(_, b)| (b, a))
        })
    }

    /// Finds the lowest floating segment and the segment to which it belongs.
    fn floating(
        &self,
        s: &Segments,
        seams: &BTreeMap<(usize, usize), Seam>,
        ground: f64,
        smallest: usize,
    ) -> Option<(usize, usize)> {
        let stands = |a: usize| {
            seams
                .iter()
                .any(|(&(x, y), &seam)| (x == a && seam == Seam::On) || (y == a && seam == Seam::Under))
        };
        let carries = |a: usize, b: usize| {
            (seams.get(&(a, b)) == Some(&Seam::Under)) || (seams.get(&(b, a)) == Some(&Seam::On))
        };
        let mut left: Vec<(f64, usize)> = s
            .left()
            .into_iter()
            .filter(|&a| s.size(a) >= smallest)
            .map(|a| (self.height(s, a, 0.01), a))
            .collect();
        left.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
        for &(low, a) in left.iter().filter(|(low, _)| *low > ground + FOOT_M) {
            if stands(a) && !self.is_underside(s, a) {
                continue;
            }
            let above = |b: usize| self.height(s, b, 0.5) > low - 0.5 * LEVEL_M;
            let is_underside = self.is_underside(s, a);
            let step = s.size(a).div_ceil(300);
            let own: Vec<DVec3> = s.members(a).iter().step_by(step).map(|&i| self.surfels[i].p_w).collect();
            let nearest = left
                .iter()
                .map(|x| x.1)
                .filter(|&b| b != a && if is_underside { above(b) } else { !carries(a, b) })
                .map(|b| {
                    let to = |p: &DVec3| {
                        let others = s.members(b).iter().map(|&j| self.surfels[j].p_w.distance_squared(*p));
                        others.fold(f64::INFINITY, f64::min)
                    };
                    // The 10th percentile is robust to noise, unlike the nearest pair of points.
                    let mut distances: Vec<f64> = own.iter().map(to).collect();
                    distances.sort_by(f64::total_cmp);
                    (distances[distances.len() / 10].sqrt(), b)
                })
                .fold((HANGS_M, None), |best, (d, b)| if d < best.0 { (d, Some(b)) } else { best });
            if let Some(b) = nearest.1 {
                return Some((b, a));
            }
        }
        None
    }

    /// Finds a post that touches no segment it could carry, and the lowest segment above its end. The post is a leg of
    /// that segment.
    fn hidden_leg(
        &self,
        s: &Segments,
        seams: &BTreeMap<(usize, usize), Seam>,
        smallest: usize,
    ) -> Option<(usize, usize)> {
        let left = || s.left().into_iter().filter(|&a| s.size(a) >= smallest);
        let post = |a: usize| Post::of(self.surfels, s.members(a));
        let touches = |a: usize| seams.keys().any(|&(x, y)| x == a || y == a);
        let posts: Vec<(usize, Post)> =
            left().filter(|&a| !touches(a)).filter_map(|a| Some((a, post(a)?))).collect();
        if posts.is_empty() {
            return None;
        }
        let carriers: Vec<(usize, Footprint)> = left()
            .filter(|&b| post(b).is_none())
            .map(|b| (b, Footprint::of(self.surfels, s.members(b))))
            .collect();
        posts.into_iter().find_map(|(a, post)| {
            let pieces = carriers.iter().map(|(b, footprint)| (*b, s.members(*b), footprint));
            Some((post.lowest_over(self.surfels, pieces)?.1, a))
        })
    }
}

#[cfg(test)]
mod tests;
