//! Rigid-body worlds: the World trait, the Rapier adapter, contact timing, the striker.

mod world;

pub use world::{BodyId, BodyState, KinematicShape, SimError, World, WorldFactory, WorldOptions};
