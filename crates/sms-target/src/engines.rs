//! Target engines by their names on the command line and in tables.

use crate::{SameEngineTarget, Target};
use sms_core::InputError;
use sms_sim::{RapierFactory, WorldFactory, WorldOptions};

#[cfg(feature = "mujoco")]
use crate::mujoco::MujocoFactory;
#[cfg(feature = "physx")]
use crate::physx::PhysxFactory;

/// A physics engine in which plans are executed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum TargetEngine {
    /// Rapier, the planner's engine, at a quarter of its step.
    Rapier,
    /// PhysX, tuned for the closest agreement with closed forms.
    Physx,
    /// PhysX with its default parameters.
    PhysxStock,
    /// MuJoCo.
    Mujoco,
}

impl TargetEngine {
    /// All engines, built in or not.
    pub const ALL: [Self; 4] = [Self::Rapier, Self::Physx, Self::PhysxStock, Self::Mujoco];

    /// Returns the name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rapier => "rapier",
            Self::Physx => "physx",
            Self::PhysxStock => "physx-stock",
            Self::Mujoco => "mujoco",
        }
    }

    /// Returns the name in metrics.
    pub fn key(self) -> &'static str {
        match self {
            Self::Rapier => "rapier",
            Self::Physx => "physx_precise",
            Self::PhysxStock => "physx_stock",
            Self::Mujoco => "mujoco",
        }
    }

    /// Returns whether the engine is built in. MuJoCo also needs its library at run time.
    pub fn is_built_in(self) -> bool {
        match self {
            Self::Rapier => true,
            Self::Physx | Self::PhysxStock => cfg!(feature = "physx"),
            Self::Mujoco => cfg!(feature = "mujoco"),
        }
    }

    /// Returns the default engine: PhysX (precise) if it is built in, otherwise Rapier.
    pub fn preferred() -> Self {
        if Self::Physx.is_built_in() { Self::Physx } else { Self::Rapier }
    }

    /// Builds the target.
    ///
    /// # Errors
    /// [`InputError`] if the engine is not built in, or its library is not found.
    pub fn target(self) -> Result<Box<dyn Target>, InputError> {
        let step = match self {
            Self::Rapier => return Ok(Box::new(SameEngineTarget)),
            Self::Physx => 0.25,
            Self::PhysxStock | Self::Mujoco => 1.0,
        };
        Ok(Box::new(EngineTarget { factory: self.factory()?, step }))
    }

    /// Builds the factory of its worlds.
    ///
    /// # Errors
    /// [`InputError`] if the engine is not built in, or its library is not found.
    pub fn factory(self) -> Result<Box<dyn WorldFactory>, InputError> {
        match self {
            Self::Rapier => Ok(Box::new(RapierFactory)),
            #[cfg(feature = "physx")]
            Self::Physx => Ok(Box::new(PhysxFactory::Precise)),
            #[cfg(feature = "physx")]
            Self::PhysxStock => Ok(Box::new(PhysxFactory::Stock)),
            #[cfg(feature = "mujoco")]
            Self::Mujoco => Ok(Box::new(MujocoFactory::new()?)),
            #[allow(unreachable_patterns, reason = "reached if a feature is off")]
            _ => Err(self.not_built_in()),
        }
    }

    #[allow(dead_code, reason = "used if a feature is off")]
    fn not_built_in(self) -> InputError {
        let feature = if self == Self::Mujoco { "mujoco" } else { "physx" };
        InputError::new(
            format!("this program was built without the engine `{}`", self.name()),
            "--engine",
            format!("build with `--features {feature}` (docs/book/src/guides/engines.md), or use `rapier`"),
        )
    }
}

/// An engine at a fraction of the planner's step.
struct EngineTarget {
    factory: Box<dyn WorldFactory>,
    step: f64,
}

impl Target for EngineTarget {
    fn factory(&self) -> &dyn WorldFactory {
        &*self.factory
    }

    fn world_options(&self, planner: &WorldOptions) -> WorldOptions {
        WorldOptions { dt: self.step * planner.dt, ..*planner }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_built_in_says_how_to_get_it() {
        for engine in TargetEngine::ALL {
            match engine.target() {
                Ok(target) => assert!(engine.is_built_in() && !target.label().is_empty()),
                Err(e) if engine.is_built_in() => assert_eq!(engine, TargetEngine::Mujoco, "{e}"),
                Err(e) => assert!(e.to_string().contains("--features"), "{e}"),
            }
        }
    }

    #[test]
    fn only_rapier_is_labelled_as_the_same_engine() {
        for engine in TargetEngine::ALL {
            if let Ok(target) = engine.target() {
                assert_eq!(target.label().contains("same engine"), engine == TargetEngine::Rapier);
            }
        }
    }
}
