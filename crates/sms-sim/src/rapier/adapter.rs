//! The Rapier world. `super::engine` is Rapier in single or double precision.
#![allow(
    clippy::unnecessary_cast,
    reason = "`Real` is f32 in one instance of this file and f64 in the other"
)]

use super::engine::math::{Pose, Real, Rotation, Vector};
use super::engine::prelude::*;
use super::face::{from_engine, to_engine};
use super::hull::StableHull;
use crate::{BodyId, BodyState, SimError, World, WorldOptions};
use glamx::{DPose3, DQuat, DVec3};
use sms_core::Mesh;
use sms_scene::{Body, BodyKind, BodyShape, Scene};
use std::sync::Mutex;

/// Rapier's tolerances assume bodies of a metre. This scale sets the prediction distance of contacts to 20 µm; at
/// Rapier's default of 20 mm, a contact normal differs from that at the impact.
const LENGTH_UNIT: f64 = 1e-3;
/// Largest speed of a body, m/s. Rapier scales its limit with the length unit, so its default would be 0.4 m/s.
const MAX_SPEED: f64 = 400.0;
/// Largest speed at which overlapping bodies are pushed apart, m/s. Reconstructed bodies may overlap by a millimetre.
const MAX_PUSH_OUT_SPEED: f64 = 0.1;
/// Contacts are reused while the relative motion since their determination is below this, metres.
const RECYCLE_DISTANCE: f64 = 2e-4;
/// Natural frequency of contacts, Hz. A body sinks in by g/(2πf)². With Rapier's 30 Hz the upper of two boxes sinks
/// 0.55 mm into the lower; with this value, 12 µm.
const CONTACT_FREQUENCY: f64 = 200.0;
/// Speed below which a body may fall asleep, m/s at its farthest point. The limit for balls is lower: a ball rolls
/// farther than an obstacle slides before it stops.
const SLEEP_SPEED_BALL: f64 = 1e-3;
const SLEEP_SPEED: f64 = 5e-3;
/// Time below this speed until a body sleeps, seconds. Half of Rapier's, at a tenth of its speed: the body has moved
/// less than 2.5 mm.
const TIME_UNTIL_SLEEP: f64 = 0.25;
/// Approach speed above which a contact counts as an impact, m/s.
const IMPACT_SPEED: f64 = 5e-3;

/// A world of Rapier.
pub(crate) struct RapierWorld {
    engine: &'static str,
    physics: PhysicsWorld,
    bodies: Vec<RigidBodyHandle>,
    /// Bodies with a wrench in the next step.
    wrenched: Vec<BodyId>,
    kinematics: Vec<RapierKinematic>,
    last_dt: f64,
    touches: Touches,
    options: WorldOptions,
    saved: Option<Box<RapierSnapshot>>,
}

/// A kinematic body. Rapier derives its velocity from two poses, which has errors of percents in single precision at
/// the short steps of impacts. Therefore its velocity is set directly, and its pose is corrected after each step.
#[derive(Clone)]
struct RapierKinematic {
    body: BodyId,
    x_wk: DPose3,
    target_x_wk: DPose3,
    enabled: bool,
}

/// The complete state of a world; [`PhysicsWorld`] has no `Clone`.
struct RapierSnapshot {
    islands: IslandManager,
    broad_phase: BroadPhaseBvh,
    narrow_phase: NarrowPhase,
    bodies: RigidBodySet,
    colliders: ColliderSet,
    impulse_joints: ImpulseJointSet,
    multibody_joints: MultibodyJointSet,
    soft_bodies: SoftBodySet,
    ccd_solver: CCDSolver,
    handles: usize,
    kinematics: Vec<RapierKinematic>,
    last_dt: f64,
}

/// Collects pairs of bodies that begin to touch, in the order of Rapier's reports.
#[derive(Default)]
struct Touches(Mutex<Vec<(BodyId, BodyId)>>);

impl EventHandler for Touches {
    fn handle_collision_event(
        &self,
        _bodies: &RigidBodySet,
        colliders: &ColliderSet,
        event: CollisionEvent,
        _pair: Option<&ContactPair>,
    ) {
        let CollisionEvent::Started(a, b, _) = event else { return };
        let body = |handle: ColliderHandle| colliders.get(handle).map(|c| c.user_data as BodyId);
        if let (Some(a), Some(b), Ok(mut pairs)) = (body(a), body(b), self.0.lock()) {
            pairs.push((a, b));
        }
    }

    fn handle_contact_force_event(
        &self,
        _dt: Real,
        _bodies: &RigidBodySet,
        _colliders: &ColliderSet,
        _pair: &ContactPair,
        _force: Real,
    ) {
    }

    fn handle_soft_body_tear_event(&self, _bodies: &SoftBodySet, _event: &SoftBodyTearEvent) {}
}

/// Friction due to restitution. Rapier applies restitution after friction, so the restitution impulse (`e` times the
/// compression impulse) causes no friction. The friction impulse of an impact is bounded by µ(1+e)·J, so the friction
/// of a pair is scaled by 1+e at impacts (a closing contact without an impulse in the last step). It is not scaled at
/// resting contacts, where it would increase sliding friction.
struct ImpactFriction;

impl PhysicsHooks for ImpactFriction {
    fn modify_solver_contacts(&self, context: &mut ContactModificationContext) {
        let (bodies, first, second) = (context.bodies, context.rigid_body1, context.rigid_body2);
        let Some(contact) = context.rigid_mut() else { return };
        if contact.manifold.points.iter().any(|p| p.data.impulse != 0.0) {
            return;
        }
        let Some(point) = contact.solver_contacts.first().map(|c| c.anchor1) else { return };
        let velocity = |handle: Option<RigidBodyHandle>| {
            handle.and_then(|h| bodies.get(h)).map_or(Vector::ZERO, |b| b.velocity_at_point(point))
        };
        // The normal points from the first body to the second.
        let approach = (velocity(first) - velocity(second)).dot(*contact.normal);
        if approach > IMPACT_SPEED as Real {
            *contact.friction *= 1.0 + *contact.restitution;
        }
    }
}

impl RapierWorld {
    /// Builds a world of the scene.
    pub(crate) fn build(
        engine: &'static str,
        scene: &Scene,
        options: &WorldOptions,
    ) -> Result<Self, SimError> {
        let mut physics = PhysicsWorld::new();
        physics.gravity = to_engine(scene.gravity_w);
        let p = &mut physics.integration_parameters;
        p.dt = options.dt as Real;
        p.min_ccd_dt = (options.dt / 100.0) as Real;
        // Contact timing above this trait handles balls. The engine's own sweeps treat every thin hull as fast and
        // recompute its mass properties in each step, which takes more than half of a rollout.
        p.max_ccd_substeps = 0;
        p.length_unit = LENGTH_UNIT as Real;
        p.normalized_max_linear_velocity = (MAX_SPEED / LENGTH_UNIT) as Real;
        p.normalized_max_corrective_velocity = (MAX_PUSH_OUT_SPEED / LENGTH_UNIT) as Real;
        p.normalized_contact_recycle_distance = (RECYCLE_DISTANCE / LENGTH_UNIT) as Real;
        p.contact_softness.natural_frequency = CONTACT_FREQUENCY as Real;
        p.static_contact_softness.natural_frequency = CONTACT_FREQUENCY as Real;
        // One friction point per manifold, with a twist. The other model, with one point per contact, lets the friction
        // forces at the corners of a sliding box oppose each other and loses 10 % (probe `sliding_block`).
        p.friction_model = FrictionModel::Simplified;
        let mut world = Self {
            engine,
            physics,
            bodies: Vec::with_capacity(scene.bodies.len() + 1),
            wrenched: Vec::new(),
            kinematics: Vec::new(),
            last_dt: options.dt,
            touches: Touches::default(),
            options: *options,
            saved: None,
        };
        for body in &scene.bodies {
            world.add(body)?;
        }
        Ok(world)
    }

    fn add(&mut self, body: &Body) -> Result<(), SimError> {
        let refuse = |why: &str| SimError::Body { body: body.name.clone(), why: why.to_owned() };
        if !body.x_wb.is_finite() {
            return Err(refuse("its pose is not finite"));
        }
        let is_ball = matches!(body.shape, BodyShape::Sphere { .. });
        let builder = match body.kind {
            BodyKind::Static => RigidBodyBuilder::fixed(),
            BodyKind::Dynamic => {
                let mass = body.mass.as_ref().ok_or_else(|| refuse("it is dynamic and has no mass"))?;
                RigidBodyBuilder::dynamic()
                    .additional_mass_properties(mass_properties(mass))
                    // Otherwise Rapier limits the spin of small bodies.
                    .allow_fast_rotation(true)
                    .can_sleep(self.options.sleep)
            }
        };
        let handle = self.physics.insert_body(builder.pose(pose_to_engine(&body.x_wb)));
        if self.options.sleep && body.kind == BodyKind::Dynamic {
            let activation = self.physics.bodies[handle].activation_mut();
            let speed = if is_ball { SLEEP_SPEED_BALL } else { SLEEP_SPEED };
            activation.normalized_linear_threshold = (speed / LENGTH_UNIT) as Real;
            activation.time_until_sleep = TIME_UNTIL_SLEEP as Real;
        }
        let (friction, restitution) =
            (body.material.friction.value.best, body.material.restitution.value.best);
        for collider in colliders(&body.shape).map_err(|why| refuse(&why))? {
            // Contacts of pairs with a hook are never reused; only balls and the striker need it.
            let hooks = if is_ball { ActiveHooks::MODIFY_SOLVER_CONTACTS } else { ActiveHooks::empty() };
            let collider = with_material(collider, friction, restitution)
                .active_hooks(hooks)
                .user_data(self.bodies.len() as u128);
            // No touches are reported between two static bodies.
            let collider = match body.kind {
                BodyKind::Dynamic => collider.active_events(ActiveEvents::COLLISION_EVENTS),
                BodyKind::Static => collider,
            };
            self.physics.insert_collider(collider, Some(handle));
        }
        self.bodies.push(handle);
        Ok(())
    }

    fn start_kinematics(&mut self, dt: f64) {
        for k in &self.kinematics {
            let (v_w, w_w) = if k.enabled {
                let turn = k.target_x_wk.rotation * k.x_wk.rotation.inverse();
                ((k.target_x_wk.translation - k.x_wk.translation) / dt, turn.to_scaled_axis() / dt)
            } else {
                (DVec3::ZERO, DVec3::ZERO)
            };
            let body = &mut self.physics.bodies[self.bodies[k.body]];
            body.set_linvel(to_engine(v_w), true);
            body.set_angvel(to_engine(w_w), true);
        }
    }

    fn place_kinematics(&mut self) {
        for k in &mut self.kinematics {
            let body = &mut self.physics.bodies[self.bodies[k.body]];
            k.x_wk = k.target_x_wk;
            let place = pose_to_engine(&k.x_wk);
            if *body.position() != place {
                body.set_position(place, false);
            }
        }
    }

    fn add_striker(
        &mut self,
        builder: RigidBodyBuilder,
        half: DVec3,
        friction: f64,
        restitution: f64,
    ) -> BodyId {
        let handle = self.physics.insert_body(builder);
        let body = self.bodies.len();
        let collider = with_material(cuboid(half), friction, restitution)
            .active_hooks(ActiveHooks::MODIFY_SOLVER_CONTACTS)
            .user_data(body as u128);
        self.physics.insert_collider(collider, Some(handle));
        self.bodies.push(handle);
        body
    }

    fn body(&self, body: BodyId) -> &RigidBody {
        &self.physics.bodies[self.bodies[body]]
    }

    fn body_mut(&mut self, body: BodyId) -> &mut RigidBody {
        &mut self.physics.bodies[self.bodies[body]]
    }
}

impl World for RapierWorld {
    fn engine(&self) -> &'static str {
        self.engine
    }

    fn step(&mut self, dt: f64) {
        let p = &mut self.physics.integration_parameters;
        p.dt = dt as Real;
        // Contacts start from the impulses of the last step, which scale with its length. A short step that starts from
        // the impulses of a long one would throw resting bodies up.
        p.warmstart_coefficient = (dt / self.last_dt).min(1.0) as Real;
        self.last_dt = dt;
        self.start_kinematics(dt);
        self.physics.step_with_events(&ImpactFriction, &self.touches);
        self.place_kinematics();
        for body in std::mem::take(&mut self.wrenched) {
            let body = self.body_mut(body);
            body.reset_forces(false);
            body.reset_torques(false);
        }
    }

    fn state(&self, body: BodyId) -> BodyState {
        let body = self.body(body);
        BodyState {
            x_wb: pose_from_engine(body.position()),
            v_w: from_engine(body.linvel()),
            w_w: from_engine(body.angvel()),
        }
    }

    fn set_state(&mut self, body: BodyId, state: &BodyState) {
        if let Some(k) = self.kinematics.iter_mut().find(|k| k.body == body) {
            (k.x_wk, k.target_x_wk) = (state.x_wb, state.x_wb);
        }
        let body = self.body_mut(body);
        body.set_position(pose_to_engine(&state.x_wb), true);
        if body.is_dynamic() {
            body.set_linvel(to_engine(state.v_w), true);
            body.set_angvel(to_engine(state.w_w), true);
        }
    }

    fn apply_wrench(&mut self, body: BodyId, force_w: DVec3, torque_w: DVec3, wake: bool) {
        let rigid = self.body_mut(body);
        rigid.add_force(to_engine(force_w), wake);
        rigid.add_torque(to_engine(torque_w), wake);
        self.wrenched.push(body);
    }

    fn is_asleep(&self, body: BodyId) -> bool {
        self.body(body).is_sleeping()
    }

    fn add_kinematic(&mut self, half: DVec3, x_wk: DPose3, friction: f64, restitution: f64) -> BodyId {
        let builder = RigidBodyBuilder::kinematic_velocity_based().pose(pose_to_engine(&x_wk));
        let body = self.add_striker(builder, half, friction, restitution);
        self.kinematics.push(RapierKinematic { body, x_wk, target_x_wk: x_wk, enabled: true });
        body
    }

    fn set_kinematic_target(&mut self, body: BodyId, x_wk: DPose3) {
        if let Some(k) = self.kinematics.iter_mut().find(|k| k.body == body) {
            k.target_x_wk = x_wk;
        }
    }

    fn add_tool(&mut self, half: DVec3, x_wt: DPose3, friction: f64, restitution: f64) -> BodyId {
        let builder = RigidBodyBuilder::dynamic()
            .pose(pose_to_engine(&x_wt))
            .additional_mass_properties(tool_mass(1.0))
            .lock_rotations()
            .gravity_scale(0.0)
            .can_sleep(false);
        self.add_striker(builder, half, friction, restitution)
    }

    fn set_tool(&mut self, body: BodyId, state: &BodyState, mass: f64) {
        let rigid = self.body_mut(body);
        rigid.set_position(pose_to_engine(&state.x_wb), true);
        rigid.set_linvel(to_engine(state.v_w), true);
        rigid.set_angvel(to_engine(state.w_w), true);
        // The engine recomputes mass properties only after a change.
        if (rigid.mass() as f64 - mass).abs() > 1e-6 * mass {
            rigid.set_additional_mass_properties(tool_mass(mass), true);
        }
    }

    fn set_kinematic_enabled(&mut self, body: BodyId, enabled: bool) {
        if let Some(k) = self.kinematics.iter_mut().find(|k| k.body == body) {
            k.enabled = enabled;
        }
        let handles = self.body(body).colliders().to_vec();
        for handle in handles {
            self.physics.colliders[handle].set_enabled(enabled);
        }
    }

    fn save(&mut self) -> bool {
        let w = &self.physics;
        self.saved = Some(Box::new(RapierSnapshot {
            islands: w.islands.clone(),
            broad_phase: w.broad_phase.clone(),
            narrow_phase: w.narrow_phase.clone(),
            bodies: w.bodies.clone(),
            colliders: w.colliders.clone(),
            impulse_joints: w.impulse_joints.clone(),
            multibody_joints: w.multibody_joints.clone(),
            soft_bodies: w.soft_bodies.clone(),
            ccd_solver: w.ccd_solver.clone(),
            handles: self.bodies.len(),
            kinematics: self.kinematics.clone(),
            last_dt: self.last_dt,
        }));
        true
    }

    fn restore(&mut self) -> bool {
        let Some(saved) = &self.saved else { return false };
        let w = &mut self.physics;
        w.islands = saved.islands.clone();
        w.broad_phase = saved.broad_phase.clone();
        w.narrow_phase = saved.narrow_phase.clone();
        w.bodies = saved.bodies.clone();
        w.colliders = saved.colliders.clone();
        w.impulse_joints = saved.impulse_joints.clone();
        w.multibody_joints = saved.multibody_joints.clone();
        w.soft_bodies = saved.soft_bodies.clone();
        w.ccd_solver = saved.ccd_solver.clone();
        // Removes kinematic bodies added since.
        self.bodies.truncate(saved.handles);
        self.kinematics.clone_from(&saved.kinematics);
        self.last_dt = saved.last_dt;
        self.wrenched.clear();
        if let Ok(touches) = self.touches.0.get_mut() {
            touches.clear();
        }
        true
    }

    fn take_touches(&mut self, pairs: &mut Vec<(BodyId, BodyId)>) {
        if let Ok(touches) = self.touches.0.get_mut() {
            pairs.append(touches);
        }
    }

    fn first_failed(&self) -> Option<BodyId> {
        let failed = self.physics.quarantine().bodies().first()?;
        self.bodies.iter().position(|h| h == failed)
    }
}

/// Mass properties of a tool; an infinite inertia keeps contacts from turning it.
fn tool_mass(mass: f64) -> MassProperties {
    MassProperties::new(Vector::ZERO, mass as Real, Vector::splat(mass as Real))
}

fn with_material(collider: ColliderBuilder, friction: f64, restitution: f64) -> ColliderBuilder {
    collider
        .density(0.0)
        .friction(friction as Real)
        .restitution(restitution as Real)
        .friction_combine_rule(CoefficientCombineRule::Average)
        .restitution_combine_rule(CoefficientCombineRule::Average)
}

fn colliders(shape: &BodyShape) -> Result<Vec<ColliderBuilder>, String> {
    match shape {
        BodyShape::Sphere { radius } => Ok(vec![ColliderBuilder::ball(*radius as Real)]),
        BodyShape::Box { half_extents } => Ok(vec![cuboid(*half_extents)]),
        BodyShape::Cylinder { radius, half_length } => {
            // Rapier's cylinders are along y.
            let upright = DQuat::from_rotation_arc(DVec3::Y, DVec3::Z);
            let pose = Pose::from_parts(Vector::ZERO, rotation_to_engine(&upright));
            Ok(vec![ColliderBuilder::cylinder(*half_length as Real, *radius as Real).position(pose)])
        }
        BodyShape::HalfSpace => Ok(vec![ColliderBuilder::new(SharedShape::halfspace(Vector::Z))]),
        BodyShape::Hulls { hulls } if hulls.is_empty() => Err("it has no hulls".to_owned()),
        BodyShape::Hulls { hulls } => hulls.iter().enumerate().map(hull).collect(),
        BodyShape::TriMesh { mesh } => {
            // Contacts at inner edges of a flat surface would stop sliding bodies. Both sides count, because a
            // reconstructed surface may be oriented either way.
            let flags =
                TriMeshFlags::FIX_INTERNAL_EDGES_TWO_SIDED | TriMeshFlags::DELETE_DEGENERATE_TRIANGLES;
            ColliderBuilder::trimesh_with_flags(vertices(mesh), mesh.triangles.clone(), flags)
                .map(|c| vec![c])
                .map_err(|e| format!("its mesh cannot be used: {e}"))
        }
    }
}

fn cuboid(half: DVec3) -> ColliderBuilder {
    ColliderBuilder::cuboid(half.x as Real, half.y as Real, half.z as Real)
}

fn hull((index, mesh): (usize, &Mesh)) -> Result<ColliderBuilder, String> {
    Some(vertices(mesh))
        .filter(|v| v.len() >= 4)
        .and_then(|v| StableHull::new(&v))
        .map(|h| ColliderBuilder::new(SharedShape::new(h)))
        .ok_or_else(|| format!("hull {index} has no volume"))
}

fn vertices(mesh: &Mesh) -> Vec<Vector> {
    mesh.vertices.iter().map(|&v| to_engine(v)).collect()
}

/// Diagonalized in double precision: the decomposition's tolerances in single precision exceed small inertias (1e-6).
fn mass_properties(mass: &sms_core::MassProperties) -> MassProperties {
    let (moments, axes) = mass.principal();
    MassProperties::with_principal_inertia_frame(
        to_engine(mass.com()),
        mass.mass() as Real,
        to_engine(moments),
        rotation_to_engine(&axes),
    )
}

fn rotation_to_engine(q: &DQuat) -> Rotation {
    Rotation::from_xyzw(q.x as Real, q.y as Real, q.z as Real, q.w as Real)
}

fn pose_to_engine(x: &DPose3) -> Pose {
    Pose::from_parts(to_engine(x.translation), rotation_to_engine(&x.rotation))
}

fn pose_from_engine(x: &Pose) -> DPose3 {
    let q = x.rotation;
    DPose3::from_parts(
        from_engine(x.translation),
        DQuat::from_xyzw(q.x as f64, q.y as f64, q.z as f64, q.w as f64),
    )
}
