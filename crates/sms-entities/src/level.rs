//! Faces on which objects stand on each other are level before objects are parted.
//!
//! Parting cuts two convex pieces along the plane between their deepest points. Where a surface that nobody saw bulges into a flat
//! board, that plane leans by a degree or two: it slices off the board's far end, and what is left rocks on the bulge. So where
//! the face itself is known, from the seen part of an overhanging underside or because the object is an exact solid, what
//! carries it ends there, and it is flat.

use crate::contact::{cut_to, is_exact};
use crate::grid::{median, quantile};
use crate::stack::{BELOW_M, CLOSED_M, REACH_M, bottom, bottom_outline, can_stand, is_under, outline_of};
use glamx::{DVec2, DVec3};
use sms_convex::convex_hull;
use sms_core::{Entity, EntityKind, Mesh};

/// Seen points of an underside look down at least so steeply (cosine).
const DOWN: f64 = 0.95;
/// Fewer seen points say nothing of a face.
const FEWEST: usize = 30;
/// Four fifths of the points seen of a face lie within this height, metres; others are no level face.
const LEVEL_M: f64 = 0.004;
/// Vertices within this share of an object's thickness belong to its underside.
const THICKNESS_SHARE: f64 = 0.35;

/// Least share of a piece that is kept below a face: most of what was made up above a thin slab may be cut off.
const LEAST_LEFT: f64 = 0.01;

/// Makes undersides flat whose height is known, and ends there what carries them.
pub(crate) fn level_faces(entities: &mut [Entity], floor: f64, max_vertices: usize) {
    let mut order: Vec<usize> = (0..entities.len()).filter(|&i| can_stand(&entities[i], floor)).collect();
    order.sort_by(|&a, &b| bottom(&entities[a]).total_cmp(&bottom(&entities[b])));
    for upper in order {
        let Some(face) = face(&entities[upper]) else { continue };
        let height = face.height;
        if !is_exact(&entities[upper]) {
            flatten(&mut entities[upper], &face, max_vertices);
        }
        let outline = bottom_outline(&entities[upper]);
        if outline.len() < 3 {
            continue;
        }
        for carrier in (0..entities.len()).filter(|&i| i != upper) {
            let carrier = &mut entities[carrier];
            let carries = carrier.kind == EntityKind::Dynamic
                && !is_exact(carrier)
                && bottom(carrier) < height - BELOW_M;
            if carries {
                carrier.parts.iter_mut().for_each(|part| end_at(part, &outline, height, max_vertices));
            }
        }
    }
}

/// A level face that an object stands on.
struct Face {
    height: f64,
    /// Where it was seen from below, in the world's x and y.
    seen: Vec<DVec2>,
}

/// The level face that an object stands on; `None` where it is not known.
fn face(entity: &Entity) -> Option<Face> {
    let low = bottom(entity);
    if is_exact(entity) {
        let corners = entity.mesh.vertices.iter().filter(|v| v.z < low + 1e-3).count();
        return (corners >= 3).then_some(Face { height: low, seen: Vec::new() });
    }
    let cloud = &entity.cloud;
    let down = cloud.points_w.iter().zip(&cloud.normals_w).filter(|(_, n)| n.z < -DOWN).map(|(p, _)| *p);
    let mut points: Vec<DVec3> = down.collect();
    if points.len() < FEWEST {
        return None;
    }
    // Other undersides (a lid's, a rim's) are higher up.
    let lowest = quantile(points.iter().map(|p| p.z).collect(), 0.1);
    points.retain(|p| (p.z - lowest).abs() < 2.0 * REACH_M);
    let heights: Vec<f64> = points.iter().map(|p| p.z).collect();
    let spread = quantile(heights.clone(), 0.9) - quantile(heights.clone(), 0.1);
    let height = median(heights);
    points.retain(|p| (p.z - height).abs() < LEVEL_M);
    let is_face = points.len() >= FEWEST && spread < LEVEL_M && (height - low).abs() < REACH_M;
    is_face.then(|| Face { height, seen: points.into_iter().map(|p| p.truncate()).collect() })
}

/// Puts the corners of an object's underside onto its face, and makes its pieces reach as far on the face as it was seen.
fn flatten(entity: &mut Entity, face: &Face, max_vertices: usize) {
    let height = face.height;
    let top = entity.parts.iter().flat_map(|p| &p.vertices).map(|v| v.z).fold(f64::MIN, f64::max);
    let reach = REACH_M.min(THICKNESS_SHARE * (top - height));
    for part in &mut entity.parts {
        // A mesh rounds the edges of thin boards; seen from above the piece reaches to the end.
        let silhouette = outline_of(part.vertices.iter().copied());
        let seen = face.seen.iter().filter(|p| is_inside(&silhouette, **p)).map(|p| p.extend(height));
        let below = part.vertices.iter().map(|v| if v.z < height + reach { v.with_z(height) } else { *v });
        let reaches_down = part.vertices.iter().any(|v| v.z < height + reach);
        let points: Vec<DVec3> = below.chain(seen.filter(|_| reaches_down)).collect();
        let hull = convex_hull(&points, max_vertices, 1e-6);
        if let Some(hull) = hull.filter(|h| h.volume() > 0.2 * part.volume()) {
            *part = hull;
        }
    }
}

fn is_inside(outline: &[DVec2], p: DVec2) -> bool {
    let left = |i: usize| {
        let (a, b) = (outline[i], outline[(i + 1) % outline.len()]);
        (b - a).perp_dot(p - a) >= 0.0
    };
    outline.len() >= 3 && (0..outline.len()).all(left)
}

/// Cuts off what of a piece reaches above a face that stands on it. What reaches far above it beside the face was seen there.
fn end_at(part: &mut Mesh, outline: &[DVec2], height: f64, max_vertices: usize) {
    let above: Vec<DVec3> = part.vertices.iter().copied().filter(|v| v.z > height + CLOSED_M).collect();
    let beside = |v: &DVec3| v.z > height + REACH_M && !is_under(outline, v.truncate());
    if above.is_empty() || above.iter().any(beside) {
        return;
    }
    let own = outline_of(part.vertices.iter().copied().filter(|v| v.z > height - REACH_M));
    if meet(&own, outline) {
        cut_to(part, DVec3::Z, height, max_vertices, LEAST_LEFT);
    }
}

/// Whether two convex outlines (counterclockwise) have a point in common; one of fewer than three corners as the points it has.
fn meet(a: &[DVec2], b: &[DVec2]) -> bool {
    let parted_by = |p: &[DVec2], q: &[DVec2]| {
        (0..p.len()).any(|i| {
            let (start, edge) = (p[i], p[(i + 1) % p.len()] - p[i]);
            edge != DVec2::ZERO && p.len() > 2 && q.iter().all(|v| edge.perp_dot(v - start) < 0.0)
        })
    };
    !a.is_empty() && !b.is_empty() && !parted_by(a, b) && !parted_by(b, a)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::part_objects;
    use crate::stack::{close_gaps, tests::entity};
    use sms_core::{EntityShape, PointCloud};

    /// A board of 12 mm on a solid block whose top nobody saw bulges into it, 15 mm high on one side.
    fn board_on_bulge(seen: usize) -> [Entity; 2] {
        let half = DVec3::new(0.2, 0.2, 0.25);
        let mut block = Mesh::cuboid(half);
        block.vertices.iter_mut().for_each(|v| v.z += 0.25);
        let mut points = block.vertices.clone();
        points.push(DVec3::new(0.05, 0.1, 0.515));
        let mut block = entity("block", convex_hull(&points, 64, 0.0).unwrap(), EntityShape::Convex);
        block.label = 1;
        let mut slab = Mesh::cuboid(DVec3::new(0.5, 0.15, 0.006));
        // A scan's underside is uneven by a millimetre.
        for v in slab.vertices.iter_mut() {
            let uneven = if v.z < 0.0 { 1e-3 * (v.x * v.y).signum() } else { 0.0 };
            *v += DVec3::new(0.3, 0.0, 0.506 + uneven);
        }
        let mut board = entity("board", convex_hull(&slab.vertices, 64, 0.0).unwrap(), EntityShape::Convex);
        let noise = |i: usize| 4e-4 * ((i % 5) as f64 - 2.0);
        board.cloud = PointCloud {
            points_w: (0..seen).map(|i| DVec3::new(0.4 + 1e-3 * i as f64, 0.0, 0.5 + noise(i))).collect(),
            normals_w: vec![DVec3::NEG_Z; seen],
            colors: vec![[0; 3]; seen],
        };
        [block, board]
    }

    fn highest(e: &Entity) -> f64 {
        e.parts.iter().flat_map(|p| &p.vertices).map(|v| v.z).fold(f64::MIN, f64::max)
    }

    #[test]
    fn a_board_keeps_its_end_where_a_bulge_reaches_into_it() {
        let mut pair = board_on_bulge(100);
        level_faces(&mut pair, 0.0, 64);
        assert!(part_objects(&mut pair, 64, 1e-4).is_empty(), "nothing is left to part");
        close_gaps(&mut pair, 0.0, 64);
        let [block, board] = &pair;
        assert!((highest(block) - 0.5).abs() < 1e-9 && (bottom(board) - 0.5).abs() < 1e-9);
        assert!(board.parts[0].vertices.iter().filter(|v| (v.z - 0.5).abs() < 1e-9).count() >= 4);
        let end = board.parts[0].aabb().unwrap();
        assert!((end.max.x - 0.8).abs() < 1e-9 && (end.min.x + 0.2).abs() < 1e-9);
        assert!(pair.iter().all(|e| e.parts[0].is_closed_oriented()));
        // The whole top of the block carries it.
        let face = block.parts[0].vertices.iter().filter(|v| (v.z - 0.5).abs() < 1e-9);
        assert!(outline_of(face.copied()).len() >= 4);
    }

    #[test]
    fn a_thin_piece_keeps_its_top_under_a_high_bulge() {
        let mut pair = board_on_bulge(100);
        // The block's top is a piece of its own: 6 mm of it were there, and 40 mm were made up.
        let slab = |low: f64, high: f64, half: f64| {
            let mut mesh = Mesh::cuboid(DVec3::new(half, half, 0.5 * (high - low)));
            mesh.vertices.iter_mut().for_each(|v| v.z += 0.5 * (low + high));
            mesh
        };
        pair[0].parts = vec![slab(0.0, 0.494, 0.2), slab(0.494, 0.54, 0.1)];
        level_faces(&mut pair, 0.0, 64);
        let found = part_objects(&mut pair, 64, 1e-4);
        assert!(found.is_empty() && pair[0].parts.len() == 2, "{}", pair[0].parts.len());
        assert!((highest(&pair[0]) - 0.5).abs() < 1e-9);
    }

    #[test]
    fn an_underside_reaches_as_far_as_it_was_seen() {
        let [block, mut board] = board_on_bulge(380);
        // The mesh of the board's end is a wedge: its underside begins 30 cm further in.
        for v in board.parts[0].vertices.iter_mut().filter(|v| v.x > 0.7 && v.z < 0.505) {
            v.z = 0.508;
        }
        board.parts[0].vertices.extend([-0.15, 0.15].map(|y| DVec3::new(0.5, y, 0.5)));
        board.parts[0] = convex_hull(&board.parts[0].vertices, 64, 0.0).unwrap();
        for (i, p) in board.cloud.points_w.iter_mut().enumerate() {
            p.y = if i % 2 == 0 { 0.145 } else { -0.145 };
        }
        let reach = |e: &Entity| {
            let face = e.parts[0].vertices.iter().filter(|v| (v.z - 0.5).abs() < 1.5e-3);
            face.map(|v| v.x).fold(f64::MIN, f64::max)
        };
        assert!(reach(&board) < 0.51);
        let mut pair = [block, board];
        level_faces(&mut pair, 0.0, 64);
        assert!((reach(&pair[1]) - 0.779).abs() < 2e-3, "{}", reach(&pair[1]));
    }

    #[test]
    fn an_underside_that_was_not_seen_is_left_to_parting() {
        let before = board_on_bulge(FEWEST - 1);
        let mut pair = before.clone();
        level_faces(&mut pair, 0.0, 64);
        assert_eq!(pair, before);
        // The test of the other one would not see what it is about if parting alone kept the end.
        part_objects(&mut pair, 64, 1e-4);
        assert!(pair[1].parts[0].volume() < 0.9 * before[1].parts[0].volume());
    }

    #[test]
    fn what_was_seen_high_above_a_face_beside_it_stays() {
        let mut pair = board_on_bulge(100);
        // A lug at the far side of the block, away from the board.
        let mut points = pair[0].parts[0].vertices.clone();
        points.push(DVec3::new(0.0, 0.19, 0.56));
        pair[0].parts[0] = convex_hull(&points, 64, 0.0).unwrap();
        let lug = pair[0].parts[0].clone();
        level_faces(&mut pair, 0.0, 64);
        assert_eq!(pair[0].parts[0], lug);
    }

    #[test]
    fn outlines_meet_where_they_have_a_point_in_common() {
        let square = |x: f64, half: f64| {
            [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
                .map(|(s, t)| DVec2::new(x + half * s, half * t))
        };
        assert!(meet(&square(0.0, 1.0), &square(1.5, 1.0)));
        assert!(meet(&square(0.0, 1.0), &square(0.1, 0.1)) && meet(&square(0.1, 0.1), &square(0.0, 1.0)));
        assert!(!meet(&square(0.0, 1.0), &square(2.5, 1.0)));
        assert!(!meet(&square(0.0, 1.0), &[]));
        assert!(meet(&square(0.0, 1.0), &[DVec2::ZERO]) && !meet(&square(0.0, 1.0), &[DVec2::new(3.0, 0.0)]));
    }
}
