//! Approximate convex decomposition, so that physics can collide concave objects without filling their hollows.
//!
//! The surface is cut by planes, always at the part whose hull leaves the object farthest (a collision-aware concavity
//! as in CoACD, Wei et al. 2022), and hulls are merged again where that stays within the threshold. Cutting needs no
//! caps: the hull of a cut surface is the hull of the cut solid, because the cut's outline lies on both.

use crate::config::ConvexConfig;
use crate::hull::convex_hull;
use crate::voxels::VoxelSolid;
use glamx::DVec3;
use rayon::prelude::*;
use sms_core::Mesh;

struct Piece {
    triangles: Vec<[DVec3; 3]>,
    hull: Mesh,
    concavity: f64,
    deepest: DVec3,
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
    let parts = decompose(mesh, config).or_else(|| voxel_parts(mesh, config)).unwrap_or_default();
    let mut parts: Vec<Mesh> = parts
        .iter()
        .filter_map(|p| convex_hull(&p.vertices, limit, 1e-5))
        .filter(|p| p.volume() > 0.0)
        .collect();
    // Slivers left by cuts carry nothing and trouble physics engines.
    parts.retain(|p| p.volume() > 1e-5 * whole.volume());
    if parts.is_empty() {
        parts.extend(convex_hull(&mesh.vertices, limit, 0.0));
    }
    parts
}

fn decompose(mesh: &Mesh, config: &ConvexConfig) -> Option<Vec<Mesh>> {
    let size = mesh.aabb()?.extents().max_element();
    let solid = VoxelSolid::new(mesh, 80)?;
    let threshold = (config.concavity * size).max(config.concavity_floor).max(1.2 * solid.cell());
    let all = (0..mesh.triangles.len()).map(|t| mesh.corners(t)).collect();
    let mut pieces = vec![piece(all, &solid)?];
    let most = 2 * config.max_parts.max(1);
    while pieces.len() < most {
        let worst = (0..pieces.len())
            .max_by(|&a, &b| pieces[a].concavity.total_cmp(&pieces[b].concavity).then(b.cmp(&a)))?;
        if pieces[worst].concavity <= threshold {
            break;
        }
        let Some(cut) = best_cut(&pieces[worst], &solid) else {
            // It cannot be cut any further; keep it and go on with the others.
            pieces[worst].concavity = 0.0;
            continue;
        };
        pieces.swap_remove(worst);
        pieces.extend(cut);
    }
    Some(merge(pieces.into_iter().map(|p| p.hull).collect(), &solid, threshold, config.max_parts))
}

fn piece(triangles: Vec<[DVec3; 3]>, solid: &VoxelSolid) -> Option<Piece> {
    let hull = convex_hull(&corner_points(&triangles), 96, 1e-5)?;
    let (concavity, deepest) = solid.concavity(&hull);
    Some(Piece { triangles, hull, concavity, deepest })
}

fn corner_points(triangles: &[[DVec3; 3]]) -> Vec<DVec3> {
    let mut points: Vec<DVec3> = triangles.iter().flatten().copied().collect();
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)).then(a.z.total_cmp(&b.z)));
    points.dedup();
    points
}

/// Directions that planes are tried along: up, and eight level ones.
fn cut_normals() -> Vec<DVec3> {
    let level = (0..8).map(|k| {
        let (sin, cos) = (std::f64::consts::PI / 8.0 * f64::from(k)).sin_cos();
        DVec3::new(cos, sin, 0.0)
    });
    std::iter::once(DVec3::Z).chain(level).collect()
}

fn hull_volume(side: &[[DVec3; 3]]) -> f64 {
    convex_hull(&corner_points(side), 32, 1e-4).map_or(0.0, |hull| hull.volume())
}

/// Cuts by the plane that saves the most hull volume, or by two planes at once through the deepest point where that
/// saves more for each cut: halves of a tube have the hull of the whole tube, and only its quarters show the gain.
fn best_cut(piece: &Piece, solid: &VoxelSolid) -> Option<Vec<Piece>> {
    let normals = cut_normals();
    let points = corner_points(&piece.triangles);
    let margin = solid.cell();
    let range = |n: DVec3| {
        points.iter().map(|p| p.dot(n)).fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(v), b.max(v)))
    };
    let mut cuts: Vec<Vec<(DVec3, f64)>> = Vec::new();
    let mut deep = Vec::new();
    for &n in &normals {
        let (low, high) = range(n);
        let is_inner = |d: f64| d > low + margin && d < high - margin;
        let deepest = piece.deepest.dot(n);
        let offsets = (1..8).map(|k| low + (high - low) * f64::from(k) / 8.0).chain([deepest]);
        cuts.extend(offsets.filter(|&d| is_inner(d)).map(|d| vec![(n, d)]));
        if is_inner(deepest) {
            deep.push((n, deepest));
        }
    }
    for (i, &first) in deep.iter().enumerate() {
        cuts.extend(
            deep[..i].iter().filter(|second| second.0.dot(first.0).abs() < 0.8).map(|&s| vec![first, s]),
        );
    }
    let whole = piece.hull.volume();
    // Scores come back in the cuts' order whatever the threads do.
    let gains: Vec<f64> = cuts
        .par_iter()
        .map(|planes| {
            let sides = apply(&piece.triangles, planes);
            let left: f64 = sides.iter().map(|side| hull_volume(side)).sum();
            (whole - left) / (sides.len() as f64 - 1.0).max(1.0)
        })
        .collect();
    let mut order: Vec<usize> = (0..cuts.len()).collect();
    order.sort_by(|&a, &b| gains[b].total_cmp(&gains[a]).then(a.cmp(&b)));
    order.into_iter().take(4).find_map(|i| {
        let sides = apply(&piece.triangles, &cuts[i]);
        let pieces: Vec<Piece> = sides.into_iter().filter_map(|side| self::piece(side, solid)).collect();
        (pieces.len() >= 2).then_some(pieces)
    })
}

/// All sides of all planes that hold any surface.
fn apply(triangles: &[[DVec3; 3]], planes: &[(DVec3, f64)]) -> Vec<Vec<[DVec3; 3]>> {
    let mut sides = vec![triangles.to_vec()];
    for &(n, d) in planes {
        sides = sides
            .iter()
            .flat_map(|side| {
                let (below, above) = clip(side, n, d);
                [below, above]
            })
            .filter(|side| !side.is_empty())
            .collect();
    }
    sides
}

/// The triangles below and above a plane, cut where they cross it.
pub fn clip(triangles: &[[DVec3; 3]], n: DVec3, d: f64) -> (Vec<[DVec3; 3]>, Vec<[DVec3; 3]>) {
    let (mut below, mut above) = (Vec::new(), Vec::new());
    for t in triangles {
        let h = t.map(|p| p.dot(n) - d);
        if h.iter().all(|&h| h <= 0.0) {
            below.push(*t);
            continue;
        }
        if h.iter().all(|&h| h >= 0.0) {
            above.push(*t);
            continue;
        }
        let (mut low, mut high) = (Vec::with_capacity(4), Vec::with_capacity(4));
        for i in 0..3 {
            let j = (i + 1) % 3;
            if h[i] <= 0.0 {
                low.push(t[i]);
            }
            if h[i] >= 0.0 {
                high.push(t[i]);
            }
            if h[i] * h[j] < 0.0 {
                // Cut from the lower corner upwards, so that the neighbour across the edge gets the same point.
                let (a, b, ha, hb) =
                    if h[i] < 0.0 { (t[i], t[j], h[i], h[j]) } else { (t[j], t[i], h[j], h[i]) };
                let cut = a + (b - a) * (ha / (ha - hb));
                low.push(cut);
                high.push(cut);
            }
        }
        for (polygon, side) in [(low, &mut below), (high, &mut above)] {
            for k in 1..polygon.len().saturating_sub(1) {
                side.push([polygon[0], polygon[k], polygon[k + 1]]);
            }
        }
    }
    (below, above)
}

/// Joins hulls, the least concave union first: all that stay within the threshold, and more while there are too many.
fn merge(mut hulls: Vec<Mesh>, solid: &VoxelSolid, threshold: f64, max_parts: usize) -> Vec<Mesh> {
    let union = |a: &Mesh, b: &Mesh| -> Option<(f64, Mesh)> {
        let (ba, bb) = (a.aabb()?, b.aabb()?);
        let gap = (ba.min - bb.max).max(bb.min - ba.max).max_element();
        if gap > 1e-4 {
            return None;
        }
        let points: Vec<DVec3> = a.vertices.iter().chain(&b.vertices).copied().collect();
        let hull = convex_hull(&points, 96, 1e-5)?;
        Some((solid.concavity(&hull).0, hull))
    };
    let mut costs: std::collections::BTreeMap<(usize, usize), (f64, Mesh)> = Default::default();
    let mut ids: Vec<usize> = (0..hulls.len()).collect();
    let mut next_id = ids.len();
    let mut fresh = ids.clone();
    while hulls.len() > 1 {
        let pairs: Vec<(usize, usize)> = (0..hulls.len())
            .flat_map(|i| (0..i).map(move |j| (j, i)))
            .filter(|&(j, i)| fresh.contains(&ids[i]) || fresh.contains(&ids[j]))
            .collect();
        let found: Vec<Option<(f64, Mesh)>> =
            pairs.par_iter().map(|&(j, i)| union(&hulls[j], &hulls[i])).collect();
        for (&(j, i), cost) in pairs.iter().zip(found) {
            if let Some(cost) = cost {
                costs.insert((ids[j], ids[i]), cost);
            }
        }
        let best = costs.iter().min_by(|a, b| a.1.0.total_cmp(&b.1.0).then(a.0.cmp(b.0)));
        let Some((&(a, b), &(cost, _))) = best else { break };
        if cost > threshold && hulls.len() <= max_parts {
            break;
        }
        let Some((_, hull)) = costs.remove(&(a, b)) else { break };
        costs.retain(|k, _| ![k.0, k.1].iter().any(|id| *id == a || *id == b));
        let mut i = 0;
        hulls.retain(|_| {
            i += 1;
            ids[i - 1] != a && ids[i - 1] != b
        });
        ids.retain(|&id| id != a && id != b);
        hulls.push(hull);
        ids.push(next_id);
        fresh = vec![next_id];
        next_id += 1;
    }
    hulls
}

fn voxel_parts(mesh: &Mesh, config: &ConvexConfig) -> Option<Vec<Mesh>> {
    use parry3d_f64::transformation::vhacd::{VHACD, VHACDParameters};
    let parameters = VHACDParameters { max_convex_hulls: config.max_parts as u32, ..Default::default() };
    let parts = VHACD::decompose(&parameters, &mesh.vertices, &mesh.triangles, true)
        .compute_exact_convex_hulls(&mesh.vertices, &mesh.triangles);
    let parts: Vec<Mesh> = parts.into_iter().map(|(v, t)| Mesh::new(v, t)).collect();
    (!parts.is_empty()).then_some(parts)
}
