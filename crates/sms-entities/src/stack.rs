//! Gaps between stacked objects. No camera saw the faces on which objects stand: the lower surface is extrapolated and
//! bulges into the upper one. Cutting the two apart leaves steps and gaps of millimetres, and the stack would drop into
//! them.

use crate::piece::{CollisionPiece, is_exact, pieces_near, translate};
use crate::standing::{
    CLOSED_M, PieceColumn, REACH_M, bottom, bottom_outline, can_carry, corners_of_faces, standing, under,
};
use glamx::{DVec2, DVec3};
use sms_core::{Entity, Mesh};
use sms_mesh::{
    convex_hull,
    outline::{common, is_within, meet, outline_of, width},
};

/// Smallest upward component of the normal of a hull's top faces; both sides of a ridge are included.
const UP: f64 = 0.1;
/// A piece that is narrower than this from above is a wall with a ridge, metres.
const WALL_M: f64 = 0.03;
/// Closes gaps between objects that stand on each other, from the lowest up. If a convex piece of a carrier ends below
/// the upper object, its top is raised. An object on an exact solid, or on the middle of a wide top, is lowered
/// instead.
pub(crate) fn close_gaps(entities: &mut [Entity], floor: f64, max_vertices: usize) {
    for upper in standing(entities, floor) {
        let outline = bottom_outline(&entities[upper]);
        if outline.len() < 3 {
            continue;
        }
        let (mut drop, mut limit) = (f64::INFINITY, f64::INFINITY);
        for lower in (0..entities.len()).filter(|&i| i != upper) {
            let height = bottom(&entities[upper]);
            let carrier = &entities[lower];
            if !can_carry(carrier, height) {
                continue;
            }
            if is_exact(carrier) {
                drop = drop.min(gap_over_exact(carrier, &outline, height));
                continue;
            }
            for k in 0..carrier.parts.len() {
                let part = &entities[lower].parts[k];
                let raised = raise_top(part, &outline, height, max_vertices);
                // The raised top may collide with a neighbour.
                if let Some(raised) = raised.filter(|r| enters_none(r, part, lower, entities)) {
                    entities[lower].parts[k] = raised;
                    drop = 0.0;
                } else if let Some((gap, is_in_the_middle)) = gap_over(part, &outline, height) {
                    // An object that extends over a lower one is supported elsewhere.
                    limit = limit.min(gap);
                    drop = if is_in_the_middle { drop.min(gap) } else { drop };
                }
            }
        }
        let drop = if drop <= REACH_M { drop.min(limit) } else { 0.0 };
        if drop > CLOSED_M {
            translate(&mut entities[upper], DVec3::NEG_Z * drop);
        }
    }
}

/// Returns whether a point lies under an outline, or beside it within the error of a scan.
fn is_under(outline: &[DVec2], p: DVec2) -> bool {
    is_within(outline, p, REACH_M)
}

/// Returns the height of the bottom above an exact solid's top: infinite if they are not above each other, negative if
/// they overlap.
fn gap_over_exact(carrier: &Entity, outline: &[DVec2], height: f64) -> f64 {
    let Some(bounds) = carrier.mesh.aabb() else { return f64::INFINITY };
    let top = outline_of(carrier.mesh.vertices.iter().copied().filter(|v| v.z > bounds.max.z - 1e-3));
    if top.len() >= 3 && meet(&top, outline) { height - bounds.max.z } else { f64::INFINITY }
}

/// Returns the height of the bottom above the part of a piece under it, and whether this part is under the middle of
/// the outline. Returns `None` if no part is under it.
fn gap_over(part: &Mesh, outline: &[DVec2], height: f64) -> Option<(f64, bool)> {
    let under = under(part, outline);
    let top = under.iter().map(|p| p.z).reduce(f64::max)?;
    let near = outline_of(under.into_iter().filter(|p| p.z > top - REACH_M));
    let middle = outline.iter().sum::<DVec2>() / outline.len() as f64;
    Some(((height - top).max(0.0), is_within(&near, middle, 0.0)))
}

/// Returns whether a raised piece overlaps every other object's piece no more than before.
fn enters_none(raised: &Mesh, before: &Mesh, own: usize, entities: &[Entity]) -> bool {
    let (Some(space), Some(raised), Some(before)) =
        (raised.aabb(), CollisionPiece::of(raised), CollisionPiece::of(before))
    else {
        return false;
    };
    let others = (0..entities.len()).filter(|&i| i != own);
    others
        .flat_map(|i| pieces_near(&entities[i], &space))
        .all(|other| raised.depth_in(&other) <= before.depth_in(&other) + CLOSED_M)
}

/// Raises a piece's top under the outline to `height` if it is at most [`REACH_M`] lower. This moves corners of the
/// piece, and adds points where its top crosses the outline (the ridge of a wall has no corner there).
fn raise_top(part: &Mesh, outline: &[DVec2], height: f64, max_vertices: usize) -> Option<Mesh> {
    let is_near = |z: f64| z > height - REACH_M && z < height + CLOSED_M;
    // The underside of a thin piece may be as close; it is kept.
    let looks_up = corners_of_faces(part, |up| up > UP);
    let is_raised = |v: &DVec3, up: bool| up && is_near(v.z) && is_under(outline, v.truncate());
    let (corners, kept): (Vec<_>, Vec<_>) =
        part.vertices.iter().copied().zip(looks_up).partition(|(v, up)| is_raised(v, *up));
    let corners: Vec<DVec3> = corners.into_iter().map(|(v, _)| v).collect();
    let column = PieceColumn::of(part)?;
    let top = |p: DVec2| column.top(p, height + 1.0);
    let high = outline_of(part.vertices.iter().copied().filter(|v| v.z > height - 2.0 * REACH_M));
    // A wide top was seen beside the upper object; crossings would lift its seen part.
    let crossings = if width(&high) < WALL_M { common(&high, outline) } else { Vec::new() };
    let crossings = crossings.into_iter().filter(|&p| top(p).is_some_and(is_near));
    let crossings: Vec<DVec3> = crossings.map(|p| p.extend(height)).collect();
    // A single corner or edge is a detail instead of a face.
    if corners.len() + crossings.len() < 3 {
        return None;
    }
    if crossings.is_empty() && corners.iter().all(|v| (v.z - height).abs() <= CLOSED_M) {
        return Some(part.clone());
    }
    let corners = corners.into_iter().map(|v| v.with_z(height));
    let raised: Vec<DVec3> = kept.into_iter().map(|(v, _)| v).chain(corners).chain(crossings).collect();
    convex_hull(&raised, max_vertices, 1e-6)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::entity;
    use glamx::DPose3;
    use sms_core::EntityShape;

    fn cuboid(name: &str, half: DVec3, center: DVec3, exact: bool) -> Entity {
        let x_ws = DPose3::from_translation(center);
        let mesh = Mesh::cuboid(half).transformed(&x_ws);
        let shape = if exact { EntityShape::Box { x_ws, half_extents: half } } else { EntityShape::Convex };
        entity(name, mesh, shape)
    }

    #[test]
    fn a_step_below_a_box_is_filled_and_what_was_seen_beside_it_stays() {
        // A stool with a top that ends 1.7 mm below the box on one side and 2.5 mm on the other.
        let mut stool = cuboid("stool", DVec3::new(0.2, 0.2, 0.3), DVec3::Z * 0.3, false);
        for v in stool.parts[0].vertices.iter_mut().filter(|v| v.z > 0.5) {
            v.z -= if v.x > 0.0 { 0.0017 } else { 0.0025 };
        }
        let mut all = [stool, cuboid("box", DVec3::new(0.3, 0.3, 0.05), DVec3::new(0.0, 0.0, 0.65), true)];
        close_gaps(&mut all, 0.0, 64);
        let top: Vec<DVec3> = all[0].parts[0].vertices.iter().filter(|v| v.z > 0.5).copied().collect();
        assert!(top.len() == 4 && top.iter().all(|v| (v.z - 0.6).abs() < 1e-12), "{top:?}");
        assert!(all[0].parts[0].is_closed_oriented() && (bottom(&all[1]) - 0.6).abs() < 1e-12);

        // Beside the box, the top keeps its seen height.
        let wide = cuboid("table", DVec3::new(0.5, 0.5, 0.299), DVec3::Z * 0.299, false);
        let mut all =
            [wide.clone(), cuboid("box", DVec3::new(0.1, 0.1, 0.05), DVec3::new(0.0, 0.0, 0.65), true)];
        close_gaps(&mut all, 0.0, 64);
        assert_eq!(all[0], wide);
        assert!((bottom(&all[1]) - 0.598).abs() < 1e-9, "it is put down instead");
    }

    #[test]
    fn a_top_is_not_raised_into_what_stands_beside() {
        // A round table 3 mm below a box at its rim. If raised there, it would overlap a box in its middle.
        let rim = |z: f64| {
            (0..32).map(move |k| {
                let (sin, cos) = (std::f64::consts::TAU / 32.0 * f64::from(k)).sin_cos();
                DVec3::new(0.5 * cos, 0.5 * sin, z)
            })
        };
        let top = convex_hull(&rim(0.0).chain(rim(0.597)).collect::<Vec<_>>(), 64, 0.0).unwrap();
        let table = entity("table", top, EntityShape::Convex);
        let at_rim = cuboid("box", DVec3::splat(0.15), DVec3::new(0.55, 0.0, 0.75), true);
        let middle = cuboid("vase", DVec3::splat(0.1), DVec3::Z * 0.697, true);
        let mut all = [table.clone(), at_rim.clone(), middle.clone()];
        close_gaps(&mut all, 0.0, 64);
        assert!(all[0] == table && all[2] == middle);
        assert!((bottom(&all[1]) - 0.6).abs() < 1e-9, "its middle is beyond the rim");
        let mut all = [table.clone(), at_rim];
        close_gaps(&mut all, 0.0, 64);
        assert!(all[0] != table, "without it nothing is in the way");
    }

    #[test]
    fn planks_that_cross_are_put_down_on_each_other_and_not_through_a_ridge() {
        // Neither object has a corner over the other one.
        let low = cuboid("low", DVec3::new(0.3, 0.02, 0.1), DVec3::Z * 0.1, true);
        let high = cuboid("high", DVec3::new(0.02, 0.3, 0.01), DVec3::Z * 0.214, true);
        let mut all = [low.clone(), high.clone()];
        close_gaps(&mut all, 0.0, 64);
        assert!((bottom(&all[1]) - 0.2).abs() < 1e-9);
        // A peak 1 mm below the box carries it before the plank does.
        let mut peak = cuboid("peak", DVec3::new(0.01, 0.01, 0.05), DVec3::new(0.0, 0.2, 0.05), false);
        peak.parts[0].vertices.push(DVec3::new(0.0, 0.2, 0.203));
        peak.parts[0] = convex_hull(&peak.parts[0].vertices, 64, 0.0).unwrap();
        let mut all = [low, high, peak];
        close_gaps(&mut all, 0.0, 64);
        assert!((bottom(&all[1]) - 0.203).abs() < 1e-9, "{}", bottom(&all[1]));
    }

    #[test]
    fn a_thin_slab_keeps_its_underside() {
        let mut slab = cuboid("stool", DVec3::new(0.1, 0.1, 0.002), DVec3::Z * 0.497, false);
        slab.parts.extend(cuboid("leg", DVec3::new(0.02, 0.02, 0.24), DVec3::Z * 0.24, false).parts);
        let board = cuboid("board", DVec3::new(0.5, 0.5, 0.01), DVec3::new(0.25, 0.0, 0.51), false);
        let mut all = [slab.clone(), board];
        close_gaps(&mut all, 0.0, 64);
        let (raised, before) = (&all[0].parts[0], &slab.parts[0]);
        assert!(raised.volume() > before.volume(), "{}", raised.volume() / before.volume());
        assert_eq!(raised.aabb().unwrap().min, before.aabb().unwrap().min);
        assert!((raised.aabb().unwrap().max.z - 0.5).abs() < 1e-12);
    }

    #[test]
    fn a_turned_wall_carries_a_board_where_they_cross() {
        let turn = glamx::DQuat::from_rotation_z(0.5);
        let wall = Mesh::cuboid(DVec3::new(0.3, 0.004, 0.149));
        let wall = wall.transformed(&DPose3::from_parts(DVec3::Z * 0.149, turn));
        let wall = entity("wall", wall, EntityShape::Convex);
        let board = cuboid("board", DVec3::new(0.1, 0.4, 0.01), DVec3::new(0.0, 0.0, 0.31), false);
        let mut all = [wall, board];
        close_gaps(&mut all, 0.0, 64);
        let part = &all[0].parts[0];
        let face: Vec<DVec3> = part.vertices.iter().copied().filter(|v| (v.z - 0.3).abs() < 1e-9).collect();
        assert!(face.len() >= 4 && face.iter().all(|v| v.x.abs() < 0.1 + 1e-9), "{face:?}");
    }

    #[test]
    fn a_wall_that_runs_on_beyond_a_board_carries_it_where_they_cross() {
        // A wall of 8 mm along x, 2 mm too low. All its corners lie beyond the board, which crosses it.
        let wall = cuboid("wall", DVec3::new(0.3, 0.004, 0.149), DVec3::Z * 0.149, false);
        let board = cuboid("board", DVec3::new(0.1, 0.4, 0.01), DVec3::new(0.0, 0.0, 0.31), false);
        let mut all = [wall, board];
        close_gaps(&mut all, 0.0, 64);
        let part = &all[0].parts[0];
        let face: Vec<DVec3> = part.vertices.iter().copied().filter(|v| (v.z - 0.3).abs() < 1e-12).collect();
        assert!(face.len() >= 4 && face.iter().all(|v| v.x.abs() < 0.1 + 1e-9), "{face:?}");
        assert!(face.iter().any(|v| v.x > 0.099) && face.iter().any(|v| v.x < -0.099));
        assert!(part.is_closed_oriented() && (part.aabb().unwrap().max.x - 0.3).abs() < 1e-12);
    }

    #[test]
    fn exact_solids_are_put_down_on_each_other_from_the_lowest_up() {
        let mut all = [
            cuboid("ballast", DVec3::splat(0.04), DVec3::new(0.1, 0.0, 0.464), true),
            cuboid("board", DVec3::new(0.3, 0.1, 0.01), DVec3::new(0.1, 0.0, 0.4125), true),
            cuboid("crate", DVec3::splat(0.2), DVec3::Z * 0.2, true),
        ];
        close_gaps(&mut all, 0.0, 64);
        let heights: Vec<f64> = all.iter().map(bottom).collect();
        assert!((heights[1] - 0.4).abs() < 1e-9 && (heights[0] - 0.42).abs() < 1e-9, "{heights:?}");
        assert_eq!(heights[2], 0.0);
        // A gap of ten centimetres is not a scan error, and objects side by side do not carry each other.
        let high = cuboid("lamp", DVec3::splat(0.05), DVec3::Z * 0.55, true);
        let beside = cuboid("shelf", DVec3::splat(0.05), DVec3::new(0.5, 0.0, 0.452), true);
        let mut all =
            [high.clone(), beside.clone(), cuboid("crate", DVec3::splat(0.2), DVec3::Z * 0.2, true)];
        close_gaps(&mut all, 0.0, 64);
        assert_eq!((&all[0], &all[1]), (&high, &beside));
    }
}
