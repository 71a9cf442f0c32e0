//! Rigid-body worlds: the [`World`] trait, its Rapier implementation in both precisions, and [`Simulation`], which adds
//! the parts that all engines share: contact timing, rolling resistance and strikers (the arm, or a kinematic finger).
//!
//! ```
//! use glamx::{DPose3, DVec3};
//! use sms_core::sphere_mass_properties;
//! use sms_scene::{Body, BodyKind, BodyShape, Scene, example_material, floor_body};
//! use sms_sim::{RapierFactory, Simulation, StrikerMotion, WorldOptions};
//!
//! let center_w = DVec3::new(0.5, 0.0, 0.03);
//! let floor = floor_body(0.0, example_material());
//! let ball = Body {
//!     name: "cue".into(),
//!     kind: BodyKind::Dynamic,
//!     x_wb: DPose3::from_translation(center_w),
//!     shape: BodyShape::Sphere { radius: 0.03 },
//!     mass: Some(sphere_mass_properties(DVec3::ZERO, 0.03, 1700.0)?),
//!     ..floor.clone()
//! };
//! let scene = Scene {
//!     version: sms_scene::SCENE_VERSION,
//!     name: "one ball".into(),
//!     gravity_w: DVec3::new(0.0, 0.0, -9.81),
//!     size_sigma: 0.0,
//!     x_world_recording: DPose3::IDENTITY,
//!     bodies: vec![floor, ball],
//! };
//! let mut simulation = Simulation::new(&RapierFactory, &scene, &WorldOptions::default())?;
//! let motion = StrikerMotion { contact_w: center_w, angle: 0.0, speed: 0.5, ball_radius: 0.03 };
//! simulation.strike(motion, 0.65, 0.75);
//! for _ in 0..400 {
//!     simulation.advance(0.0025)?;
//! }
//! assert!(simulation.state(1).x_wb.translation.x > 0.7, "the ball was struck along x");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod arm;
mod engine_arm;
mod geometry;
mod penetration;
mod rapier;
mod rest;
mod simulation;
mod striker;
mod support;
mod timing;
mod tipping;
mod wash;
mod world;

pub use geometry::signed_distance;
#[cfg(feature = "f64")]
pub use rapier::RapierF64Factory;
pub use rapier::{NamedRapier, RapierFactory};
pub use rest::{RestLimits, RestingDrift, fix_restless, resting_drift};
pub use simulation::{Simulation, SimulationProfile};
pub use sms_robots::SEGMENT_M;
pub use sms_wash::BodyState;
pub use striker::{FINGER_HALF, Striker, StrikerMotion};
pub use tipping::{LoadRamp, LoadTest, ramp_load_n, tipping_load_n};
pub use wash::{WashInWorld, wash_surfaces};
pub use world::{
    ArmKind, BodyId, ContactEvent, PhysicsViolation, SimError, World, WorldFactory, WorldOptions,
};
