//! Faces on which objects stand on each other. No camera saw them: the lower one's surface is made up there and bulges into the
//! upper one, and what parts the two leaves steps and gaps of millimetres into which a stack would drop.

use crate::contact::{Piece, is_exact, pieces, translate};
use crate::outline::{common, is_within, meet, outline_of, width};
use glamx::{DVec2, DVec3};
use parry3d_f64::query::{Ray, RayCast};
use parry3d_f64::shape::ConvexPolyhedron;
use sms_convex::convex_hull;
use sms_core::{Entity, EntityKind, EntityShape, Mesh};

/// Steps and gaps up to this are mended, metres: more than that was seen, or is another shape.
pub(crate) const REACH_M: f64 = 0.005;
/// What ends lower than this above the floor stands on that, metres.
const OFF_FLOOR_M: f64 = 0.03;
/// What carries another reaches down at least so far below the face, metres.
pub(crate) const BELOW_M: f64 = 0.005;
/// What is narrower from above is a wall's ridge, metres.
const WALL_M: f64 = 0.03;
/// Gaps that physics engines do not notice, metres.
pub(crate) const CLOSED_M: f64 = 1e-5;

/// Closes what is left open between objects that stand on each other, from the lowest up: tops of a carrier's convex pieces that end
/// below the other's bottom are brought up to it; what stands on an exact solid is put down on it.
pub(crate) fn close_gaps(entities: &mut [Entity], floor: f64, max_vertices: usize) {
    let mut order: Vec<usize> = (0..entities.len()).filter(|&i| can_stand(&entities[i], floor)).collect();
    order.sort_by(|&a, &b| bottom(&entities[a]).total_cmp(&bottom(&entities[b])));
    for upper in order {
        let outline = bottom_outline(&entities[upper]);
        if outline.len() < 3 {
            continue;
        }
        let (mut drop, mut limit) = (f64::INFINITY, f64::INFINITY);
        for lower in (0..entities.len()).filter(|&i| i != upper) {
            let height = bottom(&entities[upper]);
            let carrier = &entities[lower];
            if carrier.kind != EntityKind::Dynamic || bottom(carrier) > height - BELOW_M {
                continue;
            }
            if is_exact(carrier) {
                drop = drop.min(gap_over_exact(carrier, &outline, height));
                continue;
            }
            for k in 0..carrier.parts.len() {
                let part = &entities[lower].parts[k];
                let raised = raise_top(part, &outline, height, max_vertices);
                let others =
                    || (0..entities.len()).filter(|&i| i != lower).flat_map(|i| pieces(&entities[i]));
                match raised {
                    // What is beside the other object may be in the way of what comes up.
                    Some(raised) if enters_none(&raised, part, others()) => {
                        entities[lower].parts[k] = raised;
                        drop = 0.0;
                    }
                    _ => limit = limit.min(gap_over(part, &outline, height)),
                }
            }
        }
        let drop = if drop <= REACH_M { drop.min(limit) } else { 0.0 };
        if drop > CLOSED_M {
            translate(&mut entities[upper], DVec3::NEG_Z * drop);
        }
    }
}

/// Whether an object stands on something, and not on the floor. Balls touch at a point, which is seen to elsewhere.
pub(crate) fn can_stand(entity: &Entity, floor: f64) -> bool {
    let is_ball = matches!(entity.shape, EntityShape::Sphere { .. });
    entity.kind == EntityKind::Dynamic && !is_ball && bottom(entity) > floor + OFF_FLOOR_M
}

fn vertices(entity: &Entity) -> Box<dyn Iterator<Item = DVec3> + '_> {
    if is_exact(entity) {
        return Box::new(entity.mesh.vertices.iter().copied());
    }
    Box::new(entity.parts.iter().flat_map(|p| p.vertices.iter().copied()))
}

pub(crate) fn bottom(entity: &Entity) -> f64 {
    vertices(entity).map(|v| v.z).fold(f64::INFINITY, f64::min)
}

/// Convex outline of an object's bottom from above, counterclockwise.
pub(crate) fn bottom_outline(entity: &Entity) -> Vec<DVec2> {
    let low = bottom(entity) + REACH_M;
    outline_of(vertices(entity).filter(|v| v.z < low))
}

/// Whether a point lies under an outline, or beside it by no more than a scan may err.
fn is_under(outline: &[DVec2], p: DVec2) -> bool {
    is_within(outline, p, REACH_M)
}

/// Height of the bottom over an exact solid's top where one is above the other, else infinite; negative where they overlap.
fn gap_over_exact(carrier: &Entity, outline: &[DVec2], height: f64) -> f64 {
    let Some(bounds) = carrier.mesh.aabb() else { return f64::INFINITY };
    let top = outline_of(carrier.mesh.vertices.iter().copied().filter(|v| v.z > bounds.max.z - 1e-3));
    if top.len() >= 3 && meet(&top, outline) { height - bounds.max.z } else { f64::INFINITY }
}

/// Height of the bottom over the corners of a piece that lie under it; infinite where none does.
fn gap_over(part: &Mesh, outline: &[DVec2], height: f64) -> f64 {
    let under = part.vertices.iter().filter(|v| v.z < height + CLOSED_M && is_under(outline, v.truncate()));
    under.map(|v| (height - v.z).max(0.0)).fold(f64::INFINITY, f64::min)
}

/// Whether a piece that was raised is in no other one that it was not in before.
fn enters_none(raised: &Mesh, before: &Mesh, mut others: impl Iterator<Item = Piece>) -> bool {
    let (Some(raised), Some(before)) = (Piece::of(raised), Piece::of(before)) else { return false };
    others.all(|other| raised.depth_in(&other) <= before.depth_in(&other) + CLOSED_M)
}

/// Brings what of a piece's top lies under the outline, and at most [`REACH_M`] below `height`, up to it: its corners there, and
/// the places where its top passes from under the outline (a wall's ridge that runs on has no corner there).
fn raise_top(part: &Mesh, outline: &[DVec2], height: f64, max_vertices: usize) -> Option<Mesh> {
    let is_near = |z: f64| z > height - REACH_M && z < height + CLOSED_M;
    let is_raised = |v: &DVec3| is_near(v.z) && is_under(outline, v.truncate());
    let corners: Vec<DVec3> =
        part.vertices.iter().filter(|v| is_raised(v)).map(|v| v.with_z(height)).collect();
    let shape = ConvexPolyhedron::from_convex_mesh(part.vertices.clone(), &part.triangles)?;
    let top = |p: DVec2| {
        let down = Ray::new(p.extend(height + 1.0), DVec3::NEG_Z);
        shape.cast_local_ray(&down, 2.0, true).map(|t| height + 1.0 - t)
    };
    let high = outline_of(part.vertices.iter().copied().filter(|v| v.z > height - 2.0 * REACH_M));
    // Of a wide top what is beside the other object was seen, and would be lifted with it.
    let crossings = if width(&high) < WALL_M { common(&high, outline) } else { Vec::new() };
    let crossings = crossings.into_iter().filter(|&p| top(p).is_some_and(is_near));
    let crossings: Vec<DVec3> = crossings.map(|p| p.extend(height)).collect();
    // A corner or an edge alone is a detail, no face.
    if corners.len() + crossings.len() < 3 {
        return None;
    }
    let kept = part.vertices.iter().filter(|v| !is_raised(v)).copied();
    let raised: Vec<DVec3> = kept.chain(corners).chain(crossings).collect();
    convex_hull(&raised, max_vertices, 1e-6)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use glamx::DPose3;
    use sms_core::PointCloud;

    pub(crate) fn entity(name: &str, mesh: Mesh, shape: EntityShape) -> Entity {
        let parts = if shape.is_primitive() { Vec::new() } else { vec![mesh.clone()] };
        Entity {
            label: 1,
            name: name.into(),
            description: String::new(),
            kind: EntityKind::Dynamic,
            shape,
            cloud: PointCloud::default(),
            mesh,
            texture: None,
            parts,
            observed_share: 1.0,
            residual_m: 0.0,
            mean_color: [0; 3],
        }
    }

    fn cuboid(name: &str, half: DVec3, center: DVec3, exact: bool) -> Entity {
        let x_ws = DPose3::from_translation(center);
        let mesh = Mesh::cuboid(half).transformed(&x_ws);
        let shape = if exact { EntityShape::Box { x_ws, half_extents: half } } else { EntityShape::Convex };
        entity(name, mesh, shape)
    }

    #[test]
    fn a_step_below_a_box_is_filled_and_what_was_seen_beside_it_stays() {
        // A stool whose top ends 1.7 mm below the box on one side, 2.5 mm on the other.
        let mut stool = cuboid("stool", DVec3::new(0.2, 0.2, 0.3), DVec3::Z * 0.3, false);
        for v in stool.parts[0].vertices.iter_mut().filter(|v| v.z > 0.5) {
            v.z -= if v.x > 0.0 { 0.0017 } else { 0.0025 };
        }
        let mut all = [stool, cuboid("box", DVec3::new(0.3, 0.3, 0.05), DVec3::new(0.0, 0.0, 0.65), true)];
        close_gaps(&mut all, 0.0, 64);
        let top: Vec<DVec3> = all[0].parts[0].vertices.iter().filter(|v| v.z > 0.5).copied().collect();
        assert!(top.len() == 4 && top.iter().all(|v| (v.z - 0.6).abs() < 1e-12), "{top:?}");
        assert!(all[0].parts[0].is_closed_oriented() && (bottom(&all[1]) - 0.6).abs() < 1e-12);

        // Beside the box the top is as it was seen.
        let wide = cuboid("table", DVec3::new(0.5, 0.5, 0.299), DVec3::Z * 0.299, false);
        let mut all =
            [wide.clone(), cuboid("box", DVec3::new(0.1, 0.1, 0.05), DVec3::new(0.0, 0.0, 0.65), true)];
        close_gaps(&mut all, 0.0, 64);
        assert_eq!(all[0], wide);
    }

    #[test]
    fn a_top_is_not_raised_into_what_stands_beside() {
        // A round table 3 mm below a box at its rim; raised there it would be in a box in its middle.
        let rim = |z: f64| {
            (0..32).map(move |k| {
                let (sin, cos) = (std::f64::consts::TAU / 32.0 * f64::from(k)).sin_cos();
                DVec3::new(0.5 * cos, 0.5 * sin, z)
            })
        };
        let top = convex_hull(&rim(0.0).chain(rim(0.597)).collect::<Vec<_>>(), 64, 0.0).unwrap();
        let table = entity("table", top, EntityShape::Convex);
        let at_rim = cuboid("box", DVec3::splat(0.15), DVec3::new(0.5, 0.0, 0.75), true);
        let middle = cuboid("vase", DVec3::splat(0.1), DVec3::Z * 0.697, true);
        let mut all = [table.clone(), at_rim.clone(), middle.clone()];
        close_gaps(&mut all, 0.0, 64);
        assert_eq!(all, [table.clone(), at_rim.clone(), middle]);
        let mut all = [table.clone(), at_rim];
        close_gaps(&mut all, 0.0, 64);
        assert!(all[0] != table, "without it nothing is in the way");
    }

    #[test]
    fn planks_that_cross_are_put_down_on_each_other_and_not_through_a_ridge() {
        // Neither has a corner over the other one.
        let low = cuboid("low", DVec3::new(0.3, 0.02, 0.1), DVec3::Z * 0.1, true);
        let high = cuboid("high", DVec3::new(0.02, 0.3, 0.01), DVec3::Z * 0.214, true);
        let mut all = [low.clone(), high.clone()];
        close_gaps(&mut all, 0.0, 64);
        assert!((bottom(&all[1]) - 0.2).abs() < 1e-9);
        // A peak 1 mm below carries it before the plank does.
        let mut peak = cuboid("peak", DVec3::new(0.01, 0.01, 0.05), DVec3::new(0.0, 0.2, 0.05), false);
        peak.parts[0].vertices.push(DVec3::new(0.0, 0.2, 0.203));
        peak.parts[0] = convex_hull(&peak.parts[0].vertices, 64, 0.0).unwrap();
        let mut all = [low, high, peak];
        close_gaps(&mut all, 0.0, 64);
        assert!((bottom(&all[1]) - 0.203).abs() < 1e-9, "{}", bottom(&all[1]));
    }

    #[test]
    fn a_wall_that_runs_on_beyond_a_board_carries_it_where_they_cross() {
        // A wall of 8 mm along x, 2 mm too low, whose corners all lie beyond the board across it.
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
        // Ten centimetres of air are no error of a scan, and neighbours do not carry.
        let high = cuboid("lamp", DVec3::splat(0.05), DVec3::Z * 0.55, true);
        let beside = cuboid("shelf", DVec3::splat(0.05), DVec3::new(0.5, 0.0, 0.452), true);
        let mut all =
            [high.clone(), beside.clone(), cuboid("crate", DVec3::splat(0.2), DVec3::Z * 0.2, true)];
        close_gaps(&mut all, 0.0, 64);
        assert_eq!((&all[0], &all[1]), (&high, &beside));
    }
}
