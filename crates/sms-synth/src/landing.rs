//! Structures for a quadrotor to land on, which its wash or its weight could topple (paper, appendix on the quadrotor).

use crate::assets::{Household, make_household};
use crate::floor::draw_floor;
use crate::random::uniform;
use crate::scene::{LandingTruth, TruthObject, TruthScene, bounds_w, on_top};
use crate::tipping::{convex_hull, support};
use glamx::DVec2;
use serde::{Deserialize, Serialize};
use sms_core::Seed;

/// Relative variation of the sizes of a drawn structure.
const SPREAD: f64 = 0.08;
/// Load at the far end of the overhang that topples a structure, newtons. Drawn structures are built to about a quarter of the
/// weight of the paper's quadrotor (1.182 kg), fixed ones to [`LandingStructure::fixed_end_load_n`].
const END_LOADS_N: [f64; 2] = [2.0, 3.5];
/// Ballast ends this far from the platform's end, metres.
const BALLAST_INSET_M: f64 = 0.02;
/// Starts of flights: their number and the radius of their circle, metres.
const STARTS: usize = 10;
const START_RADIUS_M: f64 = 2.0;
/// Height of flights above the platform, metres (issue "landing": "in the plane 0.35 m above the platform").
const FLIGHT_HEIGHT_M: f64 = 0.35;
/// Height tolerance of the corners of a level top, metres: scanned models are not exactly level.
const LEVEL_M: f64 = 1e-4;
/// The floor is larger than in other scenes, because flights start above it.
const FLOOR_HALF_SIZE_M: f64 = 2.5;

/// Kinds of landing structures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LandingStructure {
    /// A flat cardboard box that overhangs the platform of a step ladder.
    BoxOnLadder,
    /// A closed tote that overhangs the seat of a stool.
    ToteOnStool,
    /// A board that juts out from a recycling bin, held down by a brass bar.
    BoardOnBin,
    /// A board that juts out from a stool of counter height, held down by a slab of marble.
    BoardOnStool,
}

impl LandingStructure {
    /// All of them, as `sms synth --family landing` numbers them from 1.
    pub const ALL: [Self; 4] = [Self::BoxOnLadder, Self::ToteOnStool, Self::BoardOnBin, Self::BoardOnStool];

    /// The word in files, names and seeds.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::BoxOnLadder => "box_on_ladder",
            Self::ToteOnStool => "tote_on_stool",
            Self::BoardOnBin => "board_on_bin",
            Self::BoardOnStool => "board_on_stool",
        }
    }

    /// Returns the base, the platform and the ballast.
    fn things(self) -> (Household, Household, Option<Household>) {
        match self {
            Self::BoxOnLadder => (Household::StepLadder, Household::FlatBox, None),
            Self::ToteOnStool => (Household::Stool, Household::LiddedTote, None),
            Self::BoardOnBin => (Household::RecyclingBin, Household::Board, Some(Household::BrassBar)),
            Self::BoardOnStool => (Household::CounterStool, Household::Board, Some(Household::MarbleSlab)),
        }
    }

    /// Returns the load at the end of the overhang that topples the fixed structure, newtons. A quadrotor that flies straight over
    /// the overhang at 0.5 m/s topples it. Short overhangs need less, because they are passed in less time.
    pub fn fixed_end_load_n(self) -> f64 {
        match self {
            Self::BoxOnLadder => 1.75,
            Self::ToteOnStool => 2.25,
            Self::BoardOnBin | Self::BoardOnStool => 3.0,
        }
    }

    /// Returns the fixed scene of the benchmark: usual sizes, toppled by [`LandingStructure::fixed_end_load_n`] at the end of
    /// the overhang. Frozen: a test holds the hash of all four.
    pub fn fixed(self) -> TruthScene {
        self.fixed_of(&mut make_household)
    }

    fn fixed_of(self, make: &mut Make<'_>) -> TruthScene {
        let number = self as usize + 1;
        let mut scene = build(self, Seed(number as u64), 0.0, [self.fixed_end_load_n(); 2], make);
        scene.name = format!("landing scene {number} of 4 ({})", self.as_str());
        scene
    }
}

/// Generates a structure with sizes, colours, materials, turns and overhang from the seed; its base stands at the world's
/// origin. The overhang is such that 2 to 3.5 N at its end topple the structure. Frozen: the same seed gives the same scene.
pub fn generate_landing(structure: LandingStructure, seed: Seed) -> TruthScene {
    build(structure, seed, SPREAD, END_LOADS_N, &mut make_household)
}

/// Returns the structure of a landing scene's number: 1 to 4 are the fixed ones, others use each structure in turn.
pub fn landing_structure(number: u64) -> LandingStructure {
    let all = LandingStructure::ALL;
    fixed_structure(number).unwrap_or(all[(number % all.len() as u64) as usize])
}

fn fixed_structure(number: u64) -> Option<LandingStructure> {
    (number as usize).checked_sub(1).and_then(|i| LandingStructure::ALL.get(i)).copied()
}

/// Returns the landing scene of a number: 1 to 4 are the fixed ones, others are drawn with the number as their seed.
pub fn landing_scene(number: u64) -> TruthScene {
    landing_scene_of(number, &mut make_household)
}

/// As [`landing_scene`], with another source of objects.
pub(crate) fn landing_scene_of(number: u64, make: &mut Make<'_>) -> TruthScene {
    match fixed_structure(number) {
        Some(fixed) => fixed.fixed_of(make),
        None => build(landing_structure(number), Seed(number), SPREAD, END_LOADS_N, make),
    }
}

/// Makes an object that stands at the origin. Arguments: its kind, the relative variation of its sizes, the yaw of its longer
/// side from x (radians), and its seed.
pub(crate) type Make<'a> = dyn FnMut(Household, f64, f64, Seed) -> TruthObject + 'a;

fn build(
    structure: LandingStructure,
    scene_seed: Seed,
    spread: f64,
    end_loads: [f64; 2],
    make: &mut Make<'_>,
) -> TruthScene {
    let seed = scene_seed.derive("landing v1").derive(structure.as_str());
    let mut rng = seed.derive("layout").rng();
    let yaw = uniform(&mut rng, [0.0, std::f64::consts::TAU]);
    let turn = yaw + uniform(&mut rng, [-0.06, 0.06]);
    let ballast_yaw = turn + uniform(&mut rng, [-0.08, 0.08]);
    let end_load = uniform(&mut rng, end_loads);
    let mut make = |kind: Household, yaw: f64| make(kind, spread, yaw, seed.derive(kind.as_str()));
    let (base, platform, ballast) = structure.things();
    let base = make(base, yaw);
    let platform = on_top(make(platform, turn), &base);
    let overhang = DVec2::from_angle(turn);
    let reach = |o: &TruthObject| {
        o.mesh_w().vertices.iter().map(|v| v.truncate().dot(overhang)).fold(f64::MIN, f64::max)
    };
    let half_length = reach(&platform);
    let mut objects = vec![base, platform];
    if let Some(kind) = ballast {
        let mut weight = on_top(make(kind, ballast_yaw), &objects[1]);
        let back = half_length - BALLAST_INSET_M - reach(&weight);
        weight.x_wb.translation -= (overhang * back).extend(0.0);
        objects.push(weight);
    }
    let name = format!("landing on {}, seed {}", structure.as_str(), scene_seed.0);
    let mut scene = TruthScene::of_objects(name, scene_seed, objects, draw_floor(scene_seed, seed));
    scene.floor.half_size_m = FLOOR_HALF_SIZE_M;
    let slid = |by: f64| {
        let mut slid = scene.clone();
        slid.objects[1..].iter_mut().for_each(|o| o.x_wb.translation += (overhang * by).extend(0.0));
        slid.landing = Some(landing_truth(&slid, overhang, half_length));
        slid
    };
    // The toppling load decreases with the overhang.
    let (mut near, mut far) = (-0.5 * half_length, half_length);
    for _ in 0..40 {
        let middle = 0.5 * (near + far);
        let trial = slid(middle);
        let end: DVec2 = trial.landing.as_ref().map_or(DVec2::ZERO, |l| l.end_w.into());
        if trial.tipping_load_n(end).is_some_and(|load| load > end_load) {
            near = middle
        } else {
            far = middle
        }
    }
    let mut scene = slid(near);
    let bounds = bounds_w(&scene);
    scene.workspace_center_w = bounds.center();
    if let Some(landing) = &mut scene.landing {
        let center = bounds.center().with_z(landing.top_m + FLIGHT_HEIGHT_M);
        let step = std::f64::consts::TAU / STARTS as f64;
        let start = |k: usize| center + (DVec2::from_angle(step * k as f64) * START_RADIUS_M).extend(0.0);
        landing.starts_w = (0..STARTS).map(start).collect();
    }
    scene
}

/// Computes the truth of a base, a platform and perhaps ballast, in this order; without starts.
fn landing_truth(scene: &TruthScene, overhang: DVec2, half_length: f64) -> LandingTruth {
    let [base, platform, ballast @ ..] = &scene.objects[..] else {
        unreachable!("a landing structure has a base and a platform");
    };
    let above: Vec<&TruthObject> = ballast.iter().collect();
    let all: Vec<&TruthObject> = std::iter::once(platform).chain(ballast).collect();
    let mut supports = vec![support(base, None, &all), support(platform, Some(base), &above)];
    supports.extend(ballast.iter().map(|b| support(b, Some(platform), &[])));
    let top = platform.aabb_w().max.z;
    let corners =
        platform.mesh_w().vertices.into_iter().filter(|v| top - v.z < LEVEL_M).map(|v| v.truncate());
    let center = platform.aabb_w().center().truncate();
    LandingTruth {
        platform: platform.name.clone(),
        top_m: top,
        outline_w: convex_hull(corners.collect()).into_iter().map(|p| p.to_array()).collect(),
        overhang_w: overhang.to_array(),
        end_w: (center + overhang * half_length).to_array(),
        supports,
        starts_w: Vec::new(),
    }
}
