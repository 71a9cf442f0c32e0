//! Adapter from the `World` trait to PhysX.

use super::instance::{Blueprint, Instance, Kept, Role, group};
use super::rest::Rest;
use super::shapes::{Shaper, Surface, transform};
use super::tuning::Tuning;
use glamx::{DPose3, DQuat, DVec3};
use physx_sys::{PxTransform, PxVec3};
use sms_robots::ArmStrike;
use sms_scene::{Body, BodyKind, BodyShape, Scene};
use sms_sim::{BodyId, BodyState, SimError, World, WorldOptions};

/// A world of PhysX.
pub(super) struct PhysxWorld {
    tuning: &'static Tuning,
    may_sleep: bool,
    gravity_w: DVec3,
    // Declared before the blueprints: actors must be released before the shapes that they share.
    instance: Instance,
    blueprints: Vec<Blueprint>,
    kinematics: Vec<Kinematic>,
    tools: Vec<Tool>,
    pushes: Vec<Push>,
    /// Tools of the arms in the scene.
    arms: Vec<BodyId>,
    rest: Rest,
    /// A body with a non-finite state, which is kept from PhysX; the world does not step any more.
    failed: Option<BodyId>,
    saved: Option<Saved>,
}

#[derive(Clone, Copy)]
struct Tool {
    body: BodyId,
    enabled: bool,
}

#[derive(Clone)]
struct Kinematic {
    body: BodyId,
    x_wk: DPose3,
    target_x_wk: DPose3,
    /// Velocity in the current step.
    v_w: DVec3,
    w_w: DVec3,
    enabled: bool,
}

impl Kinematic {
    fn is_moving(&self) -> bool {
        self.v_w != DVec3::ZERO || self.w_w != DVec3::ZERO
    }

    /// Returns its pose `left` seconds before it reaches its target.
    fn pose_before_target(&self, left: f64) -> DPose3 {
        let x = &self.target_x_wk;
        DPose3::from_parts(
            x.translation - left * self.v_w,
            DQuat::from_scaled_axis(-left * self.w_w) * x.rotation,
        )
    }
}

/// A force (N) and a torque (N·m) for the next step.
struct Push {
    body: BodyId,
    force_w: DVec3,
    torque_w: DVec3,
    wake: bool,
}

struct Saved {
    states: Vec<Kept>,
    kinematics: Vec<Kinematic>,
    tools: Vec<Tool>,
}

impl PhysxWorld {
    pub(super) fn build(
        tuning: &'static Tuning,
        scene: &Scene,
        options: &WorldOptions,
    ) -> Result<Self, SimError> {
        let refuse = |body: &str, why: String| SimError::Body { body: body.to_owned(), why };
        let instance = Instance::new(tuning, scene.gravity_w).map_err(|why| refuse("scene", why))?;
        let mut world = Self {
            tuning,
            may_sleep: options.sleep,
            gravity_w: scene.gravity_w,
            instance,
            blueprints: Vec::with_capacity(scene.bodies.len() + 1),
            kinematics: Vec::new(),
            tools: Vec::new(),
            pushes: Vec::new(),
            arms: Vec::new(),
            rest: Rest::default(),
            failed: None,
            saved: None,
        };
        for body in &scene.bodies {
            let blueprint = world.blueprint(body).map_err(|why| refuse(&body.name, why))?;
            world.add(blueprint, &Kept::at(&body.x_wb)).map_err(|why| refuse(&body.name, why))?;
        }
        world.rest.begin(&world.instance, world.blueprints.len());
        Ok(world)
    }

    fn blueprint(&self, body: &Body) -> Result<Blueprint, String> {
        if !body.x_wb.is_finite() {
            return Err("its pose is not finite".to_owned());
        }
        let is_ball = matches!(body.shape, BodyShape::Sphere { .. });
        let role = match body.kind {
            BodyKind::Static => Role::Static,
            BodyKind::Dynamic if matches!(body.shape, BodyShape::HalfSpace | BodyShape::TriMesh { .. }) => {
                return Err("its shape has no inside, and it is dynamic".to_owned());
            }
            BodyKind::Dynamic => {
                Role::dynamic(body.mass.as_ref().ok_or("it is dynamic and has no mass")?, is_ball)
            }
        };
        let surface = Surface {
            friction: body.material.friction.value.best,
            restitution: body.material.restitution.value.best,
        };
        let shaper = Shaper { surface, group: group(&role), is_ball, tuning: self.tuning };
        Ok(Blueprint { shapes: shaper.body(&body.shape)?, role })
    }

    fn add(&mut self, blueprint: Blueprint, kept: &Kept) -> Result<(), String> {
        // The blueprint is kept even if creating the actor fails, because an incomplete actor holds its shapes.
        self.blueprints.push(blueprint);
        let blueprint = &self.blueprints[self.blueprints.len() - 1];
        self.instance.add(blueprint, kept, self.tuning, self.may_sleep)
    }

    /// Builds a new scene with these states. Contacts and all internal orders are those of a new world, so all later
    /// runs are bitwise identical.
    fn rebuild(&mut self, saved: &Saved) -> Result<(), String> {
        let mut instance = Instance::new(self.tuning, self.gravity_w)?;
        for (blueprint, kept) in self.blueprints.iter().zip(&saved.states) {
            instance.add(blueprint, kept, self.tuning, self.may_sleep)?;
        }
        for k in saved.kinematics.iter().filter(|k| !k.enabled) {
            instance.set_present(k.body, false);
        }
        for t in saved.tools.iter().filter(|t| !t.enabled) {
            instance.set_present(t.body, false);
        }
        self.instance = instance;
        self.rest.begin(&self.instance, saved.states.len());
        self.pushes.clear();
        self.arms.clear();
        self.failed = None;
        self.kinematics.clone_from(&saved.kinematics);
        self.tools.clone_from(&saved.tools);
        Ok(())
    }

    /// Adds a striker.
    fn add_striker(
        &mut self,
        role: Role,
        half: DVec3,
        x_wb: &DPose3,
        friction: f64,
        restitution: f64,
    ) -> BodyId {
        let surface = Surface { friction, restitution };
        let shaper = Shaper { surface, group: group(&role), is_ball: false, tuning: self.tuning };
        let shape = shaper.cuboid(half);
        let is_shaped = shape.is_ok();
        let blueprint = Blueprint { shapes: shape.into_iter().collect(), role };
        let is_added = self.add(blueprint, &Kept::at(x_wb)).is_ok();
        let body = self.blueprints.len() - 1;
        if !(is_shaped && is_added) {
            self.failed = self.failed.or(Some(body));
        }
        body
    }

    fn is_dynamic(&self, body: BodyId) -> bool {
        is_dynamic(&self.blueprints[body].role)
    }
}

impl World for PhysxWorld {
    fn engine(&self) -> &'static str {
        self.tuning.engine
    }

    fn step(&mut self, dt: f64) {
        let pushes = std::mem::take(&mut self.pushes);
        if self.failed.is_some() {
            return;
        }
        let longest = match self.tuning.step_lengths_s {
            Some((short, long)) => {
                if dt < long {
                    short
                } else {
                    long
                }
            }
            None => dt,
        };
        let steps = (dt / longest - 1e-9).ceil().max(1.0);
        let h = dt / steps;
        let gained = self.tuning.bounce_gravity_steps * self.gravity_w.length() * h;
        self.instance.set_bounce_speed(self.tuning.bounce_speed.max(gained));
        for k in self.kinematics.iter_mut().filter(|k| k.enabled) {
            let turn = k.target_x_wk.rotation * k.x_wk.rotation.inverse();
            k.v_w = (k.target_x_wk.translation - k.x_wk.translation) / dt;
            k.w_w = turn.to_scaled_axis() / dt;
        }
        for part in 1..=steps as usize {
            for push in &pushes {
                self.instance.push(push.body, push.force_w, push.torque_w, push.wake);
            }
            for &arm in &self.arms {
                if let Some(arm) = self.instance.arm(arm) {
                    arm.before_step();
                }
            }
            for k in self.kinematics.iter().filter(|k| k.enabled) {
                self.instance.set_velocity(k.body, k.v_w, k.w_w);
            }
            self.instance.step(h);
            let left = dt - h * part as f64;
            for k in self.kinematics.iter().filter(|k| k.enabled && k.is_moving()) {
                self.instance.set_pose(k.body, &transform(&k.pose_before_target(left)), false);
            }
        }
        for k in &mut self.kinematics {
            k.x_wk = k.target_x_wk;
        }
        if self.may_sleep && self.tuning.sleeps_where_it_stays {
            self.rest.after_step(dt, &mut self.instance, &self.blueprints);
        }
    }

    fn state(&self, body: BodyId) -> BodyState {
        let kept = self.instance.kept(body, &self.blueprints[body].role);
        if let Some(arm) = self.instance.arm_at(body) {
            let (x_wl, v_w, w_w) =
                (pose_from_engine(&kept.x_wb), from_engine(&kept.v_w), from_engine(&kept.w_w));
            let (x_wb, v_w, w_w) = arm.tool(&x_wl, v_w, w_w);
            return BodyState { x_wb, v_w, w_w };
        }
        BodyState {
            x_wb: pose_from_engine(&kept.x_wb),
            v_w: from_engine(&kept.v_w),
            w_w: from_engine(&kept.w_w),
        }
    }

    fn set_state(&mut self, body: BodyId, state: &BodyState) {
        if !(state.x_wb.is_finite() && state.v_w.is_finite() && state.w_w.is_finite()) {
            self.failed = Some(body);
            return;
        }
        if let Some(k) = self.kinematics.iter_mut().find(|k| k.body == body) {
            (k.x_wk, k.target_x_wk) = (state.x_wb, state.x_wb);
        }
        let wakes = self.is_dynamic(body);
        self.instance.set_pose(body, &transform(&state.x_wb), wakes);
        if wakes {
            self.instance.set_velocity(body, state.v_w, state.w_w);
        }
    }

    fn apply_wrench(&mut self, body: BodyId, force_w: DVec3, torque_w: DVec3, wake: bool) {
        if !(force_w.is_finite() && torque_w.is_finite()) {
            self.failed = Some(body);
        } else if self.is_dynamic(body) {
            self.pushes.push(Push { body, force_w, torque_w, wake });
        }
    }

    fn is_asleep(&self, body: BodyId) -> bool {
        self.instance.is_asleep(body, &self.blueprints[body].role)
    }

    fn add_kinematic(&mut self, half: DVec3, x_wk: DPose3, friction: f64, restitution: f64) -> BodyId {
        let body = self.add_striker(Role::Kinematic, half, &x_wk, friction, restitution);
        self.kinematics.push(Kinematic {
            body,
            x_wk,
            target_x_wk: x_wk,
            v_w: DVec3::ZERO,
            w_w: DVec3::ZERO,
            enabled: true,
        });
        body
    }

    fn set_kinematic_target(&mut self, body: BodyId, x_wk: DPose3) {
        if let Some(k) = self.kinematics.iter_mut().find(|k| k.body == body) {
            k.target_x_wk = x_wk;
        }
    }

    fn add_tool(&mut self, half: DVec3, x_wt: DPose3, friction: f64, restitution: f64) -> BodyId {
        let body = self.add_striker(Role::Tool, half, &x_wt, friction, restitution);
        self.tools.push(Tool { body, enabled: true });
        body
    }

    fn set_tool(&mut self, body: BodyId, state: &BodyState, mass: f64) {
        let finite = state.x_wb.is_finite() && state.v_w.is_finite() && state.w_w.is_finite();
        if !(finite && mass.is_finite()) {
            self.failed = Some(body);
        } else if self.tools.iter().any(|t| t.body == body && t.enabled) {
            self.instance.set_mass(body, mass);
            self.instance.set_pose(body, &transform(&state.x_wb), true);
            self.instance.set_velocity(body, state.v_w, state.w_w);
        }
    }

    fn add_arm(&mut self, strike: &ArmStrike, friction: f64, restitution: f64) -> Option<BodyId> {
        let surface = Surface { friction, restitution };
        let shaper = Shaper { surface, group: group(&Role::Arm), is_ball: false, tuning: self.tuning };
        let fist = shaper.cuboid(strike.half).ok()?;
        // If PhysX cannot simulate this robot, the caller uses the tool alone.
        if !self.instance.add_arm(strike, &fist).ok()? {
            return None;
        }
        let body = self.blueprints.len();
        self.blueprints.push(Blueprint { shapes: vec![fist], role: Role::Arm });
        self.arms.push(body);
        Some(body)
    }

    fn arm_joints(&self, body: BodyId, q: &mut [f64], qd: &mut [f64]) {
        if let Some(arm) = self.instance.arm_at(body) {
            arm.joints(q, qd);
        }
    }

    fn set_arm_torques(&mut self, body: BodyId, tau: &[f64]) {
        if !tau.iter().all(|t| t.is_finite()) {
            self.failed = Some(body);
        } else if let Some(arm) = self.instance.arm(body) {
            arm.set_torques(tau);
        }
    }

    fn set_kinematic_enabled(&mut self, body: BodyId, enabled: bool) {
        if let Some(k) = self.kinematics.iter_mut().find(|k| k.body == body) {
            k.enabled = enabled;
            self.instance.set_present(body, enabled);
        }
        if !enabled && self.arms.contains(&body) {
            self.arms.retain(|a| *a != body);
            self.instance.set_present(body, false);
        }
        if let Some(t) = self.tools.iter_mut().find(|t| t.body == body) {
            t.enabled = enabled;
            self.instance.set_present(body, enabled);
        }
    }

    fn save(&mut self) -> bool {
        if !self.arms.is_empty() {
            return false;
        }
        let states =
            self.blueprints.iter().enumerate().map(|(b, p)| self.instance.kept(b, &p.role)).collect();
        let saved = Saved { states, kinematics: self.kinematics.clone(), tools: self.tools.clone() };
        let is_saved = self.rebuild(&saved).is_ok();
        self.saved = is_saved.then_some(saved);
        is_saved
    }

    fn restore(&mut self) -> bool {
        let Some(saved) = self.saved.take() else { return false };
        let is_restored = self.rebuild(&saved).is_ok();
        if is_restored {
            // Drops kinematic bodies that were added after the snapshot.
            self.blueprints.truncate(saved.states.len());
        }
        self.saved = Some(saved);
        is_restored
    }

    fn first_failed(&self) -> Option<BodyId> {
        self.failed
    }
}

pub(super) fn is_dynamic(role: &Role) -> bool {
    matches!(role, Role::Dynamic { .. })
}

fn from_engine(v: &PxVec3) -> DVec3 {
    DVec3::new(f64::from(v.x), f64::from(v.y), f64::from(v.z))
}

fn pose_from_engine(x: &PxTransform) -> DPose3 {
    let q = DQuat::from_xyzw(f64::from(x.q.x), f64::from(x.q.y), f64::from(x.q.z), f64::from(x.q.w));
    DPose3::from_parts(from_engine(&x.p), q)
}
