//! From a closed surface to convex parts: cut, measure, merge.

use crate::config::ConvexConfig;
use crate::hull::convex_hull;
use crate::limit::limited_hull;
use crate::merge::merge;
use crate::piece::Piece;
use crate::repair::{Surface, clean, closed_surface};
use crate::search::{Breadth, Planes, Scratch, best_cut};
use crate::solid::Solid;
use glamx::DVec3;
use rayon::prelude::*;
use sms_core::{Aabb, Mesh};

/// Surfaces are cut with about so many faces.
const FACES: usize = 2000;

/// … in smooth places and more in rough ones, up to so many before they are smoothed more strongly;
const MOST_FACES: usize = 6000;

/// the best cuts are sought with so many.
const COARSE_FACES: usize = 600;

/// Volume, in those whose [`rv`] is the threshold, that a result may have more for one part less.
const PART_COST: f64 = 0.25;

/// Pieces are not cut any further once there are so many.
const MOST_PIECES: usize = 256;

/// A convex part in unit coordinates.
#[derive(Clone)]
pub(crate) struct Part {
    /// The hull's vertices.
    pub(crate) points: Vec<DVec3>,
    pub(crate) min: DVec3,
    pub(crate) max: DVec3,
    /// Volume of the solid that the part stands for.
    pub(crate) volume: f64,
    pub(crate) hull_volume: f64,
}

impl Part {
    pub(crate) fn new(points: Vec<DVec3>, volume: f64, hull_volume: f64) -> Option<Self> {
        let bounds = Aabb::of_points(points.iter().copied())?;
        (hull_volume > 0.0).then_some(Self { points, min: bounds.min, max: bounds.max, volume, hull_volume })
    }
}

/// When a part is convex enough.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tolerance {
    /// Concavity in half sizes of the object.
    pub(crate) threshold: f64,
    /// Distance of the samples on a hull's surface.
    pub(crate) spacing: f64,
}

/// CoACD's measure of a surplus of volume: 0.3 times the radius of a ball of that volume (its `R_v`, k = 0.3).
pub(crate) fn rv(surplus: f64) -> f64 {
    0.3 * (surplus.max(0.0) * 3.0 / (4.0 * std::f64::consts::PI)).cbrt()
}

/// The volume whose [`rv`] is `threshold`.
fn rv_volume(threshold: f64) -> f64 {
    4.0 / 3.0 * std::f64::consts::PI * (threshold / 0.3).powi(3)
}

/// Convex parts whose union approximates the solid that `mesh` bounds, in its frame: each a closed hull with positive
/// volume and at most `max_vertices` vertices. A convex object comes back as one part.
///
/// Any mesh will do. Open, torn, tangled and inside-out ones are made closed first (a single sheet becomes a shell);
/// what still encloses nothing goes to voxel decomposition (V-HACD, crate `parry3d`), then to a single hull. Empty only
/// when all vertices lie in one plane. The same mesh and settings give the same bytes, however many threads there are.
///
/// ```
/// use sms_core::{Mesh, glamx::DVec3};
/// let parts = sms_convex::convex_parts(&Mesh::cuboid(DVec3::splat(0.05)), &Default::default());
/// assert_eq!(parts.len(), 1);
/// ```
pub fn convex_parts(mesh: &Mesh, config: &ConvexConfig) -> Vec<Mesh> {
    let finite = || mesh.vertices.iter().copied().filter(|p| p.is_finite());
    let Some(bounds) = Aabb::of_points(finite()) else { return Vec::new() };
    let frame = Frame { center: bounds.center(), half: 0.5 * bounds.extents().max_element() };
    if !(frame.half > 1e-9 && frame.half < 1e9 && frame.center.length() < 1e9) {
        return Vec::new();
    }
    let points: Vec<DVec3> = mesh.vertices.iter().map(|&p| (p - frame.center) / frame.half).collect();
    let solid: Vec<DVec3> = points.iter().copied().filter(|p| p.is_finite()).collect();
    if convex_hull(&solid, 4, 0.0).is_none() {
        return Vec::new();
    }
    let hulls = decompose(&points, &mesh.triangles, config, frame.half)
        .or_else(|| voxel_parts(&points, &mesh.triangles, config))
        .unwrap_or_default();
    let hull = |points: &[DVec3]| {
        let mut hull = limited_hull(points, config.max_vertices)?;
        for v in &mut hull.vertices {
            *v = frame.center + *v * frame.half;
        }
        (hull.volume() > 0.0 && hull.is_closed_oriented()).then_some(hull)
    };
    let parts: Vec<Mesh> = hulls.iter().filter_map(|p| hull(p)).collect();
    if !parts.is_empty() {
        return parts;
    }
    hull(&solid).into_iter().collect()
}

/// Where the unit coordinates lie in the mesh's.
#[derive(Clone, Copy)]
struct Frame {
    center: DVec3,
    half: f64,
}

/// Points of each part's hull; all in unit coordinates, of which `half` metres are one.
fn decompose(
    points: &[DVec3],
    triangles: &[[u32; 3]],
    config: &ConvexConfig,
    half: f64,
) -> Option<Vec<Vec<DVec3>>> {
    let surface = closed_surface(points, triangles)?
        .decimated(FACES, 0.06 * config.threshold)
        .decimated(MOST_FACES, 0.2 * config.threshold);
    let coarse = surface.clone().decimated(COARSE_FACES, 0.4 * config.threshold);
    let solid = Solid::new(&surface)?;
    let threshold = config.threshold.max(config.floor / half);
    let tolerance = Tolerance { threshold, spacing: 0.04 };
    let breadth = Breadth {
        first: 15,
        second: 7,
        candidates: 16,
        planes: Planes::All,
        part_cost: 0.05 * rv_volume(tolerance.threshold),
    };
    let run = |planes: Planes| {
        let breadth = Breadth { planes, ..breadth };
        let parts = cut(&surface, &coarse, &solid, tolerance, breadth);
        let parts = merge(parts, &solid, tolerance, config.max_parts.max(1));
        // What a hull lacks of its own piece counts too.
        let hulls: f64 =
            parts.iter().map(|p| p.hull_volume + 5.0 * (p.volume - p.hull_volume).max(0.0)).sum();
        (hulls + PART_COST * rv_volume(threshold) * parts.len() as f64, parts)
    };
    // Some planes suit what is built square, others what is round: the cheapest result is taken.
    let ways: Vec<(f64, Vec<Part>)> =
        [Planes::All, Planes::Square, Planes::Flat].into_par_iter().map(run).collect();
    let parts = ways.into_iter().min_by(|a, b| a.0.total_cmp(&b.0))?.1;
    (!parts.is_empty()).then(|| parts.into_iter().map(|p| p.points).collect())
}

/// The leaves of the tree of cuts.
fn cut(
    surface: &Surface,
    coarse: &Surface,
    solid: &Solid,
    tolerance: Tolerance,
    breadth: Breadth,
) -> Vec<Part> {
    let whole =
        |s: &Surface| Piece { points: s.points.clone(), triangles: s.triangles.clone(), ..Piece::default() };
    let mut open = vec![[whole(surface), whole(coarse)]];
    let mut parts: Vec<Part> = Vec::new();
    while !open.is_empty() {
        let room = MOST_PIECES.saturating_sub(parts.len() + open.len());
        let cut: Vec<(Option<Part>, Vec<[Piece; 2]>)> = open
            .par_iter()
            .enumerate()
            .map(|(i, piece)| examine(piece, solid, tolerance, breadth, i < room))
            .collect();
        open.clear();
        for (part, sides) in cut {
            parts.extend(part);
            open.extend(sides);
        }
    }
    parts
}

/// A part where the piece is convex enough, else its two sides.
fn examine(
    [piece, coarse]: &[Piece; 2],
    solid: &Solid,
    tolerance: Tolerance,
    breadth: Breadth,
    may_cut: bool,
) -> (Option<Part>, Vec<[Piece; 2]>) {
    let mut scratch = Scratch::default();
    piece.hull_volume(&mut scratch.hull);
    if piece.cell.len() > 2 {
        // Corners where three cuts meet inside the solid lie on the caps; fans also cross space that is not solid.
        for &p in piece.caps.iter().flatten() {
            if p.abs().max_element() <= 1.0 && scratch.hull.leaves_out(p) && solid.contains(p) {
                scratch.hull.push(p);
            }
        }
    }
    let hull_volume = scratch.hull.volume();
    let volume = piece.volume().max(0.0);
    if hull_volume <= 0.0 {
        return (None, Vec::new());
    }
    let enough = tolerance.threshold;
    let convex = || {
        rv(hull_volume - volume) <= enough
            && solid.reach(scratch.hull.triangles(), tolerance.spacing, enough) <= enough
    };
    if may_cut
        && !convex()
        && let Some(plane) = best_cut(coarse, hull_volume - volume, solid, breadth)
    {
        let inside = |p| solid.contains(p);
        let sides = piece.split(plane, true, &inside).into_iter().zip(coarse.split(plane, false, &inside));
        let sides = sides.map(|(fine, coarse)| [fine, coarse]);
        // A block from deep inside has no surface, but spines.
        return (None, sides.filter(|s| s[0].points.len() > 3).collect());
    }
    (Part::new(scratch.hull.vertices(), volume, hull_volume), Vec::new())
}

fn voxel_parts(points: &[DVec3], triangles: &[[u32; 3]], config: &ConvexConfig) -> Option<Vec<Vec<DVec3>>> {
    use parry3d_f64::transformation::vhacd::{VHACD, VHACDParameters};
    let Surface { points, triangles } = clean(points, triangles);
    if triangles.len() < 4 {
        return None;
    }
    let parameters =
        VHACDParameters { max_convex_hulls: config.max_parts.max(1) as u32, ..Default::default() };
    let parts = VHACD::decompose(&parameters, &points, &triangles, true)
        .compute_exact_convex_hulls(&points, &triangles);
    let parts: Vec<Vec<DVec3>> = parts.into_iter().map(|(v, _)| v).filter(|v| v.len() > 3).collect();
    (!parts.is_empty()).then_some(parts)
}
