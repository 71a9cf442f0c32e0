//! Billiards scenes that cannot all be solved by a straight shot. The paper's eighteen were adjusted by hand (appendix "Scene
//! Generation"); here they are drawn from layouts. Brute force in a target world (`sms-experiments scenes`) tests whether a
//! scene needs a rebound.

use crate::assets::{AssetKind, make_asset, make_pool_ball};
use crate::billiards::{
    FRONTAL_DISTANCE_M, FRONTAL_SLOPE, SWEEP_HALF_WIDTH_M, WORKSPACE_HALF_WIDTH_M, billiards_truth,
    distance_to_segment, distance_to_sweep, footprint, footprint_radius,
};
use crate::floor::draw_floor;
use crate::random::{pick, uniform};
use crate::scene::{TruthObject, TruthScene, name_uniquely};
use crate::{BALL_RADIUS_M, BilliardsSettings};
use glamx::{DVec2, DVec3};
use rand::RngExt;
use serde::{Deserialize, Serialize};
use sms_core::{Seed, StageRng};

/// Kind of shot that a scene requires.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Layout {
    /// Two balls only.
    Empty,
    /// The direct path is free, and a light box stands at a likely rebound (the paper's scene A).
    Direct,
    /// The goal lies too far back for any cut; a heavy object stands where the target ball can rebound
    /// (scene B).
    Backstop,
    /// An obstacle stands between target ball and goal, a heavy object beside them.
    Screened,
    /// An obstacle stands between cue and target ball, a heavy object beside them.
    CueBank,
    /// The target ball has to rebound twice: off a heavy object and off a movable ball (scene C).
    Chain,
    /// A far goal that a thin cut and a rebound both reach (scene D).
    TwoWays,
}

impl Layout {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::Empty,
        Self::Direct,
        Self::Backstop,
        Self::Screened,
        Self::CueBank,
        Self::Chain,
        Self::TwoWays,
    ];

    /// The word in files, names and seeds.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Empty => "empty",
            Self::Direct => "direct",
            Self::Backstop => "backstop",
            Self::Screened => "screened",
            Self::CueBank => "cue_bank",
            Self::Chain => "chain",
            Self::TwoWays => "two_ways",
        }
    }
}

/// Heavy objects that a ball rebounds off.
const HEAVY: [AssetKind; 4] =
    [AssetKind::BrassBlock, AssetKind::BrassStatue, AssetKind::MarbleStatue, AssetKind::SeatedStatue];
/// Objects that block a path.
const SCREENS: [AssetKind; 6] = [
    AssetKind::WoodBlock,
    AssetKind::Bowl,
    AssetKind::Mug,
    AssetKind::Vase,
    AssetKind::CeramicBear,
    AssetKind::SeatedStatue,
];
/// Attempts to draw a shot that fits the workspace, and to place one obstacle.
const DRAWS: usize = 4000;
const PLACES: usize = 600;
/// Half width of the intended paths of balls.
const WAY_M: f64 = BALL_RADIUS_M + 0.012;
/// Smallest gap between two objects, metres.
const GAP_M: f64 = 0.02;

/// An intended shot: positions of the balls and the goal, the paths of the balls, and the objects that it needs.
struct PlannedShot {
    cue: DVec2,
    target: DVec2,
    goal: DVec2,
    /// Paths that stay free.
    ways: Vec<(DVec2, DVec2)>,
    props: Vec<Prop>,
}

/// An object that the layout needs.
struct Prop {
    kind: AssetKind,
    /// Position of the ball's centre at the rebound, and the surface's normal there.
    at: DVec2,
    facing: Option<DVec2>,
}

/// Generates a scene of this layout with up to `obstacles` further objects scattered around. The same arguments give the
/// same scene. `None` if the seed's draws do not fit into the workspace.
pub fn generate_challenge(layout: Layout, scene_seed: Seed, obstacles: usize) -> Option<TruthScene> {
    let seed = scene_seed.derive("billiards challenge v1").derive(layout.as_str());
    let mut rng = seed.derive("shot").rng();
    let shot = (0..DRAWS).find_map(|_| draw(layout, &mut rng))?;
    let mut balls = seed.derive("balls").rng();
    let mut objects =
        vec![make_pool_ball(true, shot.cue, &mut balls), make_pool_ball(false, shot.target, &mut balls)];
    for (index, prop) in shot.props.iter().enumerate() {
        let object = place_prop(prop, seed.derive_index("prop", index as u64));
        let clear = objects.iter().all(|o| apart(o, &object) >= 0.004);
        if !clear || !inside(&object) || crosses(&object, &shot, prop) {
            return None;
        }
        objects.push(object);
    }
    let mut deck: Vec<AssetKind> = Vec::new();
    let mut shuffle = seed.derive("kinds").rng();
    for index in 0..obstacles {
        if deck.is_empty() {
            deck = AssetKind::ALL.into_iter().filter(|k| *k != AssetKind::Plate).collect();
        }
        let kind = deck.swap_remove(shuffle.random_range(0..deck.len()));
        objects.extend(scatter(kind, &shot, &objects, seed.derive_index("obstacle", index as u64)));
    }
    name_uniquely(&mut objects);
    let name = format!("billiards, {}, seed {}", layout.as_str(), scene_seed.0);
    Some(billiards_truth(name, scene_seed, objects, draw_floor(scene_seed, seed), shot.goal))
}

/// Draws a shot; `None` if it leaves the workspace.
fn draw(layout: Layout, rng: &mut StageRng) -> Option<PlannedShot> {
    let cue = DVec2::new(uniform(rng, [0.30, 0.42]), uniform(rng, [-0.12, 0.12]));
    let heading = uniform(rng, [-0.6, 0.6]);
    let side = if rng.random::<bool>() { 1.0 } else { -1.0 };
    let along = |from: DVec2, angle: f64, by: f64| from + DVec2::from_angle(angle) * by;
    // A ball that comes along `from` and leaves along `to` turns at a surface that faces their difference.
    let facing = |from: f64, to: f64| (DVec2::from_angle(to) - DVec2::from_angle(from)).normalize();
    let target = match layout {
        Layout::CueBank => along(cue, heading, uniform(rng, [0.26, 0.38])),
        Layout::TwoWays => along(cue, heading, uniform(rng, [0.12, 0.20])),
        _ => along(cue, heading, uniform(rng, [0.16, 0.30])),
    };
    // The middle of a screen between two points, and the ball's centre where it rebounds beside the screen.
    let detour = |rng: &mut StageRng, from: DVec2, to: DVec2, shares: [f64; 2], widths: [f64; 2]| {
        let between = from.lerp(to, uniform(rng, shares));
        let across = (to - from).normalize().perp();
        (between, 0.5 * (from + to) + side * across * uniform(rng, widths))
    };
    let detour_props = |rng: &mut StageRng, from: DVec2, to: DVec2, between: DVec2, aside: DVec2| {
        let turn = facing((aside - from).to_angle(), (to - aside).to_angle());
        vec![
            Prop { kind: pick(rng, &SCREENS), at: between, facing: None },
            Prop { kind: pick(rng, &HEAVY), at: aside, facing: Some(turn) },
        ]
    };
    let (goal, ways, props) = match layout {
        Layout::Empty | Layout::Direct => {
            let cut = side * uniform(rng, [0.15, 0.95]);
            let goal = along(target, heading + cut, uniform(rng, [0.20, 0.38]));
            let mut props = Vec::new();
            if layout == Layout::Direct {
                // Beyond the goal's side of the target ball, where a ball that missed would rebound.
                let beyond = along(target, heading - 0.4 * side, uniform(rng, [0.16, 0.24]));
                props.push(Prop { kind: AssetKind::CardboardBox, at: beyond, facing: None });
            }
            (goal, vec![(cue, target), (target, goal)], props)
        }
        Layout::Backstop | Layout::TwoWays => {
            let first = heading + side * uniform(rng, [-0.3, 0.7]);
            let turn = along(target, first, uniform(rng, [0.08, 0.18]));
            let far = layout == Layout::TwoWays;
            let back = if far { uniform(rng, [1.0, 1.6]) } else { uniform(rng, [1.75, 2.7]) };
            let last = heading + side * back;
            let goal =
                along(turn, last, if far { uniform(rng, [0.26, 0.38]) } else { uniform(rng, [0.14, 0.30]) });
            let prop = Prop { kind: pick(rng, &HEAVY), at: turn, facing: Some(facing(first, last)) };
            let mut ways = vec![(cue, target), (target, turn), (turn, goal)];
            if far {
                ways.push((target, goal));
            }
            (goal, ways, vec![prop])
        }
        Layout::Screened => {
            let cut = side * uniform(rng, [0.0, 0.5]);
            let goal = along(target, heading + cut, uniform(rng, [0.26, 0.38]));
            let (between, aside) = detour(rng, target, goal, [0.45, 0.6], [0.10, 0.17]);
            let props = detour_props(rng, target, goal, between, aside);
            (goal, vec![(cue, target), (target, aside), (aside, goal)], props)
        }
        Layout::CueBank => {
            let (between, aside) = detour(rng, cue, target, [0.48, 0.60], [0.11, 0.18]);
            let last = (target - aside).to_angle();
            let goal = along(target, last + uniform(rng, [-0.6, 0.6]), uniform(rng, [0.12, 0.24]));
            let props = detour_props(rng, cue, target, between, aside);
            (goal, vec![(cue, aside), (aside, target), (target, goal)], props)
        }
        Layout::Chain => {
            let first = heading + side * uniform(rng, [-0.2, 0.5]);
            let turn = along(target, first, uniform(rng, [0.08, 0.15]));
            let second = heading + side * uniform(rng, [1.5, 2.3]);
            let at_ball = along(turn, second, uniform(rng, [0.10, 0.20]));
            // After hitting a ball of equal mass, the target ball moves at right angles to the line of centres.
            let last = second + side * uniform(rng, [0.7, 1.3]);
            let goal = along(at_ball, last, uniform(rng, [0.10, 0.20]));
            let square = DVec2::from_angle(last).perp();
            let line = if square.dot(DVec2::from_angle(second)) > 0.0 { square } else { -square };
            let props = vec![
                Prop { kind: pick(rng, &HEAVY), at: turn, facing: Some(facing(first, second)) },
                Prop { kind: AssetKind::PoolBall, at: at_ball, facing: Some(-line) },
            ];
            (goal, vec![(cue, target), (target, turn), (turn, at_ball), (at_ball, goal)], props)
        }
    };
    let reach = BilliardsSettings::default().reach_m;
    let fits = [cue, target, goal]
        .iter()
        .chain(ways.iter().map(|(_, b)| b))
        .all(|p| p.x > 0.20 && p.length() <= reach && p.y.abs() < 0.34 && in_wedge(*p, BALL_RADIUS_M));
    // The finger sweeps from behind the cue ball.
    let clear = [(target, cue), (goal, cue), (goal, target)].iter().all(|(a, b)| a.distance(*b) > 0.12);
    (fits && clear).then_some(PlannedShot { cue, target, goal, ways, props })
}

/// Returns whether a disc lies in the wedge of the first view.
fn in_wedge(p: DVec2, radius: f64) -> bool {
    p.y.abs() + radius <= WORKSPACE_HALF_WIDTH_M.min(FRONTAL_SLOPE * (p.x + FRONTAL_DISTANCE_M))
}

fn inside(object: &TruthObject) -> bool {
    let (center, radius) = footprint(object);
    center.x - radius >= 0.16
        && center.length() + radius <= BilliardsSettings::default().reach_m + 0.1
        && in_wedge(center, radius)
}

/// Places a prop so that a ball centred at `at` touches it with the normal `facing`; without one, with its axis at `at`.
fn place_prop(prop: &Prop, seed: Seed) -> TruthObject {
    let mut rng = seed.derive("asset").rng();
    let yaw = match prop.facing {
        // Blocks turn a long side (their y axis) to the ball.
        Some(n) if prop.kind == AssetKind::BrassBlock => n.to_angle() - std::f64::consts::FRAC_PI_2,
        _ => uniform(&mut seed.derive("yaw").rng(), [0.0, std::f64::consts::TAU]),
    };
    let mut object = make_asset(prop.kind, DVec2::ZERO, yaw, 1.0, &mut rng);
    let mut at = prop.at;
    if let Some(n) = prop.facing {
        // Extent of the object towards the ball at the heights of contact.
        let com = object.x_wb.translation;
        let reach = match object.sphere_radius {
            // Horizontal distance of the centres of two touching balls of different size on one floor.
            Some(r) => com.truncate().dot(n) + 2.0 * (r * BALL_RADIUS_M).sqrt() - BALL_RADIUS_M,
            None => (object.mesh.vertices.iter())
                .map(|v| *v + com)
                .filter(|p| p.z > 0.5 * BALL_RADIUS_M && p.z < 1.6 * BALL_RADIUS_M)
                .map(|p| p.truncate().dot(n))
                .fold(0.0, f64::max),
        };
        at -= n * (BALL_RADIUS_M + reach);
    }
    object.x_wb.translation += DVec3::new(at.x, at.y, 0.0);
    object
}

/// Returns the gap between the discs that contain two objects; the gap between their hulls is larger.
fn apart(a: &TruthObject, b: &TruthObject) -> f64 {
    let ((p, r), (q, s)) = (footprint(a), footprint(b));
    p.distance(q) - r - s
}

/// Returns whether a prop blocks a path that it is not part of, or the finger's path.
fn crosses(object: &TruthObject, shot: &PlannedShot, prop: &Prop) -> bool {
    let (center, radius) = footprint(object);
    let turns = |p: DVec2| prop.facing.is_some() && p.distance(prop.at) < 1e-9;
    distance_to_sweep(center, shot.cue, shot.ways[0].1) < radius + SWEEP_HALF_WIDTH_M
        || shot
            .ways
            .iter()
            .filter(|(a, b)| !turns(*a) && !turns(*b))
            .any(|(a, b)| distance_to_segment(center, *a, *b) < radius + BALL_RADIUS_M)
        || shot.goal.distance(center) < radius + BALL_RADIUS_M
}

/// Places one more obstacle off all paths.
fn scatter(kind: AssetKind, shot: &PlannedShot, placed: &[TruthObject], seed: Seed) -> Option<TruthObject> {
    let yaw = uniform(&mut seed.derive("yaw").rng(), [0.0, std::f64::consts::TAU]);
    let mut object = make_asset(kind, DVec2::ZERO, yaw, 1.0, &mut seed.derive("asset").rng());
    let radius = footprint_radius(&object);
    let others: Vec<(DVec2, f64)> = placed.iter().map(footprint).collect();
    let reach = BilliardsSettings::default().reach_m;
    let mut rng = seed.derive("place").rng();
    for _ in 0..PLACES {
        let p = DVec2::new(uniform(&mut rng, [0.2, reach]), uniform(&mut rng, [-0.4, 0.4]));
        let free = p.length() + radius <= reach + 0.02
            && p.x - radius >= 0.16
            && in_wedge(p, radius)
            && shot.ways.iter().all(|(a, b)| distance_to_segment(p, *a, *b) >= radius + WAY_M)
            && p.distance(shot.goal) >= radius + WAY_M
            && distance_to_sweep(p, shot.cue, shot.ways[0].1) >= radius + SWEEP_HALF_WIDTH_M
            && others.iter().all(|(q, r)| p.distance(*q) >= radius + r + GAP_M);
        if free {
            object.x_wb.translation += DVec3::new(p.x, p.y, 0.0);
            return Some(object);
        }
    }
    None
}
