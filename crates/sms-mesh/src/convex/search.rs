//! Search for the best cut of a piece. The score of a plane is the hull volume after this cut and the best next cuts.
//!
//! CoACD (Wei et al. 2022) searches a tree of axis-aligned cuts at random; here all planes of a direction are scored in
//! one pass ([`crate::convex::sweep`]), so that every first cut can be tried with its best second cuts. A single cut is
//! uninformative for rings, tubes and bowls: the hulls of two half rings are together as large as the hull of the ring.

use crate::convex::piece::Piece;
use crate::convex::solid::{Decomposition, rv_volume};
use crate::convex::sweep::{GrowingHull, outline};
use crate::plane::Plane;
use glamx::{DVec2, DVec3};
use rayon::prelude::*;

/// Hulls for scores leave out points that protrude less than this, in half sizes of the object.
const SLIGHT: f64 = 2e-3;

/// Share of a piece's surplus that a good cut removes.
const PLENTY: f64 = 0.6;

/// Number of offsets along each direction of the first cut, and of the second.
const OFFSETS: [usize; 2] = [15, 3];

/// Number of first cuts that are tried with second cuts.
const CANDIDATES: usize = 4;

/// Hull volume that an additional part must save, in units of the volume with [`rv`](crate::convex::solid::rv) at the
/// threshold.
const PART_COST: f64 = 0.05;

/// Set of candidate planes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum CutPlanes {
    /// The axes of the frame and of the piece, and diagonals.
    All,
    /// Only the axes of the frame.
    Square,
    /// Planes through flat faces, if any. An open box should be cut into its five walls, but other scores show this
    /// only at the last of four cuts.
    Flat,
}

/// Buffers of one task.
#[derive(Default)]
struct HullBuffers {
    hull: GrowingHull,
    heights: Vec<f64>,
    order: Vec<u32>,
    outlines: Vec<Vec<(DVec2, DVec3)>>,
    below: Vec<f64>,
}

/// Computes the volumes of the hulls below and above each of the planes `normal · p = offsets[k]` (ascending).
fn side_volumes(
    piece: &Piece,
    edges: &[(u32, u32)],
    normal: DVec3,
    offsets: &[f64],
    scratch: &mut HullBuffers,
) -> Vec<(f64, f64)> {
    let HullBuffers { hull, heights, order, outlines, below } = scratch;
    heights.clear();
    heights.extend(piece.points.iter().map(|p| p.dot(normal)));
    order.clear();
    order.extend(0..piece.points.len() as u32);
    order.sort_unstable_by(|&a, &b| heights[a as usize].total_cmp(&heights[b as usize]).then(a.cmp(&b)));
    let u = normal.any_orthonormal_vector();
    let v = normal.cross(u);
    if outlines.len() < offsets.len() {
        outlines.resize_with(offsets.len(), Vec::new);
    }
    for o in &mut outlines[..offsets.len()] {
        o.clear();
    }
    for &(i, j) in edges {
        let (mut i, mut j) = (i as usize, j as usize);
        if heights[i] > heights[j] {
            std::mem::swap(&mut i, &mut j);
        }
        let (low, high) = (heights[i], heights[j]);
        let from = offsets.partition_point(|&d| d <= low);
        for k in from..offsets.len() {
            if offsets[k] >= high {
                break;
            }
            let p = piece.points[i].lerp(piece.points[j], (offsets[k] - low) / (high - low));
            outlines[k].push((DVec2::new(p.dot(u), p.dot(v)), p));
        }
    }
    below.clear();
    hull.clear(SLIGHT);
    let mut at = 0;
    for (k, &d) in offsets.iter().enumerate() {
        // The outline first: many of the points below are then inside.
        outline(&mut outlines[k]);
        outlines[k].iter().for_each(|(_, p)| hull.push(*p));
        while at < order.len() && heights[order[at] as usize] <= d {
            hull.push(piece.points[order[at] as usize]);
            at += 1;
        }
        below.push(hull.volume());
    }
    let mut volumes = vec![(0.0, 0.0); offsets.len()];
    hull.clear(SLIGHT);
    let mut at = order.len();
    for (k, &d) in offsets.iter().enumerate().rev() {
        outlines[k].iter().for_each(|(_, p)| hull.push(*p));
        while at > 0 && heights[order[at - 1] as usize] >= d {
            hull.push(piece.points[order[at - 1] as usize]);
            at -= 1;
        }
        volumes[k] = (below[k], hull.volume());
    }
    volumes
}

pub(crate) fn extent(piece: &Piece, normal: DVec3) -> (f64, f64) {
    let heights = piece.points.iter().map(|p| p.dot(normal));
    heights.fold((f64::MAX, f64::MIN), |(low, high), h| (low.min(h), high.max(h)))
}

/// Returns evenly spaced offsets inside the piece's extent along `normal`; none when the piece is too thin to cut.
fn even_offsets(piece: &Piece, normal: DVec3, count: usize) -> Vec<f64> {
    let (low, high) = extent(piece, normal);
    const THINNEST: f64 = 0.02;
    let count = count.min(((high - low) / THINNEST) as usize);
    (1..=count).map(|k| low + (high - low) * k as f64 / (count + 1) as f64).collect()
}

/// Returns the axes of the frame and of the piece, and the diagonals between the latter.
fn directions(piece: &Piece) -> Vec<DVec3> {
    let mut out = DVec3::AXES.to_vec();
    let axes = piece.axes();
    let diagonals = [0, 1, 2].map(|k| (axes[k], axes[(k + 1) % 3]));
    let diagonals = diagonals.into_iter().flat_map(|(a, b)| [(a + b).normalize(), (a - b).normalize()]);
    let level = [DVec3::Y, DVec3::NEG_Y].map(|b| (DVec3::X + b).normalize());
    for d in axes.into_iter().chain(diagonals).chain(level) {
        if out.iter().all(|e| e.dot(d).abs() < 0.985) {
            out.push(d);
        }
    }
    out
}

/// Returns the axes of the frame and the directions of the largest flat faces.
fn flat_directions(piece: &Piece) -> Vec<DVec3> {
    let mut flat: Vec<(DVec3, f64)> = Vec::new();
    for (_, cross) in piece.faces() {
        let Some(n) = cross.try_normalize() else { continue };
        match flat.iter().position(|f| f.0.dot(n).abs() > 0.9995) {
            Some(k) => flat[k].1 += cross.length(),
            None => flat.push((n, cross.length())),
        }
        if flat.len() > 200 {
            // The piece is round everywhere.
            return DVec3::AXES.to_vec();
        }
    }
    let total: f64 = flat.iter().map(|f| f.1).sum();
    flat.retain(|f| f.1 > 0.03 * total);
    flat.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut out: Vec<DVec3> = flat.iter().take(6).map(|f| f.0).collect();
    for axis in DVec3::AXES {
        if out.iter().all(|d| d.dot(axis).abs() < 0.9995) {
            out.push(axis);
        }
    }
    out
}

/// Returns heights along `normal` beside large flat faces: cuts there leave clean blocks. Heights are shifted slightly
/// to the open side of the faces, so that a cut does not run through corners, and no film of one block stays on the
/// other.
pub(crate) fn flat_heights(piece: &Piece, normal: DVec3) -> Vec<f64> {
    const HAIR: f64 = 1e-5;
    let mut flat: Vec<(f64, f64)> = Vec::new();
    let mut total = 0.0;
    for t in &piece.triangles {
        let [a, b, c] = piece.corners(t);
        let cross = (b - a).cross(c - a);
        let (area, up) = (cross.length(), cross.dot(normal));
        total += area;
        if up.abs() > 0.999 * area {
            flat.push(((a + b + c).dot(normal) / 3.0, up));
        }
    }
    flat.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut levels: Vec<(f64, f64)> = flat
        .chunk_by(|a, b| b.0 - a.0 < 5e-4)
        .filter_map(|level| {
            let area: f64 = level.iter().map(|f| f.1.abs()).sum();
            let up: f64 = level.iter().map(|f| f.1).sum();
            let height = if up > 0.0 { level.last()?.0 + HAIR } else { level.first()?.0 - HAIR };
            Some((height, area))
        })
        .collect();
    levels.retain(|l| l.1 > 0.01 * total);
    levels.sort_by(|a, b| b.1.total_cmp(&a.1));
    levels.truncate(6);
    levels.into_iter().map(|l| l.0).collect()
}

/// Returns the least cost of a side's hulls after at most one more cut.
fn after_next_cut(
    side: &Piece,
    whole: f64,
    planes: CutPlanes,
    part_cost: f64,
    scratch: &mut HullBuffers,
) -> f64 {
    if whole < 2.0 * part_cost {
        return whole;
    }
    let edges = side.edges();
    let mut best = whole;
    for normal in if planes == CutPlanes::All { side.axes() } else { DVec3::AXES } {
        let offsets = even_offsets(side, normal, OFFSETS[1]);
        for (below, above) in side_volumes(side, &edges, normal, &offsets, scratch) {
            best = best.min(below + above + part_cost);
        }
    }
    best
}

/// Returns the plane with the least hull volume after this cut and one more cut on each side; `None` when the piece is
/// too thin everywhere.
pub(crate) fn best_cut(piece: &Piece, surplus: f64, planes: CutPlanes, task: Decomposition) -> Option<Plane> {
    let Decomposition { solid, threshold, work } = task;
    let edges = piece.edges();
    let directions = match planes {
        CutPlanes::All => directions(piece),
        CutPlanes::Square => DVec3::AXES.to_vec(),
        CutPlanes::Flat => flat_directions(piece),
    };
    let per_direction: Vec<Vec<(Plane, f64, f64, bool)>> = directions
        .par_iter()
        .map_init(HullBuffers::default, |scratch, &normal| {
            let mut offsets = even_offsets(piece, normal, OFFSETS[0]);
            let (low, high) = extent(piece, normal);
            let middle = 0.5 * (low + high);
            let mut flat = flat_heights(piece, normal);
            flat.retain(|h| *h > low + 2e-3 && *h < high - 2e-3);
            let is_flat = planes == CutPlanes::Flat && !flat.is_empty();
            if is_flat {
                offsets.clear();
            }
            offsets.extend(&flat);
            offsets.sort_by(f64::total_cmp);
            offsets.dedup();
            if offsets.is_empty() {
                return Vec::new();
            }
            let volumes = side_volumes(piece, &edges, normal, &offsets, scratch);
            work.add((edges.len() + piece.points.len()) as u64 + scratch.hull.take_steps());
            let candidate =
                |k: usize| (Plane { normal, offset: offsets[k] }, volumes[k].0, volumes[k].1, is_flat);
            if is_flat {
                return (0..offsets.len()).map(candidate).collect();
            }
            let sum = |k: usize| volumes[k].0 + volumes[k].1;
            let mut chosen: Vec<usize> = Vec::new();
            // The best two offsets that are not neighbours, and the middle.
            let mut order: Vec<usize> = (0..offsets.len()).collect();
            order.sort_by(|&a, &b| sum(a).total_cmp(&sum(b)).then(a.cmp(&b)));
            for k in order {
                let apart = (high - low) / OFFSETS[0] as f64 * 1.5;
                if chosen.len() < 2 && chosen.iter().all(|&c| (offsets[c] - offsets[k]).abs() > apart) {
                    chosen.push(k);
                }
            }
            let mid = (0..offsets.len()).min_by(|&a, &b| {
                (offsets[a] - middle).abs().total_cmp(&(offsets[b] - middle).abs()).then(a.cmp(&b))
            });
            chosen.extend(mid.filter(|m| !chosen.contains(m)));
            chosen.into_iter().map(candidate).collect()
        })
        .collect();
    let mut candidates: Vec<(Plane, f64, f64, bool)> = per_direction.into_iter().flatten().collect();
    if candidates.iter().any(|c| c.3) {
        candidates.retain(|c| c.3);
    }
    let sum = |c: &(Plane, f64, f64, bool)| c.1 + c.2;
    let best = candidates.iter().min_by(|a, b| sum(a).total_cmp(&sum(b)))?;
    let whole = piece.hull_volume(&mut GrowingHull::default());
    // One cut already removes most of the surplus: the search can stop.
    if whole - sum(best) > PLENTY * surplus {
        return Some(best.0);
    }
    candidates.sort_by(|a, b| sum(a).total_cmp(&sum(b)));
    candidates.truncate(CANDIDATES);
    let part_cost = PART_COST * rv_volume(threshold);
    let scores: Vec<f64> = candidates
        .par_iter()
        .map_init(HullBuffers::default, |scratch, &(plane, below, above, _)| {
            work.add(2 * piece.size());
            let sides = piece.split(plane, false, &|p| solid.contains(p, work));
            if sides.iter().any(|s| s.points.len() < 4) {
                return f64::INFINITY;
            }
            let score = after_next_cut(&sides[0], below, planes, part_cost, scratch)
                + after_next_cut(&sides[1], above, planes, part_cost, scratch);
            work.add(6 * piece.size() + scratch.hull.take_steps());
            score
        })
        .collect();
    let best = (0..candidates.len())
        .filter(|&i| scores[i].is_finite())
        .min_by(|&a, &b| scores[a].total_cmp(&scores[b]).then(a.cmp(&b)))?;
    Some(candidates[best].0)
}
