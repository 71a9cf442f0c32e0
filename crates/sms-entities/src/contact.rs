//! Contact repair between objects. Overlapping collision shapes would push each other apart in the first simulation
//! step.

use crate::piece::{are_apart, bounds, cut, is_exact, is_thick, overlap, piece_count, translate};
use crate::standing::{LevelFace, bottom_outline, can_carry, reaches_beside};
use glamx::DVec3;
use sms_core::{Entity, EntityKind, Mesh};

/// If this much overlap remains after cutting, a piece is dropped, metres.
const GIVE_UP: f64 = 0.001;

/// Smallest cosine between the vertical and the normal of two pieces that overlap at a contact face.
const ALONG: f64 = 0.8;
/// Largest distance between the middle of such an overlap and the height of the face, metres.
const AT_FACE_M: f64 = 0.02;

/// Two overlapping objects, by index, and the depth of the overlap (metres).
pub(crate) struct ObjectOverlap {
    pub(crate) first: usize,
    pub(crate) second: usize,
    pub(crate) depth: f64,
    /// Remaining depth. Exact solids that overlap by more than a scan error are not moved.
    pub(crate) left: f64,
}

/// Cuts the convex parts of dynamic objects along a plane between them wherever they overlap. Contact faces then meet
/// without overlap and without a gap. An exact solid keeps its shape, and the other side is cut. Where one object
/// stands on the other with a level face, the cut is at that face. Returns overlaps deeper than `report` metres.
pub(crate) fn part_objects(
    entities: &mut [Entity],
    faces: &[LevelFace],
    max_vertices: usize,
    report: f64,
) -> Vec<ObjectOverlap> {
    let mut found = Vec::new();
    for second in 0..entities.len() {
        for first in 0..second {
            let depth = part_pair(entities, first, second, faces, max_vertices);
            if depth > report {
                let left = left_overlap(&entities[first], &entities[second]);
                found.push(ObjectOverlap { first, second, depth, left });
            }
        }
    }
    found
}

/// Returns the height at which one of two objects stands on the other, and whether the second one stands on the first.
fn level_between(
    entities: &[Entity],
    faces: &[LevelFace],
    first: usize,
    second: usize,
) -> Option<(f64, bool)> {
    let stands = |upper: usize, lower: usize| {
        let face = faces.iter().find(|f| f.upper == upper)?;
        can_carry(&entities[lower], face.height).then_some(face.height)
    };
    let over = stands(second, first).map(|height| (height, true));
    over.or_else(|| stands(first, second).map(|height| (height, false)))
}

fn part_pair(
    entities: &mut [Entity],
    first: usize,
    second: usize,
    faces: &[LevelFace],
    max_vertices: usize,
) -> f64 {
    let level = level_between(entities, faces, first, second);
    let foot = level
        .map(|(_, second_is_upper)| bottom_outline(&entities[if second_is_upper { second } else { first }]));
    let (left, right) = entities.split_at_mut(second);
    let (a, b) = (&mut left[first], &mut right[0]);
    let either_moves = a.kind == EntityKind::Dynamic || b.kind == EntityKind::Dynamic;
    let apart = match (bounds(a), bounds(b)) {
        (Some(p), Some(q)) => are_apart(&p, &q),
        _ => true,
    };
    if !either_moves || apart {
        return 0.0;
    }
    let mut deepest = 0.0f64;
    for i in 0..piece_count(a) {
        for j in 0..piece_count(b) {
            // Each cut reduces the overlap along one direction; a few suffice for convex pieces.
            for _ in 0..4 {
                let Some((normal, on_a, on_b)) = overlap(a, i, b, j) else { break };
                let depth = (on_a - on_b).dot(normal);
                deepest = deepest.max(depth);
                let middle = match (is_exact(a), is_exact(b)) {
                    (true, true) => {
                        move_apart(a, b, normal * depth);
                        break;
                    }
                    (true, false) => on_a,
                    (false, true) => on_b,
                    (false, false) => 0.5 * (on_a + on_b),
                };
                let between = (normal, normal.dot(middle));
                let at_face = level.and_then(|(height, second_is_upper)| {
                    let up = if second_is_upper { DVec3::Z } else { DVec3::NEG_Z };
                    let end = if is_exact(a) || is_exact(b) { middle.z } else { height };
                    let is_at_face = (middle.z - height).abs() < AT_FACE_M && normal.dot(up) > ALONG;
                    let lower = if second_is_upper { (&*a, i) } else { (&*b, j) };
                    let foot = foot.as_deref().unwrap_or_default();
                    let ends_there =
                        is_exact(lower.0) || !reaches_beside(&lower.0.parts[lower.1], foot, height, 0.0);
                    (is_at_face && ends_there).then_some((up, up.z * end))
                });
                let is_cut = at_face
                    .is_some_and(|plane| cut_both_or_neither((a, i), (b, j), plane, max_vertices))
                    || cut_both((a, i), (b, j), between, max_vertices);
                if !is_cut {
                    break;
                }
            }
            if overlap(a, i, b, j).is_some_and(|(normal, on_a, on_b)| (on_a - on_b).dot(normal) > GIVE_UP) {
                give_up_smaller(a, i, b, j);
            }
        }
    }
    for entity in [a, b] {
        entity.parts.retain(|p| !p.triangles.is_empty());
        // Drops slivers that are too thin for engines, unless the object has no other parts.
        if entity.parts.iter().any(is_thick) {
            entity.parts.retain(is_thick);
        }
    }
    deepest
}

/// Cuts two pieces along a plane (normal and offset) between them; exact solids are not cut. Returns whether enough is
/// left of both.
fn cut_both(
    (a, i): (&mut Entity, usize),
    (b, j): (&mut Entity, usize),
    (normal, offset): (DVec3, f64),
    max_vertices: usize,
) -> bool {
    let cut_a = is_exact(a) || cut(&mut a.parts[i], normal, offset, max_vertices);
    let cut_b = is_exact(b) || cut(&mut b.parts[j], -normal, -offset, max_vertices);
    cut_a && cut_b
}

/// Like [`cut_both`], but changes nothing if too little of one piece would be left. A level cut of only one piece would
/// lead to another cut of the same piece.
fn cut_both_or_neither(
    (a, i): (&mut Entity, usize),
    (b, j): (&mut Entity, usize),
    (normal, offset): (DVec3, f64),
    max_vertices: usize,
) -> bool {
    let before = a.parts.get(i).cloned();
    if !(is_exact(a) || cut(&mut a.parts[i], normal, offset, max_vertices)) {
        return false;
    }
    let is_cut = is_exact(b) || cut(&mut b.parts[j], -normal, -offset, max_vertices);
    if let (false, Some(part)) = (is_cut, before) {
        a.parts[i] = part;
    }
    is_cut
}

/// Largest distance by which an exact solid is moved out of another, metres.
const LARGEST_MOVE: f64 = 0.005;

/// Moves the smaller of two movable exact solids until they touch. Both stay in place if the distance is too large.
fn move_apart(a: &mut Entity, b: &mut Entity, b_from_a: DVec3) {
    if b_from_a.length() > LARGEST_MOVE {
        return;
    }
    let is_free = |e: &Entity| e.kind == EntityKind::Dynamic;
    let a_goes = is_free(a) && (!is_free(b) || a.mesh.volume() < b.mesh.volume());
    if a_goes {
        translate(a, -b_from_a);
    } else if is_free(b) {
        translate(b, b_from_a);
    }
}

/// Returns the deepest overlap of two objects, metres.
fn left_overlap(a: &Entity, b: &Entity) -> f64 {
    let pairs = (0..piece_count(a)).flat_map(|i| (0..piece_count(b)).map(move |j| (i, j)));
    let depths = pairs.filter_map(|(i, j)| overlap(a, i, b, j)).map(|(n, p, q)| (p - q).dot(n));
    depths.fold(0.0, f64::max)
}

/// Drops the smaller of two inseparable convex parts, unless it is its object's last.
fn give_up_smaller(a: &mut Entity, i: usize, b: &mut Entity, j: usize) {
    let volume = |e: &Entity, k: usize| if is_exact(e) { f64::INFINITY } else { e.parts[k].volume() };
    let others = |e: &Entity| e.parts.iter().filter(|p| !p.triangles.is_empty()).count() > 1;
    let first_goes = others(a) && (volume(a, i) <= volume(b, j) || !others(b));
    if first_goes {
        a.parts[i] = Mesh::default();
    } else if others(b) {
        b.parts[j] = Mesh::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DPose3;
    use sms_core::{EntityShape, PointCloud};

    fn entity(center: DVec3, half: f64, radius: Option<f64>) -> Entity {
        let mut mesh = Mesh::cuboid(DVec3::splat(radius.unwrap_or(half)));
        mesh.vertices.iter_mut().for_each(|v| *v += center);
        Entity {
            label: 1,
            name: "a".into(),
            description: String::new(),
            kind: EntityKind::Dynamic,
            shape: match radius {
                Some(radius) => EntityShape::Sphere { center_w: center, radius },
                None => EntityShape::Convex,
            },
            cloud: PointCloud::default(),
            parts: if radius.is_some() { Vec::new() } else { vec![mesh.clone()] },
            mesh,
            texture: None,
            observed_share: 1.0,
            residual_m: 0.0,
            mean_color: [0; 3],
        }
    }

    #[test]
    fn overlapping_boxes_meet_in_the_middle() {
        let mut pair = [entity(DVec3::ZERO, 0.05, None), entity(DVec3::new(0.096, 0.01, 0.003), 0.05, None)];
        let found = part_objects(&mut pair, &[], 64, 0.001);
        assert!((found[0].depth - 0.004).abs() < 1e-9);
        let (left, right) = (pair[0].parts[0].aabb().unwrap(), pair[1].parts[0].aabb().unwrap());
        assert!((left.max.x - 0.048).abs() < 1e-6 && (right.min.x - 0.048).abs() < 1e-6);
        assert!(pair.iter().all(|e| e.parts[0].is_closed_oriented()));
        assert!(part_objects(&mut pair, &[], 64, 1e-4).is_empty());
    }

    #[test]
    fn exact_solids_are_moved_apart_by_what_a_scan_may_err() {
        let ball = entity(DVec3::ZERO, 0.0, Some(0.03));
        let mut carton = entity(DVec3::new(0.077, 0.0, 0.0), 0.05, None);
        let x_ws = DPose3::from_translation(DVec3::new(0.077, 0.0, 0.0));
        carton.shape = EntityShape::Box { x_ws, half_extents: DVec3::splat(0.05) };
        carton.parts.clear();
        let mut pair = [ball, carton];
        let found = part_objects(&mut pair, &[], 64, 0.001);
        assert!((found[0].depth - 0.003).abs() < 1e-9 && found[0].left < 2e-5, "{}", found[0].left);
        let EntityShape::Sphere { center_w, .. } = pair[0].shape else { panic!() };
        assert!((center_w.x + 0.003).abs() < 1e-6, "the smaller one gives way: {center_w}");
        assert!((pair[0].mesh.aabb().unwrap().center() - center_w).length() < 1e-9);
        // An overlap of centimetres is reported: it is larger than a scan error.
        translate(&mut pair[0], DVec3::X * 0.02);
        let found = part_objects(&mut pair, &[], 64, 0.001);
        assert!((found[0].left - 0.02).abs() < 1e-4, "{}", found[0].left);
    }

    #[test]
    fn what_reaches_up_beside_a_level_face_is_parted_where_it_is_deepest() {
        // Beside the block, its carrier rises 3 cm above the face. The slope begins inside the block.
        let block = entity(DVec3::new(0.0, 0.0, 0.15), 0.05, None);
        let mut carrier = entity(DVec3::new(0.05, 0.0, 0.05), 0.05, None);
        for v in &mut carrier.parts[0].vertices {
            let far = v.x > 0.05;
            v.x = if far { 0.15 } else { -0.05 };
            v.z = if v.z < 0.05 {
                0.0
            } else if far {
                0.13
            } else {
                0.102
            };
        }
        let faces = [LevelFace { upper: 0, height: 0.1 }];
        let mut pair = [block.clone(), carrier];
        part_objects(&mut pair, &faces, 64, 1e-4);
        let top = pair[1].parts[0].aabb().unwrap().max.z;
        assert!(top > 0.115 && top < 0.13, "{top}");
        // A lid of 4 mm that bulges 15 mm above the face: a level cut would leave too little.
        let mut lid = entity(DVec3::ZERO, 0.05, None);
        lid.parts[0].vertices.iter_mut().for_each(|v| v.z = if v.z > 0.0 { 0.115 } else { 0.097 });
        let mut pair = [block, lid];
        part_objects(&mut pair, &faces, 64, 1e-4);
        let (upper, lower) = (pair[0].parts[0].aabb().unwrap(), pair[1].parts[0].aabb().unwrap());
        assert!((upper.min.z - lower.max.z).abs() < 1e-6 && lower.max.z > 0.1, "{lower:?}");
    }

    #[test]
    fn pieces_that_were_moved_out_of_their_mesh_are_parted() {
        let mut pair = [entity(DVec3::ZERO, 0.05, None), entity(DVec3::X * 0.104, 0.05, None)];
        pair[1].parts[0].vertices.iter_mut().for_each(|v| v.x -= 0.008);
        let found = part_objects(&mut pair, &[], 64, 0.001);
        assert!(found.len() == 1 && (found[0].depth - 0.004).abs() < 1e-9);
    }

    #[test]
    fn a_box_gives_way_to_a_ball() {
        let mut pair =
            [entity(DVec3::ZERO, 0.05, None), entity(DVec3::new(0.077, 0.0, 0.0), 0.0, Some(0.03))];
        part_objects(&mut pair, &[], 64, 0.0);
        assert!((pair[0].parts[0].aabb().unwrap().max.x - 0.047).abs() < 1e-6);
        assert!(matches!(pair[1].shape, EntityShape::Sphere { radius: 0.03, .. }));
    }
}
