//! Checks that the places of a task can be reached.

use crate::body::{TaskBody, bodies_of, horizontal};
use glamx::DVec2;
use sms_core::InputError;
use sms_scene::{Body, BodyKind, BodyShape, Scene};
use sms_sim::signed_distance;
use std::path::Path;

/// A place farther than this from every body is outside the scan, metres.
const FARTHEST_M: f64 = 3.0;

/// A body within this distance of a static body stands on it, metres.
const STANDS_M: f64 = 0.01;

/// Overlap of a ball with an obstacle that is still accepted, metres: meshes are rough.
const TOUCH_M: f64 = 0.005;

/// Samples around a place: rings, and directions per ring.
const RINGS: u32 = 8;
const DIRECTIONS: u32 = 24;

/// Rejects a place far from the whole scene: units or axes are wrong.
pub(crate) fn check_near(path: &Path, what: &str, place_w: DVec2, scene: &Scene) -> Result<(), InputError> {
    let nearest = scene
        .bodies
        .iter()
        .filter(|b| !matches!(b.shape, BodyShape::HalfSpace))
        .map(|b| horizontal(b.x_wb.translation).distance(place_w))
        .fold(f64::INFINITY, f64::min);
    if nearest <= FARTHEST_M {
        return Ok(());
    }
    Err(InputError::new(
        format!(
            "{what}, at [{:.3}, {:.3}], is {nearest:.1} m from the nearest scanned body",
            place_w.x, place_w.y
        ),
        path,
        format!("give world coordinates in metres; the scene has {}", bodies_of(scene)),
    ))
}

/// Rejects a place on the floor if the body cannot come within `enough_m` of it at its own height, because a static
/// body is in the way or there is no floor.
pub(crate) fn check_reachable(
    path: &Path,
    what: &str,
    place_w: DVec2,
    enough_m: f64,
    body: &TaskBody,
    scene: &Scene,
) -> Result<(), InputError> {
    let is_sphere = matches!(scene.bodies[body.index].shape, BodyShape::Sphere { .. });
    let still: Vec<&Body> = scene.bodies.iter().filter(|b| b.kind == BodyKind::Static).collect();
    let refuse = |why: String, cure: &str| {
        let name = &body.name;
        Err(InputError::new(
            format!("{what}, at [{:.3}, {:.3}], cannot be reached by `{name}`: {why}", place_w.x, place_w.y),
            path,
            format!("{cure}; the scene has {}", bodies_of(scene)),
        ))
    };
    if is_sphere {
        let is_in_way = |b: &&&Body, p_w: DVec2| {
            !matches!(b.shape, BodyShape::HalfSpace)
                && signed_distance(b, p_w.extend(body.center_w.z)) < body.radius - TOUCH_M
        };
        let in_way = |p_w: DVec2| still.iter().find(|b| is_in_way(b, p_w));
        // Samples of the disc that counts as reaching the place.
        let mut around = (1..=RINGS).flat_map(|ring| {
            (0..DIRECTIONS).map(move |k| {
                let turn = std::f64::consts::TAU * f64::from(k) / f64::from(DIRECTIONS);
                place_w + enough_m * f64::from(ring) / f64::from(RINGS) * DVec2::from_angle(turn)
            })
        });
        if let Some(obstacle) = in_way(place_w)
            && around.all(|p_w| in_way(p_w).is_some())
        {
            return refuse(
                format!(
                    "the static body `{}` keeps it more than {:.0} mm away",
                    obstacle.name,
                    1e3 * enough_m
                ),
                "choose a place beside it",
            );
        }
    }
    // A place on the floor needs the body's present support below it, or an infinite floor.
    let lowest_w = |p_w: DVec2| p_w.extend(body.center_w.z - body.radius);
    let gap_m =
        |p_w: DVec2| still.iter().map(|b| signed_distance(b, lowest_w(p_w))).fold(f64::INFINITY, f64::min);
    let here_m = gap_m(horizontal(body.center_w)).max(0.0);
    let there_m = gap_m(place_w);
    // A body on a movable support gives no information about the floor.
    if here_m < STANDS_M && there_m > here_m + enough_m {
        return refuse(
            format!("there is no floor within {:.0} mm", 1e3 * there_m),
            "choose a place on the floor, or a box `{ min_w, max_w }` for a place off it",
        );
    }
    Ok(())
}
