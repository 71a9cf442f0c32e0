//! The rollout that planner and target share: the vehicle flies, cuts its motors, and touches down as a free body.

use crate::outcome::{BodyChange, change, failure, tilt};
use crate::{
    CarriedOut, LandingAction, LandingError, LandingOutcome, LandingTask, ParticleFrame, QUADROTOR,
    ResolvedLanding,
};
use glamx::{DPose3, DVec3};
use serde::{Deserialize, Serialize};
use sms_core::{Aabb, Interval, Property, PropertySource};
use sms_robots::{Flight, Rotor};
use sms_scene::{Body, Scene, example_material};
use sms_sim::{
    BodyId, BodyState, PhysicsViolation, SimError, Simulation, WashInWorld, WorldFactory, WorldOptions,
    wash_surfaces,
};
use sms_task::{BodyTrack, Trajectory};
use sms_wash::{VehicleState, WashModel, WashSettings};

/// Time that a world settles before its first use, seconds: contact forces converge.
const SETTLE_S: f64 = 0.25;
/// Horizontal distance of the vehicle's centre from the structure's box at which the simulation begins, metres: no
/// stream reaches the structure from farther away.
const NEAR_M: f64 = 0.5;
/// Number of steps for which the wrenches of streams are held: at 0.5 m/s the vehicle flies 5 mm in 10 ms.
const HOLD: usize = 4;
/// Change of velocity in a step, without gravity's, at which the vehicle detects a touch, m/s.
const TOUCH_SPEED: f64 = 0.02;
/// A rollout is at rest when no body was faster than this for this time: m/s, rad/s, seconds.
const STILL_SPEED: f64 = 5e-4;
const STILL_TURN: f64 = 5e-3;
const STILL_S: f64 = 0.4;

/// Recording of the motion of a rollout.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LandingRecording {
    /// Time between states, seconds.
    pub every_s: f64,
    /// Whether the wash particles are recorded, too.
    pub particles: bool,
}

/// Options of a rollout.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RolloutOptions {
    /// Execution errors of the flight.
    pub carried_out: CarriedOut,
    /// Recording of the motion, if any.
    pub recording: Option<LandingRecording>,
    /// Ends the rollout as soon as the structure alone makes the objective this large: searches cap it there
    /// ([`LandingOutcome::score`]).
    pub enough: Option<f64>,
}

/// A world with a structure, a vehicle and a wash model, for many rollouts of one task. Each rollout starts from the
/// same state.
pub struct LandingWorld {
    simulation: Simulation,
    wash: Option<WashInWorld>,
    wash_name: &'static str,
    /// The structure: names and ids.
    structure: Vec<(String, BodyId)>,
    /// Their poses in the scene.
    poses_w: Vec<DPose3>,
    vehicle: BodyId,
    /// The box around the structure.
    around: Option<Aabb>,
    landing: ResolvedLanding,
    rotors: Vec<Rotor>,
    hover: Vec<f64>,
    gravity: DVec3,
    /// Number of steps for which the wash's wrenches are held.
    hold: usize,
    used: bool,
    can_restore: bool,
}

/// Log of a rollout.
#[derive(Default)]
struct Log {
    impulses_w: Vec<DVec3>,
    peaks: Vec<f64>,
    toppled_s: Option<f64>,
    still_s: f64,
    trajectory: Trajectory,
    particles: Vec<ParticleFrame>,
    next_record_s: f64,
}

impl LandingWorld {
    /// Builds the world of a scene. `structure` names the judged bodies of this scene: those of
    /// [`ResolvedLanding::structure`] in the planner's scene, their counterparts in a target's.
    ///
    /// # Errors
    /// [`LandingError`] if the scene or the wash cannot be simulated, or a body is unknown.
    pub fn new(
        factory: &dyn WorldFactory,
        options: &WorldOptions,
        scene: &Scene,
        landing: &ResolvedLanding,
        structure: &[String],
        wash: &WashSettings,
    ) -> Result<Self, LandingError> {
        let surfaces = wash_surfaces(scene)?;
        let bodies = scene.bodies.len();
        let ids: Vec<(String, BodyId)> = structure
            .iter()
            .map(|name| {
                Ok((name.clone(), crate::surface::body_index(landing.task(), scene, "structure", name)?))
            })
            .collect::<Result<_, LandingError>>()?;
        let corners = ids.iter().filter_map(|(_, i)| surfaces[*i].extent_w(&scene.bodies[*i].x_wb));
        let around = Aabb::of_points(corners.flat_map(|e| [e.min, e.max]));
        let air = wash.build(surfaces)?;
        let wash_name = air.as_ref().map_or("none", |a| a.name());
        let mut with_vehicle = scene.without_pictures();
        with_vehicle.bodies.push(vehicle_body(landing, scene)?);
        let simulation = Simulation::new(factory, &with_vehicle, options)?;
        let vehicle = landing.vehicle();
        let mut world = Self {
            simulation,
            wash: air.map(|a| WashInWorld::new(a, bodies)),
            wash_name,
            poses_w: ids.iter().map(|(_, i)| scene.bodies[*i].x_wb).collect(),
            structure: ids,
            vehicle: bodies,
            around,
            landing: landing.clone(),
            rotors: vehicle.propellers(),
            hover: vehicle.hover_thrusts(scene.gravity_w.length()),
            gravity: scene.gravity_w,
            // Particles are integrated in every step. Streams have no memory and change as slowly as the vehicle flies.
            hold: if wash.model == WashModel::Sph { 1 } else { HOLD },
            used: false,
            can_restore: false,
        };
        let parked = BodyState::at_rest(DPose3::from_translation(landing.start_w()));
        for _ in 0..(SETTLE_S / landing.task().dt).round() as usize {
            world.simulation.set_state(world.vehicle, &parked);
            world.simulation.advance(landing.task().dt)?;
        }
        world.can_restore = world.simulation.save();
        Ok(world)
    }

    /// Returns whether the world can fly again: it is unused, or its engine can restore the saved state.
    pub fn is_reusable(&self) -> bool {
        self.can_restore || !self.used
    }

    /// Returns the name of the engine.
    pub fn engine(&self) -> &'static str {
        self.simulation.engine()
    }

    /// Flies an action. A simulation that diverges returns an outcome without an objective.
    ///
    /// # Errors
    /// [`LandingError`] if the flight cannot be built, or the world was used and cannot be restored.
    pub fn fly(
        &mut self,
        action: &LandingAction,
        options: &RolloutOptions,
    ) -> Result<LandingOutcome, LandingError> {
        if self.used && !self.simulation.restore() {
            return Err(SimError::Unphysical {
                engine: self.simulation.engine(),
                time_s: 0.0,
                why: PhysicsViolation::Other("a used world of this engine cannot be restored".to_owned()),
            }
            .into());
        }
        self.used = true;
        if let Some(wash) = &mut self.wash {
            wash.restore();
        }
        let flight = self.landing.flight(action, &options.carried_out)?;
        let bodies = self.structure.len();
        let (impulses_w, peaks) = (vec![DVec3::ZERO; bodies], vec![0.0; bodies]);
        let mut log = Log { impulses_w, peaks, ..Log::default() };
        match self.run(&flight, action, options, &mut log) {
            Ok(outcome) => Ok(outcome),
            Err(e) if e.is_invalid_rollout() => {
                let end_s = match &e {
                    SimError::Diverged { time_s, .. } | SimError::Unphysical { time_s, .. } => *time_s,
                    _ => 0.0,
                };
                Ok(LandingOutcome {
                    trajectory: log.trajectory,
                    ..LandingOutcome::invalid(self.engine(), self.wash_name, end_s, e.to_string())
                })
            }
            Err(e) => Err(e.into()),
        }
    }

    fn run(
        &mut self,
        flight: &Flight,
        action: &LandingAction,
        options: &RolloutOptions,
        log: &mut Log,
    ) -> Result<LandingOutcome, SimError> {
        let task = self.landing.task().clone();
        let (dt, success) = (task.dt, task.success);
        let thrusts: Vec<f64> = self.hover.iter().map(|t| t * options.carried_out.wash).collect();
        let off = vec![0.0; thrusts.len()];
        let enough = |bodies: &[BodyChange]| {
            options.enough.is_some_and(|cap| LandingTask::objective(bodies, 0.0) >= cap)
        };
        let standing_w = self.landing.standing_w(action.landing());

        // Times are from the start of the flight; the simulation starts when the vehicle comes near.
        let first = (self.near_s(flight) / dt).floor() as usize;
        for k in 0..first {
            self.record(log, options, k as f64 * dt, Some(flight));
        }
        let mut step = first;
        let (cut_s, touched_early) = loop {
            let t = step as f64 * dt;
            let now = flight.state(t);
            if !now.motors {
                break (t, false);
            }
            self.record(log, options, t, Some(flight));
            let state = BodyState { x_wb: now.x_wv, v_w: now.v_w, w_w: DVec3::ZERO };
            self.simulation.set_state(self.vehicle, &state);
            self.advance(&state, &thrusts, dt, (step - first).is_multiple_of(self.hold), log)?;
            step += 1;
            let bodies = self.note(log, &success, step as f64 * dt);
            if enough(&bodies) {
                return Ok(self.outcome(log, bodies, standing_w, None, false, step as f64 * dt));
            }
            let v_w = self.simulation.state(self.vehicle).v_w;
            if (v_w - state.v_w - self.gravity * dt).length() > TOUCH_SPEED {
                break (step as f64 * dt, true);
            }
        };
        if !touched_early {
            let last = flight.state(cut_s);
            let state = BodyState { x_wb: last.x_wv, v_w: last.v_w, w_w: DVec3::ZERO };
            self.simulation.set_state(self.vehicle, &state);
        }
        let steps = (success.after_s / dt).round() as usize;
        for k in 0..steps {
            let t = cut_s + k as f64 * dt;
            self.record(log, options, t, None);
            let state = self.simulation.state(self.vehicle);
            self.advance(&state, &off, dt, true, log)?;
            let bodies = self.note(log, &success, t + dt);
            let is_over = enough(&bodies) || self.is_still(log, dt);
            if is_over && options.recording.is_none() {
                return Ok(self.outcome(log, bodies, standing_w, Some(cut_s), touched_early, t + dt));
            }
        }
        let end_s = cut_s + steps as f64 * dt;
        self.record(log, options, end_s, None);
        let bodies = self.note(log, &success, end_s);
        Ok(self.outcome(log, bodies, standing_w, Some(cut_s), touched_early, end_s))
    }

    /// Advances the bodies by one step, with new wrenches of the wash if `fresh`, otherwise with those of the last
    /// step.
    fn advance(
        &mut self,
        vehicle: &BodyState,
        thrusts: &[f64],
        dt: f64,
        fresh: bool,
        log: &mut Log,
    ) -> Result<(), SimError> {
        let blows = thrusts.iter().any(|t| *t > 0.0);
        let Some(wash) = self.wash.as_mut().filter(|w| blows || w.wash().is_active()) else {
            return self.simulation.advance(dt);
        };
        let now = VehicleState { x_wv: vehicle.x_wb, v_w: vehicle.v_w, rotors: &self.rotors, thrusts };
        if fresh {
            wash.advance(&mut self.simulation, &now, dt)?;
        } else {
            for (body, wrench) in wash.wrenches().iter().enumerate() {
                if wrench.force_w != DVec3::ZERO {
                    self.simulation.apply_wrench(body, wrench.force_w, wrench.torque_w);
                }
            }
            self.simulation.advance(dt)?;
        }
        for (i, (_, id)) in self.structure.iter().enumerate() {
            let force_w = wash.wrenches()[*id].force_w;
            log.impulses_w[i] += dt * force_w;
            log.peaks[i] = log.peaks[i].max(force_w.length());
        }
        Ok(())
    }

    /// Returns the changes of the structure's bodies, and logs the time at which one first exceeds its limits.
    fn note(&self, log: &mut Log, success: &crate::LandingSuccess, t: f64) -> Vec<BodyChange> {
        let bodies: Vec<BodyChange> = self
            .structure
            .iter()
            .zip(&self.poses_w)
            .enumerate()
            .map(|(i, ((name, id), from))| {
                let (moved_m, turned_rad) = change(from, &self.simulation.state(*id).x_wb);
                BodyChange {
                    body: name.clone(),
                    moved_m,
                    turned_rad,
                    wash_impulse_w: log.impulses_w[i],
                    wash_peak_n: log.peaks[i],
                }
            })
            .collect();
        let off = |b: &BodyChange| b.moved_m > success.moved_m || b.turned_rad > success.turned_rad;
        if log.toppled_s.is_none() && bodies.iter().any(off) {
            log.toppled_s = Some(t);
        }
        bodies
    }

    /// Whether all bodies and the wash have been at rest for [`STILL_S`].
    fn is_still(&self, log: &mut Log, dt: f64) -> bool {
        let ids = self.structure.iter().map(|(_, id)| *id).chain([self.vehicle]);
        let still = |id: BodyId| {
            let s = self.simulation.state(id);
            s.v_w.length() < STILL_SPEED && s.w_w.length() < STILL_TURN
        };
        let air = self.wash.as_ref().is_some_and(|w| w.wash().is_active());
        log.still_s = if !air && ids.into_iter().all(still) { log.still_s + dt } else { 0.0 };
        log.still_s > STILL_S
    }

    /// Returns the time at which the vehicle first comes near the structure, seconds.
    fn near_s(&self, flight: &Flight) -> f64 {
        let Some(around) = &self.around else { return 0.0 };
        let end_s = flight.arrival_s();
        let count = (end_s / 0.01).ceil() as usize;
        let is_near = |k: &usize| {
            let p = flight.state((*k as f64 * 0.01).min(end_s)).x_wv.translation.truncate();
            let gap = (around.min.truncate() - p).max(p - around.max.truncate()).max(glamx::DVec2::ZERO);
            gap.length() < NEAR_M
        };
        // The flight is sampled every 10 ms, more coarsely than the steps: start one sample earlier.
        (0..=count).find(is_near).map_or(end_s, |k| (k as f64 - 1.0).max(0.0) * 0.01)
    }

    fn outcome(
        &self,
        log: &mut Log,
        bodies: Vec<BodyChange>,
        standing_w: DVec3,
        cut_s: Option<f64>,
        touched_early: bool,
        end_s: f64,
    ) -> LandingOutcome {
        let state = self.simulation.state(self.vehicle);
        let landing_error_m = state.x_wb.translation.distance(standing_w);
        let (tilt_rad, speed) = (tilt(&state), state.v_w.length());
        let success = &self.landing.task().success;
        // A rollout without motor cut ended early because the structure had toppled.
        let landing = if cut_s.is_some() { landing_error_m } else { 0.0 };
        LandingOutcome {
            engine: self.engine().to_owned(),
            wash: self.wash_name.to_owned(),
            objective: Some(LandingTask::objective(&bodies, landing)),
            failure: failure(success, &bodies, landing_error_m, tilt_rad, speed),
            bodies,
            landing_error_m,
            tilt_rad,
            speed,
            cut_s,
            touched_early,
            toppled_s: log.toppled_s,
            end_s,
            trajectory: std::mem::take(&mut log.trajectory),
            particles: std::mem::take(&mut log.particles),
        }
    }

    /// Records the states at `t` if the next record is due. During the flight, the vehicle's state is that of `flight`.
    fn record(&self, log: &mut Log, options: &RolloutOptions, t: f64, flight: Option<&Flight>) {
        let Some(recording) = options.recording.filter(|_| t + 1e-9 >= log.next_record_s) else { return };
        log.next_record_s += recording.every_s
            * ((t - log.next_record_s) / recording.every_s).floor().max(0.0)
            + recording.every_s;
        let vehicle = match flight {
            Some(flight) => {
                let now = flight.state(t);
                BodyState { x_wb: now.x_wv, v_w: now.v_w, w_w: DVec3::ZERO }
            }
            None => self.simulation.state(self.vehicle),
        };
        let trajectory = &mut log.trajectory;
        if trajectory.bodies.is_empty() {
            let names = self.structure.iter().map(|(n, _)| n.as_str()).chain([QUADROTOR]);
            trajectory.bodies = names.map(|n| BodyTrack { name: n.to_owned(), states: Vec::new() }).collect();
        }
        trajectory.times_s.push(t);
        let states = self.structure.iter().map(|(_, id)| self.simulation.state(*id)).chain([vehicle]);
        for (track, state) in trajectory.bodies.iter_mut().zip(states) {
            track.states.push(state);
        }
        if recording.particles {
            let particles_w = self.wash.as_ref().map_or(Vec::new(), |w| w.wash().particles_w());
            log.particles.push(ParticleFrame { time_s: t, particles_w });
        }
    }
}

/// Returns the vehicle as a body at the start of its flight.
fn vehicle_body(landing: &ResolvedLanding, scene: &Scene) -> Result<Body, LandingError> {
    let vehicle = landing.vehicle();
    let mut material = example_material();
    let known = |v: f64| Property::new(Interval::exact(v), PropertySource::User);
    material.friction = known(landing.task().feet.friction);
    material.restitution = known(landing.task().feet.restitution);
    material.rolling_m = known(0.0);
    let mut name = QUADROTOR.to_owned();
    while scene.body_index(&name).is_some() {
        name.push('_');
    }
    let mass = vehicle
        .mass_properties()
        .map_err(|e| SimError::Body { body: vehicle.name.clone(), why: e.to_string() })?;
    Ok(vehicle.body(&name, DPose3::from_translation(landing.start_w()), Some(mass), material))
}

/// Flies one landing in a new world: the planner's ([`sms_sim::RapierFactory`], the scanned scene) or a target's. Use a
/// [`LandingWorld`] for many landings in one scene. The crate's example uses it.
///
/// # Errors
/// [`LandingError`] if the scene, the wash or the flight cannot be built.
pub fn rollout_landing(
    factory: &dyn WorldFactory,
    wash: &WashSettings,
    scene: &Scene,
    landing: &ResolvedLanding,
    action: &LandingAction,
    options: &RolloutOptions,
) -> Result<LandingOutcome, LandingError> {
    let structure = landing.structure();
    LandingWorld::new(factory, &landing.world_options(), scene, landing, structure, wash)?
        .fly(action, options)
}
