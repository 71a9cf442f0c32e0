//! Whether a scene rests.

use crate::{SimError, Simulation, WorldFactory, WorldOptions};
use serde::{Deserialize, Serialize};
use sms_scene::{BodyKind, Scene};

/// How far a dynamic body came from where it was.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RestingDrift {
    /// Name of the body.
    pub body: String,
    /// Distance of its centre of mass from the start, metres.
    pub moved_m: f64,
    /// Angle to its attitude at the start, radians.
    pub turned_rad: f64,
}

/// Lets a scene stand for `seconds` and says how far each dynamic body moved and turned, in the scene's order.
/// Bodies may not sleep, so that slow creeping shows.
///
/// # Errors
/// [`SimError`] when the world cannot be built or blows up.
pub fn resting_drift(
    factory: &dyn WorldFactory,
    scene: &Scene,
    seconds: f64,
) -> Result<Vec<RestingDrift>, SimError> {
    let options = WorldOptions { sleep: false, ..WorldOptions::default() };
    let mut simulation = Simulation::new(factory, scene, &options)?;
    let steps = (seconds / options.dt).round() as usize;
    for _ in 0..steps {
        simulation.advance(options.dt)?;
    }
    let drift = |(id, body): (usize, &sms_scene::Body)| {
        let now = simulation.state(id).x_wb;
        RestingDrift {
            body: body.name.clone(),
            moved_m: now.translation.distance(body.x_wb.translation),
            turned_rad: now.rotation.angle_between(body.x_wb.rotation),
        }
    };
    Ok(scene.bodies.iter().enumerate().filter(|(_, b)| b.kind == BodyKind::Dynamic).map(drift).collect())
}
