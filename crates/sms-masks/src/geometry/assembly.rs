//! What stands free on the ground and is larger than an object: furniture, containers, and what is stacked on them.

use super::GeometryConfig;
use super::cluster::quantile;
use super::fuse::{Neighbors, Surfel};
use super::planes::extents;
use super::segments::{Border, Segments};
use glamx::DVec3;
use std::cmp::Reverse;
use std::collections::BTreeMap;

/// Of the largest object's length: what is thinner is a wall or a lip, though it may stand free.
const THICK: f64 = 0.25;
/// An assembly may be so much longer than one structure: a board that juts out from a stool.
const OVER: f64 = 1.5;
/// The lowest cells are at most so high over the ground.
const FOOT_M: f64 = 0.04;
/// Upright surface faces away from the middle by at least this (mean cosine); the walls of a bin or a shelf face inwards.
const OUTWARD: f64 = 0.1;
/// Length of the mean of the upright normals' level parts, of theirs: 0 for what is seen all around, 1 for one side.
const ONE_SIDED: f64 = 0.5;
/// At most this share of an assembly lies beside static surfaces other than the ground.
const TOUCHING: f64 = 0.05;

/// The connected pieces of the cells that are no ground which stand free as a whole: sorted cells.
///
/// `heights` are the cells' heights over the ground (not finite where there is none), `is_ground` says which belong to
/// it, `is_static` which belong to other large planes. Faces of what is found here are not static, however large.
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
    if std::env::var_os("SMS_DBG").is_some() {
        println!("assembly? {} cells, extents {thin:.2} .. {long:.2}, lowest {lowest:.3}, outward {:.2}, one-sided {:.2}, touching {:.3}",
            members.len(), outward / total, sum.length() / total, touching / members.len() as f64);
    }
    lowest < FOOT_M
        && outward > OUTWARD * total
        && sum.length() < ONE_SIDED * total
        && touching <= TOUCHING * members.len() as f64
}

/// Heights of a contact are known to this.
const LEVEL_M: f64 = 0.02;
/// Colours of surfaces that face the same way differ by so many spreads where two things of one body never do, and by so
/// many where a flush seam is one between two things.
const OTHER_COLOR: f64 = 2.0;
const FLUSH_COLOR: f64 = 2.4;
/// Share of a border that bends inwards below which it is smooth or an edge of one thing.
const BENT: f64 = 0.25;
/// Sectors around the middle of a contact, and the share of them that its visible seam reaches: four legs reach few.
const SECTORS: usize = 24;
const CLOSED: f64 = 0.5;
/// What is that much shorter than what it carries is a foot of it.
const FOOT: f64 = 0.15;
/// What hangs in the air is part of what is nearest to it, this far at most.
const HANGS_M: f64 = 0.1;

/// How two segments meet.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Seam {
    /// The first stands on the second.
    On,
    /// The second stands on the first.
    Under,
    /// Both are one thing; the greater the surer.
    One(f64),
    /// Two things beside each other, if both stand by themselves.
    Beside,
}

/// Merges the segments of an assembly into its bodies. `members` are all its surfels, `smallest` the surfels of the least
/// object.
///
/// What stands free is stacked: bodies meet where one stands on another, in a level seam around the contact with the one above
/// it and the other below. And nothing floats: what neither reaches the ground nor stands on something is part of what it
/// hangs on, whatever its colour.
pub(crate) fn merge_bodies(
    s: &mut Segments,
    surfels: &[Surfel],
    graph: &Neighbors,
    members: &[usize],
    smallest: usize,
) {
    let mut bodies = Bodies { owner: vec![usize::MAX; surfels.len()], surfels, graph };
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
        // The first of equals.
        let surest = surest.fold(None, |best: Option<(f64, (usize, usize))>, x| {
            if best.is_none_or(|b| x.0 > b.0) { Some(x) } else { best }
        });
        let pair = surest.map(|x| x.1).or_else(|| bodies.floating(s, &seams, ground, smallest));
        if std::env::var_os("SMS_DBG").is_some() {
            if surest.is_none() {
                for a in s.left().into_iter().filter(|&a| s.size(a) >= smallest) {
                    let z = |q| bodies.height(s, a, q) - ground;
                    println!("  body {a}: {} surfels, z {:.3} .. {:.3} center {:.2?} facing {:.2?}", s.size(a), z(0.01), z(0.99), s.spread(a).center(), s.facing(a));
                }
                for (pair, seam) in &seams {
                    println!("   seam {pair:?} {seam:?}");
                }
            }
            println!("  merges {pair:?} sure {:?}", surest.map(|x| x.0));
        }
        let Some((a, b)) = pair else { break };
        bodies.merge(s, a, b);
    }
}

/// The bodies of an assembly while they are put together.
struct Bodies<'a> {
    /// The segment of each surfel.
    owner: Vec<usize>,
    surfels: &'a [Surfel],
    graph: &'a Neighbors,
}

impl Bodies<'_> {
    fn merge(&mut self, s: &mut Segments, a: usize, b: usize) {
        s.members(b).iter().for_each(|&i| self.owner[i] = a);
        s.merge(a, b);
    }

    /// Height below which a share of a segment lies.
    fn height(&self, s: &Segments, a: usize, share: f64) -> f64 {
        quantile(s.members(a).iter().map(|&i| self.surfels[i].p_w.z), share)
    }

    /// Gives crumbs, of faces that cameras look along, to the segment that most of the surfels near them are of.
    fn attach_crumbs(&mut self, s: &mut Segments, smallest: usize) {
        for _ in 0..4 {
            let mut joins = Vec::new();
            for a in s.left().into_iter().filter(|&a| s.size(a) < smallest) {
                let mut near: BTreeMap<usize, usize> = BTreeMap::new();
                let around = s.members(a).iter().flat_map(|&i| self.graph.of(i)).map(|j| self.owner[j]);
                around.filter(|&b| b != usize::MAX && s.size(b) > s.size(a)).for_each(|b| *near.entry(b).or_default() += 1);
                joins.extend(near.iter().max_by_key(|(b, n)| (**n, Reverse(**b))).map(|(&b, _)| (b, a)));
            }
            if joins.is_empty() {
                break;
            }
            for (b, a) in joins {
                // Its neighbour may itself have gone in this round.
                let into = s.members(a).first().map(|_| b).filter(|&b| s.size(b) > 0);
                if let Some(b) = into {
                    self.merge(s, b, a);
                }
            }
        }
    }

    /// How each pair of neighbours meets, the lesser number first.
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
        let z = border.spread.center().z;
        let above = |c: usize| self.height(s, c, 0.05) > z - LEVEL_M;
        let below = |c: usize| self.height(s, c, 0.95) < z + LEVEL_M;
        let contrast = s.shared_contrast(a, b);
        let bent = border.crease / border.pairs;
        let one = Seam::One(1.0 / (1.0 + contrast.unwrap_or(1.0)));
        let lower = match (below(a) && above(b), below(b) && above(a)) {
            (true, _) => a,
            (_, true) => b,
            _ if bent > BENT && contrast.is_some_and(|c| c > OTHER_COLOR) => return Seam::Beside,
            _ => return one,
        };
        let upper = a + b - lower;
        let [thin, middle, long] = border.spread.extents();
        let is_level = thin < 0.25 * middle && border.spread.normal().z.abs() > 0.9;
        let [_, width, height] = s.spread(lower).extents();
        let is_post = width < 0.12 && height > 2.5 * width && long < 2.0 * width;
        let is_foot = height < FOOT * s.spread(upper).extents()[2];
        // The side on which a face is seen has no body: what looks down is the underside of what is above it.
        let is_underside = s.facing(lower).z < -0.7;
        if !is_level || is_post || is_foot || is_underside || self.closed(s, a, b) < CLOSED {
            return one;
        }
        let parts = bent > BENT || contrast.is_some_and(|c| c > FLUSH_COLOR);
        match parts {
            false => one,
            true if upper == a => Seam::On,
            true => Seam::Under,
        }
    }

    /// The share of the directions around the middle of a border in which it runs.
    fn closed(&self, s: &Segments, a: usize, b: usize) -> f64 {
        let (small, other) = if s.size(a) < s.size(b) { (a, b) } else { (b, a) };
        let touches = |&&i: &&usize| self.graph.of(i).any(|j| self.owner[j] == other);
        let points: Vec<DVec3> = s.members(small).iter().filter(touches).map(|&i| self.surfels[i].p_w).collect();
        let (low, high) = points.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), &p| (l.min(p), h.max(p)));
        let middle = 0.5 * (low + high);
        let mut reached = [false; SECTORS];
        for p in &points {
            let d = (*p - middle).truncate();
            let turn = d.to_angle() / std::f64::consts::TAU + 0.5;
            reached[((turn * SECTORS as f64) as usize).min(SECTORS - 1)] = true;
        }
        reached.iter().filter(|r| **r).count() as f64 / SECTORS as f64
    }

    /// The lowest segment that hangs in the air, and what it is part of.
    fn floating(
        &self,
        s: &Segments,
        seams: &BTreeMap<(usize, usize), Seam>,
        ground: f64,
        smallest: usize,
    ) -> Option<(usize, usize)> {
        let stands = |a: usize| {
            seams.iter().any(|(&(x, y), &seam)| (x == a && seam == Seam::On) || (y == a && seam == Seam::Under))
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
            if stands(a) {
                continue;
            }
            let _ = low;
            let step = s.size(a).div_ceil(300);
            let own: Vec<DVec3> = s.members(a).iter().step_by(step).map(|&i| self.surfels[i].p_w).collect();
            let nearest = left
                .iter()
                .map(|x| x.1)
                .filter(|&b| b != a && !carries(a, b))
                .map(|b| {
                    let to = |p: &DVec3| {
                        let others = s.members(b).iter().map(|&j| self.surfels[j].p_w.distance_squared(*p));
                        others.fold(f64::INFINITY, f64::min)
                    };
                    // Not the nearest pair of points, which noise decides: as much of a tenth of it is.
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
}
