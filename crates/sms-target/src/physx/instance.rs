//! A PhysX scene with its actors; restoring a world discards it and builds a new one.

use super::arm::Arm;
use super::contacts::{self, GROUP_DYNAMIC, GROUP_KINEMATIC, GROUP_STATIC, GROUP_TOOL};
use super::sdk::{Sdk, take_error};
use super::shapes::{Shape, transform, vector};
use super::tuning::Tuning;
use glamx::{DPose3, DVec3};
use physx_sys::*;
use sms_core::MassProperties;
use sms_robots::ArmStrike;
use std::ptr::{null, null_mut};

/// Moment of inertia of a tool, kg·m²: large enough that no contact turns it, but finite. TGS solves for angular
/// velocity times the root of the inertia and omits an infinite one: a body touched by a rotating tool then felt the
/// velocity of the tool's centre instead of the contact point's, and balls were 0.6 % too fast.
const TOOL_MOMENT: f64 = 1e3;

/// The shapes and the role of a body, without its state.
pub(super) struct Blueprint {
    pub(super) shapes: Vec<Shape>,
    pub(super) role: Role,
}

pub(super) enum Role {
    Static,
    Dynamic {
        /// Centre of mass and principal axes in the body's frame.
        x_bp: PxTransform,
        mass: f32,
        moments: PxVec3,
        is_ball: bool,
    },
    /// A dynamic body of infinite mass with prescribed velocity. PhysX's own kinematic bodies derive the velocity from
    /// two poses; in single precision and at the short steps of impacts it is wrong by percents.
    Kinematic,
    /// A dynamic body without gravity that contacts push but do not turn. Its mass is set before each step.
    Tool,
    /// The link of an articulation that carries the tool.
    Arm,
}

impl Role {
    pub(super) fn dynamic(mass: &MassProperties, is_ball: bool) -> Self {
        let (moments, axes) = mass.principal();
        Self::Dynamic {
            x_bp: transform(&DPose3::from_parts(mass.com(), axes)),
            mass: mass.mass() as f32,
            moments: vector(moments),
            is_ball,
        }
    }
}

/// The state of a body, in the engine's own precision.
#[derive(Clone, Copy)]
pub(super) struct Kept {
    pub(super) x_wb: PxTransform,
    pub(super) v_w: PxVec3,
    pub(super) w_w: PxVec3,
    /// Seconds until it may sleep; it sleeps at zero or below.
    pub(super) awake_s: Option<f32>,
}

impl Kept {
    pub(super) fn at(x_wb: &DPose3) -> Self {
        let zero = vector(DVec3::ZERO);
        Self { x_wb: transform(x_wb), v_w: zero, w_w: zero, awake_s: None }
    }
}

/// A scene and its actors, in the order of the bodies.
pub(super) struct Instance {
    scene: *mut PxScene,
    dispatcher: *mut PxDefaultCpuDispatcher,
    actors: Vec<*mut PxRigidActor>,
    /// Articulations and the indices of their tools among the actors.
    arms: Vec<(usize, Arm)>,
}

// SAFETY: only the thread that owns the instance uses the scene and its actors. PhysX keeps no data of a scene in
// thread-local storage between calls, and the dispatcher has no threads of its own.
unsafe impl Send for Instance {}

impl Instance {
    /// Creates an empty scene.
    ///
    /// # Errors
    /// PhysX's error message.
    pub(super) fn new(tuning: &Tuning, gravity_w: DVec3) -> Result<Self, String> {
        let sdk = Sdk::get();
        let _lock = sdk.lock();
        take_error();
        // SAFETY: the descriptor is a plain value; its pointers to dispatcher and filter shader outlive the scene.
        unsafe {
            let dispatcher = phys_PxDefaultCpuDispatcherCreate(
                0,
                null_mut(),
                PxDefaultCpuDispatcherWaitForWorkMode::WaitForWork,
                0,
            );
            let mut d = PxSceneDesc_new(sdk.scale());
            d.gravity = vector(gravity_w);
            d.cpuDispatcher = dispatcher.cast();
            d.flags = tuning.scene_flags;
            d.solverType = tuning.solver;
            contacts::install(&mut d);
            d.bounceThresholdVelocity = tuning.bounce_speed as f32;
            if let Some(offset) = tuning.friction_offset {
                d.frictionOffsetThreshold = offset;
            }
            if let Some(distance) = tuning.friction_correlation {
                d.frictionCorrelationDistance = distance;
            }
            let scene = PxPhysics_createScene_mut(sdk.physics(), &d);
            if scene.is_null() {
                PxDefaultCpuDispatcher_release_mut(dispatcher);
                return Err(take_error().unwrap_or_else(|| "PhysX created no scene".to_owned()));
            }
            Ok(Self { scene, dispatcher, actors: Vec::new(), arms: Vec::new() })
        }
    }

    /// Adds a body.
    ///
    /// # Errors
    /// PhysX's error message.
    pub(super) fn add(
        &mut self,
        blueprint: &Blueprint,
        kept: &Kept,
        tuning: &Tuning,
        may_sleep: bool,
    ) -> Result<(), String> {
        if matches!(blueprint.role, Role::Arm) {
            return Err("an arm must be added with `add_arm`".to_owned());
        }
        let sdk = Sdk::get();
        let _lock = sdk.lock();
        take_error();
        // SAFETY: creates an actor that this instance owns, and sets it up before it is in a scene.
        let actor: *mut PxRigidActor = unsafe {
            match blueprint.role {
                Role::Static => PxPhysics_createRigidStatic_mut(sdk.physics(), &kept.x_wb).cast(),
                _ => PxPhysics_createRigidDynamic_mut(sdk.physics(), &kept.x_wb).cast(),
            }
        };
        if actor.is_null() {
            return Err(take_error().unwrap_or_else(|| "PhysX created no body".to_owned()));
        }
        self.actors.push(actor);
        for shape in &blueprint.shapes {
            // SAFETY: both are alive; the actor takes a reference of its own.
            if !unsafe { PxRigidActor_attachShape_mut(actor, shape.as_ptr()) } {
                return Err(take_error().unwrap_or_else(|| "PhysX rejected a shape".to_owned()));
            }
        }
        let body: *mut PxRigidDynamic = actor.cast();
        // SAFETY: `body` is used only if the role is that of a dynamic actor.
        unsafe {
            match &blueprint.role {
                Role::Static | Role::Arm => {}
                Role::Dynamic { x_bp, mass, moments, is_ball } => {
                    PxRigidBody_setCMassLocalPose_mut(body.cast(), x_bp);
                    PxRigidBody_setMass_mut(body.cast(), *mass);
                    PxRigidBody_setMassSpaceInertiaTensor_mut(body.cast(), moments);
                    if tuning.free_motion {
                        PxRigidBody_setAngularDamping_mut(body.cast(), 0.0);
                        PxRigidBody_setMaxAngularVelocity_mut(body.cast(), 1e4);
                        let gyroscopic = PxRigidBodyFlag::EnableGyroscopicForces;
                        PxRigidBody_setRigidBodyFlag_mut(body.cast(), gyroscopic, true);
                    }
                    if let Some((positions, velocities)) = tuning.iterations {
                        PxRigidDynamic_setSolverIterationCounts_mut(body, positions, velocities);
                    }
                    if let Some(speed) = tuning.push_out_speed {
                        PxRigidBody_setMaxDepenetrationVelocity_mut(body.cast(), speed);
                    }
                    // Kinetic energy per mass.
                    if !may_sleep {
                        PxRigidDynamic_setSleepThreshold_mut(body, 0.0);
                    } else if let Some((ball, other)) = tuning.sleep_speeds {
                        let speed = if *is_ball { ball } else { other };
                        PxRigidDynamic_setSleepThreshold_mut(body, (0.5 * speed * speed) as f32);
                    }
                }
                Role::Kinematic | Role::Tool => {
                    // PhysX treats zero mass and zero moments of inertia as infinite.
                    let (mass, moment) =
                        if matches!(blueprint.role, Role::Tool) { (1.0, TOOL_MOMENT) } else { (0.0, 0.0) };
                    PxRigidBody_setMass_mut(body.cast(), mass);
                    PxRigidBody_setMassSpaceInertiaTensor_mut(body.cast(), &vector(DVec3::splat(moment)));
                    PxRigidBody_setAngularDamping_mut(body.cast(), 0.0);
                    PxRigidDynamic_setSleepThreshold_mut(body, 0.0);
                    PxActor_setActorFlag_mut(actor.cast(), PxActorFlag::DisableGravity, true);
                    if let Some((positions, velocities)) = tuning.iterations {
                        PxRigidDynamic_setSolverIterationCounts_mut(body, positions, velocities);
                    }
                }
            }
            PxScene_addActor_mut(self.scene, actor.cast(), null());
            if !matches!(blueprint.role, Role::Static) {
                PxRigidDynamic_setLinearVelocity_mut(body, &kept.v_w, false);
                PxRigidDynamic_setAngularVelocity_mut(body, &kept.w_w, false);
                match kept.awake_s {
                    None => PxRigidDynamic_wakeUp_mut(body),
                    Some(left) if left > 0.0 => PxRigidDynamic_setWakeCounter_mut(body, left),
                    Some(_) => PxRigidDynamic_putToSleep_mut(body),
                }
            }
        }
        Ok(())
    }

    /// Adds an arm; its tool becomes the next body. Returns `false` if PhysX cannot simulate this robot.
    ///
    /// # Errors
    /// PhysX's error message.
    pub(super) fn add_arm(&mut self, strike: &ArmStrike, fist: &Shape) -> Result<bool, String> {
        let Some(arm) = Arm::new(self.scene, strike, fist)? else { return Ok(false) };
        self.arms.push((self.actors.len(), arm));
        let arm = &self.arms[self.arms.len() - 1].1;
        self.actors.push(arm.tool_link());
        Ok(true)
    }

    /// Returns the arm to which a tool belongs.
    pub(super) fn arm(&mut self, index: usize) -> Option<&mut Arm> {
        self.arms.iter_mut().find(|a| a.0 == index).map(|a| &mut a.1)
    }

    pub(super) fn arm_at(&self, index: usize) -> Option<&Arm> {
        self.arms.iter().find(|a| a.0 == index).map(|a| &a.1)
    }

    /// Returns the state of a body that is not static.
    pub(super) fn kept(&self, index: usize, role: &Role) -> Kept {
        let actor = self.actors[index];
        // SAFETY: getters of a living actor; velocities are read from dynamic ones only.
        unsafe {
            let x_wb = PxRigidActor_getGlobalPose(actor);
            if matches!(role, Role::Static) {
                return Kept { x_wb, v_w: vector(DVec3::ZERO), w_w: vector(DVec3::ZERO), awake_s: None };
            }
            let (v_w, w_w) =
                (PxRigidBody_getLinearVelocity(actor.cast()), PxRigidBody_getAngularVelocity(actor.cast()));
            if matches!(role, Role::Arm) {
                return Kept { x_wb, v_w, w_w, awake_s: None };
            }
            Kept {
                x_wb,
                v_w,
                w_w,
                awake_s: Some(if PxRigidDynamic_isSleeping(actor.cast()) {
                    0.0
                } else {
                    PxRigidDynamic_getWakeCounter(actor.cast()).max(f32::MIN_POSITIVE)
                }),
            }
        }
    }

    pub(super) fn pose(&self, index: usize) -> PxTransform {
        // SAFETY: a getter of a living actor.
        unsafe { PxRigidActor_getGlobalPose(self.actors[index]) }
    }

    /// Puts a dynamic body to sleep.
    pub(super) fn put_to_sleep(&mut self, index: usize) {
        // SAFETY: the caller guarantees that it is dynamic; no step is running.
        unsafe { PxRigidDynamic_putToSleep_mut(self.actors[index].cast()) };
    }

    pub(super) fn set_pose(&mut self, index: usize, x_wb: &PxTransform, wake: bool) {
        // SAFETY: the actor is alive and no step is running.
        unsafe { PxRigidActor_setGlobalPose_mut(self.actors[index], x_wb, wake) };
    }

    /// Sets the velocities of a body that is not static.
    pub(super) fn set_velocity(&mut self, index: usize, v_w: DVec3, w_w: DVec3) {
        let body: *mut PxRigidDynamic = self.actors[index].cast();
        // SAFETY: the caller guarantees that it is dynamic; no step is running.
        unsafe {
            PxRigidDynamic_setLinearVelocity_mut(body, &vector(v_w), true);
            PxRigidDynamic_setAngularVelocity_mut(body, &vector(w_w), true);
        }
    }

    /// Sets the mass of a dynamic body; its moments of inertia stay.
    pub(super) fn set_mass(&mut self, index: usize, mass: f64) {
        // SAFETY: the caller guarantees that it is dynamic; no step is running.
        unsafe { PxRigidBody_setMass_mut(self.actors[index].cast(), mass as f32) };
    }

    /// Adds a force and a torque about the centre of mass to a dynamic body, for the next step.
    pub(super) fn push(&mut self, index: usize, force_w: DVec3, torque_w: DVec3, wake: bool) {
        let body: *mut PxRigidBody = self.actors[index].cast();
        // SAFETY: the caller guarantees that it is dynamic; no step is running.
        unsafe {
            if !wake && PxRigidDynamic_isSleeping(body.cast()) {
                return;
            }
            PxRigidBody_addForce_mut(body, &vector(force_w), PxForceMode::Force, wake);
            PxRigidBody_addTorque_mut(body, &vector(torque_w), PxForceMode::Force, wake);
        }
    }

    pub(super) fn is_asleep(&self, index: usize, role: &Role) -> bool {
        if matches!(role, Role::Arm) {
            return false;
        }
        // SAFETY: a getter of a living actor that is dynamic.
        matches!(role, Role::Static) || unsafe { PxRigidDynamic_isSleeping(self.actors[index].cast()) }
    }

    /// Removes a body from the scene, or adds it again; it stays alive. An arm cannot be added again.
    pub(super) fn set_present(&mut self, index: usize, present: bool) {
        if let Some((_, arm)) = self.arms.iter_mut().find(|a| a.0 == index) {
            return arm.leave(self.scene);
        }
        let actor: *mut PxActor = self.actors[index].cast();
        // SAFETY: the actor is alive, in no other scene, and no step is running.
        unsafe {
            let is_present = !PxActor_getScene(actor).is_null();
            match (is_present, present) {
                (true, false) => PxScene_removeActor_mut(self.scene, actor, true),
                (false, true) => {
                    PxScene_addActor_mut(self.scene, actor, null());
                }
                _ => {}
            }
        }
    }

    pub(super) fn set_bounce_speed(&mut self, speed: f64) {
        // SAFETY: the scene is alive and no step is running.
        unsafe { PxScene_setBounceThresholdVelocity_mut(self.scene, speed as f32) };
    }

    pub(super) fn step(&mut self, dt: f64) {
        let mut error = 0u32;
        // SAFETY: the scene is alive. Without scratch memory and completion task, and with a dispatcher without
        // threads, the whole step runs in these calls.
        unsafe {
            PxScene_simulate_mut(self.scene, dt as f32, null_mut(), null_mut(), 0, true);
            PxScene_fetchResults_mut(self.scene, true, &mut error);
        }
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        // Arms lock the SDK themselves.
        let tools: Vec<usize> = self.arms.drain(..).map(|a| a.0).collect();
        let _lock = Sdk::get().lock();
        // SAFETY: `self` owns the actors, the scene and the dispatcher, and releases dependent objects first.
        unsafe {
            for (index, &actor) in self.actors.iter().enumerate() {
                if !tools.contains(&index) {
                    PxActor_release_mut(actor.cast());
                }
            }
            PxScene_release_mut(self.scene);
            PxDefaultCpuDispatcher_release_mut(self.dispatcher);
        }
    }
}

/// Returns the collision group of a role.
pub(super) fn group(role: &Role) -> u16 {
    match role {
        Role::Static => GROUP_STATIC,
        Role::Dynamic { .. } => GROUP_DYNAMIC,
        Role::Kinematic => GROUP_KINEMATIC,
        Role::Tool | Role::Arm => GROUP_TOOL,
    }
}
