//! Rims that carry: of an open container under a board cameras see the rim's sides, never its top, and a mesh of so thin a wall ends
//! millimetres too low, or nowhere. What lies on it would tip over the part of the rim that is left.

use crate::contact::{Piece, is_exact, pieces_near};
use crate::grid::PointGrid;
use crate::outline::{convex_outline, is_within, outline_of, width};
use crate::stack::{CLOSED_M, REACH_M, bottom, bottom_outline, can_carry, standing, under};
use crate::support::Surroundings;
use glamx::{DVec2, DVec3};
use sms_convex::convex_hull;
use sms_core::{BACKGROUND, Entity, Mesh};

/// Corners of a lid.
const CORNERS: usize = 24;
/// Thickness of a lid, metres.
const THICK_M: f64 = 0.01;
/// Seen points have so many others within this, metres: else they are noise. Unlabelled ones are the object's this near to it.
const NEIGHBORS: usize = 3;
const NEAR_M: f64 = 0.02;
/// What ends this near to what lies on it bears it, once it has settled, metres.
const TOUCH_M: f64 = 1e-3;
/// A face of contact that reaches as far as what was seen, but for this, is left as it is, metres.
const MISSING_M: f64 = 0.015;
/// Less than this is no face on which something stands, metres.
const NARROW_M: f64 = 0.02;

/// Where an object was seen to reach the underside of what stands on it, and its collision shape does not: adds a convex piece under
/// that underside whose outline is that of the points seen there. For what lies on a rim it is as good as the rim: both bear it within
/// the same outline.
/// Unlabelled surface beside the object counts as its own: masks lose strips between two things.
pub(crate) fn add_lids(entities: &mut [Entity], floor: f64, around: &Surroundings) {
    for upper in standing(entities, floor) {
        let (outline, height) = (bottom_outline(&entities[upper]), bottom(&entities[upper]));
        if outline.len() < 3 {
            continue;
        }
        for lower in (0..entities.len()).filter(|&i| i != upper) {
            let carrier = &entities[lower];
            if is_exact(carrier) || !can_carry(carrier, height) {
                continue;
            }
            let lid =
                missing_lid(carrier, &outline, height, around).filter(|lid| is_clear(lid, lower, entities));
            entities[lower].parts.extend(lid);
        }
    }
}

/// Whether a piece is in none of the others.
fn is_clear(lid: &Mesh, own: usize, entities: &[Entity]) -> bool {
    let (Some(space), Some(lid)) = (lid.aabb(), Piece::of(lid)) else { return false };
    let others = (0..entities.len()).filter(|&i| i != own);
    others
        .flat_map(|i| pieces_near(&entities[i], &space))
        .all(|other| lid.depth_in(&other) <= 10.0 * CLOSED_M)
}

fn missing_lid(carrier: &Entity, outline: &[DVec2], height: f64, around: &Surroundings) -> Option<Mesh> {
    let is_under = |p: &DVec3| is_within(outline, p.truncate(), 0.0);
    let tops = carrier.parts.iter().flat_map(|part| under(part, outline));
    let touching = outline_of(tops.filter(|p| (p.z - height).abs() < TOUCH_M));
    let near = |p: &&DVec3| (p.z - height).abs() < REACH_M && is_under(p);
    let own = PointGrid::new(&carrier.cloud.points_w, NEAR_M);
    let unlabelled =
        around.points.iter().zip(&around.labels).filter(|(_, l)| **l == BACKGROUND).map(|(p, _)| p);
    let beside = unlabelled.filter(near).filter(|p| own.is_near(**p, NEAR_M));
    let seen: Vec<DVec3> = carrier.cloud.points_w.iter().filter(near).chain(beside).copied().collect();
    let grid = PointGrid::new(&seen, NEAR_M);
    // Itself is among them.
    let kept = |p: &&DVec3| grid.within(**p, NEAR_M).len() > NEIGHBORS;
    let rim: Vec<DVec2> = seen.iter().filter(kept).map(|p| p.truncate()).chain(touching.clone()).collect();
    let rim = convex_outline(&rim);
    let is_missing = touching.len() < 3 || rim.iter().any(|&p| !is_within(&touching, p, MISSING_M));
    if rim.len() < 3 || width(&rim) < NARROW_M || !is_missing {
        return None;
    }
    // The farthest in so many directions.
    let extreme = |k: usize| {
        let (sin, cos) = (std::f64::consts::TAU * k as f64 / CORNERS as f64).sin_cos();
        rim.iter().copied().max_by(|a, b| {
            let along = |p: &DVec2| cos * p.x + sin * p.y;
            along(a).total_cmp(&along(b))
        })
    };
    let lid = convex_outline(&(0..CORNERS).filter_map(extreme).collect::<Vec<_>>());
    let both = lid.iter().flat_map(|p| [p.extend(height), p.extend(height - THICK_M)]);
    convex_hull(&both.collect::<Vec<_>>(), 2 * CORNERS, 1e-9)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stack::tests::entity;
    use glamx::DPose3;
    use sms_core::EntityShape;

    fn cuboid(name: &str, half: DVec3, center: DVec3) -> Entity {
        let mesh = Mesh::cuboid(half).transformed(&DPose3::from_translation(center));
        entity(name, mesh, EntityShape::Convex)
    }

    /// A bin whose collision shape ends `low` below its rim at 0.5 m, where the rim of 0.3 × 0.4 m was seen.
    fn bin(low: f64) -> Entity {
        let half = 0.5 * (0.5 - low);
        let mut bin = cuboid("bin", DVec3::new(0.1, 0.12, half), DVec3::Z * half);
        for k in 0..700 {
            let (along, z) = (f64::from(k % 350) / 350.0 * 1.4, 0.499 - 0.003 * f64::from(k / 350));
            let p = match along {
                a if a < 0.3 => DVec2::new(a - 0.15, -0.2),
                a if a < 0.7 => DVec2::new(0.15, a - 0.5),
                a if a < 1.0 => DVec2::new(0.85 - a, 0.2),
                a => DVec2::new(-0.15, 1.2 - a),
            };
            bin.cloud.points_w.push(p.extend(z));
        }
        // Noise far outside.
        bin.cloud.points_w.push(DVec3::new(0.25, 0.0, 0.499));
        bin
    }

    fn nothing() -> Surroundings {
        Surroundings { points: Vec::new(), normals: Vec::new(), colors: Vec::new(), labels: Vec::new() }
    }

    #[test]
    fn a_rim_that_no_mask_explains_is_of_what_is_beside_it() {
        let board = cuboid("board", DVec3::new(0.2, 0.6, 0.006), DVec3::new(0.0, -0.3, 0.506));
        let mut bin = bin(0.007);
        // Labels end 1 cm below the rim, which is background.
        let rim = std::mem::take(&mut bin.cloud.points_w);
        bin.cloud.points_w.extend(rim.iter().map(|p| p - DVec3::Z * 0.012));
        let mut around = nothing();
        let far = (0..50).map(|k| DVec3::new(0.0, -0.6, 0.498) + DVec3::X * 0.002 * f64::from(k));
        for p in rim.iter().step_by(3).copied().chain(far) {
            around.points.push(p);
            around.normals.push(DVec3::X);
            around.colors.push([0; 3]);
            around.labels.push(BACKGROUND);
        }
        let mut all = [bin, board];
        add_lids(&mut all, 0.0, &around);
        let bounds = all[0].parts[1].aabb().unwrap();
        assert!((bounds.max - DVec3::new(0.15, 0.2, 0.5)).abs().max_element() < 0.006, "{bounds:?}");
        assert!((bounds.min - DVec3::new(-0.15, -0.2, 0.49)).abs().max_element() < 0.006, "{bounds:?}");
    }

    #[test]
    fn a_rim_that_was_seen_bears_what_lies_on_it() {
        let board = cuboid("board", DVec3::new(0.2, 0.6, 0.006), DVec3::new(0.0, -0.3, 0.506));
        let mut all = [bin(0.007), board.clone()];
        add_lids(&mut all, 0.0, &nothing());
        let [_, lid] = &all[0].parts[..] else { panic!("{} parts", all[0].parts.len()) };
        let bounds = lid.aabb().unwrap();
        assert!((bounds.max - DVec3::new(0.15, 0.2, 0.5)).abs().max_element() < 0.005, "{bounds:?}");
        assert!((bounds.min - DVec3::new(-0.15, -0.2, 0.49)).abs().max_element() < 0.005, "{bounds:?}");
        assert_eq!(bounds.max.z, bottom(&all[1]));
        assert_eq!(all[1], board);
        // Once is enough.
        let before = all.clone();
        add_lids(&mut all, 0.0, &nothing());
        assert_eq!(all, before);
    }

    #[test]
    fn what_was_seen_to_end_lower_bears_nothing_and_nothing_is_put_into_others() {
        let high = cuboid("board", DVec3::new(0.2, 0.6, 0.006), DVec3::new(0.0, -0.3, 0.52));
        let mut all = [bin(0.007), high];
        add_lids(&mut all, 0.0, &nothing());
        assert_eq!(all[0].parts.len(), 1);
        let board = cuboid("board", DVec3::new(0.2, 0.6, 0.006), DVec3::new(0.0, -0.3, 0.506));
        let inside = cuboid("bottle", DVec3::new(0.02, 0.02, 0.2), DVec3::new(0.13, 0.0, 0.295));
        let mut all = [bin(0.007), board, inside];
        add_lids(&mut all, 0.0, &nothing());
        assert_eq!(all[0].parts.len(), 1);
    }
}
