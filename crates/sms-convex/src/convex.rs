//! From a closed surface to convex parts: cut, measure, merge.

use crate::config::ConvexConfig;
use crate::hull::convex_hull;
use crate::merge::merge;
use crate::piece::Piece;
use crate::repair::{Surface, closed_surface};
use crate::search::{Breadth, Scratch, best_cut};
use crate::solid::Solid;
use glamx::DVec3;
use rayon::prelude::*;
use sms_core::Mesh;

/// Surfaces are cut with about so many faces.
const FACES: usize = 2000;

/// … and the best cuts sought with so many.
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
        let bounds = sms_core::Aabb::of_points(points.iter().copied())?;
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

/// Convex parts whose union approximates the closed `mesh`, in its frame: each a closed hull with at most
/// `max_vertices` vertices. A convex object comes back as one part. Falls back to voxel decomposition (V-HACD, crate
/// `parry3d`), then to a single hull; empty only when the mesh is flat.
///
/// ```
/// use sms_core::{Mesh, glamx::DVec3};
/// let parts = sms_convex::convex_parts(&Mesh::cuboid(DVec3::splat(0.05)), &Default::default());
/// assert_eq!(parts.len(), 1);
/// ```
pub fn convex_parts(mesh: &Mesh, config: &ConvexConfig) -> Vec<Mesh> {
    let limit = config.max_vertices.max(8);
    let Some(whole) = convex_hull(&mesh.vertices, usize::MAX, 0.0) else { return Vec::new() };
    let parts = decompose(mesh, config).unwrap_or_default();
    let mut parts: Vec<Mesh> =
        parts.iter().filter_map(|p| convex_hull(p, limit, 1e-5)).filter(|p| p.volume() > 0.0).collect();
    // Slivers left by cuts carry nothing and trouble physics engines.
    parts.retain(|p| p.volume() > 1e-5 * whole.volume());
    if parts.is_empty() {
        parts.extend(convex_hull(&mesh.vertices, limit, 0.0));
    }
    parts
}

fn decompose(mesh: &Mesh, config: &ConvexConfig) -> Option<Vec<Vec<DVec3>>> {
    let bounds = mesh.aabb()?;
    let half = 0.5 * bounds.extents().max_element();
    let center = bounds.center();
    let points: Vec<DVec3> = mesh.vertices.iter().map(|&p| (p - center) / half).collect();
    let surface = closed_surface(&points, &mesh.triangles)?.decimated(FACES, 0.06 * config.threshold);
    let coarse = surface.clone().decimated(COARSE_FACES, 0.4 * config.threshold);
    let solid = Solid::new(&surface)?;
    let threshold = config.threshold.max(config.floor / half);
    let tolerance = Tolerance { threshold, spacing: 0.04 };
    let breadth = Breadth {
        first: 15,
        second: 7,
        candidates: 16,
        diagonals: true,
        part_cost: 0.05 * rv_volume(tolerance.threshold),
    };
    let run = |diagonals: bool| {
        let breadth = Breadth { diagonals, ..breadth };
        let parts = cut(&surface, &coarse, &solid, tolerance, breadth);
        let parts = merge(parts, &solid, tolerance, config.max_parts.max(1));
        let hulls: f64 = parts.iter().map(|p| p.hull_volume).sum();
        (hulls + PART_COST * rv_volume(threshold) * parts.len() as f64, parts)
    };
    // Cuts along the frame's axes suit what is built square, and all directions the rest: the cheaper result is taken.
    let (all, square) = rayon::join(|| run(true), || run(false));
    let parts = if square.0 < all.0 { square.1 } else { all.1 };
    Some(parts.into_iter().map(|p| p.points.iter().map(|&q| center + q * half).collect()).collect())
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
    let hull_volume = piece.hull_volume(&mut scratch.hull);
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
