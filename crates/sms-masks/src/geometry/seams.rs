//! Level seams: heights at which a free-standing assembly separates, because the upper body juts out over the lower
//! one.
//!
//! Segmentation alone cannot separate a board from a stool with flush sides: the board is only a few surfels thick,
//! coplanar sides have no crease, and woods look alike. The evidence comes from the whole perimeter at the height where
//! the outline changes: a ledge, an underside or a step in colour, all around.

use super::extents::quantile;
use super::fuse::Surfel;
use super::posts::{Footprint, WIDE_M};
use glamx::{DVec2, DVec3};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Sides are compared within this distance above and below a height, except near the height, where noise mixes them.
const BAND_M: f64 = 0.012;
const MIXED_M: f64 = 0.002;
/// Largest upward part of the normal of a side, and smallest of a level face.
const SIDE: f64 = 0.5;
const LEVEL: f64 = 0.6;
/// Smallest vertical extent of a side; the edge of a slab has less.
const REACHES_M: f64 = 0.006;
/// Largest distance of a level face from the height.
const FACE_M: f64 = 0.006;
/// Largest horizontal distance between flush sides above and below.
const FLUSH_M: f64 = 0.008;
/// The upper body must jut out, somewhere, by this share of the width of the lower one. Lips, rims and tops of
/// cupboards jut out by less.
const JUTS: f64 = 0.2;
/// Number of sectors around the contact, and the share of them that must show the seam.
const SECTORS: usize = 24;
const SHOWN: f64 = 0.5;
/// Hues of two objects differ by this many spreads of the difference along the perimeter. Light changes the logarithm
/// of the ratio of two channels by `LIGHT`.
pub(crate) const OTHER_HUE: f64 = 2.0;
const LIGHT: f64 = 0.03;
/// Largest distance of a touching surface outside the outline of the body below.
const ASIDE_M: f64 = 0.015;

/// A level line along which one body stands on another.
#[derive(Debug, Clone)]
pub(crate) struct LevelSeam {
    pub(crate) height_m: f64,
    /// Outline of the body below.
    pub(crate) outline: Footprint,
}

impl LevelSeam {
    /// Returns whether a surfel is above the seam. Near the seam, level surfels that face up (a ledge or its edge)
    /// count as below, and level surfels that face down as above.
    pub(crate) fn is_above(&self, s: &Surfel) -> bool {
        let up = s.p_w.z - self.height_m;
        if up.abs() < FACE_M * s.n_w.z.abs() { s.n_w.z < 0.0 } else { up > 0.0 }
    }

    /// Returns 1 if the first of two neighbours is above the seam and the second below, −1 for the reverse, else 0.
    fn between(&self, a: &Surfel, b: &Surfel) -> f64 {
        let (over, under) = (self.is_above(a), self.is_above(b));
        if over == under || !self.outline.covers(0.5 * (a.p_w + b.p_w).truncate(), ASIDE_M) {
            return 0.0;
        }
        if over { 1.0 } else { -1.0 }
    }
}

/// Like [`LevelSeam::between`], for the first seam between two surfels.
pub(crate) fn between(seams: &[LevelSeam], a: &Surfel, b: &Surfel) -> f64 {
    seams.iter().map(|s| s.between(a, b)).find(|x| *x != 0.0).unwrap_or(0.0)
}

/// Evidence for a seam at a height.
struct Shown {
    seam: LevelSeam,
    /// Number of sectors with a ledge or an underside.
    creased: usize,
    /// Size of the step in hue at flush sides, and the number of sectors with such a step.
    step: f64,
    stepped: usize,
}

/// Returns the level seams of an assembly's surfels.
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
    // The best of coincident seams: the one with the most creased sectors, then with the largest step in hue.
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

/// Returns the cells connected to `from`.
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

/// Collects the evidence at a height, for each connected outline of `below` sides with `above` sides that jut out over
/// it; `level` are the level faces at this height.
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
        // A load that juts out over a post belongs to the post.
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

/// Collects the evidence for a seam along the sides of the lower body.
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
    // The hue of one object varies in all directions along the perimeter; between two objects it steps in one
    // direction.
    let flush: Vec<DVec2> = steps.iter().filter(|(at, _)| is_flush(&sectors[*at])).map(|s| s.1).collect();
    let count = flush.len().max(1) as f64;
    let mean = flush.iter().sum::<DVec2>() / count;
    let variance = flush.iter().map(|d| (d - mean) * (d - mean)).sum::<DVec2>() / count;
    let steps_along =
        |s: &&Sector| is_flush(s) && (s.steps / s.flush as f64).dot(mean) > 0.5 * mean.length_squared();
    let stepped =
        if spreads(mean, variance) > OTHER_HUE { sectors.iter().filter(steps_along).count() } else { 0 };
    // Level faces give the most accurate height.
    let height_m = if creased > stepped { quantile(heights.into_iter(), 0.5) } else { seam.height_m };
    let seam = LevelSeam { height_m, ..seam };
    Shown { seam, creased, step: mean.length(), stepped }
}

/// Returns the difference between the hues of two sets of surfels, in spreads.
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

/// Returns the length of a difference of hues in spreads, which include the effect of light.
fn spreads(difference: DVec2, variance: DVec2) -> f64 {
    let variance = variance.max(DVec2::ZERO) + DVec2::splat(2.0 * LIGHT * LIGHT);
    (difference * difference / variance).element_sum().sqrt()
}

/// Logarithms of channel ratios: shade hardly changes them.
fn hue(s: &Surfel) -> DVec2 {
    let [r, g, b] = s.color.map(|c| f64::from(c.max(8.0)).ln());
    DVec2::new(r - g, g - b)
}
/// Returns the angle of an offset as a share of the full turn, from 0 to 1.
pub(crate) fn share_around(offset: DVec2) -> f64 {
    offset.to_angle() / std::f64::consts::TAU + 0.5
}

/// Returns which of `count` equal sectors contains a share of the full turn.
pub(crate) fn sector(share: f64, count: usize) -> usize {
    ((share * count as f64) as usize).min(count - 1)
}
