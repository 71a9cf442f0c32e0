//! Lids: corrected upper faces of carriers. No camera saw the face on which an object stands. There a mesh bulges
//! beyond the seen edge by centimetres, or the thin wall of an open bin ends millimetres too low. The object would tip
//! over a wrong edge. The edge follows from the sides, which were seen up to a few millimetres below the face.

use crate::piece::{CollisionPiece, cut_to, is_exact, is_thick, pieces_near};
use crate::standing::{CLOSED_M, REACH_M, bottom, bottom_outline, can_carry, standing, under};
use crate::support::{Carrier, RestingPlane, Surroundings, UPRIGHT};
use glamx::{DVec2, DVec3};
use sms_core::{Aabb, Entity, Mesh};
use sms_mesh::{
    PointGrid, convex_hull,
    outline::{common, convex_outline, is_within, outline_of, width},
    quantile,
};

/// Number of corners of a lid.
const CORNERS: usize = 24;
/// Smallest number of points that determine an edge.
const FEWEST: usize = 30;
/// Thickness of a lid, metres, if its carrier is high enough.
const THICK_M: f64 = 0.01;
/// Masks lose a strip between two objects. A carrier that was seen up to this distance below the face ends at the face,
/// metres. If another carrier supports the object, the limit is [`REACH_M`].
const STRIP_M: f64 = 0.012;
/// Height range of the sides that are used, below their upper end, metres.
const SIDES_M: f64 = 0.008;
/// Unlabelled sides up to this far below the face belong to the carrier, metres: masks may lose a whole flared rim.
const LOST_M: f64 = 0.03;
/// Largest distance of such sides from the carrier's labelled surface, metres: a flared rim is far from the wall below.
const FLARED_M: f64 = 0.045;
/// Unlabelled sides that face the object are excluded (cosine of the angle between).
const BACK: f64 = 0.5;
/// Surface within this distance of the face is extrapolated, metres.
const MADE_UP_M: f64 = 0.002;
/// Points with fewer neighbours than this within [`NEAR_M`] are noise.
const NEIGHBORS: usize = 3;
/// A place within this distance of seen points was seen, metres.
const NEAR_M: f64 = 0.02;
/// Sides limit a bulge if they face the direction in which it extends (cosine of the angle between, seen from above).
const FACES: f64 = 0.5;
/// A top within this distance of the object on it carries it after settling, metres.
const TOUCH_M: f64 = 1e-3;
/// A contact face is too small if it ends more than this before the seen edge, metres.
const MISSING_M: f64 = 0.008;
/// A contact face is too large if it extends more than this beyond the seen edge, metres.
const EXCESS_M: f64 = 0.004;
/// A part that extends more than this beyond the seen edge is not a bulge, metres.
const UNSEEN_M: f64 = 0.06;
/// Distance by which tops beyond the edge are lowered, metres: a structure that tilts by as much has tipped.
const LOWERED_M: f64 = 0.0015;
/// Smallest width of a face, metres.
const NARROW_M: f64 = 0.02;

/// Corrects contact faces of carriers if their collision shape does not end at the seen edge. A convex piece with the
/// seen outline, under the underside of the upper object, replaces the face. This also holds for an object on a rim: a
/// rim and a lid with the same outline carry it alike.
pub(crate) fn add_lids(
    entities: &mut [Entity],
    rests: &[(u16, RestingPlane)],
    floor: f64,
    max_vertices: usize,
    around: &Surroundings,
) {
    for upper in standing(entities, floor) {
        let (outline, height) = (bottom_outline(&entities[upper]), bottom(&entities[upper]));
        if outline.len() < 3 {
            continue;
        }
        let rest = rests.iter().find(|r| r.0 == entities[upper].label).map(|r| r.1.carrier);
        for lower in (0..entities.len()).filter(|&i| i != upper) {
            let carrier = &entities[lower];
            if is_exact(carrier) || !can_carry(carrier, height) {
                continue;
            }
            let others = || (0..entities.len()).filter(|&i| i != lower && i != upper).map(|i| &entities[i]);
            let bears = |e: &Entity| bottom(e) < height - REACH_M && touches(e, &outline, height);
            let is_elsewhere = match rest {
                Some(Carrier::Object(label)) => label != carrier.label,
                Some(Carrier::Environment | Carrier::Floor) => true,
                Some(Carrier::Unseen) | None => false,
            };
            let strip = if is_elsewhere || others().any(bears) { REACH_M } else { STRIP_M };
            let upper = Upper { entity: &entities[upper], outline: &outline, height };
            let Some(lid) = lid(carrier, &upper, strip, around) else { continue };
            // A top that also carries another object must not be lowered.
            let is_shared = |e: &Entity| {
                let foot = bottom_outline(e);
                (bottom(e) - height).abs() < REACH_M && touches(carrier, &foot, bottom(e))
            };
            if !is_clear(&lid.piece, lower, entities) || lid.replaces && others().any(is_shared) {
                continue;
            }
            if lid.replaces {
                lower_tops(&mut entities[lower].parts, &outline, height, max_vertices);
            }
            entities[lower].parts.push(lid.piece);
        }
    }
}

/// Returns whether an object with this outline and lower end `height` touches `carrier`.
fn touches(carrier: &Entity, outline: &[DVec2], height: f64) -> bool {
    let is_near = |p: &DVec3| (p.z - height).abs() < TOUCH_M;
    let of = |piece: &Mesh| under(piece, outline).iter().any(is_near);
    outline.len() >= 3 && if is_exact(carrier) { of(&carrier.mesh) } else { carrier.parts.iter().any(of) }
}

/// Returns whether a piece is outside all other objects.
fn is_clear(lid: &Mesh, own: usize, entities: &[Entity]) -> bool {
    let (Some(space), Some(lid)) = (lid.aabb(), CollisionPiece::of(lid)) else { return false };
    let others = (0..entities.len()).filter(|&i| i != own);
    others
        .flat_map(|i| pieces_near(&entities[i], &space))
        .all(|other| lid.depth_in(&other) <= 10.0 * CLOSED_M)
}

/// Lowers pieces that carry an object with this outline a little. Parts that reach far above it beside the outline were
/// seen and are kept.
fn lower_tops(parts: &mut Vec<Mesh>, outline: &[DVec2], height: f64, max_vertices: usize) {
    let is_bearing = |part: &Mesh| {
        let high = part.vertices.iter().map(|v| v.z).fold(f64::MIN, f64::max);
        let touches = || under(part, outline).iter().any(|p| p.z > height - LOWERED_M);
        high < height + REACH_M && high > height - LOWERED_M && touches()
    };
    let lowered = |part: &mut Mesh| {
        if !is_bearing(part) {
            return true;
        }
        let is_left = cut_to(part, DVec3::Z, height - LOWERED_M, max_vertices, 1e-6);
        is_left && is_thick(part)
    };
    // The lid replaces pieces within the last millimetre.
    parts.retain_mut(lowered);
}

struct Lid {
    piece: Mesh,
    /// Whether the carrier's shape extends beyond the lid.
    replaces: bool,
}

/// The object on a face: its outline and the height of the face.
struct Upper<'a> {
    entity: &'a Entity,
    outline: &'a [DVec2],
    height: f64,
}

/// Returns `None` if the shape ends at the seen edge, or if no edge was seen within `strip` of the face.
fn lid(carrier: &Entity, upper: &Upper<'_>, strip: f64, around: &Surroundings) -> Option<Lid> {
    let Upper { outline, height, .. } = *upper;
    let tops = carrier.parts.iter().flat_map(|part| under(part, outline));
    let touching = outline_of(tops.filter(|p| (p.z - height).abs() < TOUCH_M));
    let seen = seen_sides(carrier, upper, strip, around)?;
    // Where no side facing outwards was seen, the edge is a guess; the mesh is a better one.
    let is_guessed = |p: &&DVec2| {
        let edge = nearest_on(&seen.edge, **p);
        let out = (**p - edge).normalize_or_zero();
        let ends = |side: &SeenSide| side.p.distance(edge) < NEAR_M && side.normal.dot(out) > FACES;
        p.distance(edge) > UNSEEN_M || !seen.sides.iter().any(ends)
    };
    let guessed = touching.iter().filter(|p| !is_within(&seen.edge, **p, EXCESS_M)).filter(is_guessed);
    let edge = convex_outline(&seen.edge.iter().chain(guessed).copied().collect::<Vec<_>>());
    let edge = simplified(&convex_outline(&common(&edge, outline)));
    let thickness = THICK_M.min(height - bottom(carrier));
    if edge.len() < 3 || width(&edge) < NARROW_M {
        return None;
    }
    let is_missing = touching.len() < 3 || edge.iter().any(|&p| !is_within(&touching, p, MISSING_M));
    let replaces = touching.iter().any(|&p| !is_within(&edge, p, EXCESS_M));
    if !is_missing && !replaces {
        return None;
    }
    let both = edge.iter().flat_map(|p| [p.extend(height), p.extend(height - thickness)]);
    let piece = convex_hull(&both.collect::<Vec<_>>(), 2 * CORNERS, 1e-9)?;
    Some(Lid { piece, replaces })
}

/// Returns the farthest corners in [`CORNERS`] directions.
fn simplified(outline: &[DVec2]) -> Vec<DVec2> {
    let extreme = |k: usize| {
        let out = DVec2::from_angle(std::f64::consts::TAU * k as f64 / CORNERS as f64);
        outline.iter().copied().max_by(|a, b| a.dot(out).total_cmp(&b.dot(out)))
    };
    convex_outline(&(0..CORNERS).filter_map(extreme).collect::<Vec<_>>())
}

/// Returns the point of an outline nearest to a point outside it.
fn nearest_on(outline: &[DVec2], p: DVec2) -> DVec2 {
    let on = |i: usize| {
        let (a, b) = (outline[i], outline[(i + 1) % outline.len()]);
        a + (b - a) * ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0)
    };
    let places = (0..outline.len()).map(on);
    places.min_by(|a, b| a.distance_squared(p).total_cmp(&b.distance_squared(p))).unwrap_or(p)
}

/// A seen point of a side, from above.
#[derive(Clone, Copy)]
struct SeenSide {
    p: DVec2,
    /// Horizontal unit normal of the side, or zero if unknown.
    normal: DVec2,
}

impl SeenSide {
    fn new(p: DVec3, normal: DVec3) -> Self {
        Self { p: p.truncate(), normal: normal.truncate().normalize_or_zero() }
    }
}

/// The seen sides of an object, from above.
struct Sides {
    sides: Vec<SeenSide>,
    /// Convex outline of the sides.
    edge: Vec<DVec2>,
}

/// Returns an object's seen sides right below a face. Unlabelled sides beside the object belong to it.
fn seen_sides(carrier: &Entity, upper: &Upper<'_>, strip: f64, around: &Surroundings) -> Option<Sides> {
    let Upper { outline, height, .. } = *upper;
    let is_near = |p: DVec3| {
        let is_side = p.z > height - LOST_M && p.z < height - MADE_UP_M;
        is_side && is_within(outline, p.truncate(), NEAR_M)
    };
    let cloud = &carrier.cloud;
    let own = PointGrid::new(&cloud.points_w, FLARED_M);
    // A rim faces away from the wall below it, and a neighbour faces the object.
    let looks_away = |p: DVec3, normal: DVec3| {
        let wall = own.nearest(p).filter(|(distance, _)| *distance <= FLARED_M);
        wall.is_some_and(|(distance, k)| normal.dot(p - cloud.points_w[k]) > -BACK * distance)
    };
    let is_lost = |(p, normal): &(DVec3, DVec3)| is_near(*p) && looks_away(*p, *normal);
    let lost: Vec<(DVec3, DVec3)> = around.lost_sides.iter().copied().filter(is_lost).collect();
    let points: Vec<DVec3> = lost.iter().map(|(p, _)| *p).collect();
    let grid = PointGrid::new(&points, NEAR_M);
    // The point itself is in the count.
    let is_no_noise = |p: DVec3, grid: &PointGrid| grid.within(p, NEAR_M).len() > NEIGHBORS;
    let lost: Vec<(DVec3, DVec3)> = lost.into_iter().filter(|(p, _)| is_no_noise(*p, &grid)).collect();
    let normal = |i: usize| cloud.normals_w.get(i).copied().unwrap_or_default();
    let upright: Vec<usize> = (0..cloud.points_w.len()).filter(|&i| normal(i).z.abs() < UPRIGHT).collect();
    let mut sides: Vec<usize> = upright.iter().copied().filter(|&i| is_near(cloud.points_w[i])).collect();
    // Sides that continue above the face do not end there. Points inside the upper object's outline at the face cannot
    // have been seen: they come from discs of the sides below.
    let beyond = |p: DVec3| p.z > height + REACH_M && is_within(outline, p.truncate(), 0.0);
    let beyond: Vec<DVec3> = upright.iter().map(|&i| cloud.points_w[i]).filter(|&p| beyond(p)).collect();
    let space = Aabb::of_points(beyond.iter().copied());
    let inside: Vec<CollisionPiece> =
        space.iter().flat_map(|space| pieces_near(upper.entity, space)).collect();
    let goes_on = beyond.iter().filter(|p| !inside.iter().any(|piece| piece.holds(**p))).count();
    if goes_on > sides.len() / 10 {
        return None;
    }
    let end = |heights: Vec<f64>| (!heights.is_empty()).then(|| quantile(heights, 0.98));
    let own_end = end(sides.iter().map(|&i| cloud.points_w[i].z).collect())?;
    let lost_end = end(lost.iter().map(|(p, _)| p.z).collect());
    if own_end.max(lost_end.unwrap_or(own_end)) < height - strip {
        return None;
    }
    sides.retain(|&i| cloud.points_w[i].z > own_end - SIDES_M);
    let points: Vec<DVec3> = sides.iter().map(|&i| cloud.points_w[i]).collect();
    let grid = PointGrid::new(&points, NEAR_M);
    sides.retain(|&i| is_no_noise(cloud.points_w[i], &grid));
    if sides.len() + lost.len() < FEWEST {
        return None;
    }
    let sides: Vec<SeenSide> =
        sides.into_iter().map(|i| SeenSide::new(cloud.points_w[i], normal(i))).collect();
    // The outermost Gaussians are noise; unlabelled points are averaged depths.
    let outermost = convex_outline(&sides.iter().map(|s| s.p).collect::<Vec<_>>());
    let inner = sides.into_iter().filter(|s| !outermost.contains(&s.p));
    let lost = lost.into_iter().map(|(p, normal)| SeenSide::new(p, normal));
    let sides: Vec<SeenSide> = inner.chain(lost).collect();
    let edge = convex_outline(&sides.iter().map(|s| s.p).collect::<Vec<_>>());
    (edge.len() >= 3).then_some(Sides { sides, edge })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::entity;
    use glamx::DPose3;
    use sms_core::{BACKGROUND, EntityKind, EntityShape};
    use sms_mesh::Plane;

    fn cuboid(name: &str, half: DVec3, center: DVec3) -> Entity {
        let mesh = Mesh::cuboid(half).transformed(&DPose3::from_translation(center));
        entity(name, mesh, EntityShape::Convex)
    }

    /// A bin with a collision shape that ends `low` below its rim. The rim of 0.3 × 0.4 m was seen at 0.5 m.
    fn bin(low: f64) -> Entity {
        let half = 0.5 * (0.5 - low);
        let mut bin = cuboid("bin", DVec3::new(0.1, 0.12, half), DVec3::Z * half);
        for k in 0..700 {
            let (along, z) = (f64::from(k % 350) / 350.0 * 1.4, 0.499 - 0.003 * f64::from(k / 350));
            let (p, normal) = match along {
                a if a < 0.3 => (DVec2::new(a - 0.15, -0.2), DVec3::NEG_Y),
                a if a < 0.7 => (DVec2::new(0.15, a - 0.5), DVec3::X),
                a if a < 1.0 => (DVec2::new(0.85 - a, 0.2), DVec3::Y),
                a => (DVec2::new(-0.15, 1.2 - a), DVec3::NEG_X),
            };
            bin.cloud.points_w.push(p.extend(z));
            bin.cloud.normals_w.push(normal);
        }
        // Noise far outside the bin.
        bin.cloud.points_w.push(DVec3::new(0.25, 0.0, 0.499));
        bin.cloud.normals_w.push(DVec3::X);
        bin
    }

    fn nothing() -> Surroundings {
        Surroundings::default()
    }

    /// Unlabelled surface.
    fn unlabelled(points: impl Iterator<Item = DVec3>, normal: DVec3) -> Surroundings {
        let points: Vec<DVec3> = points.collect();
        let (normals, labels) = (vec![normal; points.len()], vec![BACKGROUND; points.len()]);
        let mut around = Surroundings { points, normals, labels, ..nothing() };
        around.collect_lost_sides(&[]);
        around
    }

    #[test]
    fn a_rim_that_no_mask_explains_is_of_what_is_beside_it() {
        let board = cuboid("board", DVec3::new(0.2, 0.6, 0.006), DVec3::new(0.0, -0.3, 0.506));
        let mut bin = bin(0.007);
        // Labels end 1 cm below the rim; the rim is background.
        let rim = std::mem::take(&mut bin.cloud.points_w);
        bin.cloud.points_w.extend(rim.iter().map(|p| p - DVec3::Z * 0.012));
        let far = (0..50).map(|k| DVec3::new(0.0, -0.6, 0.498) + DVec3::X * 0.002 * f64::from(k));
        let around = unlabelled(rim.iter().step_by(3).copied().chain(far), DVec3::X);
        let mut all = [bin, board];
        add_lids(&mut all, &[], 0.0, 64, &around);
        let bounds = all[0].parts[1].aabb().unwrap();
        assert!((bounds.max - DVec3::new(0.15, 0.2, 0.5)).abs().max_element() < 0.006, "{bounds:?}");
        assert!((bounds.min - DVec3::new(-0.15, -0.2, 0.49)).abs().max_element() < 0.006, "{bounds:?}");
    }

    #[test]
    fn a_rim_that_was_seen_bears_what_lies_on_it() {
        let board = cuboid("board", DVec3::new(0.2, 0.6, 0.006), DVec3::new(0.0, -0.3, 0.506));
        let mut all = [bin(0.007), board.clone()];
        add_lids(&mut all, &[], 0.0, 64, &nothing());
        let [_, lid] = &all[0].parts[..] else { panic!("{} parts", all[0].parts.len()) };
        let bounds = lid.aabb().unwrap();
        assert!((bounds.max - DVec3::new(0.15, 0.2, 0.5)).abs().max_element() < 0.005, "{bounds:?}");
        assert!((bounds.min - DVec3::new(-0.15, -0.2, 0.49)).abs().max_element() < 0.005, "{bounds:?}");
        assert_eq!(bounds.max.z, bottom(&all[1]));
        assert_eq!(all[1], board);
        // A second pass changes nothing.
        let before = all.clone();
        add_lids(&mut all, &[], 0.0, 64, &nothing());
        assert_eq!(all, before);
    }

    /// Returns the smallest mass at y = 0.2 m that keeps a board of unit mass at y = -0.3 m from tipping over the edge
    /// of these parts at negative y. The tops of the parts are at z = 0.5 m. A board that tilts by 2° has tipped: lower
    /// tops do not carry it.
    fn counterweight(parts: &[Mesh]) -> f64 {
        let corners = || parts.iter().flat_map(|p| p.vertices.iter().copied());
        let level = corners().filter(|v| v.z > 0.5 - TOUCH_M).map(|v| -v.y).fold(f64::MIN, f64::max);
        let met = |v: &DVec3| v.z > 0.5 - (-v.y - level) * 2f64.to_radians().tan();
        let edge = corners().filter(|v| -v.y > level).filter(met).map(|v| -v.y).fold(level, f64::max);
        (0.3 - edge) / (0.2 + edge)
    }

    /// A seat of 0.3 × 0.4 m with seen sides. Its mesh bulges 3 cm beyond them at the top.
    #[test]
    fn a_top_bears_within_the_edge_that_was_seen() {
        let mut stool = bin(0.0);
        stool.cloud.points_w.iter_mut().for_each(|p| p.z -= 0.003);
        let rim = |half: DVec2, z: f64| {
            [-1.0, 1.0].map(|s| [-1.0, 1.0].map(|t| (half * DVec2::new(s, t)).extend(z)))
        };
        let corners = [rim(DVec2::new(0.15, 0.2), 0.3), rim(DVec2::new(0.18, 0.23), 0.5)];
        stool.parts[0] = convex_hull(&corners.concat().concat(), 64, 0.0).unwrap();
        let lamp = cuboid("lamp", DVec3::splat(0.02), DVec3::Z * 0.52).parts.remove(0);
        let board = cuboid("board", DVec3::new(0.2, 0.6, 0.006), DVec3::new(0.0, -0.3, 0.506));
        let mut all = [stool.clone(), board.clone()];
        add_lids(&mut all, &[], 0.0, 64, &nothing());
        let [_, lid] = &all[0].parts[..] else { panic!("{} parts", all[0].parts.len()) };
        // The weight of the board acts at y = -0.3 m, the counterweight at 0.2 m. It tips over the seen edge at -0.2 m
        // with less than a quarter of the board's mass, and over the end of the bulge with less than a sixth.
        assert!((counterweight(&stool.parts) - 0.163).abs() < 0.002, "{}", counterweight(&stool.parts));
        assert!((counterweight(&all[0].parts) - 0.25).abs() < 0.02, "{}", counterweight(&all[0].parts));
        let bounds = lid.aabb().unwrap();
        assert!((bounds.max - DVec3::new(0.15, 0.2, 0.5)).abs().max_element() < 0.006, "{bounds:?}");
        assert!((bounds.min.truncate() - DVec2::new(-0.15, -0.2)).abs().max_element() < 0.006, "{bounds:?}");
        assert_eq!(all[1], board);
        // A seen part of the seat that rises beside the board is kept, and so is a top that ends at its seen edge.
        let mut post = stool.clone();
        post.parts.push(lamp.transformed(&DPose3::from_translation(DVec3::new(0.0, 0.4, 0.0))));
        let mut all = [post.clone(), board.clone()];
        add_lids(&mut all, &[], 0.0, 64, &nothing());
        assert_eq!(all[0].parts[1], post.parts[1]);
        // The back of the seat was not seen: the mesh is the better guess there.
        let mut half = stool.clone();
        let (points, normals): (Vec<_>, Vec<_>) =
            half.cloud.points_w.iter().zip(&half.cloud.normals_w).filter(|(p, _)| p.y < 0.0).unzip();
        (half.cloud.points_w, half.cloud.normals_w) = (points, normals);
        let mut all = [half, board.clone()];
        add_lids(&mut all, &[], 0.0, 64, &nothing());
        let bounds = all[0].parts[1].aabb().unwrap();
        assert!((bounds.min.y + 0.2).abs() < 0.006 && bounds.max.y > 0.22, "{bounds:?}");
        let mut all = [bin(0.0), board];
        all[0].parts = cuboid("seat", DVec3::new(0.15, 0.2, 0.1), DVec3::Z * 0.4).parts;
        let before = all.clone();
        add_lids(&mut all, &[], 0.0, 64, &nothing());
        assert_eq!(all, before);
    }

    #[test]
    fn a_table_beside_a_book_is_no_side_of_it() {
        // Half of the board is over the book, 2 cm above an unlabelled table.
        let mut book = cuboid("book", DVec3::new(0.1, 0.15, 0.01), DVec3::Z * 0.49);
        for k in 0..1200 {
            let (i, j) = (f64::from(k % 40) / 39.0, f64::from(k / 40) / 29.0);
            let (p, n) = match k % 3 {
                0 => (DVec3::new(0.1, 0.3 * i - 0.15, 0.481 + 0.018 * j), DVec3::X),
                1 => (DVec3::new(0.2 * i - 0.1, 0.15, 0.481 + 0.018 * j), DVec3::Y),
                _ => (DVec3::new(0.2 * i - 0.1, -0.15, 0.481 + 0.018 * j), DVec3::NEG_Y),
            };
            book.cloud.points_w.push(p);
            book.cloud.normals_w.push(n);
        }
        let board = cuboid("board", DVec3::new(0.3, 0.1, 0.006), DVec3::new(0.2, 0.0, 0.506));
        let at = |k: u32| {
            DVec3::new(0.102 + 0.3 * f64::from(k % 20) / 19.0, 0.3 * f64::from(k / 20) / 19.0 - 0.15, 0.48)
        };
        let around = unlabelled((0..400).map(at), DVec3::Z);
        let mut all = [book, board];
        let before = all.clone();
        add_lids(&mut all, &[], 0.0, 64, &around);
        assert_eq!(all, before);
    }

    #[test]
    fn two_that_stand_on_one_top_keep_it() {
        let board = |y: f64| cuboid("board", DVec3::new(0.2, 0.1, 0.006), DVec3::new(0.0, y, 0.506));
        let mut seat = bin(0.0);
        seat.cloud.points_w.iter_mut().for_each(|p| p.z -= 0.003);
        // The mesh of the seat extends 3 cm beyond its seen sides.
        seat.parts = cuboid("seat", DVec3::new(0.18, 0.23, 0.25), DVec3::Z * 0.25).parts;
        let mut alone = [seat.clone(), board(-0.12)];
        add_lids(&mut alone, &[], 0.0, 64, &nothing());
        assert_eq!(alone[0].parts.len(), 2);
        let mut both = [seat.clone(), board(-0.12), board(0.12)];
        add_lids(&mut both, &[], 0.0, 64, &nothing());
        assert_eq!(both[0], seat);
    }

    #[test]
    fn a_rim_is_not_raised_to_what_stands_on_another() {
        let board = cuboid("board", DVec3::new(0.2, 0.6, 0.006), DVec3::new(0.0, -0.3, 0.506));
        let post = cuboid("post", DVec3::new(0.05, 0.05, 0.25), DVec3::new(0.0, -0.7, 0.25));
        // The seen sides end 7 mm below the board.
        let mut low = bin(0.007);
        low.cloud.points_w.iter_mut().for_each(|p| p.z -= 0.007);
        let mut all = [low.clone(), board.clone()];
        add_lids(&mut all, &[], 0.0, 64, &nothing());
        assert_eq!(all[0].parts.len(), 2);
        let mut fixed = post.clone();
        fixed.kind = EntityKind::Static;
        for other in [post, fixed] {
            let mut all = [low.clone(), board.clone(), other];
            add_lids(&mut all, &[], 0.0, 64, &nothing());
            assert_eq!(all[0], low);
        }
        // An unlabelled bracket.
        let mut all = [low.clone(), board];
        all[1].label = 7;
        let rest = |carrier| RestingPlane { plane: Plane::horizontal(0.5), carrier, noise_m: 1e-3 };
        add_lids(&mut all, &[(7, rest(Carrier::Environment))], 0.0, 64, &nothing());
        assert_eq!(all[0], low);
        add_lids(&mut all, &[(7, rest(Carrier::Object(low.label)))], 0.0, 64, &nothing());
        assert_eq!(all[0].parts.len(), 2);
    }

    #[test]
    fn what_goes_on_beyond_the_face_gets_no_lid() {
        // A mug of 20 cm under a riser that is supported elsewhere.
        let riser = cuboid("riser", DVec3::new(0.3, 0.3, 0.006), DVec3::Z * 0.406);
        let mut mug = bin(0.0);
        mug.parts = cuboid("mug", DVec3::new(0.02, 0.02, 0.1), DVec3::Z * 0.1).parts;
        let rows = (0..700).map(|k| mug.cloud.points_w[k % 700].with_z(0.3 + 0.2 * (k as f64 / 700.0)));
        mug.cloud.points_w = rows.collect();
        mug.cloud.normals_w.truncate(700);
        let mut all = [mug.clone(), riser];
        add_lids(&mut all, &[], 0.0, 64, &nothing());
        assert_eq!(all[0], mug);
    }

    #[test]
    fn skirts_within_what_stands_there_are_no_sides_that_go_on() {
        // A box of 10 cm on a seat: a third of the discs on the seat's sides extend up to 3 cm into the box.
        let upright = cuboid("box", DVec3::new(0.25, 0.3, 0.05), DVec3::Z * 0.55);
        let mut seat = bin(0.007);
        let skirt: Vec<DVec3> = (0..700)
            .step_by(3)
            .map(|k| seat.cloud.points_w[k] + DVec3::Z * (0.01 + 3e-5 * k as f64))
            .collect();
        let normals: Vec<DVec3> = seat.cloud.normals_w[..700].iter().copied().step_by(3).collect();
        seat.cloud.normals_w.extend(normals);
        seat.cloud.points_w.extend(skirt);
        let mut all = [seat.clone(), upright.clone()];
        add_lids(&mut all, &[], 0.0, 64, &nothing());
        let [_, lid] = &all[0].parts[..] else { panic!("{} parts", all[0].parts.len()) };
        let bounds = lid.aabb().unwrap();
        assert!((bounds.max - DVec3::new(0.15, 0.2, 0.5)).abs().max_element() < 0.006, "{bounds:?}");
        // The same points are sides of a frame around them, and the seat passes through the frame.
        let mut frame = upright;
        frame.parts = [-1.0, 1.0]
            .map(|s| {
                cuboid("bar", DVec3::new(0.02, 0.3, 0.05), DVec3::new(0.23 * s, 0.0, 0.55)).parts.remove(0)
            })
            .to_vec();
        frame.shape = EntityShape::TriMesh;
        let mut all = [seat.clone(), frame];
        add_lids(&mut all, &[], 0.0, 64, &nothing());
        assert_eq!(all[0], seat);
    }

    #[test]
    fn a_wall_behind_is_no_side() {
        let board = cuboid("board", DVec3::new(0.3, 0.6, 0.006), DVec3::new(0.1, -0.3, 0.506));
        let wall = |normal: DVec3| {
            let at = |k: u32| {
                DVec3::new(0.18, 0.4 * f64::from(k % 40) / 39.0 - 0.2, 0.475 + 0.005 * f64::from(k / 40))
            };
            let around = unlabelled((0..200).map(at), normal);
            let mut all = [bin(0.007), board.clone()];
            add_lids(&mut all, &[], 0.0, 64, &around);
            all[0].parts[1].aabb().unwrap().max.x
        };
        // A panel 3 cm behind the bin faces it; a flared rim faces away.
        assert!((wall(DVec3::NEG_X) - 0.15).abs() < 0.006, "{}", wall(DVec3::NEG_X));
        assert!((wall(DVec3::X) - 0.18).abs() < 0.006, "{}", wall(DVec3::X));
    }

    #[test]
    fn what_was_seen_to_end_lower_bears_nothing_and_nothing_is_put_into_others() {
        let high = cuboid("board", DVec3::new(0.2, 0.6, 0.006), DVec3::new(0.0, -0.3, 0.52));
        let mut all = [bin(0.007), high];
        add_lids(&mut all, &[], 0.0, 64, &nothing());
        assert_eq!(all[0].parts.len(), 1);
        let board = cuboid("board", DVec3::new(0.2, 0.6, 0.006), DVec3::new(0.0, -0.3, 0.506));
        let inside = cuboid("bottle", DVec3::new(0.02, 0.02, 0.2), DVec3::new(0.13, 0.0, 0.295));
        let mut all = [bin(0.007), board, inside];
        add_lids(&mut all, &[], 0.0, 64, &nothing());
        assert_eq!(all[0].parts.len(), 1);
    }
}
