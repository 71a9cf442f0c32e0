//! What sets the two PhysX targets apart.

use physx_sys::{PxMaterialFlags, PxSceneFlags, PxSolverType};

/// Parameters of a world. `None` leaves PhysX's default.
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
    /// Gap at which a shape makes contacts, metres; PhysX's default is 20 mm. That of a pair is the sum. What approaches
    /// through such a gap is let close four fifths of it in a step, so it loses speed before an impact: the gap is the
    /// one at which a step is split for the impact, and little more.
    pub(super) contact_offset: Option<f32>,
    /// Gap up to which a contact has friction and distance at which contacts share a friction anchor, metres; PhysX's
    /// defaults are 40 mm and 25 mm.
    pub(super) friction_offset: Option<f32>,
    pub(super) friction_correlation: Option<f32>,
    /// Steps are made of steps of at most the second length, and those shorter than that (an impact's, or those up to one)
    /// of steps of at most the first, seconds. What gravity adds in a step counts as approach and is given back with the
    /// rebound: in an impact of 0.4 ms, which a slow ball takes, that keeps it hopping at 2 cm/s for ever.
    pub(super) step_lengths_s: Option<(f64, f64)>,
    /// Position and velocity iterations; PhysX's default is 4 and 1.
    pub(super) iterations: Option<(u32, u32)>,
    /// Approach speed from which contacts bounce, m/s, at least.
    pub(super) bounce_speed: f64,
    /// The same, as a multiple of what gravity adds in a step: a body at rest approaches at one such speed, and what falls back
    /// from a hop must not gain by it.
    pub(super) bounce_gravity_steps: f64,
    /// Whether bodies move without the engine's damping (PhysX's default slows spins by 5 % a second), as fast as they
    /// like and with gyroscopic torques.
    pub(super) free_motion: bool,
    /// Largest speed at which overlapping bodies are pushed apart, m/s.
    pub(super) push_out_speed: Option<f32>,
    /// Speeds below which balls and other bodies fall asleep, m/s. PhysX's default, 0.1, is a ball that still rolls. PhysX
    /// compares with it the *sum* of the velocities in the steps of 0.2 s, 320 of them here: a box's tremor of 5e-5 m/s at
    /// rest comes to 0.016. A far larger value puts balls to sleep that are struck just when they were about to fall asleep.
    pub(super) sleep_speeds: Option<(f64, f64)>,
    /// Whether what stays where it is falls asleep, however it trembles (`rest`).
    pub(super) sleeps_where_it_stays: bool,
}

/// The defaults of PhysX 5.1, but for the threshold of bouncing: with its 2 m/s nothing on a table bounces.
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

/// As near to a real table as the engine comes: within every limit of the closed-form suite.
///
/// - The solver is TGS, whose friction is bounded by a circle. That of PGS is bounded axis by axis, along and across the
///   velocity of the centres and not of the slip: a ball that rolls threw the one that it struck at a cut by up to 3.8° too
///   far, and curved paths were off by 11 %.
/// - Contacts are determined anew in each step (no PCM): kept ones miss a ball that is within micrometres of a mesh. Nor is there
///   PhysX's cache of contacts: without PCM a pair keeps what it had, *no contacts* too, until one body has come 1 % of the
///   scale's length (10 mm) or 0.01 in a component of its rotation nearer. What hopped off the floor fell that far into it.
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
