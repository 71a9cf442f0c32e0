//! A robot's arm as a PhysX articulation in reduced coordinates.
//!
//! Links have the masses and inertias of the robot's model, joints the inertia of its rotors. The caller sets the
//! torques; joint friction and damping are subtracted before each step by the model's law, which differs from PhysX's
//! joint friction. The controller and the checks enforce position limits. The fist is the only collision shape.

use super::sdk::{Sdk, take_error};
use super::shapes::{Shape, transform, vector};
use glamx::{DPose3, DQuat, DVec3};
use physx_sys::*;
use sms_robots::{ArmStrike, JointKind, RobotModel, Workspace, joint_friction};
use std::ptr::null_mut;
use std::sync::Arc;

/// An articulation in a scene.
pub(super) struct Arm {
    model: Arc<RobotModel>,
    articulation: *mut PxArticulationReducedCoordinate,
    cache: *mut PxArticulationCache,
    tool: *mut PxArticulationLink,
    /// Pose of the tool in the frame of the link that carries it.
    x_lt: DPose3,
    tau: Vec<f64>,
}

/// Returns the poses of the joint frames in the world. `None` unless the robot is a serial chain of revolute joints
/// with massive links.
fn joint_poses(model: &RobotModel, q: &[f64]) -> Option<Vec<DPose3>> {
    let mut x_wj = model.x_wr();
    let mut poses = Vec::new();
    for (i, joint) in model.joints().iter().enumerate() {
        if joint.parent != i.checked_sub(1) || joint.kind == JointKind::Prismatic || joint.mass.is_none() {
            return None;
        }
        let turn = DQuat::from_axis_angle(joint.axis, q[i]);
        x_wj = x_wj * joint.x_pj * DPose3::from_parts(DVec3::ZERO, turn);
        poses.push(x_wj);
    }
    (!poses.is_empty()).then_some(poses)
}

impl Arm {
    /// Adds an arm to a scene, at rest at the start of a strike. `fist` is the striking shape, in the tool's frame.
    /// `None` if the robot is not a serial chain of revolute joints.
    ///
    /// # Errors
    /// PhysX's error message.
    pub(super) fn new(scene: *mut PxScene, strike: &ArmStrike, fist: &Shape) -> Result<Option<Self>, String> {
        let model = &strike.model;
        let Some(poses) = joint_poses(model, &strike.q_start) else { return Ok(None) };
        let mut ws = Workspace::default();
        model.forward_kinematics(&strike.q_start, &mut ws);
        let x_lt = poses[poses.len() - 1].inverse() * model.frame_pose(model.tool(), &ws);
        // Created before the lock: on failure, dropping these takes the lock again.
        let mut arm = Self {
            model: model.clone(),
            articulation: null_mut(),
            cache: null_mut(),
            tool: null_mut(),
            x_lt,
            tau: vec![0.0; poses.len()],
        };
        let sdk = Sdk::get();
        let _lock = sdk.lock();
        take_error();
        // SAFETY: creates an articulation that `Self` owns and sets it up before it is in the scene; links and joints
        // belong to it. The scene outlives it: `Instance` releases its arms first.
        unsafe {
            let articulation = PxPhysics_createArticulationReducedCoordinate_mut(sdk.physics());
            if articulation.is_null() {
                return Err(take_error().unwrap_or_else(|| "PhysX created no articulation".to_owned()));
            }
            arm.articulation = articulation;
            let flags = PxArticulationFlags::FixBase | PxArticulationFlags::DisableSelfCollision;
            PxArticulationReducedCoordinate_setArticulationFlags_mut(articulation, flags);
            // TGS moves the joints in each of its iterations in single precision. With sixteen iterations, each slow
            // move of 2e-6 rad would lose several percent to rounding. In contact, the other body's iterations count.
            PxArticulationReducedCoordinate_setSolverIterationCounts_mut(articulation, 1, 1);
            PxArticulationReducedCoordinate_setSleepThreshold_mut(articulation, 0.0);
            let base = PxArticulationReducedCoordinate_createLink_mut(
                articulation,
                null_mut(),
                &transform(&model.x_wr()),
            );
            let mut parent = base;
            for (joint, x_wj) in model.joints().iter().zip(&poses) {
                parent = link(articulation, parent, joint, x_wj)
                    .ok_or_else(|| take_error().unwrap_or_else(|| "PhysX created no link".to_owned()))?;
            }
            arm.tool = parent;
            PxShape_setLocalPose_mut(fist.as_ptr(), &transform(&x_lt));
            if !PxRigidActor_attachShape_mut(parent.cast(), fist.as_ptr()) {
                return Err(take_error().unwrap_or_else(|| "PhysX rejected the fist".to_owned()));
            }
            if !PxScene_addArticulation_mut(scene, articulation) {
                return Err(take_error().unwrap_or_else(|| "PhysX rejected the arm".to_owned()));
            }
            arm.cache = PxArticulationReducedCoordinate_createCache(articulation);
            if arm.cache.is_null() {
                return Err(take_error().unwrap_or_else(|| "PhysX is out of memory for an arm".to_owned()));
            }
            PxArticulationReducedCoordinate_zeroCache(articulation, arm.cache);
            for (i, q) in strike.q_start.iter().enumerate() {
                *(*arm.cache).jointPosition.add(i) = *q as f32;
            }
            let set = PxArticulationCacheFlags::Position | PxArticulationCacheFlags::Velocity;
            PxArticulationReducedCoordinate_applyCache_mut(articulation, arm.cache, set, true);
        }
        Ok(Some(arm))
    }

    /// Returns the link that carries the tool, as an actor.
    pub(super) fn tool_link(&self) -> *mut PxRigidActor {
        self.tool.cast()
    }

    /// Reads the positions and velocities of the joints.
    pub(super) fn joints(&self, q: &mut [f64], qd: &mut [f64]) {
        // SAFETY: the articulation is in a scene, no step is running, and the cache has an entry for each joint.
        unsafe {
            let get = PxArticulationCacheFlags::Position | PxArticulationCacheFlags::Velocity;
            PxArticulationReducedCoordinate_copyInternalStateToCache(self.articulation, self.cache, get);
            for i in 0..self.tau.len() {
                q[i] = f64::from(*(*self.cache).jointPosition.add(i));
                qd[i] = f64::from(*(*self.cache).jointVelocity.add(i));
            }
        }
    }

    pub(super) fn set_torques(&mut self, tau: &[f64]) {
        self.tau.copy_from_slice(tau);
    }

    /// Passes the torques minus friction to PhysX for the next step.
    pub(super) fn before_step(&mut self) {
        let n = self.tau.len();
        let (mut q, mut qd) = (vec![0.0; n], vec![0.0; n]);
        self.joints(&mut q, &mut qd);
        // SAFETY: as in `joints`.
        unsafe {
            for (i, joint) in self.model.joints().iter().enumerate() {
                let driven = self.tau[i] - joint_friction(joint.damping, joint.friction, qd[i]);
                *(*self.cache).jointForce.add(i) = driven as f32;
            }
            let set = PxArticulationCacheFlags::Force;
            PxArticulationReducedCoordinate_applyCache_mut(self.articulation, self.cache, set, true);
        }
    }

    /// Returns the pose of the tool, the velocity of its origin and its angular velocity, from those of its link's
    /// centre of mass.
    pub(super) fn tool(&self, x_wl: &DPose3, v_com_w: DVec3, w_w: DVec3) -> (DPose3, DVec3, DVec3) {
        let x_wt = *x_wl * self.x_lt;
        let com = self.model.joints().last().and_then(|j| j.mass).map_or(DVec3::ZERO, |m| m.com());
        let arm_w = x_wt.translation - x_wl.transform_point(com);
        (x_wt, v_com_w + w_w.cross(arm_w), w_w)
    }

    /// Removes the arm from the scene.
    pub(super) fn leave(&mut self, scene: *mut PxScene) {
        // SAFETY: the articulation is alive, and no step is running.
        unsafe {
            if !PxArticulationReducedCoordinate_getScene(self.articulation).is_null() {
                PxScene_removeArticulation_mut(scene, self.articulation, true);
            }
        }
    }
}

/// Creates a link at the end of a joint.
///
/// # Safety
/// The articulation and the parent are alive, and the articulation is not in a scene.
unsafe fn link(
    articulation: *mut PxArticulationReducedCoordinate,
    parent: *mut PxArticulationLink,
    joint: &sms_robots::Joint,
    x_wj: &DPose3,
) -> Option<*mut PxArticulationLink> {
    let mass = joint.mass.as_ref()?;
    // SAFETY: guaranteed by the caller.
    unsafe {
        let link = PxArticulationReducedCoordinate_createLink_mut(articulation, parent, &transform(x_wj));
        if link.is_null() {
            return None;
        }
        let (moments, axes) = mass.principal();
        let body: *mut PxRigidBody = link.cast();
        PxRigidBody_setCMassLocalPose_mut(body, &transform(&DPose3::from_parts(mass.com(), axes)));
        PxRigidBody_setMass_mut(body, mass.mass() as f32);
        PxRigidBody_setMassSpaceInertiaTensor_mut(body, &vector(moments));
        PxRigidBody_setLinearDamping_mut(body, 0.0);
        PxRigidBody_setAngularDamping_mut(body, 0.0);
        let inbound = PxArticulationLink_getInboundJoint(link);
        // PhysX's joints rotate about x.
        let x_to_axis = DPose3::from_parts(DVec3::ZERO, DQuat::from_rotation_arc(DVec3::X, joint.axis));
        PxArticulationJointReducedCoordinate_setJointType_mut(
            inbound,
            PxArticulationJointType::RevoluteUnwrapped,
        );
        PxArticulationJointReducedCoordinate_setMotion_mut(
            inbound,
            PxArticulationAxis::Twist,
            PxArticulationMotion::Free,
        );
        let x_parent = joint.x_pj * x_to_axis;
        PxArticulationJointReducedCoordinate_setParentPose_mut(inbound, &transform(&x_parent));
        PxArticulationJointReducedCoordinate_setChildPose_mut(inbound, &transform(&x_to_axis));
        let armature = joint.armature as f32;
        PxArticulationJointReducedCoordinate_setArmature_mut(inbound, PxArticulationAxis::Twist, armature);
        PxArticulationJointReducedCoordinate_setFrictionCoefficient_mut(inbound, 0.0);
        Some(link)
    }
}

impl Drop for Arm {
    fn drop(&mut self) {
        let _lock = Sdk::get().lock();
        // SAFETY: owned here; links, joints and their references to shapes go with the articulation.
        unsafe {
            if !self.cache.is_null() {
                PxArticulationCache_release_mut(self.cache);
            }
            if !self.articulation.is_null() {
                PxArticulationReducedCoordinate_release_mut(self.articulation);
            }
        }
    }
}
