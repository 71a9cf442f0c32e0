//! A world with contact timing, rolling resistance and the striker: what every engine shares.

use crate::geometry::{BodyGeometry, Part, Path};
use crate::timing::{Impact, MIN_CLOSING_SPEED, TOUCH_GAP, time_of_impact};
use crate::{BodyId, BodyState, ContactEvent, SimError, StrikerMotion, World, WorldFactory, WorldOptions};
use glamx::DVec3;
use sms_scene::{Body, BodyKind, BodyShape, Scene};
use std::time::Instant;

/// Least length of the step in which an impact happens, seconds: at 0.8 m/s a ball travels 40 µm in it. A slow ball
/// gets as long as it needs to close the remaining gap in a part of the step, else an engine that predicts
/// contacts only brakes it.
const IMPACT_STEP_S: f64 = 5e-5;
const IMPACT_STEP_GAPS: f64 = 4.0;
/// Steps shorter than this are not made, seconds.
const MIN_STEP_S: f64 = 4e-6;
/// Splits of one nominal step after which the rest is one step.
const MAX_SPLITS: usize = 24;
/// Gap up to which a ball is carried by what is below it, metres: engines let bodies sink in and float by some µm.
const SUPPORT_GAP: f64 = 5e-5;
/// Largest distance from the origin that still counts as a state, metres.
const MAX_DISTANCE: f64 = 1e6;

/// A simulation of a scene: an engine's [`World`], stepped so that impacts of balls fall on the boundaries of steps.
///
/// Body ids are those of the world: the scene's bodies in order, then strikers.
///
/// - **Contact timing**: steps are split where a ball is about to hit another body (computed on our own shapes, the
///   same for every engine), unless [`WorldOptions::contact_timing`] is off.
/// - **Rolling resistance** of balls: a torque of (mean rolling lever of both surfaces) × (weight on the surface)
///   against the rolling, and as much against spinning about the contact normal. A ball on a level surface
///   decelerates by 5/7·g·lever/radius.
/// - **Striker**: [`Simulation::strike`].
pub struct Simulation {
    world: Box<dyn World>,
    options: WorldOptions,
    gravity_w: DVec3,
    names: Vec<String>,
    bodies: Vec<SimBody>,
    states: Vec<BodyState>,
    sweeps: Vec<Sweep>,
    wrenches: Vec<(BodyId, DVec3, DVec3)>,
    /// Time of the world.
    world_s: f64,
    /// Time that was asked for. The difference, at most the length of an impact's step, is made up by the next
    /// advance: an impact that begins just before the end of a step is not cut in two.
    time_s: f64,
    splits: usize,
    /// First touches of a ball and another body since the start, in order of time.
    contacts: Vec<ContactEvent>,
    profile: Option<Profile>,
    saved: Option<Saved>,
}

/// Where the time of a simulation goes, since [`Simulation::begin_profile`]. Wall-clock seconds of the calling thread.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Profile {
    /// Steps of the engine, the parts of split steps included.
    pub steps: usize,
    /// Steps that were made because a step was split.
    pub splits: usize,
    /// In the engine's steps.
    pub engine_s: f64,
    /// In finding out what balls rest on and when they will hit something.
    pub impacts_s: f64,
    /// In returning to the saved state.
    pub restore_s: f64,
}

struct SimBody {
    geometry: BodyGeometry,
    kind: Kind,
    rolling_m: f64,
}

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Static,
    Dynamic,
    Ball { radius: f64, mass: f64, inertia: f64 },
    Kinematic,
}

#[derive(Clone)]
struct Sweep {
    body: BodyId,
    motion: StrikerMotion,
    start_s: f64,
    over: bool,
}

struct Saved {
    states: Vec<BodyState>,
    sweeps: Vec<Sweep>,
    world_s: f64,
    time_s: f64,
    splits: usize,
}

/// What a ball touches.
#[derive(Clone, Copy, Default)]
struct Support {
    /// Whether it touches anything.
    touching: bool,
    /// Upward normal, rolling lever (m) and spin of what carries it.
    carried: Option<(DVec3, f64, DVec3)>,
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
            sweeps: Vec::new(),
            wrenches: Vec::new(),
            world_s: 0.0,
            time_s: 0.0,
            splits: 0,
            contacts: Vec::new(),
            profile: None,
            saved: None,
        })
    }

    /// Name of the engine.
    pub fn engine(&self) -> &'static str {
        self.world.engine()
    }

    /// Gravity in the world, m/s².
    pub fn gravity_w(&self) -> DVec3 {
        self.gravity_w
    }

    /// Time that was advanced, seconds. States may be up to half a millisecond older, where an impact is about to
    /// happen.
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// How often a step was split for an impact.
    pub fn split_count(&self) -> usize {
        self.splits
    }

    /// Every pair of a ball and another body that hit each other, once, when it did for the first time since the start or
    /// the saved state. Only impacts for
    /// which a step was split are known ([`WorldOptions::contact_timing`]); a body that a ball rests on or rolls
    /// against from the start is none.
    pub fn contacts(&self) -> &[ContactEvent] {
        &self.contacts
    }

    /// How deep a ball is inside of another body that is no robot, metres; 0 where it is in none. For a mesh, which
    /// has no inside, how much nearer than its radius the ball's centre is.
    pub fn penetration(&self, ball: BodyId) -> f64 {
        let Kind::Ball { radius, .. } = self.bodies[ball].kind else { return 0.0 };
        let center_w = self.states[ball].x_wb.translation;
        let mut deepest = 0.0f64;
        for (other, body) in self.bodies.iter().enumerate() {
            let state = &self.states[other];
            let reach = radius + body.geometry.bounding_radius;
            let is_far = center_w.distance_squared(state.x_wb.translation) > reach * reach;
            if other == ball || is_far || body.kind == Kind::Kinematic {
                continue;
            }
            let p = state.x_wb.inverse_transform_point(center_w);
            for part in body.geometry.parts_near(p, radius) {
                let (nearest, inside) = part.nearest(p);
                let distance = p.distance(nearest);
                deepest = deepest.max(if inside { radius + distance } else { radius - distance });
            }
        }
        deepest
    }

    /// Begins to measure where time goes.
    pub fn begin_profile(&mut self) {
        self.profile = Some(Profile::default());
    }

    /// What was measured since, if anything.
    pub fn profile(&self) -> Option<Profile> {
        self.profile
    }

    /// Number of bodies, strikers included.
    pub fn body_count(&self) -> usize {
        self.bodies.len()
    }

    /// State of a body.
    ///
    /// # Panics
    /// When there is no such body.
    pub fn state(&self, body: BodyId) -> BodyState {
        self.states[body]
    }

    /// Sets the state of a body and wakes it.
    pub fn set_state(&mut self, body: BodyId, state: &BodyState) {
        self.world.set_state(body, state);
        self.states[body] = *state;
    }

    /// Whether a body is asleep; bodies that nothing moves always are.
    pub fn is_asleep(&self, body: BodyId) -> bool {
        match self.bodies[body].kind {
            Kind::Static => true,
            Kind::Kinematic => self.sweeps.iter().all(|s| s.body != body || s.over),
            Kind::Dynamic | Kind::Ball { .. } => self.world.is_asleep(body),
        }
    }

    /// Adds a force (N) at the centre of mass and a torque (N·m), both in the world, that act during the next
    /// [`Simulation::advance`]; wakes the body.
    pub fn apply_wrench(&mut self, body: BodyId, force_w: DVec3, torque_w: DVec3) {
        self.wrenches.push((body, force_w, torque_w));
    }

    /// Starts a sweep of the robot's finger now, with the friction and restitution of its surface. The finger
    /// pushes bodies and is pushed by none; when the sweep is over it touches nothing any more.
    pub fn strike(&mut self, motion: &StrikerMotion, friction: f64, restitution: f64) -> BodyId {
        let body = self.world.add_kinematic(motion.shape(), motion.pose_at(0.0), friction, restitution);
        debug_assert_eq!(body, self.bodies.len(), "ids of the world and of the simulation agree");
        self.bodies.push(SimBody {
            geometry: BodyGeometry::of_kinematic(motion.shape()),
            kind: Kind::Kinematic,
            rolling_m: 0.0,
        });
        self.states.push(BodyState { x_wb: motion.pose_at(0.0), v_w: DVec3::ZERO, w_w: DVec3::ZERO });
        self.sweeps.push(Sweep { body, motion: *motion, start_s: self.world_s, over: false });
        body
    }

    /// Whether every sweep that was started is over.
    pub fn is_strike_over(&self) -> bool {
        self.sweeps.iter().all(|s| s.over)
    }

    /// Saves the state, for [`Simulation::restore`]; `false` where the engine cannot.
    pub fn save(&mut self) -> bool {
        if !self.world.save() {
            return false;
        }
        self.saved = Some(Saved {
            states: self.states.clone(),
            sweeps: self.sweeps.clone(),
            world_s: self.world_s,
            time_s: self.time_s,
            splits: self.splits,
        });
        self.contacts.clear();
        true
    }

    /// Returns to the saved state; strikers added since are gone. `false` where nothing was saved.
    pub fn restore(&mut self) -> bool {
        let Some(saved) = &self.saved else { return false };
        let began = self.profile.map(|_| Instant::now());
        if !self.world.restore() {
            return false;
        }
        if let (Some(profile), Some(began)) = (&mut self.profile, began) {
            profile.restore_s += began.elapsed().as_secs_f64();
        }
        self.bodies.truncate(saved.states.len());
        self.states.clone_from(&saved.states);
        self.sweeps.clone_from(&saved.sweeps);
        self.world_s = saved.world_s;
        self.time_s = saved.time_s;
        self.splits = saved.splits;
        self.contacts.clear();
        self.wrenches.clear();
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

    /// Steps until the time that was asked for, or until an impact that does not fit in before it.
    fn nominal_step(&mut self) -> Result<(), SimError> {
        let began = self.profile.map(|_| Instant::now());
        let supports = self.supports();
        self.add_impact_time(began);
        let mut splits = 0;
        loop {
            let left = self.time_s - self.world_s;
            if left < MIN_STEP_S {
                return Ok(());
            }
            let began = self.profile.map(|_| Instant::now());
            let impact = if self.options.contact_timing && splits < MAX_SPLITS {
                self.next_impact(left, &supports)
            } else {
                None
            };
            self.add_impact_time(began);
            let Some((impact, ball, other)) = impact else {
                self.step(left, &supports)?;
                // So that rounding does not add up.
                self.world_s = self.time_s;
                return Ok(());
            };
            // Noted before the step to it: engines that predict contacts may turn a ball back a moment earlier.
            self.note_contact(ball, other, impact.time_s);
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

    fn add_impact_time(&mut self, began: Option<Instant>) {
        if let (Some(profile), Some(began)) = (&mut self.profile, began) {
            profile.impacts_s += began.elapsed().as_secs_f64();
        }
    }

    fn note_contact(&mut self, ball: BodyId, other: BodyId, in_s: f64) {
        let is_known =
            |c: &ContactEvent| (c.ball, c.other) == (ball, other) || (c.ball, c.other) == (other, ball);
        if !self.contacts.iter().any(is_known) {
            self.contacts.push(ContactEvent { time_s: self.world_s + in_s, ball, other });
        }
    }

    /// One step of the engine.
    fn step(&mut self, dt: f64, supports: &[Support]) -> Result<(), SimError> {
        for (body, force_w, torque_w) in &self.wrenches {
            self.world.apply_wrench(*body, *force_w, *torque_w, true);
        }
        for (body, support) in supports.iter().enumerate() {
            if let Some(torque_w) = self.rolling_torque(body, support, dt) {
                self.world.apply_wrench(body, DVec3::ZERO, torque_w, false);
            }
        }
        for sweep in &mut self.sweeps {
            if sweep.over {
                continue;
            }
            let t = self.world_s + dt - sweep.start_s;
            sweep.over = t > sweep.motion.duration_s();
            if sweep.over {
                self.world.set_kinematic_enabled(sweep.body, false);
            }
            self.world.set_kinematic_target(sweep.body, sweep.motion.pose_at(t));
        }
        let began = self.profile.map(|_| Instant::now());
        self.world.step(dt);
        if let (Some(profile), Some(began)) = (&mut self.profile, began) {
            profile.engine_s += began.elapsed().as_secs_f64();
            profile.steps += 1;
        }
        self.world_s += dt;
        self.refresh_states()
    }

    fn refresh_states(&mut self) -> Result<(), SimError> {
        let mut failed = self.world.first_failed();
        for (body, state) in self.states.iter_mut().enumerate() {
            match self.bodies[body].kind {
                Kind::Static => {}
                Kind::Kinematic => {
                    let Some(sweep) = self.sweeps.iter().find(|s| s.body == body) else { continue };
                    let t = self.world_s - sweep.start_s;
                    *state = BodyState {
                        x_wb: sweep.motion.pose_at(t),
                        v_w: sweep.motion.velocity_at(t),
                        w_w: DVec3::ZERO,
                    };
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
                body: self.names.get(body).cloned().unwrap_or_else(|| "striker".to_owned()),
            }),
        }
    }

    /// What each ball touches; balls that sleep are left out.
    fn supports(&self) -> Vec<Support> {
        (0..self.bodies.len()).map(|b| self.support_of(b)).collect()
    }

    fn support_of(&self, ball: BodyId) -> Support {
        let mut support = Support::default();
        let Kind::Ball { radius, .. } = self.bodies[ball].kind else { return support };
        if self.world.is_asleep(ball) {
            return support;
        }
        let center_w = self.states[ball].x_wb.translation;
        let up_w = (-self.gravity_w).try_normalize().unwrap_or(DVec3::Z);
        // Steeper than this, a surface does not carry.
        let mut best_slope = 0.5;
        for (other, body) in self.bodies.iter().enumerate() {
            let state = &self.states[other];
            let reach = radius + body.geometry.bounding_radius + SUPPORT_GAP;
            if other == ball || center_w.distance_squared(state.x_wb.translation) > reach * reach {
                continue;
            }
            let p = state.x_wb.inverse_transform_point(center_w);
            for part in body.geometry.parts_near(p, radius + SUPPORT_GAP) {
                let (nearest, inside) = part.nearest(p);
                let distance = p.distance(nearest);
                if inside || distance > radius + SUPPORT_GAP || distance == 0.0 {
                    continue;
                }
                support.touching = true;
                let normal_w = state.x_wb.rotation * ((p - nearest) / distance);
                let slope = normal_w.dot(up_w);
                if slope > best_slope {
                    best_slope = slope;
                    let lever = 0.5 * (self.bodies[ball].rolling_m + body.rolling_m);
                    support.carried = Some((normal_w, lever, state.w_w));
                }
            }
        }
        support
    }

    /// Torque of the rolling resistance for a step of `dt`, never more than would stop the rotation.
    fn rolling_torque(&self, ball: BodyId, support: &Support, dt: f64) -> Option<DVec3> {
        let Kind::Ball { mass, inertia, .. } = self.bodies[ball].kind else { return None };
        let (normal_w, lever, spin_w) = support.carried?;
        let weight = (-mass * self.gravity_w.dot(normal_w)).max(0.0);
        let rotation = self.states[ball].w_w - spin_w;
        let spinning = rotation.dot(normal_w) * normal_w;
        let against = |part: DVec3| {
            let most = inertia * part.length() / dt;
            -part.normalize_or_zero() * (lever * weight).min(most)
        };
        let torque = against(rotation - spinning) + against(spinning);
        (torque.length_squared() > 0.0).then_some(torque)
    }

    /// The next touch of a ball and another body, if within `horizon` seconds.
    fn next_impact(&self, horizon: f64, supports: &[Support]) -> Option<(Impact, BodyId, BodyId)> {
        let mut first: Option<(Impact, BodyId, BodyId)> = None;
        for (ball, body) in self.bodies.iter().enumerate() {
            let Kind::Ball { radius, .. } = body.kind else { continue };
            let path = self.path(ball, supports);
            let center_w = self.states[ball].x_wb.translation;
            for other in 0..self.bodies.len() {
                let until = first.map_or(horizon, |(i, ..)| i.time_s);
                let Some(travel) = self.travel(ball, other, until) else { continue };
                let geometry = &self.bodies[other].geometry;
                let x_wb = &self.states[other].x_wb;
                let reach = radius + travel;
                let far = geometry.bounding_radius + reach;
                if center_w.distance_squared(x_wb.translation) > far * far {
                    continue;
                }
                let other_path = self.path(other, supports);
                for part in geometry.parts_near(x_wb.inverse_transform_point(center_w), reach) {
                    let until = first.map_or(horizon, |(i, ..)| i.time_s);
                    let impact = time_of_impact(&path, radius, part, &other_path, until);
                    first = impact.map(|i| (i, ball, other)).or(first);
                }
            }
        }
        first
    }

    fn path(&self, body: BodyId, supports: &[Support]) -> Path<'_> {
        if let Some(sweep) = self.sweeps.iter().find(|s| s.body == body) {
            return Path::Sweep { motion: &sweep.motion, start_s: self.world_s - sweep.start_s };
        }
        let is_flying = matches!(self.bodies[body].kind, Kind::Ball { .. })
            && !supports[body].touching
            && !self.world.is_asleep(body);
        let acceleration_w = if is_flying { self.gravity_w } else { DVec3::ZERO };
        Path::Free { state: &self.states[body], acceleration_w }
    }

    /// How much nearer a ball can come to a point of another body within `horizon` seconds, metres; `None` where
    /// the pair is not to be looked at.
    fn travel(&self, ball: BodyId, other: BodyId, horizon: f64) -> Option<f64> {
        let (a, b) = (&self.states[ball], &self.states[other]);
        let mut speed = (a.v_w - b.v_w).length();
        match self.bodies[other].kind {
            _ if ball == other => return None,
            // A pair of balls is looked at once, from the faster one.
            Kind::Ball { .. } => {
                let (own, its) = (a.v_w.length_squared(), b.v_w.length_squared());
                if own < its || (own == its && ball > other) {
                    return None;
                }
            }
            Kind::Kinematic => {
                if self.sweeps.iter().any(|s| s.body == other && s.over) {
                    return None;
                }
            }
            Kind::Dynamic => speed += b.w_w.length() * self.bodies[other].geometry.bounding_radius,
            Kind::Static => {}
        }
        if speed == 0.0 && self.world.is_asleep(ball) {
            return None;
        }
        // Whether it flies or is accelerated by the finger.
        speed += self.gravity_w.length() * horizon;
        if speed < MIN_CLOSING_SPEED { None } else { Some(speed * horizon + TOUCH_GAP) }
    }
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

// Parts are only looked at, never changed, once a simulation is built.
const _: fn() = || {
    fn is_send<T: Send>() {}
    is_send::<Simulation>();
    is_send::<Part>();
};
