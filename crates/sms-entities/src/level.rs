//! Makes contact faces level before overlapping objects are cut apart.
//!
//! Overlapping convex pieces are cut along the plane between their deepest points. If an unseen, extrapolated surface
//! bulges into a flat board, this plane leans by a degree or two: it slices off the far end of the board, and the rest
//! rocks on the bulge. The contact face is known if the underside was partly seen, from the upper end of its carrier,
//! or if the object is an exact solid. In these cases the carrier ends at the face and is flat. Carriers themselves get
//! a flat foot.

use crate::piece::{cut_to, is_exact};
use crate::standing::{
    CLOSED_M, LevelFace, PieceColumn, REACH_M, bottom, bottom_outline, can_carry, corners_of_faces,
    reaches_beside, standing, under,
};
use crate::support::{Carrier, RestingPlane, SIDE};
use glamx::{DVec2, DVec3};
use sms_core::{Entity, EntityShape, Mesh};
use sms_mesh::{
    Plane, PointGrid, clip, convex_hull, median,
    outline::{common, is_within, outline_of, width},
    quantile,
};

/// Seen points of an underside have normals at least this close to straight down (cosine).
const DOWN: f64 = 0.95;
/// Faces of a hull with normals closer than this to straight down (cosine) are its underside.
const STEEP: f64 = 0.5;
/// Smallest number of seen points that determine a face.
const FEWEST: usize = 30;
/// The foot of a carrier is flattened if all its corners are within this distance of the floor, metres. A foot that is
/// uneven by a millimetre tilts the stack.
const FOOT_M: f64 = 0.0035;
/// A side seen below this height continues to the floor, because masks lose a strip above the floor, metres.
const STRIP_M: f64 = 0.012;
/// Largest distance of such a side from a corner, metres.
const NEAR_M: f64 = 0.01;
/// Four fifths of the points of a level face lie within this height, metres.
const LEVEL_M: f64 = 0.004;
/// Largest apparent tilt of a level face, radians: a strip seen at a grazing angle appears tilted.
const LEANS: f64 = 0.05;
/// A narrower support is an edge instead of a face, metres.
const FACE_M: f64 = 0.01;
/// Height range above the lowest corner that is measured for the flatness of a foot, metres.
const LOWEST_M: f64 = 0.0022;
/// Smallest share of the width within [`REACH_M`] that a flat foot has within [`LOWEST_M`]. A ball has 0.7.
const FLAT_SHARE: f64 = 0.85;
/// A piece was seen beside the object on it if it reaches farther than this outside the object's outline, metres.
const BESIDE_M: f64 = 0.001;
/// Vertices within this share of a piece's thickness belong to its underside.
const THICKNESS_SHARE: f64 = 0.35;

/// Smallest share of a piece that must remain below a face. Most of the extrapolated part above a thin slab may be cut
/// off.
const LEAST_LEFT: f64 = 0.01;

/// Flattens undersides of known height and cuts off their carriers there. Returns these faces.
pub(crate) fn level_faces(
    entities: &mut [Entity],
    rests: &[(u16, RestingPlane)],
    floor: f64,
    max_vertices: usize,
) -> Vec<LevelFace> {
    let mut faces = Vec::new();
    for upper in standing(entities, floor) {
        let rest = rests.iter().find(|r| r.0 == entities[upper].label).map(|r| &r.1);
        let Some(face) = face(&entities[upper], rest) else { continue };
        let height = face.height;
        faces.push(LevelFace { upper, height });
        if !is_exact(&entities[upper]) {
            flatten(&mut entities[upper], &face, REACH_M, max_vertices, &|_| true);
        }
        let outline = bottom_outline(&entities[upper]);
        if outline.len() < 3 {
            continue;
        }
        let standing_on = foot_outlines(&entities[upper], height);
        for carrier in (0..entities.len()).filter(|&i| i != upper) {
            let carrier = &mut entities[carrier];
            if can_carry(carrier, height) && !is_exact(carrier) {
                let parts = carrier.parts.iter_mut();
                parts.for_each(|part| end_at(part, &outline, &standing_on, height, max_vertices));
                if (bottom(carrier) - floor).abs() < FOOT_M && is_below(carrier, &outline, height) {
                    stand_flat(carrier, floor, max_vertices);
                }
            }
        }
    }
    faces
}

/// Returns whether an object with this outline and lower end `height` stands on `carrier`.
fn is_below(carrier: &Entity, outline: &[DVec2], height: f64) -> bool {
    carrier.parts.iter().any(|part| under(part, outline).iter().any(|p| p.z > height - 2.0 * REACH_M))
}

/// Outlines of the feet of an object's pieces. The space between them (the hole of a ring) carries nothing.
fn foot_outlines(entity: &Entity, height: f64) -> Vec<Vec<DVec2>> {
    if is_exact(entity) {
        return vec![bottom_outline(entity)];
    }
    let foot = |part: &Mesh| outline_of(part.vertices.iter().copied().filter(|v| v.z < height + REACH_M));
    entity.parts.iter().map(foot).collect()
}

/// A level supporting face.
struct StandingFace {
    height: f64,
    /// Points of the face seen from below, in the world's x and y.
    seen: Vec<DVec2>,
}

/// Returns the level face that supports an object: the seen part of its underside, or else the upper end of its
/// carrier. Returns `None` if neither is known.
fn face(entity: &Entity, rest: Option<&RestingPlane>) -> Option<StandingFace> {
    let low = bottom(entity);
    if is_exact(entity) {
        // A lying cylinder stands on a line, although its mesh is wide one millimetre above it.
        let lies = matches!(entity.shape, EntityShape::Cylinder { x_ws, .. } if (x_ws.rotation * DVec3::Z).z.abs() < DOWN);
        let lowest = outline_of(entity.mesh.vertices.iter().copied().filter(|v| v.z < low + 1e-3));
        return (!lies && width(&lowest) > FACE_M).then_some(StandingFace { height: low, seen: Vec::new() });
    }
    let carrier = rest.filter(|r| matches!(r.carrier, Carrier::Object(_)) && r.plane.normal == DVec3::Z);
    let carrier = carrier.map(|r| r.plane.offset).filter(|height| (height - low).abs() < REACH_M);
    let carrier = carrier.filter(|_| is_flat_below(entity, low));
    seen_face(entity, low).or(carrier.map(|height| StandingFace { height, seen: Vec::new() }))
}

/// Returns whether an object that ends at `low` is about as wide there as farther up. Round undersides are not.
fn is_flat_below(entity: &Entity, low: f64) -> bool {
    let within = |of: f64| {
        width(&outline_of(entity.parts.iter().flat_map(|p| &p.vertices).copied().filter(|v| v.z < low + of)))
    };
    within(LOWEST_M) > FLAT_SHARE * within(REACH_M)
}

/// Returns the seen level face of an object that ends at `low`.
fn seen_face(entity: &Entity, low: f64) -> Option<StandingFace> {
    let cloud = &entity.cloud;
    let down = cloud.points_w.iter().zip(&cloud.normals_w).filter(|(_, n)| n.z < -DOWN).map(|(p, _)| *p);
    let mut points: Vec<DVec3> = down.collect();
    if points.len() < FEWEST {
        return None;
    }
    // Other undersides (of a lid or a rim) are higher up.
    let lowest = quantile(points.iter().map(|p| p.z).collect(), 0.1);
    points.retain(|p| (p.z - lowest).abs() < 2.0 * REACH_M);
    let spread = |of: Vec<f64>| quantile(of.clone(), 0.9) - quantile(of, 0.1);
    let heights: Vec<f64> = points.iter().map(|p| p.z).collect();
    let is_level = spread(heights.clone()) < LEVEL_M
        || Plane::least_squares(&points).is_some_and(|plane| {
            let off = points.iter().map(|p| plane.height(*p)).collect();
            plane.normal.z > LEANS.cos() && spread(off) < LEVEL_M
        });
    let height = median(heights);
    points.retain(|p| (p.z - height).abs() < 2.0 * LEVEL_M);
    let is_face = points.len() >= FEWEST && is_level && (height - low).abs() < REACH_M;
    is_face.then(|| StandingFace { height, seen: points.into_iter().map(|p| p.truncate()).collect() })
}

/// Makes the whole foot of an object touch the floor.
fn stand_flat(entity: &mut Entity, floor: f64, max_vertices: usize) {
    let cloud = &entity.cloud;
    let seen = cloud.points_w.iter().zip(&cloud.normals_w);
    let low = seen.filter(|(p, n)| p.z < floor + STRIP_M && n.z.abs() < SIDE).map(|(p, _)| *p);
    let low: Vec<DVec3> = low.collect();
    let sides = PointGrid::new(&low, NEAR_M);
    let is_foot = |v: DVec3| v.z < floor + FOOT_M || sides.is_near(v, NEAR_M);
    flatten(entity, &StandingFace { height: floor, seen: Vec::new() }, STRIP_M, max_vertices, &is_foot);
}

/// Moves corners of an object's underside onto its face if they belong to its foot and are at most `reach` metres above
/// the face. Extends the pieces on the face to its seen outline.
fn flatten(
    entity: &mut Entity,
    face: &StandingFace,
    reach: f64,
    max_vertices: usize,
    is_foot: &dyn Fn(DVec3) -> bool,
) {
    let height = face.height;
    for part in &mut entity.parts {
        let top = part.vertices.iter().map(|v| v.z).fold(f64::MIN, f64::max);
        let reach = reach.min(THICKNESS_SHARE * (top - height));
        // A mesh rounds the edges of thin boards; the silhouette reaches to the real edge.
        let silhouette = outline_of(part.vertices.iter().copied());
        let Some(column) = PieceColumn::of(part) else { continue };
        // Points outside the piece's silhouette belong to the foot of another piece.
        let ends_here =
            |p: DVec2| column.underside(p, height - 1.0).is_some_and(|z| z < height + 2.0 * REACH_M);
        let seen = face.seen.iter().filter(|p| is_within(&silhouette, **p, 0.0) && ends_here(**p));
        let seen: Vec<DVec3> = seen.map(|p| p.extend(height)).collect();
        // The upper side of a thin plate may be as close to the face as the underside of another piece.
        let mut is_below = corners_of_faces(part, |up| up < -STEEP);
        is_below
            .iter_mut()
            .zip(&part.vertices)
            .for_each(|(is, v)| *is &= v.z < height + reach && is_foot(*v));
        let reaches_down = is_below.contains(&true);
        let is_flat = part.vertices.iter().zip(&is_below).all(|(v, is)| !is || (v.z - height).abs() < 1e-9);
        if is_flat && (seen.is_empty() || !reaches_down) {
            continue;
        }
        let below = part.vertices.iter().zip(is_below).map(|(v, is)| if is { v.with_z(height) } else { *v });
        let points: Vec<DVec3> = below.chain(seen.into_iter().filter(|_| reaches_down)).collect();
        let hull = convex_hull(&points, max_vertices, 1e-6);
        if let Some(hull) = hull.filter(|h| h.volume() > 0.2 * part.volume()) {
            *part = hull;
        }
    }
}

/// Cuts off the part of a piece above a face that stands on it. A part that reaches far above the face beside it was
/// seen and is kept.
fn end_at(part: &mut Mesh, outline: &[DVec2], standing: &[Vec<DVec2>], height: f64, max_vertices: usize) {
    if reaches_beside(part, outline, height, BESIDE_M)
        || part.vertices.iter().all(|v| v.z < height + CLOSED_M)
    {
        return;
    }
    let triangles: Vec<[DVec3; 3]> = (0..part.triangles.len()).map(|t| part.corners(t)).collect();
    let above = outline_of(clip(&triangles, DVec3::Z, height).1.into_iter().flatten());
    // A piece with a smaller overlap is beside the object on the face, and is cut apart from it.
    let stands = |foot: &[DVec2]| width(&common(&above, foot)) > 0.5 * width(&above).min(width(foot));
    if standing.iter().any(|foot| stands(foot)) {
        cut_to(part, DVec3::Z, height, max_vertices, LEAST_LEFT);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::part_objects;
    use crate::fixtures::entity;
    use crate::stack::close_gaps;
    use sms_core::PointCloud;
    use sms_mesh::Plane;

    /// A board of 12 mm on a solid block. The block's top was not seen and bulges into the board, 15 mm high on one
    /// side.
    fn board_on_bulge(seen: usize) -> [Entity; 2] {
        let half = DVec3::new(0.2, 0.2, 0.25);
        let mut block = Mesh::cuboid(half);
        block.vertices.iter_mut().for_each(|v| v.z += 0.25);
        let mut points = block.vertices.clone();
        points.push(DVec3::new(0.05, 0.1, 0.515));
        let mut block = entity("block", convex_hull(&points, 64, 0.0).unwrap(), EntityShape::Convex);
        block.label = 1;
        let mut slab = Mesh::cuboid(DVec3::new(0.5, 0.15, 0.006));
        // The underside of a scan is uneven by a millimetre.
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
        level_faces(&mut pair, &[], 0.0, 64);
        assert!(part_objects(&mut pair, &[], 64, 1e-4).is_empty(), "nothing is left to part");
        close_gaps(&mut pair, 0.0, 64);
        let [block, board] = &pair;
        assert!((highest(block) - 0.5).abs() < 1e-9 && (bottom(board) - 0.5).abs() < 1e-9);
        assert!(board.parts[0].vertices.iter().filter(|v| (v.z - 0.5).abs() < 1e-9).count() >= 4);
        let end = board.parts[0].aabb().unwrap();
        assert!((end.max.x - 0.8).abs() < 1e-9 && (end.min.x + 0.2).abs() < 1e-9);
        assert!(pair.iter().all(|e| e.parts[0].is_closed_oriented()));
        // The whole top of the block carries the board.
        let face = block.parts[0].vertices.iter().filter(|v| (v.z - 0.5).abs() < 1e-9);
        assert!(outline_of(face.copied()).len() >= 4);
    }

    #[test]
    fn a_thin_piece_keeps_its_top_under_a_high_bulge() {
        let mut pair = board_on_bulge(100);
        // The top of the block is a separate piece: 6 mm of it are real and 40 mm extrapolated.
        let slab = |low: f64, high: f64, half: f64| {
            let mut mesh = Mesh::cuboid(DVec3::new(half, half, 0.5 * (high - low)));
            mesh.vertices.iter_mut().for_each(|v| v.z += 0.5 * (low + high));
            mesh
        };
        pair[0].parts = vec![slab(0.0, 0.494, 0.2), slab(0.494, 0.54, 0.1)];
        level_faces(&mut pair, &[], 0.0, 64);
        let found = part_objects(&mut pair, &[], 64, 1e-4);
        assert!(found.is_empty() && pair[0].parts.len() == 2, "{}", pair[0].parts.len());
        assert!((highest(&pair[0]) - 0.5).abs() < 1e-9);
    }

    #[test]
    fn an_underside_reaches_as_far_as_it_was_seen() {
        let [block, mut board] = board_on_bulge(380);
        // The end of the board's mesh is a wedge: its underside begins 30 cm from the end.
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
        level_faces(&mut pair, &[], 0.0, 64);
        assert!((reach(&pair[1]) - 0.779).abs() < 2e-3, "{}", reach(&pair[1]));
    }

    #[test]
    fn where_the_underside_was_not_seen_the_carriers_top_is_the_face() {
        let mut pair = board_on_bulge(0);
        pair[1].label = 2;
        let rest = RestingPlane {
            plane: Plane::horizontal(0.501),
            carrier: Carrier::Object(pair[0].label),
            noise_m: 0.001,
        };
        let faces = level_faces(&mut pair, &[(2, rest)], 0.0, 64);
        assert_eq!(faces, [LevelFace { upper: 1, height: 0.501 }]);
        assert!((highest(&pair[0]) - 0.501).abs() < 1e-9 && (bottom(&pair[1]) - 0.501).abs() < 1e-9);
        // A face is left unchanged unless it was seen to be level.
        let leaning = Plane { normal: DVec3::new(0.1, 0.0, 1.0).normalize(), offset: 0.5 };
        let before = board_on_bulge(0);
        let mut pair = before.clone();
        assert!(level_faces(&mut pair, &[(1, RestingPlane { plane: leaning, ..rest })], 0.0, 64).is_empty());
        assert_eq!(pair, before);
    }

    #[test]
    fn what_is_round_below_stays_round() {
        let [block, mut ball] = board_on_bulge(0);
        ball.label = 2;
        let round = Mesh::icosphere(0.04, 3).vertices;
        let round: Vec<DVec3> = round.iter().map(|v| v + DVec3::new(0.0, 0.0, 0.54)).collect();
        ball.parts = vec![convex_hull(&round, 256, 0.0).unwrap()];
        let rest = RestingPlane {
            plane: Plane::horizontal(0.501),
            carrier: Carrier::Object(block.label),
            noise_m: 0.001,
        };
        let mut pair = [block, ball];
        let before = pair.clone();
        assert!(level_faces(&mut pair, &[(2, rest)], 0.0, 64).is_empty());
        assert_eq!(pair, before);
    }

    #[test]
    fn an_underside_that_seems_to_lean_is_level_and_parted_there() {
        let mut pair = board_on_bulge(200);
        // Seen along 20 cm, with a tilt of 2.3°.
        for (i, p) in pair[1].cloud.points_w.iter_mut().enumerate() {
            (p.y, p.z) = (0.01 * (i % 7) as f64, p.z + 0.04 * (p.x - 0.5));
        }
        let faces = level_faces(&mut pair, &[], 0.0, 64);
        let height = faces[0].height;
        assert!((height - 0.5).abs() < 1e-3, "{height}");
        // A bulge that remains after levelling is also cut off at the face.
        pair[0].parts[0].vertices.iter_mut().filter(|v| v.z > 0.4 && v.x > 0.0).for_each(|v| v.z += 0.004);
        part_objects(&mut pair, &faces, 64, 1e-4);
        assert!((highest(&pair[0]) - height).abs() < 1e-9 && (bottom(&pair[1]) - height).abs() < 1e-9);
        let end = pair[1].parts[0].aabb().unwrap();
        assert!((end.max.x - 0.8).abs() < 1e-9 && (end.min.x + 0.2).abs() < 1e-9);
    }

    #[test]
    fn what_carries_stands_on_all_of_its_foot() {
        let mut pair = board_on_bulge(100);
        let uneven = |v: &mut DVec3| v.z += if v.z < 0.01 && v.x > 0.0 { 2e-3 } else { 0.0 };
        pair[0].parts[0].vertices.iter_mut().for_each(uneven);
        let beside = {
            let mut other = pair[0].clone();
            other.parts[0].vertices.iter_mut().for_each(|v| v.y += 5.0);
            other
        };
        let [block, board] = pair;
        let mut all = [block, board, beside.clone()];
        level_faces(&mut all, &[], 0.0, 64);
        let foot = |e: &Entity| outline_of(e.parts[0].vertices.iter().copied().filter(|v| v.z.abs() < 1e-9));
        assert!(width(&foot(&all[0])) > 0.39, "{:?}", foot(&all[0]));
        assert_eq!(all[2], beside, "it carries nothing");
    }

    #[test]
    fn a_side_that_was_seen_down_to_a_strip_goes_on_to_the_floor() {
        let mut pair = board_on_bulge(100);
        // A corner of the foot is raised by 8 mm.
        let lifted = |v: &mut DVec3| v.z += if v.z < 0.01 && v.x > 0.0 && v.y > 0.0 { 8e-3 } else { 0.0 };
        pair[0].parts[0].vertices.iter_mut().for_each(lifted);
        let corner = |e: &Entity| {
            let near = e.parts[0].vertices.iter().filter(|v| v.z < 0.1 && v.x > 0.19 && v.y > 0.19);
            near.map(|v| v.z).fold(f64::MAX, f64::min)
        };
        let mut unseen = pair.clone();
        level_faces(&mut unseen, &[], 0.0, 64);
        assert!((corner(&unseen[0]) - 8e-3).abs() < 1e-9, "{}", corner(&unseen[0]));
        pair[0].cloud.points_w =
            (0..5).map(|k| DVec3::new(0.2, 0.195, 0.009 + 1e-3 * f64::from(k))).collect();
        pair[0].cloud.normals_w = vec![DVec3::X; 5];
        pair[0].cloud.colors = vec![[0; 3]; 5];
        // The underside of a bowl at this place contradicts a flat foot.
        let mut bowl = pair.clone();
        bowl[0].cloud.normals_w = vec![DVec3::new(0.6, 0.0, -0.8); 5];
        level_faces(&mut bowl, &[], 0.0, 64);
        assert!((corner(&bowl[0]) - 8e-3).abs() < 1e-9, "{}", corner(&bowl[0]));
        level_faces(&mut pair, &[], 0.0, 64);
        assert!(corner(&pair[0]).abs() < 1e-9, "{}", corner(&pair[0]));
    }

    #[test]
    fn an_underside_that_was_not_seen_is_left_to_parting() {
        let before = board_on_bulge(FEWEST - 1);
        let mut pair = before.clone();
        level_faces(&mut pair, &[], 0.0, 64);
        assert_eq!(pair, before);
        // Cutting alone does not keep the end; the other test relies on this.
        part_objects(&mut pair, &[], 64, 1e-4);
        assert!(pair[1].parts[0].volume() < 0.9 * before[1].parts[0].volume());
    }

    fn slab(half: DVec3, center: DVec3) -> Mesh {
        let mut mesh = Mesh::cuboid(half);
        mesh.vertices.iter_mut().for_each(|v| *v += center);
        mesh
    }

    fn seen_from_below(entity: &mut Entity, p: DVec3) {
        entity.cloud = PointCloud {
            points_w: vec![p; FEWEST],
            normals_w: vec![DVec3::NEG_Z; FEWEST],
            colors: vec![[0; 3]; FEWEST],
        };
    }

    #[test]
    fn a_peg_stays_in_its_ring() {
        let base = slab(DVec3::new(0.04, 0.04, 0.02), DVec3::Z * 0.02);
        let mut stand = entity("stand", base, EntityShape::Convex);
        stand.parts.push(slab(DVec3::new(0.01, 0.01, 0.075), DVec3::Z * 0.075));
        let side = |at: DVec3| {
            slab(if at.x == 0.0 { DVec3::new(0.06, 0.02, 0.01) } else { DVec3::new(0.02, 0.06, 0.01) }, at)
        };
        let sides =
            [DVec3::X, DVec3::Y, DVec3::NEG_X, DVec3::NEG_Y].map(|d| side(0.04 * d + DVec3::Z * 0.05));
        let mut ring = entity("ring", sides[0].clone(), EntityShape::Convex);
        ring.parts = sides.to_vec();
        seen_from_below(&mut ring, DVec3::new(0.055, 0.0, 0.04));
        // First without contact, then overlapping by 0.1 mm on one side.
        for shift in [0.0, 0.0101] {
            let mut peg = stand.clone();
            peg.parts[1].vertices.iter_mut().for_each(|v| v.x += shift);
            let mut pair = [peg, ring.clone()];
            let before = pair.clone();
            level_faces(&mut pair, &[], 0.0, 64);
            assert_eq!(pair[0], before[0]);
        }
    }

    #[test]
    fn a_leaning_rail_is_not_filled_down_to_the_foot_of_its_post() {
        let rail = [DVec3::new(0.0, 0.0, 0.5), DVec3::new(0.2, 0.0, 0.6)];
        let rail = rail.map(|p| slab(DVec3::splat(0.01), p + DVec3::Z * 0.01).vertices).concat();
        let rail = convex_hull(&rail, 64, 0.0).unwrap();
        let mut easel = entity("easel", rail.clone(), EntityShape::Convex);
        easel.parts.push(slab(DVec3::new(0.01, 0.01, 0.05), DVec3::new(0.18, 0.0, 0.55)));
        seen_from_below(&mut easel, DVec3::new(0.18, 0.0, 0.5));
        level_faces(std::slice::from_mut(&mut easel), &[], 0.0, 64);
        assert!((easel.parts[0].volume() / rail.volume() - 1.0).abs() < 0.05, "{}", easel.parts[0].volume());
    }

    #[test]
    fn an_upright_that_touches_a_book_stays() {
        let mut shelf =
            entity("shelf", slab(DVec3::new(0.3, 0.2, 0.05), DVec3::Z * 0.05), EntityShape::Convex);
        // The shelf overlaps the book by 0.5 mm of the book's 3 mm.
        shelf.parts.push(slab(DVec3::new(0.0015, 0.04, 0.1), DVec3::new(0.201, 0.0, 0.1)));
        let book = slab(DVec3::new(0.1, 0.05, 0.015), DVec3::new(0.1, 0.0, 0.115));
        let mut book = entity("book", book, EntityShape::Convex);
        seen_from_below(&mut book, DVec3::new(0.1, 0.0, 0.1));
        let mut pair = [shelf, book];
        let before = pair[0].clone();
        level_faces(&mut pair, &[], 0.0, 64);
        assert_eq!(pair[0], before);
    }

    #[test]
    fn a_cylinder_has_a_face_where_it_stands_and_none_where_it_lies() {
        let rings = |axis: DVec3| {
            let (u, v) = axis.any_orthonormal_pair();
            let angle = |k: i32| std::f64::consts::TAU / 128.0 * f64::from(k);
            let rim = (0..128).map(move |k| 0.05 * (u * angle(k).cos() + v * angle(k).sin()));
            rim.flat_map(move |p| [p - 0.1 * axis, p + 0.1 * axis]).collect::<Vec<_>>()
        };
        let cylinder = |axis: DVec3| {
            let x_ws = glamx::DPose3::from_rotation(glamx::DQuat::from_rotation_arc(DVec3::Z, axis));
            let shape = EntityShape::Cylinder { x_ws, radius: 0.05, half_length: 0.1 };
            entity("can", convex_hull(&rings(axis), 256, 0.0).unwrap(), shape)
        };
        assert!((face(&cylinder(DVec3::Z), None).unwrap().height + 0.1).abs() < 1e-9);
        assert!(face(&cylinder(DVec3::X), None).is_none());
    }

    #[test]
    fn a_flat_piece_of_a_tall_object_keeps_its_shape() {
        // A plate of 4 mm with a hump of 8 mm, below a tall rest.
        let mut plate = slab(DVec3::new(0.05, 0.05, 0.002), DVec3::Z * 0.502).vertices;
        plate.push(DVec3::Z * 0.512);
        let plate = convex_hull(&plate, 64, 0.0).unwrap();
        let mut vase = entity("vase", plate.clone(), EntityShape::Convex);
        vase.parts.push(slab(DVec3::new(0.02, 0.02, 0.1), DVec3::Z * 0.604));
        seen_from_below(&mut vase, DVec3::Z * 0.5);
        level_faces(std::slice::from_mut(&mut vase), &[], 0.0, 64);
        assert!((vase.parts[0].volume() / plate.volume() - 1.0).abs() < 1e-6, "{}", vase.parts[0].volume());
    }

    #[test]
    fn what_was_seen_high_above_a_face_beside_it_stays() {
        let mut pair = board_on_bulge(100);
        // A lug at the far side of the block, away from the board.
        let mut points = pair[0].parts[0].vertices.clone();
        points.push(DVec3::new(0.0, 0.19, 0.56));
        pair[0].parts[0] = convex_hull(&points, 64, 0.0).unwrap();
        let lug = pair[0].parts[0].clone();
        level_faces(&mut pair, &[], 0.0, 64);
        assert_eq!(pair[0].parts[0], lug);
    }
}
