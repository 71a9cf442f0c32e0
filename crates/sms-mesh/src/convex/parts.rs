//! Convex parts of a closed surface: cut, measure, merge.

use crate::convex::config::ConvexConfig;
use crate::convex::merge::merge;
use crate::convex::piece::Piece;
use crate::convex::remesh::{MOST_PAIRS, pairs};
use crate::convex::repair::{TriangleSurface, clean, closed_surface};
use crate::convex::round::Rounds;
use crate::convex::search::{CutPlanes, best_cut};
use crate::convex::solid::{Decomposition, Solid, rv_volume};
use crate::convex::sweep::GrowingHull;
use crate::convex::work::Work;
use crate::hull::convex_hull;
use crate::limit::limited_hull;
use glamx::DVec3;
use rayon::prelude::*;
use sms_core::{Aabb, Mesh};

/// Number of faces in the search for cuts.
const COARSE_FACES: usize = 600;

/// Volume that a result may have more if it has one part less, in units of [`rv_volume`] at the threshold.
const PART_COST: f64 = 0.25;

/// Upper limit of that volume as a share of all hulls, so that parts follow thin walls.
const PART_SHARE: f64 = 0.0054;

/// Number of steps after which cutting stops: two seconds. Household objects need 0.4 to 110 million; thin bowls and
/// vases need most.
const MOST_WORK: u64 = 150_000_000;

/// Pieces are cut until the volume that their hulls add is below this share of the threshold. Unions may use all of the
/// threshold.
const CUT_SHARE: f64 = 0.8;

/// If the hull of the whole object adds less than this share of the threshold's volume, nothing is cut: dents of a
/// scanned block are not parts.
const WHOLE_SHARE: f64 = 1.25;

/// Pieces thinner than this are films that cuts leave beside flat faces. They have no volume, but their hulls may span
/// hollows.
const FILM: f64 = 1e-4;

/// Sectors are merged if the union adds less than this share of the cost of a part (the cost that determined their
/// number).
const SECTOR_SHARE: f64 = 0.5;

/// Largest number of pieces.
const MOST_PIECES: usize = 256;

/// A convex part in unit coordinates.
#[derive(Clone)]
pub(crate) struct HullPart {
    /// The hull's vertices.
    pub(crate) points: Vec<DVec3>,
    pub(crate) min: DVec3,
    pub(crate) max: DVec3,
    /// Volume of the solid that the part represents.
    pub(crate) volume: f64,
    pub(crate) hull_volume: f64,
}

impl HullPart {
    pub(crate) fn new(points: Vec<DVec3>, volume: f64, hull_volume: f64) -> Option<Self> {
        let bounds = Aabb::of_points(points.iter().copied())?;
        (hull_volume > 0.0).then_some(Self { points, min: bounds.min, max: bounds.max, volume, hull_volume })
    }
}

/// Returns convex parts whose union approximates the solid that `mesh` bounds, in the frame of `mesh`. Each part is a
/// closed hull with positive volume and at most `max_vertices` vertices. A convex object is one part.
///
/// Any mesh is accepted. Open, torn, self-intersecting and inverted meshes are closed first (a single sheet becomes a
/// shell). If a mesh still encloses no volume, voxel decomposition (V-HACD, crate `parry3d`) is tried, then a single
/// hull. The result is empty only when all vertices lie in one plane. It does not depend on the number of threads.
///
/// ```
/// use sms_core::{Mesh, glamx::DVec3};
/// let parts = sms_mesh::convex_parts(&Mesh::cuboid(DVec3::splat(0.05)), &Default::default());
/// assert_eq!(parts.len(), 1);
/// ```
pub fn convex_parts(mesh: &Mesh, config: &ConvexConfig) -> Vec<Mesh> {
    let finite = || mesh.vertices.iter().copied().filter(|p| p.is_finite());
    let Some(bounds) = Aabb::of_points(finite()) else { return Vec::new() };
    // Unit coordinates are relative to the centre, in halves of the longest side.
    let (center, half) = (bounds.center(), 0.5 * bounds.extents().max_element());
    if !(half > 1e-9 && half < 1e9 && center.length() < 1e9) {
        return Vec::new();
    }
    let points: Vec<DVec3> = mesh.vertices.iter().map(|&p| (p - center) / half).collect();
    let solid: Vec<DVec3> = points.iter().copied().filter(|p| p.is_finite()).collect();
    if convex_hull(&solid, 4, 0.0).is_none() {
        return Vec::new();
    }
    let hulls = decompose(&points, &mesh.triangles, config, half, &Work::default())
        .or_else(|| voxel_parts(&points, &mesh.triangles, config))
        .unwrap_or_default();
    let hull = |points: &[DVec3]| {
        let mut hull = limited_hull(points, config.max_vertices)?;
        for v in &mut hull.vertices {
            *v = center + *v * half;
        }
        (hull.volume() > 0.0 && hull.is_closed_oriented()).then_some(hull)
    };
    let parts: Vec<Mesh> = hulls.iter().filter_map(|p| hull(p)).collect();
    if parts.is_empty() { hull(&solid).into_iter().collect() } else { parts }
}

/// Returns the points of each part's hull, all in unit coordinates (`half` metres per unit). `total` counts the work.
fn decompose(
    points: &[DVec3],
    triangles: &[[u32; 3]],
    config: &ConvexConfig,
    half: f64,
    total: &Work,
) -> Option<Vec<Vec<DVec3>>> {
    let surface = closed_surface(points, triangles, config.threshold)?;
    let coarse = surface.clone().decimated(COARSE_FACES, 0.4 * config.threshold);
    // A rough surface reduced to twice as many faces is still detailed enough for the choice of cuts.
    let coarse = [1.0, 2.0, 4.0]
        .iter()
        .fold(coarse, |s, share| s.decimated(2 * COARSE_FACES, share * config.threshold));
    let solid = Solid::new(&surface)?;
    let threshold = config.threshold.max(config.floor / half);
    // A piece that is convex enough is one part, even if cutting would save volume.
    let work = Work::default();
    let mut hull = GrowingHull::default();
    let hull_volume = whole(&surface).hull_volume(&mut hull);
    let task = Decomposition { solid: &solid, threshold, work: &work };
    if hull_volume > 0.0 && task.is_convex(&hull, hull_volume - surface.volume(), WHOLE_SHARE) {
        return Some(vec![hull.vertices()]);
    }
    let max_parts = config.max_parts.max(1);
    let finish = |open: Vec<[Piece; 2]>, planes: CutPlanes, most_added: f64, work: &Work| {
        let task = Decomposition { work, ..task };
        let parts = merge(cut(open, planes, task), task, max_parts, most_added);
        total.add(work.steps());
        // Volume missing from a piece's hull counts too.
        let hulls: f64 =
            parts.iter().map(|p| p.hull_volume + 5.0 * (p.volume - p.hull_volume).max(0.0)).sum();
        (hulls, parts)
    };
    // Some planes suit box-like shapes, others round ones: the cheapest result is used.
    let mut results: Vec<(f64, Vec<HullPart>)> = [CutPlanes::All, CutPlanes::Square, CutPlanes::Flat]
        .into_par_iter()
        .map(|planes| {
            finish(vec![[whole(&surface), whole(&coarse)]], planes, f64::INFINITY, &Work::default())
        })
        .collect();
    let least = results.iter().map(|r| r.0).fold(f64::INFINITY, f64::min);
    let part_cost = (PART_COST * rv_volume(threshold)).min(PART_SHARE * least);
    let work = Work::default();
    if let Some(rounds) = Rounds::plan(&whole(&coarse), &solid, part_cost, max_parts, &work) {
        let [fine, coarse] = [(&surface, true), (&coarse, false)]
            .map(|(s, with_caps)| rounds.cut(&whole(s), with_caps, &solid, &work));
        let open = fine.into_iter().zip(coarse).map(|(fine, coarse)| [fine, coarse]).collect();
        results.push(finish(open, CutPlanes::All, SECTOR_SHARE * part_cost, &work));
    }
    let price = |r: &(f64, Vec<HullPart>)| r.0 + part_cost * r.1.len() as f64;
    let parts = results.into_iter().min_by(|a, b| price(a).total_cmp(&price(b)))?.1;
    (!parts.is_empty()).then(|| parts.into_iter().map(|p| p.points).collect())
}

fn whole(surface: &TriangleSurface) -> Piece {
    Piece { points: surface.points.clone(), triangles: surface.triangles.clone(), ..Piece::default() }
}

/// Returns the leaves of the cut trees of the `open` pieces.
fn cut(mut open: Vec<[Piece; 2]>, planes: CutPlanes, task: Decomposition) -> Vec<HullPart> {
    let mut parts: Vec<HullPart> = Vec::new();
    while !open.is_empty() {
        let spent = task.work.steps() > MOST_WORK;
        let room = if spent { 0 } else { MOST_PIECES.saturating_sub(parts.len() + open.len()) };
        let cut: Vec<(Option<HullPart>, Vec<[Piece; 2]>)> =
            open.par_iter().enumerate().map(|(i, piece)| examine(piece, planes, i < room, task)).collect();
        open.clear();
        for (part, sides) in cut {
            parts.extend(part);
            open.extend(sides);
        }
    }
    parts
}

/// Returns a part if the piece is convex enough, else its two sides.
fn examine(
    [piece, coarse]: &[Piece; 2],
    planes: CutPlanes,
    may_cut: bool,
    task: Decomposition,
) -> (Option<HullPart>, Vec<[Piece; 2]>) {
    let Decomposition { solid, work, .. } = task;
    let mut hull = GrowingHull::default();
    piece.hull_volume(&mut hull);
    if piece.cell.len() > 2 {
        // Corners where three cuts meet inside the solid are ends of inner edges of the caps.
        let inner = piece.caps.iter().flat_map(|c| &c.edges).filter(|e| e.is_inner);
        for p in inner.flat_map(|e| e.ends) {
            if p.abs().max_element() <= 1.0 && hull.leaves_out(p) && solid.contains(p, work) {
                hull.push(p);
            }
        }
    }
    let hull_volume = hull.volume();
    work.add(piece.size() + hull.take_steps());
    let volume = piece.volume().max(0.0);
    if hull_volume <= 0.0 || volume < FILM * piece.widest_side() {
        return (None, Vec::new());
    }
    let surplus = hull_volume - volume;
    if may_cut
        && !task.is_convex(&hull, surplus, CUT_SHARE)
        && let Some(plane) = best_cut(coarse, surplus, planes, task)
    {
        work.add(2 * (piece.size() + coarse.size()));
        let inside = |p| solid.contains(p, work);
        let sides = piece.split(plane, true, &inside).into_iter().zip(coarse.split(plane, false, &inside));
        let sides = sides.map(|(fine, coarse)| [fine, coarse]);
        // A block from deep inside has no surface, only spines.
        return (None, sides.filter(|s| s[0].points.len() > 3).collect());
    }
    (HullPart::new(hull.vertices(), volume, hull_volume), Vec::new())
}

/// Voxels along the longest side for voxel decomposition.
const VOXELS: usize = 64;

fn voxel_parts(points: &[DVec3], triangles: &[[u32; 3]], config: &ConvexConfig) -> Option<Vec<Vec<DVec3>>> {
    use parry3d_f64::transformation::vhacd::{VHACD, VHACDParameters};
    let surface = clean(points, triangles);
    if surface.triangles.len() < 4 || pairs(&surface, VOXELS) > MOST_PAIRS {
        return None;
    }
    let TriangleSurface { points, triangles } = surface;
    let parameters = VHACDParameters {
        resolution: VOXELS as u32,
        max_convex_hulls: config.max_parts.max(1) as u32,
        ..Default::default()
    };
    let parts = VHACD::decompose(&parameters, &points, &triangles, true)
        .compute_exact_convex_hulls(&points, &triangles);
    let parts: Vec<Vec<DVec3>> = parts.into_iter().map(|(v, _)| v).filter(|v| v.len() > 3).collect();
    (!parts.is_empty()).then_some(parts)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;
    use sms_core::Seed;

    /// Returns the number of steps for a mesh in unit coordinates, after checking the parts.
    fn steps_of(mesh: &Mesh) -> u64 {
        let work = Work::default();
        let config = ConvexConfig::default();
        if let Some(parts) = decompose(&mesh.vertices, &mesh.triangles, &config, 1.0, &work) {
            assert!(!parts.is_empty() && parts.len() <= config.max_parts);
        }
        work.steps()
    }

    #[test]
    fn tangles_take_little_work() {
        let mut rng = Seed(4).rng();
        // Two corners are exchanged: faces intersect each other.
        let mut cube = Mesh::cuboid(DVec3::ONE);
        cube.vertices.swap(0, 6);
        let mut shaken = Mesh::icosphere(0.6, 5);
        assert_eq!(shaken.triangles.len(), 20_480);
        for v in &mut shaken.vertices {
            *v += (DVec3::new(rng.random(), rng.random(), rng.random()) - 0.5) * 0.7;
        }
        let mut spikes = Mesh::icosphere(0.5, 5);
        spikes.vertices.iter_mut().for_each(|v| *v *= rng.random_range(0.6..2.0));
        for (name, mesh) in [("cube", cube), ("shaken", shaken), ("spikes", spikes)] {
            let steps = steps_of(&mesh);
            println!("{name}: {steps} steps");
            // Four ways to cut, none of which should have to stop early.
            assert!(steps < 4 * MOST_WORK, "{name}: {steps}");
        }
    }

    #[test]
    fn faces_across_everything_are_not_followed() {
        let mut rng = Seed(5).rng();
        let points: Vec<DVec3> =
            (0..3000).map(|_| DVec3::new(rng.random(), rng.random(), rng.random()) * 2.0 - 1.0).collect();
        let triangles = (0..20_000).map(|_| std::array::from_fn(|_| rng.random_range(0..3000))).collect();
        let mesh = Mesh::new(points, triangles);
        assert_eq!(steps_of(&mesh), 0);
        assert_eq!(convex_parts(&mesh, &ConvexConfig::default()).len(), 1);
    }
}
