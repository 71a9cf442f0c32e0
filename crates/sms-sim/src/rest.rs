//! Tests whether a scene is at rest.

use crate::{SimError, Simulation, WorldFactory, WorldOptions};
use serde::{Deserialize, Serialize};
use sms_scene::{BodyKind, Scene};

/// Drift of a dynamic body from its start.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RestingDrift {
    /// Name of the body.
    pub body: String,
    /// Distance of its centre of mass from the start, metres.
    pub moved_m: f64,
    /// Rotation from the start, radians.
    pub turned_rad: f64,
}

/// Simulates a scene for `seconds` and returns the drift of each dynamic body, in the scene's order. Bodies do not
/// sleep, so that slow creep counts.
///
/// # Errors
/// [`SimError`] when the world cannot be built or diverges.
pub fn resting_drift(
    factory: &dyn WorldFactory,
    scene: &Scene,
    seconds: f64,
) -> Result<Vec<RestingDrift>, SimError> {
    stand(factory, scene, seconds, |_| ())
}

/// Simulates a scene, calls `each_step` with the drifts after every step, and returns the final drifts.
fn stand(
    factory: &dyn WorldFactory,
    scene: &Scene,
    seconds: f64,
    mut each_step: impl FnMut(&[RestingDrift]),
) -> Result<Vec<RestingDrift>, SimError> {
    let options = WorldOptions { sleep: false, ..WorldOptions::default() };
    let mut simulation = Simulation::new(factory, scene, &options)?;
    let moving = || scene.bodies.iter().enumerate().filter(|(_, b)| b.kind == BodyKind::Dynamic);
    let mut drifts: Vec<RestingDrift> = moving()
        .map(|(_, body)| RestingDrift { body: body.name.clone(), moved_m: 0.0, turned_rad: 0.0 })
        .collect();
    for _ in 0..(seconds / options.dt).round() as usize {
        simulation.advance(options.dt)?;
        for (drift, (id, body)) in drifts.iter_mut().zip(moving()) {
            let now = simulation.state(id).x_wb;
            drift.moved_m = now.translation.distance(body.x_wb.translation);
            drift.turned_rad = now.rotation.angle_between(body.x_wb.rotation);
        }
        each_step(&drifts);
    }
    Ok(drifts)
}

/// Largest drift of a resting body.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RestLimits {
    /// Duration, seconds.
    pub seconds: f64,
    /// Distance, metres.
    pub moved_m: f64,
    /// Angle, radians.
    pub turned_rad: f64,
}

impl Default for RestLimits {
    fn default() -> Self {
        Self { seconds: 1.0, moved_m: 0.001, turned_rad: 0.5f64.to_radians() }
    }
}

impl RestLimits {
    /// The drift in units of the limits: above 1 the body does not rest.
    pub fn excess(&self, drift: &RestingDrift) -> f64 {
        (drift.moved_m / self.moved_m).max(drift.turned_rad / self.turned_rad)
    }
}

/// Makes bodies static until the others rest. A recording shows bodies at rest, so a moving one was reconstructed
/// incompletely. Bodies are fixed one at a time. The first body to move comes first, because it may push others.
/// Returns the drifts of the fixed bodies in this order.
///
/// # Errors
/// [`SimError`] when a world cannot be built or diverges.
pub fn fix_restless(
    factory: &dyn WorldFactory,
    scene: &mut Scene,
    limits: &RestLimits,
) -> Result<Vec<RestingDrift>, SimError> {
    let mut fixed = Vec::new();
    loop {
        let mut first = None;
        let standing = stand(factory, scene, limits.seconds, |drifts| {
            if first.is_none() {
                let excess = |i: &usize| limits.excess(&drifts[*i]);
                first = (0..drifts.len())
                    .filter(|i| excess(i) > 1.0)
                    .max_by(|a, b| excess(a).total_cmp(&excess(b)));
            }
        });
        let drift = match standing {
            Ok(mut drifts) => match first {
                Some(first) => drifts.swap_remove(first),
                None => return Ok(fixed),
            },
            // A body that diverges does not rest.
            Err(SimError::Diverged { body, .. }) if is_dynamic(scene, &body) => {
                RestingDrift { body, moved_m: f64::INFINITY, turned_rad: std::f64::consts::PI }
            }
            Err(e) => return Err(e),
        };
        if let Some(i) = scene.body_index(&drift.body) {
            scene.bodies[i].kind = BodyKind::Static;
            scene.bodies[i].mass = None;
        }
        fixed.push(drift);
    }
}

fn is_dynamic(scene: &Scene, name: &str) -> bool {
    scene.body(name).is_some_and(|b| b.kind == BodyKind::Dynamic)
}
