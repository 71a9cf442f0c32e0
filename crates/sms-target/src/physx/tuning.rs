//! Parameters of the two PhysX targets.

use physx_sys::{PxMaterialFlags, PxSceneFlags, PxSolverType};

/// Parameters of a world. `None` keeps PhysX's default.
#[derive(Debug)]
pub(super) struct Tuning {
    pub(super) engine: &'static str,
    /// Whether steps are split at the balls' impacts.
    pub(super) splits_steps: bool,
    pub(super) solver: PxSolverType,
    /// Whether friction of balls acts on velocities alone (`contacts`).
    pub(super) velocity_friction: bool,
    pub(super) scene_flags: PxSceneFlags,
    pub(super) material_flags: PxMaterialFlags,
    /// Gap at which a shape makes contacts, metres; the gap of a pair is the sum. PhysX's default is 20 mm. A body in
    /// the gap may close four fifths of it in a step and so loses speed before an impact. The gap is therefore only
    /// slightly larger than the one at which a step is split for the impact.
    pub(super) contact_offset: Option<f32>,
    /// Gap up to which a contact has friction and distance at which contacts share a friction anchor, metres; PhysX's
    /// defaults are 40 mm and 25 mm.
    pub(super) friction_offset: Option<f32>,
    pub(super) friction_correlation: Option<f32>,
    /// Longest substeps, seconds: of steps shorter than the second value (those of an impact, or up to one), and of all
    /// other steps. The speed that gravity adds in a step counts as approach and returns with the rebound: over the 0.4
    /// ms of a slow ball's impact, it keeps the ball hopping at 2 cm/s forever.
    pub(super) step_lengths_s: Option<(f64, f64)>,
    /// Position and velocity iterations; PhysX's default is 4 and 1.
    pub(super) iterations: Option<(u32, u32)>,
    /// Smallest approach speed at which contacts bounce, m/s.
    pub(super) bounce_speed: f64,
    /// The same, as a multiple of the speed that gravity adds in a step: a body at rest approaches with one such speed,
    /// and a body that falls back from a hop must not gain energy.
    pub(super) bounce_gravity_steps: f64,
    /// Whether bodies move without the engine's damping (PhysX's default slows spins by 5 % per second) and speed
    /// limits, and with gyroscopic torques.
    pub(super) free_motion: bool,
    /// Largest speed at which overlapping bodies are pushed apart, m/s.
    pub(super) push_out_speed: Option<f32>,
    /// Speeds below which balls and other bodies fall asleep, m/s. At PhysX's default, 0.1, a ball still rolls. PhysX
    /// compares this value with the *sum* of the velocities in all steps of 0.2 s, 320 here: the tremor of a box at
    /// rest, 5e-5 m/s, adds up to 0.016. Much larger values put balls to sleep that are struck while falling asleep.
    pub(super) sleep_speeds: Option<(f64, f64)>,
    /// Whether bodies without displacement fall asleep even if they tremble (`rest`).
    pub(super) sleeps_where_it_stays: bool,
}

/// The defaults of PhysX 5.1 except for the bounce threshold: with its 2 m/s no body on a table bounces.
pub(super) const STOCK: Tuning = Tuning {
    engine: "physx 5.1 stock",
    splits_steps: false,
    solver: PxSolverType::Pgs,
    velocity_friction: false,
    scene_flags: PxSceneFlags::EnablePcm,
    material_flags: PxMaterialFlags::empty(),
    contact_offset: None,
    friction_offset: None,
    friction_correlation: None,
    step_lengths_s: None,
    iterations: None,
    bounce_speed: 0.05,
    bounce_gravity_steps: 0.0,
    free_motion: false,
    push_out_speed: None,
    sleep_speeds: None,
    sleeps_where_it_stays: false,
};

/// Parameters within every limit of the closed-form suite.
///
/// - The solver is TGS, which bounds friction by a circle. PGS bounds it per axis, along and across the velocity of the
///   centres instead of the slip: a rolling ball threw an object ball in a cut shot by up to 3.8° too far, and curved
///   paths were wrong by 11 %.
/// - Contacts are found again in each step (no PCM): persistent ones miss a ball within micrometres of a mesh. PhysX's
///   contact cache is off, too: without PCM a pair keeps its contacts, even if it has *none*, until a body has moved by
///   1 % of the length scale (10 mm) or by 0.01 in a component of its rotation. A body that hopped off the floor sank
///   that far into it.
pub(super) const PRECISE: Tuning = Tuning {
    engine: "physx 5.1 precise",
    splits_steps: true,
    solver: PxSolverType::Tgs,
    velocity_friction: true,
    scene_flags: PxSceneFlags::from_bits_truncate(
        PxSceneFlags::EnableEnhancedDeterminism.bits()
            | PxSceneFlags::EnableFrictionEveryIteration.bits()
            | PxSceneFlags::DisableContactCache.bits(),
    ),
    material_flags: PxMaterialFlags::ImprovedPatchFriction,
    contact_offset: Some(1.5e-6),
    friction_offset: Some(5e-4),
    friction_correlation: Some(2e-3),
    step_lengths_s: Some((5e-5, 0.000_625)),
    iterations: Some((16, 4)),
    bounce_speed: 2e-3,
    bounce_gravity_steps: 4.5,
    free_motion: true,
    push_out_speed: Some(0.1),
    sleep_speeds: Some((1e-3, 3e-2)),
    sleeps_where_it_stays: true,
};
