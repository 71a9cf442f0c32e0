//! Wash on the bodies of a [`crate::World`], for any model of the air and any engine.

use crate::{SimError, Simulation};
use sms_scene::{BodyShape, Scene};
use sms_wash::{BodySurface, VehicleState, Wash, WashError, Wrench};

/// Smaller forces are dropped, N, so that resting bodies fall asleep when the air is still.
const LEAST_FORCE: f64 = 1e-4;

/// The surfaces of a scene's bodies in order, as input of a wash model. Static meshes do not affect the air because
/// they are not convex solids; floors do.
///
/// # Errors
/// [`SimError::Body`] when a hull has no volume.
pub fn wash_surfaces(scene: &Scene) -> Result<Vec<BodySurface>, SimError> {
    scene
        .bodies
        .iter()
        .map(|body| match &body.shape {
            BodyShape::HalfSpace => Ok(BodySurface::half_space()),
            BodyShape::TriMesh { .. } => Ok(BodySurface::empty()),
            solid => BodySurface::from_convex(&solid.meshes())
                .map_err(|e: WashError| SimError::Body { body: body.name.clone(), why: e.to_string() }),
        })
        .collect()
}

/// A wash model coupled to the bodies of a simulation.
///
/// In each nominal step the air moves first, with the bodies in their current states. The mean wrenches of the air then
/// act on the bodies during the step, so that the bodies receive the momentum that the air loses in the same step.
pub struct WashInWorld {
    wash: Box<dyn Wash>,
    wrenches: Vec<Wrench>,
}

impl WashInWorld {
    /// Couples a model to the first `bodies` bodies of a simulation (those of its scene: [`wash_surfaces`]).
    pub fn new(wash: Box<dyn Wash>, bodies: usize) -> Self {
        Self { wash, wrenches: vec![Wrench::default(); bodies] }
    }

    /// The model.
    pub fn wash(&self) -> &dyn Wash {
        &*self.wash
    }

    /// The wrenches of the last step, in the order of bodies; forces in N, torques about centres of mass in N·m.
    pub fn wrenches(&self) -> &[Wrench] {
        &self.wrenches
    }

    /// Advances the air and the simulation by one step of `dt` seconds with the vehicle in its current state; `dt` is
    /// at most the nominal step ([`crate::WorldOptions::dt`]).
    ///
    /// # Errors
    /// [`SimError::Diverged`] when a state stops being finite.
    pub fn advance(
        &mut self,
        simulation: &mut Simulation,
        vehicle: &VehicleState<'_>,
        dt: f64,
    ) -> Result<(), SimError> {
        // The scene's bodies come first in a world.
        let bodies = &simulation.states()[..self.wrenches.len()];
        self.wash.step(dt, vehicle, bodies, &mut self.wrenches);
        for (body, wrench) in self.wrenches.iter().enumerate() {
            // A wrench that is not finite is applied too, so that the simulation reports the divergence.
            if wrench.force_w.length() > LEAST_FORCE || !wrench.force_w.is_finite() {
                simulation.apply_wrench(body, wrench.force_w, wrench.torque_w);
            }
        }
        simulation.advance(dt)
    }

    /// Saves the state of the air; the simulation is saved separately ([`Simulation::save`]).
    pub fn save(&mut self) {
        self.wash.save();
    }

    /// Restores the saved state of the air.
    pub fn restore(&mut self) {
        self.wash.restore();
        self.wrenches.fill(Wrench::default());
    }
}
