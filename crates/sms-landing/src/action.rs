//! Landing actions: a landing point and an approach.

use glamx::DVec2;
use serde::{Deserialize, Serialize};
use sms_task::Action;

/// A landing: four parameters, as in the paper.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LandingAction {
    /// Point at which the vehicle's axis touches down, world x and y, metres.
    pub landing_w: [f64; 2],
    /// Distance of the approach point from the landing point, metres.
    pub approach_radius: f64,
    /// Direction of the approach point from the landing point, about z from x, radians.
    pub approach_angle: f64,
}

impl LandingAction {
    /// Returns the landing point, world x and y, metres.
    pub fn landing(&self) -> DVec2 {
        self.landing_w.into()
    }

    /// Returns the values in the order of [`crate::ResolvedLanding::parameters`], for trial logs.
    pub fn values(&self) -> Action {
        Action(vec![self.landing_w[0], self.landing_w[1], self.approach_radius, self.approach_angle])
    }

    /// Builds the action from four values in the order of [`LandingAction::values`]; `None` for any other number.
    pub fn from_values(action: &Action) -> Option<Self> {
        let [x, y, approach_radius, approach_angle] = action.0[..] else { return None };
        Some(Self { landing_w: [x, y], approach_radius, approach_angle })
    }
}
