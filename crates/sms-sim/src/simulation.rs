//! A world with contact timing, rolling resistance and strikers, for every engine.

use crate::arm::ArmInWorld;
use crate::engine_arm::EngineArm;
use crate::geometry::BodyGeometry;
use crate::striker::{FINGER_HALF, RETRACTION_M};
use crate::support::BallSupport;
use crate::timing::TOUCH_GAP;
use crate::{
    ArmKind, BodyId, BodyState, ContactEvent, SimError, Striker, StrikerMotion, World, WorldFactory,
    WorldOptions,
};
use glamx::DVec3;
use sms_robots::SweepDrive;
use sms_scene::{Body, BodyKind, BodyShape, Scene};
use std::collections::BTreeSet;
use std::time::Instant;

mod impacts;

/// Shortest step that contains an impact, seconds: a ball of 0.8 m/s travels 40 µm in it. A slow ball can close the
/// remaining gap within part of the step; otherwise engines that only predict contacts would brake it.
const IMPACT_STEP_S: f64 = 5e-5;
const IMPACT_STEP_GAPS: f64 = 4.0;
/// Shortest step, seconds.
const MIN_STEP_S: f64 = 4e-6;
/// Largest number of splits of a nominal step.
const MAX_SPLITS: usize = 24;
/// Largest distance from the origin of a valid state, metres.
const MAX_DISTANCE: f64 = 1e6;

/// A simulation of a scene: an engine's [`World`], stepped so that impacts of balls fall on the boundaries of steps.
///
/// Body ids are those of the world: the scene's bodies in order, then strikers.
///
/// - **Contact timing**: steps are split where a ball is about to hit another body (computed on shapes that are the
///   same for every engine), unless [`WorldOptions::contact_timing`] is off.
/// - **Rolling resistance** of balls: a torque of (mean rolling lever of both surfaces) × (weight on the surface)
///   against rolling, and an equal one against spinning about the contact normal. A ball on a level surface decelerates
///   by 5/7·g·lever/radius.
/// - **Striker**: [`Simulation::strike`].
pub struct Simulation {
    pub(crate) world: Box<dyn World>,
    options: WorldOptions,
    pub(crate) gravity_w: DVec3,
    names: Vec<String>,
    pub(crate) bodies: Vec<SimBody>,
    pub(crate) states: Vec<BodyState>,
    strikes: Vec<ActiveStrike>,
    wrenches: Vec<(BodyId, DVec3, DVec3)>,
    /// Time of the world, seconds.
    world_s: f64,
    /// Requested time, seconds. The world may lag behind by at most an impact step, so that an impact that begins just
    /// before the end of a step is not cut in two. The next advance makes up the difference.
    time_s: f64,
    splits: usize,
    /// First touches of pairs of bodies since the start, in order of time.
    contacts: Vec<ContactEvent>,
    /// Pairs that touched before the state was saved, or in the first step. They are not events.
    resting: BTreeSet<(BodyId, BodyId)>,
    /// Buffer for the engine's touch reports.
    touches: Vec<(BodyId, BodyId)>,
    profile: Option<SimulationProfile>,
    saved: Option<SavedState>,
}

/// Time profile of a simulation since [`Simulation::begin_profile`]. Wall-clock seconds of the calling thread.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct SimulationProfile {
    /// Number of engine steps, parts of split steps included.
    pub steps: usize,
    /// Number of additional steps due to splits.
    pub splits: usize,
    /// Time in the engine's steps.
    pub engine_s: f64,
    /// Time in the prediction of impacts and supports of balls.
    pub impacts_s: f64,
    /// Time in the strikers: dynamics and control of the arm.
    pub striker_s: f64,
    /// Time in restoring the saved state.
    pub restore_s: f64,
}

pub(crate) struct SimBody {
    pub(crate) geometry: BodyGeometry,
    pub(crate) kind: Kind,
    pub(crate) rolling_m: f64,
}

#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Kind {
    Static,
    Dynamic,
    Ball { radius: f64, mass: f64, inertia: f64 },
    Striker,
}

/// A strike in progress.
#[derive(Clone)]
struct ActiveStrike {
    body: BodyId,
    by: By,
    start_s: f64,
    over: bool,
}

#[derive(Clone)]
enum By {
    Finger(StrikerMotion),
    Arm(Box<ArmInWorld>),
    EngineArm(Box<EngineArm>),
}

impl By {
    fn duration_s(&self) -> f64 {
        match self {
            Self::Finger(motion) => motion.duration_s(),
            Self::Arm(arm) => arm.drive.strike().duration_s(),
            Self::EngineArm(arm) => arm.strike.duration_s(),
        }
    }
}

struct SavedState {
    states: Vec<BodyState>,
    strikes: Vec<ActiveStrike>,
    world_s: f64,
    time_s: f64,
    splits: usize,
}

impl Simulation {
    /// Builds a world of the scene.
    ///
    /// # Errors
    /// [`SimError::Body`] when a body's shape or mass cannot be simulated.
    pub fn new(factory: &dyn WorldFactory, scene: &Scene, options: &WorldOptions) -> Result<Self, SimError> {
        let world = factory.build(scene, options)?;
        let bodies = scene.bodies.iter().map(SimBody::new).collect::<Result<Vec<_>, _>>()?;
        let states = (0..bodies.len()).map(|b| world.state(b)).collect();
        let options =
            WorldOptions { contact_timing: options.contact_timing && factory.splits_steps(), ..*options };
        Ok(Self {
            world,
            options,
            gravity_w: scene.gravity_w,
            names: scene.bodies.iter().map(|b| b.name.clone()).collect(),
            bodies,
            states,
            strikes: Vec::new(),
            wrenches: Vec::new(),
            world_s: 0.0,
            time_s: 0.0,
            splits: 0,
            contacts: Vec::new(),
            resting: BTreeSet::new(),
            touches: Vec::new(),
            profile: None,
            saved: None,
        })
    }

    /// Returns the name of a body; the striker is called "striker".
    pub fn name(&self, body: BodyId) -> &str {
        self.names.get(body).map_or("striker", String::as_str)
    }

    /// Name of the engine.
    pub fn engine(&self) -> &'static str {
        self.world.engine()
    }

    /// Gravity in the world, m/s².
    pub fn gravity_w(&self) -> DVec3 {
        self.gravity_w
    }

    /// Simulated time, seconds. States may be up to half a millisecond older if an impact is imminent.
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// Number of steps split for an impact.
    pub fn split_count(&self) -> usize {
        self.splits
    }

    /// Returns the first contacts of pairs of bodies since the start or the saved state. Pairs that touch from the
    /// start are not listed. The list contains impacts of balls for which a step was split
    /// ([`WorldOptions::contact_timing`]). If the engine reports touches ([`World::take_touches`]), it also contains
    /// all other touches, except of two static bodies.
    pub fn contacts(&self) -> &[ContactEvent] {
        &self.contacts
    }

    /// Starts the time profile.
    pub fn begin_profile(&mut self) {
        self.profile = Some(SimulationProfile::default());
    }

    /// The time profile, if started.
    pub fn profile(&self) -> Option<SimulationProfile> {
        self.profile
    }

    /// State of a body.
    ///
    /// # Panics
    /// When the body does not exist.
    pub fn state(&self, body: BodyId) -> BodyState {
        self.states[body]
    }

    /// Sets the state of a body and wakes it.
    pub fn set_state(&mut self, body: BodyId, state: &BodyState) {
        self.world.set_state(body, state);
        self.states[body] = *state;
    }

    /// Whether a body is asleep; static and kinematic bodies always are.
    pub fn is_asleep(&self, body: BodyId) -> bool {
        match self.bodies[body].kind {
            Kind::Static => true,
            Kind::Striker => self.strikes.iter().all(|s| s.body != body || s.over),
            Kind::Dynamic | Kind::Ball { .. } => self.world.is_asleep(body),
        }
    }

    /// Adds a force (N) at the centre of mass and a torque (N·m), both in the world, that act during the next
    /// [`Simulation::advance`]; wakes the body.
    pub fn apply_wrench(&mut self, body: BodyId, force_w: DVec3, torque_w: DVec3) {
        self.wrenches.push((body, force_w, torque_w));
    }

    /// Starts a sweep now, with the friction and restitution of the striking surface. After the sweep the striker has
    /// no collisions. A finger pushes bodies without being pushed. An arm yields according to its inertia and
    /// controller, and static bodies stop it.
    pub fn strike(&mut self, striker: impl Into<Striker>, friction: f64, restitution: f64) -> BodyId {
        let (body, by, half, state) = match striker.into() {
            Striker::Finger(motion) => {
                let x_wb = motion.pose_at(0.0);
                let body = self.world.add_kinematic(FINGER_HALF, x_wb, friction, restitution);
                (body, By::Finger(motion), FINGER_HALF, BodyState::at_rest(x_wb))
            }
            Striker::Arm(strike) => {
                let half = strike.half;
                let own = (self.options.arm == ArmKind::Articulation)
                    .then(|| self.world.add_arm(&strike, friction, restitution));
                if let Some(body) = own.flatten() {
                    let state = self.world.state(body);
                    (body, By::EngineArm(Box::new(EngineArm::new(strike, state))), half, state)
                } else {
                    let arm = ArmInWorld::new(&strike);
                    let state = arm.state;
                    let body = self.world.add_tool(half, state.x_wb, friction, restitution);
                    (body, By::Arm(Box::new(arm)), half, state)
                }
            }
        };
        debug_assert_eq!(body, self.bodies.len(), "ids of the world and of the simulation agree");
        self.bodies.push(SimBody {
            geometry: BodyGeometry::of_box(half),
            kind: Kind::Striker,
            rolling_m: 0.0,
        });
        self.states.push(state);
        self.strikes.push(ActiveStrike { body, by, start_s: self.world_s, over: false });
        body
    }

    /// The arm of a strike; `None` for a finger and for other bodies.
    pub fn arm(&self, body: BodyId) -> Option<&SweepDrive> {
        self.arm_of(body).map(|arm| &arm.drive)
    }

    /// Sum of the impulses that an arm has received, N·s; `None` for a finger and for other bodies.
    pub fn received_impulse_w(&self, body: BodyId) -> Option<DVec3> {
        self.arm_of(body).map(|arm| arm.impulse_w)
    }

    /// Energy given by an arm, J: each impulse times the mean of the tool's velocities around it. `None` for a finger.
    pub fn work_j(&self, body: BodyId) -> Option<f64> {
        self.arm_of(body).map(|arm| arm.work_j)
    }

    /// States of all bodies, strikers included, by their ids.
    pub fn states(&self) -> &[BodyState] {
        &self.states
    }

    fn arm_of(&self, body: BodyId) -> Option<&ArmInWorld> {
        self.strikes.iter().find_map(|s| match &s.by {
            By::Arm(arm) if s.body == body => Some(arm.as_ref()),
            _ => None,
        })
    }

    /// Whether every sweep is over.
    pub fn is_strike_over(&self) -> bool {
        self.strikes.iter().all(|s| s.over)
    }

    /// Saves the state for [`Simulation::restore`]; `false` if the engine does not support it.
    pub fn save(&mut self) -> bool {
        if !self.world.save() {
            return false;
        }
        self.saved = Some(SavedState {
            states: self.states.clone(),
            strikes: self.strikes.clone(),
            world_s: self.world_s,
            time_s: self.time_s,
            splits: self.splits,
        });
        self.resting.extend(self.contacts.iter().map(|c| ordered(c.body, c.other)));
        self.contacts.clear();
        true
    }

    /// Restores the saved state and removes strikers added since; `false` if nothing was saved.
    pub fn restore(&mut self) -> bool {
        let Some(saved) = &self.saved else { return false };
        let began = self.clock();
        if !self.world.restore() {
            return false;
        }
        self.bodies.truncate(saved.states.len());
        self.states.clone_from(&saved.states);
        self.strikes.clone_from(&saved.strikes);
        self.world_s = saved.world_s;
        self.time_s = saved.time_s;
        self.splits = saved.splits;
        self.contacts.clear();
        self.wrenches.clear();
        self.add_time(began, |profile| &mut profile.restore_s);
        true
    }

    /// Advances by `dt` seconds, in nominal steps of at most [`WorldOptions::dt`].
    ///
    /// # Errors
    /// [`SimError::Diverged`] when a state stops being finite; the simulation must then be restored or dropped.
    pub fn advance(&mut self, dt: f64) -> Result<(), SimError> {
        let steps = (dt / self.options.dt - 1e-9).ceil().max(1.0);
        let start_s = self.time_s;
        for k in 1..=steps as usize {
            self.time_s = start_s + dt * (k as f64 / steps);
            self.nominal_step()?;
        }
        self.wrenches.clear();
        Ok(())
    }

    /// Steps to the requested time, or to an impact whose step extends beyond it.
    fn nominal_step(&mut self) -> Result<(), SimError> {
        let began = self.clock();
        let supports = self.supports();
        self.add_time(began, |profile| &mut profile.impacts_s);
        let mut splits = 0;
        loop {
            let left = self.time_s - self.world_s;
            if left < MIN_STEP_S {
                return Ok(());
            }
            let began = self.clock();
            let impact = if self.options.contact_timing && splits < MAX_SPLITS {
                self.look_ahead(left);
                self.next_impact(left, &supports)
            } else {
                None
            };
            self.add_time(began, |profile| &mut profile.impacts_s);
            let Some((impact, ball, other)) = impact else {
                self.step(left, &supports)?;
                // Avoids the accumulation of rounding errors.
                self.world_s = self.time_s;
                return Ok(());
            };
            // Recorded before the step, because engines that predict contacts may reflect a ball earlier.
            self.note_contact(ball, other, impact.time_s);
            if let Some(ActiveStrike { by: By::Arm(arm), .. }) =
                self.strikes.iter_mut().find(|s| s.body == other)
            {
                arm.expect(impact.point_w, impact.normal_w);
            }
            if impact.time_s > MIN_STEP_S {
                self.step(impact.time_s, &supports)?;
            } else {
                let length = IMPACT_STEP_S.max(IMPACT_STEP_GAPS * TOUCH_GAP / impact.closing_speed);
                if length > left {
                    return Ok(());
                }
                self.step(length, &supports)?;
            }
            splits += 1;
            self.splits += 1;
            if let Some(profile) = &mut self.profile {
                profile.splits += 1;
            }
        }
    }

    /// The current time, if the simulation is profiled.
    fn clock(&self) -> Option<Instant> {
        self.profile.map(|_| Instant::now())
    }

    /// Adds the time since `began` to a part of the profile.
    fn add_time(&mut self, began: Option<Instant>, part: fn(&mut SimulationProfile) -> &mut f64) {
        if let (Some(profile), Some(began)) = (&mut self.profile, began) {
            *part(profile) += began.elapsed().as_secs_f64();
        }
    }

    fn note_contact(&mut self, body: BodyId, other: BodyId, in_s: f64) {
        let pair = ordered(body, other);
        if !self.contacts.iter().any(|c| ordered(c.body, c.other) == pair) {
            self.contacts.push(ContactEvent { time_s: self.world_s + in_s, body, other });
        }
    }

    /// Records the touches that the engine reports for the last step of `dt`; the states are those before the step.
    fn note_touches(&mut self, dt: f64) {
        let mut touches = std::mem::take(&mut self.touches);
        self.world.take_touches(&mut touches);
        for (a, b) in touches.drain(..) {
            let is_static = |body: BodyId| self.bodies[body].kind == Kind::Static;
            if is_static(a) || is_static(b) || self.resting.contains(&ordered(a, b)) {
                continue;
            }
            // Pairs in resting contact are reported in the first step.
            if self.world_s == 0.0 {
                self.resting.insert(ordered(a, b));
                continue;
            }
            let speed = |body: BodyId| self.states[body].v_w.length();
            let (body, other) = if speed(b) > speed(a) { (b, a) } else { (a, b) };
            self.note_contact(body, other, dt);
        }
        self.touches = touches;
    }

    /// Takes one step of the engine.
    fn step(&mut self, dt: f64, supports: &[BallSupport]) -> Result<(), SimError> {
        for (body, force_w, torque_w) in &self.wrenches {
            self.world.apply_wrench(*body, *force_w, *torque_w, true);
        }
        for (body, support) in supports.iter().enumerate() {
            if let Some(torque_w) = self.rolling_torque(body, support, dt) {
                self.world.apply_wrench(body, DVec3::ZERO, torque_w, false);
            }
        }
        let began = self.clock();
        for strike in self.strikes.iter_mut().filter(|s| !s.over) {
            let t = self.world_s + dt - strike.start_s;
            strike.over = t > strike.by.duration_s();
            if strike.over {
                self.world.set_kinematic_enabled(strike.body, false);
            }
            match &mut strike.by {
                By::Finger(motion) => self.world.set_kinematic_target(strike.body, motion.pose_at(t)),
                By::Arm(arm) if strike.over => park(&mut arm.state),
                By::EngineArm(arm) if strike.over => park(&mut arm.state),
                By::EngineArm(arm) => arm.before_step(self.world.as_mut(), strike.body, t - dt),
                By::Arm(arm) => arm.before_step(self.world.as_mut(), strike.body, t, dt),
            }
        }
        self.add_time(began, |profile| &mut profile.striker_s);
        let began = self.clock();
        self.world.step(dt);
        self.add_time(began, |profile| &mut profile.engine_s);
        if let Some(profile) = &mut self.profile {
            profile.steps += 1;
        }
        self.note_touches(dt);
        self.world_s += dt;
        self.refresh_states(dt)
    }

    fn refresh_states(&mut self, dt: f64) -> Result<(), SimError> {
        let began = self.clock();
        for strike in &mut self.strikes {
            let t = self.world_s - strike.start_s;
            self.states[strike.body] = match &mut strike.by {
                By::Finger(motion) => {
                    BodyState { x_wb: motion.pose_at(t), v_w: motion.velocity_at(t), w_w: DVec3::ZERO }
                }
                By::Arm(arm) if strike.over => arm.state,
                By::EngineArm(arm) if strike.over => arm.state,
                By::EngineArm(arm) => arm.after_step(self.world.as_ref(), strike.body),
                By::Arm(arm) => arm.after_step(self.world.as_ref(), strike.body, dt),
            };
        }
        self.add_time(began, |profile| &mut profile.striker_s);
        let mut failed = self.world.first_failed();
        for (body, state) in self.states.iter_mut().enumerate() {
            match self.bodies[body].kind {
                Kind::Static => {}
                Kind::Striker => {
                    if !(state.x_wb.is_finite() && state.v_w.is_finite()) {
                        failed = failed.or(Some(body));
                    }
                }
                Kind::Dynamic | Kind::Ball { .. } => {
                    *state = self.world.state(body);
                    let sane = state.x_wb.is_finite()
                        && state.v_w.is_finite()
                        && state.w_w.is_finite()
                        && state.x_wb.translation.length() < MAX_DISTANCE;
                    if !sane {
                        failed = failed.or(Some(body));
                    }
                }
            }
        }
        match failed {
            None => Ok(()),
            Some(body) => Err(SimError::Diverged {
                engine: self.world.engine(),
                time_s: self.world_s,
                body: self.name(body).to_owned(),
            }),
        }
    }
}

/// Removes an arm from the world.
fn park(state: &mut BodyState) {
    state.x_wb.translation.z += RETRACTION_M;
    (state.v_w, state.w_w) = (DVec3::ZERO, DVec3::ZERO);
}

/// The pair in ascending order.
fn ordered(a: BodyId, b: BodyId) -> (BodyId, BodyId) {
    (a.min(b), a.max(b))
}

impl SimBody {
    fn new(body: &Body) -> Result<Self, SimError> {
        let kind = match (body.kind, &body.shape, &body.mass) {
            (BodyKind::Static, ..) => Kind::Static,
            (BodyKind::Dynamic, BodyShape::Sphere { radius }, Some(mass)) => Kind::Ball {
                radius: *radius,
                mass: mass.mass(),
                inertia: {
                    let i = mass.inertia();
                    i.x_axis.x.min(i.y_axis.y).min(i.z_axis.z)
                },
            },
            (BodyKind::Dynamic, ..) => Kind::Dynamic,
        };
        Ok(Self {
            geometry: BodyGeometry::of_body(body)?,
            kind,
            rolling_m: body.material.rolling_m.value.best,
        })
    }
}

impl std::fmt::Debug for Simulation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Simulation")
            .field("engine", &self.world.engine())
            .field("bodies", &self.names)
            .field("time_s", &self.world_s)
            .finish_non_exhaustive()
    }
}
