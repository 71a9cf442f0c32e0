//! Level seams: heights at which what stands free comes apart, because what is above juts out over what is below.
//!
//! Of a board on a stool whose sides are flush, segments do not tell: the board is thinner than a few surfels, the
//! border is no crease where both are in one plane, and woods are alike. What tells is the whole way around the height
//! at which the outline changes: there is a ledge, or an underside, or the colour steps, and it does so all along.

use super::cluster::quantile;
use super::fuse::Surfel;
use super::posts::{Footprint, WIDE_M};
use glamx::{DVec2, DVec3};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Sides just above and just below a height are compared, so far from it; nearer to it noise mixes them.
const BAND_M: f64 = 0.012;
const MIXED_M: f64 = 0.002;
/// Upward part of the normal of a side, at most, and of a level face, at least.
const SIDE: f64 = 0.5;
const LEVEL: f64 = 0.6;
/// A side reaches at least so far down or up: the edge of a slab is none.
const REACHES_M: f64 = 0.006;
/// A level face at a height is at most so far from it.
const FACE_M: f64 = 0.006;
/// Sides above and below are flush where they are at most so far aside from each other.
const FLUSH_M: f64 = 0.008;
/// What is above juts out, somewhere, by this share of the width of what is below: lips, rims and the tops of
/// cupboards do by less.
const JUTS: f64 = 0.2;
/// Parts of the way around, and the share of them where the seam must show.
const SECTORS: usize = 24;
const SHOWN: f64 = 0.5;
/// Sides of two things differ in hue by so many spreads of the difference along the way; light changes the logarithm of
/// the ratio of two channels by this much.
pub(crate) const OTHER_HUE: f64 = 2.0;
const LIGHT: f64 = 0.03;
/// Beside the outline of what is below, what touches it may be so far outside.
const ASIDE_M: f64 = 0.015;

/// A level line along which one body stands on another.
#[derive(Debug, Clone)]
pub(crate) struct LevelSeam {
    pub(crate) height_m: f64,
    /// Of the body below.
    pub(crate) outline: Footprint,
}

impl LevelSeam {
    /// Whether a surfel is above it. At the seam, what faces up is a ledge or its edge and below, what looks down is above;
    /// the more so, the more level it is.
    pub(crate) fn is_above(&self, s: &Surfel) -> bool {
        let up = s.p_w.z - self.height_m;
        if up.abs() < FACE_M * s.n_w.z.abs() { s.n_w.z < 0.0 } else { up > 0.0 }
    }

    /// 1 if the first of two neighbours is above the seam and the second below it, −1 for the reverse, else 0.
    fn between(&self, a: &Surfel, b: &Surfel) -> f64 {
        let (over, under) = (self.is_above(a), self.is_above(b));
        if over == under || !self.outline.covers(0.5 * (a.p_w + b.p_w).truncate(), ASIDE_M) {
            return 0.0;
        }
        if over { 1.0 } else { -1.0 }
    }
}

/// As [`LevelSeam::between`], of the first seam that is between two surfels.
pub(crate) fn between(seams: &[LevelSeam], a: &Surfel, b: &Surfel) -> f64 {
    seams.iter().map(|s| s.between(a, b)).find(|x| *x != 0.0).unwrap_or(0.0)
}

/// What a height shows of a seam.
struct Shown {
    seam: LevelSeam,
    /// Sectors with a ledge or an underside.
    creased: usize,
    /// How far the hue steps where sides are flush, and the sectors in which it does.
    step: f64,
    stepped: usize,
}

/// The level seams of an assembly's surfels.
pub(crate) fn level_seams(surfels: &[Surfel], members: &[usize], cell_m: f64) -> Vec<LevelSeam> {
    let by_height = |holds: &dyn Fn(f64) -> bool| {
        let mut some: Vec<usize> =
            members.iter().copied().filter(|&i| holds(surfels[i].n_w.z.abs())).collect();
        some.sort_by(|&i, &j| surfels[i].p_w.z.total_cmp(&surfels[j].p_w.z).then(i.cmp(&j)));
        some
    };
    let sides = by_height(&|up| up < SIDE);
    let faces = by_height(&|up| up > LEVEL);
    let (Some(&low), Some(&high)) = (sides.first(), sides.last()) else { return Vec::new() };
    let (low, high) = (surfels[low].p_w.z, surfels[high].p_w.z);
    let within = |list: &[usize], from: f64, to: f64| {
        let at = |z: f64| list.partition_point(|&i| surfels[i].p_w.z < z);
        list[at(from)..at(to)].to_vec()
    };
    let step = 0.5 * cell_m;
    let count = ((high - low) / step) as usize;
    let mut shown: Vec<Shown> = (0..=count)
        .into_par_iter()
        .flat_map_iter(|k| {
            let z = low + k as f64 * step;
            let below = within(&sides, z - BAND_M, z - MIXED_M);
            let above = within(&sides, z + MIXED_M, z + BAND_M);
            let level = within(&faces, z - FACE_M, z + FACE_M);
            at_height(surfels, z, &below, &above, &level, 3.0 * cell_m)
        })
        .filter(|s| (s.creased + s.stepped) as f64 >= SHOWN * SECTORS as f64)
        .collect();
    // The best of those that are one: where most of it is a crease, else where the hue steps most.
    shown.sort_by(|a, b| {
        b.creased
            .cmp(&a.creased)
            .then(b.step.total_cmp(&a.step))
            .then(a.seam.height_m.total_cmp(&b.seam.height_m))
    });
    let mut seams: Vec<LevelSeam> = Vec::new();
    for Shown { seam, .. } in shown {
        let is_same = |s: &LevelSeam| {
            (s.height_m - seam.height_m).abs() < 2.0 * BAND_M && s.outline.covers(seam.outline.center(), 0.0)
        };
        if !seams.iter().any(is_same) {
            seams.push(seam);
        }
    }
    seams
}

type Cells = BTreeMap<(i64, i64), Vec<usize>>;

fn cells(surfels: &[Surfel], members: &[usize], cell_m: f64) -> Cells {
    let mut cells = Cells::new();
    for &i in members {
        cells.entry(cell_of(surfels[i].p_w, cell_m)).or_default().push(i);
    }
    cells
}

fn cell_of(p: DVec3, cell_m: f64) -> (i64, i64) {
    ((p.x / cell_m).floor() as i64, (p.y / cell_m).floor() as i64)
}

fn around((x, y): (i64, i64)) -> impl Iterator<Item = (i64, i64)> {
    (-1..=1).flat_map(move |i| (-1..=1).map(move |j| (x + i, y + j)))
}

/// The cells that hang together with some of them.
fn connected(cells: &Cells, from: impl Iterator<Item = (i64, i64)>) -> BTreeSet<(i64, i64)> {
    let mut open: Vec<(i64, i64)> = from.filter(|c| cells.contains_key(c)).collect();
    let mut taken: BTreeSet<(i64, i64)> = open.iter().copied().collect();
    while let Some(cell) = open.pop() {
        for next in around(cell) {
            if cells.contains_key(&next) && taken.insert(next) {
                open.push(next);
            }
        }
    }
    taken
}

/// What shows of a seam at a height, for each connected outline of sides `below` it that sides `above` it jut out over; `level` are
/// the level faces at this height.
fn at_height(
    surfels: &[Surfel],
    height_m: f64,
    below: &[usize],
    above: &[usize],
    level: &[usize],
    cell_m: f64,
) -> Vec<Shown> {
    let [mut below, mut above, level] = [below, above, level].map(|m| cells(surfels, m, cell_m));
    below.retain(|_, m| m.iter().any(|&i| surfels[i].p_w.z < height_m - REACHES_M));
    above.retain(|_, m| m.iter().any(|&i| surfels[i].p_w.z > height_m + REACHES_M));
    let mut left: BTreeSet<(i64, i64)> = below.keys().copied().collect();
    let mut shown = Vec::new();
    while let Some(&first) = left.first() {
        let ring = connected(&below, std::iter::once(first));
        ring.iter().for_each(|c| {
            left.remove(c);
        });
        let members = |cells: &Cells, of: &BTreeSet<(i64, i64)>| -> Vec<usize> {
            of.iter().flat_map(|c| &cells[c]).copied().collect()
        };
        let lower = members(&below, &ring);
        let outline = Footprint::of(surfels, &lower);
        // Posts carry what juts out over them.
        if lower.len() < 2 * SECTORS || outline.narrowest() < WIDE_M {
            continue;
        }
        let upper = connected(&above, ring.iter().flat_map(|c| around(*c)));
        if upper.is_empty() || !Footprint::of(surfels, &members(&above, &upper)).juts_out(&outline, JUTS) {
            continue;
        }
        shown.push(along(surfels, LevelSeam { height_m, outline }, &lower, &above, &level, cell_m));
    }
    shown
}

/// What shows of a seam along the sides of what is below it.
fn along(
    surfels: &[Surfel],
    seam: LevelSeam,
    lower: &[usize],
    above: &Cells,
    level: &Cells,
    cell_m: f64,
) -> Shown {
    #[derive(Default, Clone)]
    struct Sector {
        all: usize,
        flush: usize,
        faced: usize,
        steps: DVec2,
    }
    let center = seam.outline.center();
    let mut sectors = vec![Sector::default(); SECTORS];
    let mut heights: Vec<f64> = Vec::new();
    let near = |cells: &Cells, p: DVec3, reach: f64| -> Vec<usize> {
        let all = around(cell_of(p, cell_m)).filter_map(|c| cells.get(&c)).flatten().copied();
        all.filter(|&j| surfels[j].p_w.truncate().distance(p.truncate()) < reach).collect()
    };
    let mut steps: Vec<(usize, DVec2)> = Vec::new();
    for &i in lower {
        let s = &surfels[i];
        let at = sector(share_around(s.p_w.truncate() - center), SECTORS);
        let sector = &mut sectors[at];
        sector.all += 1;
        let mut flush = near(above, s.p_w, FLUSH_M);
        flush.retain(|&j| surfels[j].n_w.dot(s.n_w) > 0.7);
        if !flush.is_empty() {
            let mean = flush.iter().map(|&j| hue(&surfels[j])).sum::<DVec2>() / flush.len() as f64;
            sector.flush += 1;
            sector.steps += mean - hue(s);
            steps.push((at, mean - hue(s)));
        } else {
            let faces = near(level, s.p_w, cell_m);
            sector.faced += usize::from(!faces.is_empty());
            heights.extend(faces.iter().map(|&j| surfels[j].p_w.z));
        }
    }
    let is_flush = |s: &Sector| 2 * s.flush > s.all;
    let creased = sectors.iter().filter(|s| !is_flush(s) && 2 * s.faced > s.all).count();
    // Along the way, sides of one thing differ by its pattern, this way and that; of two things, always the same way.
    let flush: Vec<DVec2> = steps.iter().filter(|(at, _)| is_flush(&sectors[*at])).map(|s| s.1).collect();
    let count = flush.len().max(1) as f64;
    let mean = flush.iter().sum::<DVec2>() / count;
    let variance = flush.iter().map(|d| (d - mean) * (d - mean)).sum::<DVec2>() / count;
    let steps_along =
        |s: &&Sector| is_flush(s) && (s.steps / s.flush as f64).dot(mean) > 0.5 * mean.length_squared();
    let stepped =
        if spreads(mean, variance) > OTHER_HUE { sectors.iter().filter(steps_along).count() } else { 0 };
    // Where there are faces, they say best how high it is.
    let height_m = if creased > stepped { quantile(heights.into_iter(), 0.5) } else { seam.height_m };
    let seam = LevelSeam { height_m, ..seam };
    Shown { seam, creased, step: mean.length(), stepped }
}

/// How different the hues of two sets of surfels are, in spreads.
pub(crate) fn hue_contrast(surfels: &[Surfel], one: &[usize], other: &[usize]) -> f64 {
    let moments = |members: &[usize]| {
        let count = members.len().max(1) as f64;
        let mean = members.iter().map(|&i| hue(&surfels[i])).sum::<DVec2>() / count;
        let square = members.iter().map(|&i| hue(&surfels[i])).map(|h| h * h).sum::<DVec2>() / count;
        (mean, square - mean * mean)
    };
    let ((m, u), (n, v)) = (moments(one), moments(other));
    spreads(m - n, u + v)
}

/// The length of a difference of hues in spreads, of which light makes a part.
fn spreads(difference: DVec2, variance: DVec2) -> f64 {
    let variance = variance.max(DVec2::ZERO) + DVec2::splat(2.0 * LIGHT * LIGHT);
    (difference * difference / variance).element_sum().sqrt()
}

/// Ratios of the channels, as logarithms: shade changes them little.
fn hue(s: &Surfel) -> DVec2 {
    let [r, g, b] = s.color.map(|c| f64::from(c.max(8.0)).ln());
    DVec2::new(r - g, g - b)
}
/// The share of the way around at which an offset points, from 0 to 1.
pub(crate) fn share_around(offset: DVec2) -> f64 {
    offset.to_angle() / std::f64::consts::TAU + 0.5
}

/// Which of `count` equal parts of the way a share of it is in.
pub(crate) fn sector(share: f64, count: usize) -> usize {
    ((share * count as f64) as usize).min(count - 1)
}
