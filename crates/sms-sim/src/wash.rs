//! Wash above the [`crate::World`] trait: any model of the air with any engine.

use crate::{BodyState, SimError, Simulation};
use glamx::DVec3;
use sms_scene::{BodyShape, Scene};
use sms_wash::{BodyMotion, BodySurface, VehicleState, Wash, WashError, Wrench};

/// Forces below this are not handed over, N: resting bodies may fall asleep again when the air is still.
const LEAST_FORCE: f64 = 1e-4;

/// The surfaces of a scene's bodies, in its order, as models of wash want them. Static meshes are not felt by the air (they are
/// no convex solids); floors are.
///
/// # Errors
/// [`SimError::Body`] when a hull bounds no volume.
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

/// A model of wash that blows at the bodies of a simulation.
///
/// In each nominal step the air moves first, past the bodies as they are; its mean wrenches act on them during the step. So
/// what the air loses the bodies get, in the same step.
pub struct WashInWorld {
    wash: Box<dyn Wash>,
    /// Scene bodies come first in a world: the wash's surfaces are theirs.
    motions: Vec<BodyMotion>,
    wrenches: Vec<Wrench>,
}

impl WashInWorld {
    /// Couples a model that was made for the first `bodies` bodies of a simulation ([`wash_surfaces`]: those of its scene).
    pub fn new(wash: Box<dyn Wash>, bodies: usize) -> Self {
        Self { wash, motions: Vec::with_capacity(bodies), wrenches: vec![Wrench::default(); bodies] }
    }

    /// The model.
    pub fn wash(&self) -> &dyn Wash {
        &*self.wash
    }

    /// The wrenches of the last step, in the order of bodies; forces in N, torques about centres of mass in N·m.
    pub fn wrenches(&self) -> &[Wrench] {
        &self.wrenches
    }

    /// Advances the air and the simulation by one step of `dt` seconds with the vehicle as it is. Take the simulation's nominal step
    /// ([`crate::WorldOptions::dt`]), or less.
    ///
    /// # Errors
    /// [`SimError::Diverged`] when a state stops being finite.
    pub fn advance(
        &mut self,
        simulation: &mut Simulation,
        vehicle: &VehicleState<'_>,
        dt: f64,
    ) -> Result<(), SimError> {
        self.motions.clear();
        self.motions.extend((0..self.wrenches.len()).map(|b| motion(&simulation.state(b))));
        self.wash.step(dt, vehicle, &self.motions, &mut self.wrenches);
        for (body, wrench) in self.wrenches.iter().enumerate() {
            // What is not finite is handed over as well: the simulation then says that it diverged.
            if wrench.force_w.length() > LEAST_FORCE || !wrench.force_w.is_finite() {
                simulation.apply_wrench(body, wrench.force_w, wrench.torque_w);
            }
        }
        simulation.advance(dt)
    }

    /// Saves the state of the air; the simulation has its own ([`Simulation::save`]).
    pub fn save(&mut self) {
        self.wash.save();
    }

    /// Returns to the saved state of the air.
    pub fn restore(&mut self) {
        self.wash.restore();
        self.wrenches.fill(Wrench { force_w: DVec3::ZERO, torque_w: DVec3::ZERO });
    }
}

fn motion(state: &BodyState) -> BodyMotion {
    BodyMotion { x_wb: state.x_wb, v_w: state.v_w, w_w: state.w_w }
}
