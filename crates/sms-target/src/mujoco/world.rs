//! Adapter from the `World` trait to MuJoCo.

use super::library::{Data, Library};
use super::model::{KinematicSpec, LONGEST_STEP_S, text};
use super::near::Bounds;
use glamx::{DPose3, DQuat, DVec3};
use sms_scene::{Body, BodyKind, Scene};
use sms_sim::{BodyId, BodyState, SimError, World, WorldOptions};
use std::sync::Arc;

/// Largest relative difference between a tool's mass and the model's; beyond it the model is recompiled.
const MASS_TOLERANCE: f64 = 1e-3;
/// Distance, beyond the travel of both in a step, below which a tool's mass matters, metres. Compiling a model takes
/// tens of milliseconds; recompiling after every motion of the arm took as long as the shot.
const NEAR_M: f64 = 1e-3;
/// Largest lever arm of a rotating body, metres.
const REACH_M: f64 = 0.5;

/// Time for which a body must rest before it falls asleep, seconds, and its largest displacement, metres, and rotation,
/// radians, in that time. A body balanced on an edge needs seconds to fall.
const WINDOW_S: f64 = 0.1;
const MOVED_M: f64 = 1e-5;
const TURNED_RAD: f64 = 1e-4;
/// Distance at which an awake body wakes a sleeping one, metres, beyond the travel of both in a step: a struck body
/// travels up to 3 mm in a step.
const WAKE_M: f64 = 0.005;

/// A world of MuJoCo.
///
/// Sleeping bodies are not in the model, because MuJoCo solves every contact of a body at rest in each of its short
/// steps, which took nine tenths of a shot's time. The model is recompiled with the body before a moving body comes
/// near.
pub(super) struct MujocoWorld {
    engine: &'static str,
    library: &'static Library,
    scene: Scene,
    may_sleep: bool,
    /// The model of the awake and fixed bodies; `None` while no movable body is awake.
    compiled: Option<Compiled>,
    now: MujocoState,
    /// Six values per body, starting with the world.
    wrenches: Vec<f64>,
    bodies: Vec<BodyInfo>,
    /// Bounds of the scene's bodies.
    bounds: Vec<Bounds>,
    /// A body with which MuJoCo refuses the model; the world is unusable then.
    failed: Option<BodyId>,
    saved: Option<MujocoState>,
}

#[derive(Clone, Copy)]
struct BodyInfo {
    /// Index of its free joint; `None` for a fixed body.
    joint: Option<usize>,
    /// Centre of mass in the body's frame.
    com: DVec3,
    /// Pose of a fixed body.
    x_wb: DPose3,
}

#[derive(Clone)]
struct MujocoKinematic {
    body: BodyId,
    spec: KinematicSpec,
    /// Current mass of a tool; the model's mass follows when the tool comes near a body.
    mass: Option<f64>,
    target_x_wk: DPose3,
}

/// The part of a world that is saved and restored.
#[derive(Clone)]
struct MujocoState {
    /// Positions and velocities of the free joints, 7 and 6 values per joint, and the last accelerations.
    q: Vec<f64>,
    v: Vec<f64>,
    a: Vec<f64>,
    /// Sleep state of the scene's bodies.
    asleep: Vec<bool>,
    /// Time since the poses of the scene's bodies were noted, seconds, and these poses.
    elapsed_s: f64,
    places: Vec<DPose3>,
    kinematics: Vec<MujocoKinematic>,
}

/// A model and its bodies.
struct Compiled {
    data: Data,
    /// Bodies in the model's order, without the world.
    bodies: Vec<BodyId>,
    /// Joints of these bodies, in the model's order.
    joints: Vec<usize>,
    // Buffers in the model's order.
    q: Vec<f64>,
    v: Vec<f64>,
    a: Vec<f64>,
    wrenches: Vec<f64>,
}

impl MujocoWorld {
    pub(super) fn build(
        engine: &'static str,
        library: &'static Library,
        scene: &Scene,
        options: &WorldOptions,
    ) -> Result<Self, SimError> {
        let refuse = |body: &str, why: &str| SimError::Body { body: body.to_owned(), why: why.to_owned() };
        let mut bodies: Vec<BodyInfo> = Vec::with_capacity(scene.bodies.len() + 1);
        let mut joints = 0;
        for body in &scene.bodies {
            if !body.x_wb.is_finite() {
                return Err(refuse(&body.name, "its pose is not finite"));
            }
            let mut info = BodyInfo { joint: None, com: DVec3::ZERO, x_wb: body.x_wb };
            if body.kind == BodyKind::Dynamic {
                let mass =
                    body.mass.as_ref().ok_or_else(|| refuse(&body.name, "it is dynamic and has no mass"))?;
                info.com = mass.com();
                info.joint = Some(joints);
                joints += 1;
            }
            bodies.push(info);
        }
        compile(library, scene, &|_| true, &[])
            .map_err(|why| refuse(culprit(library, scene).unwrap_or(&scene.name), &why))?;
        let mut world = Self {
            engine,
            library,
            scene: scene.clone(),
            may_sleep: options.sleep,
            compiled: None,
            now: MujocoState {
                q: vec![0.0; 7 * joints],
                v: vec![0.0; 6 * joints],
                a: vec![0.0; 6 * joints],
                asleep: vec![false; scene.bodies.len()],
                elapsed_s: 0.0,
                places: scene.bodies.iter().map(|b| b.x_wb).collect(),
                kinematics: Vec::new(),
            },
            wrenches: vec![0.0; 6 * (bodies.len() + 1)],
            bodies,
            bounds: scene.bodies.iter().map(|b| Bounds::of(&b.shape)).collect(),
            failed: None,
            saved: None,
        };
        for (body, from) in scene.bodies.iter().enumerate() {
            world.put(body, &BodyState::at_rest(from.x_wb));
        }
        world.recompile().map_err(|why| refuse(&scene.name, &why))?;
        Ok(world)
    }

    /// Recompiles the model after a change of bodies, kinematic bodies or collisions.
    fn recompile(&mut self) -> Result<(), String> {
        let specs: Vec<KinematicSpec> = self.now.kinematics.iter().map(|k| k.spec).collect();
        let asleep = &self.now.asleep;
        let of_scene = (0..self.scene.bodies.len()).filter(|&b| !asleep[b]);
        let bodies: Vec<BodyId> = of_scene.chain(self.now.kinematics.iter().map(|k| k.body)).collect();
        let joints: Vec<usize> = bodies.iter().filter_map(|&b| self.bodies[b].joint).collect();
        self.compiled = None;
        if joints.is_empty() {
            return Ok(());
        }
        let mut compiled = Compiled {
            data: compile(self.library, &self.scene, &|b| !asleep[b], &specs)?,
            q: vec![0.0; 7 * joints.len()],
            v: vec![0.0; 6 * joints.len()],
            a: vec![0.0; 6 * joints.len()],
            wrenches: vec![0.0; 6 * (bodies.len() + 1)],
            bodies,
            joints,
        };
        compiled.warm_start(&self.now.a);
        self.compiled = Some(compiled);
        Ok(())
    }

    /// Wakes all bodies that an awake body may touch in this step, and recursively their neighbours.
    fn wake_neighbours(&mut self, dt: f64) {
        if !self.now.asleep.contains(&true) {
            return;
        }
        let mut woken = None;
        let mut awake: Vec<BodyId> = (0..self.now.asleep.len()).filter(|&b| self.is_awake(b)).collect();
        for k in self.now.kinematics.iter().filter(|k| k.spec.enabled) {
            let tool = self.state(k.body);
            for body in 0..self.now.asleep.len() {
                let margin = WAKE_M + tool.v_w.length() * dt;
                if self.now.asleep[body]
                    && self.bounds[body].is_near(&self.state(body).x_wb, k.spec.half, &tool.x_wb, margin)
                {
                    self.now.asleep[body] = false;
                    awake.push(body);
                    woken = Some(body);
                }
            }
        }
        while let Some(mover) = awake.pop() {
            for body in 0..self.now.asleep.len() {
                if self.now.asleep[body] && self.is_beside(mover, body, dt) {
                    self.now.asleep[body] = false;
                    awake.push(body);
                    woken = Some(body);
                }
            }
        }
        if let Some(body) = woken {
            self.recompile_for(body);
        }
    }

    /// Returns whether a body of the scene is movable and awake.
    fn is_awake(&self, body: BodyId) -> bool {
        self.bodies[body].joint.is_some() && !self.now.asleep[body]
    }

    /// Returns whether two bodies of the scene may touch in a step of `dt`.
    fn is_beside(&self, a: BodyId, b: BodyId, dt: f64) -> bool {
        let (of_a, of_b) = (self.state(a), self.state(b));
        let speed = of_a.v_w.distance(of_b.v_w) + (of_a.w_w.length() + of_b.w_w.length()) * REACH_M;
        let margin = WAKE_M + speed * dt;
        let most = self.bounds[a].reach() + self.bounds[b].reach() + margin;
        of_a.x_wb.translation.distance_squared(of_b.x_wb.translation) < most * most
            && self.bounds[a].meets(&of_a.x_wb, &self.bounds[b], &of_b.x_wb, margin)
    }

    /// Puts resting bodies without a moving neighbour to sleep, after a step of `dt`.
    fn put_to_sleep(&mut self, dt: f64) {
        self.now.elapsed_s += dt;
        if !self.may_sleep || self.now.elapsed_s < WINDOW_S {
            return;
        }
        let awake: Vec<BodyId> = (0..self.now.asleep.len()).filter(|&b| self.is_awake(b)).collect();
        let stays = |&body: &BodyId| {
            let (then, now) = (&self.now.places[body], self.state(body).x_wb);
            then.translation.distance(now.translation) < MOVED_M
                && then.rotation.angle_between(now.rotation) < TURNED_RAD
        };
        let (mut still, mut restless): (Vec<BodyId>, Vec<BodyId>) = awake.into_iter().partition(stays);
        let tools: Vec<&MujocoKinematic> = self.now.kinematics.iter().filter(|k| k.spec.enabled).collect();
        let beside_tool = |&body: &BodyId| {
            let x_wb = self.state(body).x_wb;
            let near = |k: &&MujocoKinematic| {
                let tool = self.state(k.body);
                let margin = WAKE_M + tool.v_w.length() * dt;
                self.bounds[body].is_near(&x_wb, k.spec.half, &tool.x_wb, margin)
            };
            tools.iter().any(near)
        };
        restless.extend(still.extract_if(.., |b| beside_tool(b)));
        while let Some(mover) = restless.pop() {
            restless.extend(still.extract_if(.., |b| self.is_beside(mover, *b, dt)));
        }
        for &body in &still {
            self.now.asleep[body] = true;
            if let Some(joint) = self.bodies[body].joint {
                self.now.v[6 * joint..6 * joint + 6].fill(0.0);
                self.now.a[6 * joint..6 * joint + 6].fill(0.0);
            }
        }
        self.note_places();
        if let Some(&first) = still.first() {
            self.recompile_for(first);
        }
    }

    fn note_places(&mut self) {
        self.now.elapsed_s = 0.0;
        self.now.places = (0..self.scene.bodies.len()).map(|b| self.state(b).x_wb).collect();
    }

    /// Wakes a body of the scene.
    fn wake(&mut self, body: BodyId) {
        if self.now.asleep.get(body) == Some(&true) {
            self.now.asleep[body] = false;
            self.recompile_for(body);
        }
    }

    /// Recompiles the model for a body that strikes, wakes or falls asleep.
    fn recompile_for(&mut self, body: BodyId) {
        if self.recompile().is_err() {
            self.failed = self.failed.or(Some(body));
        }
    }

    /// Writes a state into the free joint of a body, if it has one.
    fn put(&mut self, body: BodyId, state: &BodyState) {
        let BodyInfo { joint: Some(joint), com, .. } = self.bodies[body] else { return };
        let r = state.x_wb.rotation;
        let p = state.x_wb.translation;
        self.now.q[7 * joint..7 * joint + 7].copy_from_slice(&[p.x, p.y, p.z, r.w, r.x, r.y, r.z]);
        // The joint's linear velocity is that of the frame's origin; its angular velocity is in the body's frame.
        let v = state.v_w - state.w_w.cross(r * com);
        let w = r.inverse() * state.w_w;
        self.now.v[6 * joint..6 * joint + 6].copy_from_slice(&[v.x, v.y, v.z, w.x, w.y, w.z]);
    }

    /// Adds a striker.
    fn add_striker(&mut self, spec: KinematicSpec) -> BodyId {
        let body = self.bodies.len();
        let joint = self.now.q.len() / 7;
        self.now.q.extend([0.0; 7]);
        self.now.v.extend([0.0; 6]);
        self.now.a.extend([0.0; 6]);
        self.wrenches.extend([0.0; 6]);
        let x_wb = spec.x_wk;
        self.bodies.push(BodyInfo { joint: Some(joint), com: DVec3::ZERO, x_wb });
        self.now.kinematics.push(MujocoKinematic { body, spec, mass: spec.mass, target_x_wk: x_wb });
        self.put(body, &BodyState::at_rest(x_wb));
        self.recompile_for(body);
        body
    }

    /// Updates the model's mass of tools that may touch a body in a step of `dt`.
    fn weigh_tools(&mut self, dt: f64) {
        for index in 0..self.now.kinematics.len() {
            let k = &self.now.kinematics[index];
            let (Some(of_model), Some(mass)) = (k.spec.mass, k.mass) else { continue };
            if !k.spec.enabled || (of_model - mass).abs() <= MASS_TOLERANCE * mass || !self.is_near(k, dt) {
                continue;
            }
            let body = k.body;
            self.now.kinematics[index].spec.mass = Some(mass);
            self.recompile_for(body);
        }
    }

    fn is_near(&self, k: &MujocoKinematic, dt: f64) -> bool {
        let tool = self.state(k.body);
        self.bounds.iter().enumerate().any(|(body, bounds)| {
            let state = self.state(body);
            let speed = tool.v_w.distance(state.v_w) + state.w_w.length() * REACH_M;
            bounds.is_near(&state.x_wb, k.spec.half, &tool.x_wb, NEAR_M + speed * dt)
        })
    }

    fn step_once(&mut self, dt: f64) {
        let Some(c) = &mut self.compiled else { return };
        c.gather(&self.now.q, &self.now.v, &self.wrenches);
        c.data.set_motion(&c.q, &c.v);
        c.data.set_wrenches(&c.wrenches);
        c.data.accelerations(&mut c.a);
        for (v, a) in c.v.iter_mut().zip(&c.a) {
            *v += dt * a;
        }
        c.data.model().integrate(&mut c.q, &c.v, dt);
        c.scatter(&mut self.now.q, &mut self.now.v, &mut self.now.a);
    }
}

impl Compiled {
    fn gather(&mut self, q: &[f64], v: &[f64], wrenches: &[f64]) {
        for (k, &joint) in self.joints.iter().enumerate() {
            self.q[7 * k..7 * k + 7].copy_from_slice(&q[7 * joint..7 * joint + 7]);
            self.v[6 * k..6 * k + 6].copy_from_slice(&v[6 * joint..6 * joint + 6]);
        }
        // Body 0 of MuJoCo is the world.
        for (k, &body) in self.bodies.iter().enumerate() {
            let (to, from) = (6 * (k + 1), 6 * (body + 1));
            self.wrenches[to..to + 6].copy_from_slice(&wrenches[from..from + 6]);
        }
    }

    fn scatter(&self, q: &mut [f64], v: &mut [f64], a: &mut [f64]) {
        for (k, &joint) in self.joints.iter().enumerate() {
            q[7 * joint..7 * joint + 7].copy_from_slice(&self.q[7 * k..7 * k + 7]);
            v[6 * joint..6 * joint + 6].copy_from_slice(&self.v[6 * k..6 * k + 6]);
            a[6 * joint..6 * joint + 6].copy_from_slice(&self.a[6 * k..6 * k + 6]);
        }
    }

    /// Sets the solver's warm start from the accelerations of all joints of the world.
    fn warm_start(&mut self, a: &[f64]) {
        for (k, &joint) in self.joints.iter().enumerate() {
            self.a[6 * k..6 * k + 6].copy_from_slice(&a[6 * joint..6 * joint + 6]);
        }
        self.data.set_warm_start(&self.a);
    }
}

fn compile(
    library: &'static Library,
    scene: &Scene,
    present: &dyn Fn(BodyId) -> bool,
    kinematics: &[KinematicSpec],
) -> Result<Data, String> {
    let model = library.model(&text(scene, present, kinematics))?;
    let bodies = (0..scene.bodies.len()).filter(|&b| present(b)).count();
    Data::new(Arc::new(model), bodies + kinematics.len() + 1)
}

/// Finds a body of a refused scene that is also refused alone.
fn culprit<'a>(library: &'static Library, scene: &'a Scene) -> Option<&'a str> {
    let alone = |body: &Body| Scene { bodies: vec![body.clone()], ..scene.clone() };
    let refused = scene.bodies.iter().find(|b| compile(library, &alone(b), &|_| true, &[]).is_err());
    refused.map(|b| b.name.as_str())
}

impl World for MujocoWorld {
    fn engine(&self) -> &'static str {
        self.engine
    }

    fn step(&mut self, dt: f64) {
        if self.failed.is_some() {
            return;
        }
        // MuJoCo's contact search may not terminate for non-finite states; the caller detects them in the state.
        if !self.now.q.iter().chain(&self.now.v).chain(&self.wrenches).all(|x| x.is_finite()) {
            return;
        }
        self.wake_neighbours(dt);
        self.weigh_tools(dt);
        if self.failed.is_some() {
            return;
        }
        let steps = (dt / LONGEST_STEP_S - 1e-9).ceil().max(1.0);
        let h = dt / steps;
        // `None` for tools, which contacts push.
        let motions: Vec<Option<(BodyId, DPose3, DVec3, DVec3)>> = self
            .now
            .kinematics
            .iter()
            .map(|k| {
                if k.spec.mass.is_some() {
                    return None;
                }
                let turn = k.target_x_wk.rotation * k.spec.x_wk.rotation.inverse();
                let v_w = (k.target_x_wk.translation - k.spec.x_wk.translation) / dt;
                Some((k.body, k.spec.x_wk, v_w, turn.to_scaled_axis() / dt))
            })
            .collect();
        for index in 0..steps as usize {
            for &(body, x_wk, v_w, w_w) in motions.iter().flatten() {
                let t = h * index as f64;
                let rotation = DQuat::from_scaled_axis(t * w_w) * x_wk.rotation;
                let x_wb = DPose3::from_parts(x_wk.translation + t * v_w, rotation);
                self.put(body, &BodyState { x_wb, v_w, w_w });
            }
            self.step_once(h);
        }
        for index in 0..self.now.kinematics.len() {
            let k = &mut self.now.kinematics[index];
            if k.spec.mass.is_some() {
                continue;
            }
            k.spec.x_wk = k.target_x_wk;
            let (body, x_wb) = (k.body, k.target_x_wk);
            let Some((_, _, v_w, w_w)) = motions[index] else { continue };
            self.put(body, &BodyState { x_wb, v_w, w_w });
        }
        self.wrenches.fill(0.0);
        self.put_to_sleep(dt);
    }

    fn state(&self, body: BodyId) -> BodyState {
        let BodyInfo { joint, com, x_wb } = self.bodies[body];
        let Some(joint) = joint else { return BodyState::at_rest(x_wb) };
        let (q, v) = (&self.now.q[7 * joint..], &self.now.v[6 * joint..]);
        let rotation = DQuat::from_xyzw(q[4], q[5], q[6], q[3]);
        let w_w = rotation * DVec3::new(v[3], v[4], v[5]);
        BodyState {
            x_wb: DPose3::from_parts(DVec3::new(q[0], q[1], q[2]), rotation),
            v_w: DVec3::new(v[0], v[1], v[2]) + w_w.cross(rotation * com),
            w_w,
        }
    }

    fn set_state(&mut self, body: BodyId, state: &BodyState) {
        if let Some(k) = self.now.kinematics.iter_mut().find(|k| k.body == body) {
            (k.spec.x_wk, k.target_x_wk) = (state.x_wb, state.x_wb);
        }
        self.put(body, state);
        self.wake(body);
        if let Some(place) = self.now.places.get_mut(body) {
            // Restarts the rest detection of this body.
            *place = DPose3::from_translation(DVec3::INFINITY);
        }
    }

    fn apply_wrench(&mut self, body: BodyId, force_w: DVec3, torque_w: DVec3, wake: bool) {
        if wake {
            self.wake(body);
        }
        // The world is MuJoCo's first body.
        let at = 6 * (body + 1);
        let six = [force_w.x, force_w.y, force_w.z, torque_w.x, torque_w.y, torque_w.z];
        for (sum, one) in self.wrenches[at..at + 6].iter_mut().zip(six) {
            *sum += one;
        }
    }

    fn is_asleep(&self, body: BodyId) -> bool {
        self.bodies[body].joint.is_none() || self.now.asleep.get(body) == Some(&true)
    }

    fn add_kinematic(&mut self, half: DVec3, x_wk: DPose3, friction: f64, restitution: f64) -> BodyId {
        self.add_striker(KinematicSpec { half, x_wk, friction, restitution, enabled: true, mass: None })
    }

    fn add_tool(&mut self, half: DVec3, x_wt: DPose3, friction: f64, restitution: f64) -> BodyId {
        let mass = Some(1.0);
        self.add_striker(KinematicSpec { half, x_wk: x_wt, friction, restitution, enabled: true, mass })
    }

    fn set_tool(&mut self, body: BodyId, state: &BodyState, mass: f64) {
        self.put(body, state);
        if let Some(k) = self.now.kinematics.iter_mut().find(|k| k.body == body && k.spec.mass.is_some())
            && mass > 0.0
        {
            k.mass = Some(mass);
        }
    }

    fn set_kinematic_target(&mut self, body: BodyId, x_wk: DPose3) {
        if let Some(k) = self.now.kinematics.iter_mut().find(|k| k.body == body) {
            k.target_x_wk = x_wk;
        }
    }

    fn set_kinematic_enabled(&mut self, body: BodyId, enabled: bool) {
        let Some(k) = self.now.kinematics.iter_mut().find(|k| k.body == body) else { return };
        if k.spec.enabled != enabled {
            k.spec.enabled = enabled;
            self.recompile_for(body);
        }
    }

    fn save(&mut self) -> bool {
        self.saved = Some(self.now.clone());
        true
    }

    fn restore(&mut self) -> bool {
        let Some(saved) = self.saved.take() else { return false };
        let others = self.now.asleep != saved.asleep
            || self.now.kinematics.len() != saved.kinematics.len()
            || self
                .now
                .kinematics
                .iter()
                .zip(&saved.kinematics)
                .any(|(a, b)| (a.spec.enabled, a.spec.mass) != (b.spec.enabled, b.spec.mass));
        self.now = saved.clone();
        self.bodies.truncate(self.scene.bodies.len() + self.now.kinematics.len());
        self.wrenches.resize(6 * (self.bodies.len() + 1), 0.0);
        self.wrenches.fill(0.0);
        self.saved = Some(saved);
        let others = others || self.failed.take().is_some();
        if others {
            return self.recompile().is_ok();
        }
        if let Some(compiled) = &mut self.compiled {
            compiled.warm_start(&self.now.a);
        }
        true
    }

    fn first_failed(&self) -> Option<BodyId> {
        self.failed
    }
}
