//! The landing task (paper section "Quadrotor Landing Scenario"): plans a [`LandingPlan`] in a scene.
//!
//! A [`LandingTask`] is read from a TOML file. [`LandingTask::resolve`] finds the surface to land on and the bodies
//! that must not move, and returns a [`ResolvedLanding`], which turns a [`LandingAction`] into a flight.
//! [`rollout_landing`] flies an action in any world, the planner's or a target's, with any wash model, and returns a
//! [`LandingOutcome`]. [`plan_landing`] screens many approaches with the `jet` model, refines the promising ones with
//! `sph`, and chooses among them in perturbed worlds.
//!
//! ```
//! use glamx::{DPose3, DVec3};
//! use sms_core::{Mesh, box_mass_properties};
//! use sms_landing::{LandingTask, RolloutOptions, rollout_landing};
//! use sms_scene::{Body, BodyKind, BodyShape, Scene, example_material, floor_body};
//! use sms_sim::RapierFactory;
//! use sms_wash::WashSettings;
//!
//! // A heavy table.
//! let half = DVec3::new(0.3, 0.3, 0.3);
//! let table = Body {
//!     name: "table".into(),
//!     kind: BodyKind::Dynamic,
//!     x_wb: DPose3::from_translation(DVec3::new(0.0, 0.0, 0.3)),
//!     shape: BodyShape::Box { half_extents: half },
//!     mass: Some(box_mass_properties(half, 300.0)?),
//!     ..floor_body(0.0, example_material())
//! };
//! let scene = Scene {
//!     version: sms_scene::SCENE_VERSION,
//!     name: "table".into(),
//!     gravity_w: DVec3::new(0.0, 0.0, -9.81),
//!     size_sigma: 0.0,
//!     x_world_recording: DPose3::IDENTITY,
//!     bodies: vec![floor_body(0.0, example_material()), table],
//! };
//! let landing = LandingTask::new([1.0, 0.0]).resolve(&scene)?;
//! assert_eq!(landing.surface().body, "table");
//! let action = landing.straight(landing.surface().point([0.5, 0.5]));
//! let wash = WashSettings::default();
//! let outcome = rollout_landing(&RapierFactory, &wash, &scene, &landing, &action, &RolloutOptions::default())?;
//! assert!(outcome.is_success(), "{:?}", outcome.failure);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod action;
mod disturb;
mod disturb_worlds;
mod error;
mod free;
mod hard;
mod outcome;
mod plan;
mod planner;
mod resolved;
mod rollout;
mod settings;
mod surface;
mod task;

pub use action::LandingAction;
pub use error::LandingError;
pub use free::{Freed, Stuck};
pub use outcome::{BodyChange, LandingFailure, LandingOutcome, ParticleFrame, QUADROTOR};
pub use plan::{
    LANDING_PLAN_FILE, LandingAlternative, LandingEvaluations, LandingPlan, LandingPlanOutcome,
    LandingPrediction, PlannedBody,
};
pub use planner::plan_landing;
pub use resolved::{CarriedOut, ResolvedLanding};
pub use rollout::{LandingRecording, LandingWorld, RolloutOptions, rollout_landing};
pub use settings::{LandingDisturbances, LandingSettings};
pub use surface::LandingSurface;
pub use task::{FootMaterial, LandingBounds, LandingKind, LandingSuccess, LandingTask, SurfaceLimits};
