//! Seeded billiards scenes (paper, appendix "Scene Generation").

use crate::assets::{AssetKind, make_asset, make_pool_ball};
use crate::floor::draw_floor;
use crate::random::uniform;
use crate::scene::{TruthFloor, TruthObject, TruthScene, name_uniquely};
use glamx::{DVec2, DVec3};
use rand::RngExt;
use serde::{Deserialize, Serialize};
use sms_core::{Seed, StageRng};

/// Settings of generated billiards scenes. Lengths in metres, angles in radians.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BilliardsSettings {
    /// Number of obstacles besides the two balls. Fewer are placed if the floor is full.
    pub objects: usize,
    /// Factor on the obstacles' sizes.
    pub object_size: f64,
    /// Kinds of obstacles to choose from; a kind is repeated only when all are used. The default leaves out the
    /// plate, which is too flat to be distinguished from the floor reliably at scan resolution.
    pub kinds: Vec<AssetKind>,
    /// Smallest gap between any two objects.
    pub gap_m: f64,
    /// Distance from the cue ball to the target ball.
    pub cue_target_m: [f64; 2],
    /// Distance from the target ball to the goal.
    pub target_goal_m: [f64; 2],
    /// Largest angle between the lines cue–target and target–goal.
    pub max_cut_angle: f64,
    /// Half width of the obstacle-free corridors cue–target and target–goal.
    pub corridor_half_width_m: f64,
    /// Maximum distance of all objects from the robot's base.
    pub reach_m: f64,
}

impl Default for BilliardsSettings {
    fn default() -> Self {
        Self {
            objects: 5,
            object_size: 1.0,
            kinds: AssetKind::SCATTERED.into_iter().filter(|k| *k != AssetKind::Plate).collect(),
            gap_m: 0.02,
            cue_target_m: [0.2, 0.4],
            target_goal_m: [0.15, 0.35],
            max_cut_angle: 35f64.to_radians(),
            corridor_half_width_m: 0.06,
            reach_m: 0.80,
        }
    }
}

/// The region of the cue ball, in front of the robot: x and y ranges.
const CUE_X: [f64; 2] = [0.30, 0.40];
const CUE_Y: [f64; 2] = [-0.08, 0.08];
/// Room for the gripper's fingers behind and beside the cue ball: the sweep is 0.1 m on either side of the contact.
const SWEEP_M: f64 = 0.16;
pub(crate) const SWEEP_HALF_WIDTH_M: f64 = 0.08;
/// All objects lie within this distance of the workspace's middle line, so that all views show most of them.
pub(crate) const WORKSPACE_HALF_WIDTH_M: f64 = 0.40;
/// All objects lie within the wedge of the first, frontal view: the slope of its sides and the distance of its apex behind
/// the robot's base (see `CameraPath` and `RecordingSettings::fov_x`).
pub(crate) const FRONTAL_SLOPE: f64 = 0.66;
pub(crate) const FRONTAL_DISTANCE_M: f64 = 0.15;
/// Centre of the workspace, at which the cameras look. Slightly above the floor, amid the objects.
pub(crate) const WORKSPACE_CENTER: [f64; 3] = [0.52, 0.0, 0.04];

/// Generates a scene from a seed. Frozen: the same seed and settings give the same scene.
///
/// Cue ball in front of the robot, target ball 0.2–0.4 m further on, goal 0.15–0.35 m beyond at a cut angle of at most
/// 35°, both corridors free ("adjusted to ensure that the target ball could reasonably achieve the goal position"), and
/// obstacles scattered around, each resting on the floor with a gap to all others.
pub fn generate_billiards(seed: Seed, settings: &BilliardsSettings) -> TruthScene {
    let scene_seed = seed;
    let seed = seed.derive("billiards scene v1");
    let balls = draw_positions(seed, settings);
    let mut rng = seed.derive("balls").rng();
    let mut objects =
        vec![make_pool_ball(true, balls.cue, &mut rng), make_pool_ball(false, balls.target, &mut rng)];
    let kinds = choose_kinds(seed, settings);
    for (index, kind) in kinds.into_iter().enumerate() {
        let own = seed.derive_index("obstacle", index as u64);
        if let Some(object) = place_obstacle(own, kind, settings, &balls, &objects) {
            objects.push(object);
        }
    }
    name_uniquely(&mut objects);
    let name = format!("billiards, seed {}", scene_seed.0);
    billiards_truth(name, scene_seed, objects, draw_floor(scene_seed, seed), balls.goal)
}

/// The scene of a cue ball, a target ball and obstacles, in this order.
pub(crate) fn billiards_truth(
    name: String,
    seed: Seed,
    objects: Vec<TruthObject>,
    floor: TruthFloor,
    goal_w: DVec2,
) -> TruthScene {
    TruthScene {
        cue: objects[0].name.clone(),
        target: objects[1].name.clone(),
        goal_w: goal_w.to_array(),
        workspace_center_w: DVec3::from_array(WORKSPACE_CENTER),
        ..TruthScene::of_objects(name, seed, objects, floor)
    }
}

/// Positions of the balls and the goal on the floor.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BallPositions {
    pub(crate) cue: DVec2,
    pub(crate) target: DVec2,
    pub(crate) goal: DVec2,
}

fn draw_positions(seed: Seed, settings: &BilliardsSettings) -> BallPositions {
    let mut rng = seed.derive("shot").rng();
    // Shots straight ahead always fit, so that narrowing the spread ends the search for all settings.
    let mut spread = 1.0;
    loop {
        let cue = DVec2::new(uniform(&mut rng, CUE_X), uniform(&mut rng, CUE_Y));
        let heading = spread * uniform(&mut rng, [-0.45, 0.45]);
        let first = DVec2::from_angle(heading);
        let target = cue + first * uniform(&mut rng, settings.cue_target_m);
        let cut = spread * uniform(&mut rng, [-settings.max_cut_angle, settings.max_cut_angle]);
        let second = DVec2::from_angle(heading + cut);
        let goal = target + second * uniform(&mut rng, settings.target_goal_m);
        // The goal may lie slightly beyond the objects, since it stays free.
        let fits = target.length() <= settings.reach_m - 0.06
            && goal.length() <= settings.reach_m + 0.08
            && target.y.abs() < 0.28
            && goal.y.abs() < 0.36;
        if fits || spread < 1e-3 {
            return BallPositions { cue, target, goal };
        }
        spread *= 0.995;
    }
}

/// Draws kinds in random order, without repetition until all are used.
fn choose_kinds(seed: Seed, settings: &BilliardsSettings) -> Vec<AssetKind> {
    let mut rng = seed.derive("kinds").rng();
    let mut chosen = Vec::with_capacity(settings.objects);
    while chosen.len() < settings.objects && !settings.kinds.is_empty() {
        let mut deck = settings.kinds.clone();
        while !deck.is_empty() && chosen.len() < settings.objects {
            chosen.push(deck.swap_remove(rng.random_range(0..deck.len())));
        }
    }
    chosen
}

fn place_obstacle(
    seed: Seed,
    kind: AssetKind,
    settings: &BilliardsSettings,
    balls: &BallPositions,
    placed: &[TruthObject],
) -> Option<TruthObject> {
    let yaw = uniform(&mut seed.derive("yaw").rng(), [0.0, std::f64::consts::TAU]);
    let others: Vec<(DVec2, f64)> = placed.iter().map(footprint).collect();
    let mut rng = seed.derive("place").rng();
    // If there is no room, a smaller object may still fit.
    for shrink in [1.0, 0.85, 0.72] {
        let size = settings.object_size * shrink;
        let mut object = make_asset(kind, DVec2::ZERO, yaw, size, &mut seed.derive("asset").rng());
        let radius = footprint_radius(&object);
        if let Some(p) = find_place(&mut rng, radius, settings, balls, &others) {
            object.x_wb.translation += DVec3::new(p.x, p.y, 0.0);
            return Some(object);
        }
    }
    None
}

/// Finds a free place for a disc: within reach and view, off the paths of balls and gripper, and clear of all other discs.
pub(crate) fn find_place(
    rng: &mut StageRng,
    radius: f64,
    settings: &BilliardsSettings,
    balls: &BallPositions,
    others: &[(DVec2, f64)],
) -> Option<DVec2> {
    for _ in 0..3000 {
        let p = DVec2::new(uniform(rng, [0.2, settings.reach_m]), uniform(rng, [-0.4, 0.4]));
        let half_width = WORKSPACE_HALF_WIDTH_M.min(FRONTAL_SLOPE * (p.x + FRONTAL_DISTANCE_M));
        let free = p.length() + radius <= settings.reach_m + 0.02
            && p.x - radius >= 0.16
            && p.y.abs() + radius <= half_width
            && distance_to_segment(p, balls.cue, balls.target) >= radius + settings.corridor_half_width_m
            && distance_to_segment(p, balls.target, balls.goal) >= radius + settings.corridor_half_width_m
            && distance_to_sweep(p, balls.cue, balls.target) >= radius + SWEEP_HALF_WIDTH_M
            && others.iter().all(|(q, r)| p.distance(*q) >= radius + r + settings.gap_m);
        if free {
            return Some(p);
        }
    }
    None
}

/// Returns the radius of the disc around the asset's axis that contains its footprint, for an object at the world's origin.
pub(crate) fn footprint_radius(object: &TruthObject) -> f64 {
    let about_axis = |p: &DVec3| {
        let p_w = object.x_wb.translation + *p;
        p_w.x.hypot(p_w.y)
    };
    object.sphere_radius.unwrap_or_else(|| object.mesh.vertices.iter().map(about_axis).fold(0.0, f64::max))
}

/// Returns a disc on the floor that contains the object: centre and radius.
pub(crate) fn footprint(object: &TruthObject) -> (DVec2, f64) {
    let com = object.x_wb.translation.truncate();
    if let Some(r) = object.sphere_radius {
        return (com, r);
    }
    let bounds = object.aabb_w();
    let center = bounds.center().truncate();
    let radius =
        object.mesh.vertices.iter().map(|v| (com + v.truncate()).distance(center)).fold(0.0, f64::max);
    (center, radius)
}

/// Returns the distance from the finger's path behind a cue ball that is played towards `next`.
pub(crate) fn distance_to_sweep(p: DVec2, cue: DVec2, next: DVec2) -> f64 {
    distance_to_segment(p, cue - (next - cue).normalize() * SWEEP_M, cue)
}

pub(crate) fn distance_to_segment(p: DVec2, a: DVec2, b: DVec2) -> f64 {
    let along = b - a;
    let t = ((p - a).dot(along) / along.length_squared().max(1e-12)).clamp(0.0, 1.0);
    p.distance(a + along * t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::BALL_RADIUS_M;

    #[test]
    fn distance_to_a_segment_counts_its_ends() {
        let (a, b) = (DVec2::ZERO, DVec2::new(2.0, 0.0));
        assert_eq!(distance_to_segment(DVec2::new(1.0, 3.0), a, b), 3.0);
        assert_eq!(distance_to_segment(DVec2::new(-3.0, 4.0), a, b), 5.0);
        assert_eq!(distance_to_segment(DVec2::new(5.0, -4.0), a, b), 5.0);
    }

    #[test]
    fn a_ball_is_where_the_shot_says() {
        let scene = generate_billiards(Seed(1), &BilliardsSettings::default());
        let cue = scene.object(&scene.cue).unwrap();
        assert_eq!(cue.sphere_radius, Some(BALL_RADIUS_M));
        assert!((cue.x_wb.translation.z - BALL_RADIUS_M).abs() < 1e-12);
    }
}
