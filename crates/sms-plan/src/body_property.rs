//! Properties of bodies that the scan may have estimated wrongly.

use serde::{Deserialize, Serialize};
use sms_scene::Body;

/// A property of a body that may differ from its estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BodyProperty {
    /// Mass in kilograms; the inertia scales with it.
    Mass,
    /// Coefficient of friction.
    Friction,
    /// Coefficient of restitution.
    Restitution,
    /// Rolling resistance lever, metres.
    Rolling,
}

impl BodyProperty {
    /// All properties.
    pub const ALL: [Self; 4] = [Self::Mass, Self::Friction, Self::Restitution, Self::Rolling];

    /// The name used in messages.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Mass => "mass",
            Self::Friction => "friction",
            Self::Restitution => "restitution",
            Self::Rolling => "rolling resistance",
        }
    }

    /// Copies this property from one body to another.
    pub(crate) fn copy(self, from: &Body, to: &mut Body) {
        let (a, b) = (&from.material, &mut to.material);
        match self {
            Self::Mass => to.mass = from.mass,
            Self::Friction => b.friction.value.best = a.friction.value.best,
            Self::Restitution => b.restitution.value.best = a.restitution.value.best,
            Self::Rolling => b.rolling_m.value.best = a.rolling_m.value.best,
        }
    }
}
