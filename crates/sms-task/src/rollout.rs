//! The rollout that planner and targets share.

use crate::body::horizontal;
use crate::resolved::Objective;
use crate::terms::{TermTracker, is_indispensable};
use crate::{BodyTrack, ClosestApproach, ResolvedTask, TaskError, Trajectory};
use glamx::{DMat3, DVec2, DVec3};
use sms_core::{Aabb, InputError};
use sms_scene::{Body, BodyKind, BodyShape, Scene};
use sms_sim::{
    BodyId, BodyState, ContactEvent, PhysicsViolation, SimError, Simulation, Striker, WorldFactory,
    WorldOptions,
};

/// Name of the striker's track.
pub const STRIKER: &str = "striker";

/// Motion below which a body is not recorded: metres and radians.
const MOVED: (f64, f64) = (2e-4, 2e-3);

/// A body other than a ball is still below these speeds (m/s, rad/s). A toppling body is faster.
const STILL: (f64, f64) = (0.003, 0.03);

/// A ball farther than this outside all bodies counts as gone, metres. The margin allows for pushed obstacles.
const ARENA_MARGIN_M: f64 = 0.05;

/// Penetration above which a ball has passed through a surface, metres. In engines, fast balls sink in by a few tenths
/// of a millimetre.
const DEEPEST_M: f64 = 0.005;

/// Limit for other bodies, in addition to their penetration at the start: their convex parts are larger than the body
/// and overlap at rest.
const DEEPEST_BODY_M: f64 = 0.01;

/// Largest ratio of the speed of a repeatedly struck body to the speed of the finger.
const FASTEST: f64 = 4.0;

/// Tolerance for energy beyond the robot's work, and for gains after the strike: a share of the energy, and joules.
/// Engines add energy when they separate overlapping bodies. Valid shots have at most 0.92 of the robot's work and gain
/// at most 0.05 mJ (152 shots in four engines, experiments/studies/plan.md). 20 mJ lift 5 kg by 0.4 mm.
const ENERGY_GAIN: (f64, f64) = (0.05, 0.02);

/// Longest settling time, seconds, and largest horizontal motion during settling, metres.
const SETTLE_S: f64 = 1.0;
const SETTLE_M: f64 = 5e-4;

/// Settings of a recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionRecording {
    /// Time between recorded states, seconds; 0 records every step.
    pub every_s: f64,
}

/// The result of a rollout.
#[derive(Debug, Clone, PartialEq)]
pub struct Rollout {
    /// Smallest horizontal distance of the target ball's centre to the goal, metres, including the time between steps;
    /// or the weighted sum of the task's terms.
    pub objective: f64,
    /// Time of the closest approach, seconds from the start of the sweep; the end of the rollout for terms.
    pub closest_s: f64,
    /// First contacts of pairs of bodies in order of time, in seconds from the start of the sweep.
    pub contacts: Vec<ContactEvent>,
    /// End of the rollout, seconds: the horizon, or earlier if the objective was final.
    pub end_s: f64,
    /// The motion, if it was recorded.
    pub trajectory: Option<Trajectory>,
}

/// The bodies of one world in a rollout. A target's world has other names and indices than the planner's.
#[derive(Debug, Clone, PartialEq)]
pub struct WorldBodies {
    target: BodyId,
    /// Bodies of the terms, in the order of the terms; `None` for a body that is missing in this world.
    term_bodies: Vec<Option<BodyId>>,
    dynamic: Vec<Mover>,
    /// Centre and radius of a disc on the floor that contains all bodies at the start.
    arena: (DVec2, f64),
}

#[derive(Debug, Clone, PartialEq)]
struct Mover {
    id: BodyId,
    name: String,
    /// Radius of a ball.
    radius: Option<f64>,
    mass: f64,
    /// Upper bound of the principal moments of inertia, kg·m².
    inertia: f64,
    /// Lower bound of the principal moments of inertia, kg·m².
    least_inertia: f64,
}

impl Mover {
    fn of(id: BodyId, body: &Body) -> Self {
        let radius = match body.shape {
            BodyShape::Sphere { radius } => Some(radius),
            _ => None,
        };
        let (mass, i) = body.mass.map_or((0.0, DMat3::ZERO), |m| (m.mass(), m.inertia()));
        // Gershgorin's bound on the smallest eigenvalue.
        let least = |k: usize| i.row(k)[k] - (i.row(k).abs().element_sum() - i.row(k)[k].abs());
        let inertia = i.x_axis.x.max(i.y_axis.y).max(i.z_axis.z);
        let least_inertia = least(0).min(least(1)).min(least(2)).max(0.0);
        Self { id, name: body.name.clone(), radius, mass, inertia, least_inertia }
    }
}

impl ResolvedTask {
    /// Returns the bodies of a world built from `scene`. The target is called `target`, and the other bodies keep their
    /// names.
    ///
    /// # Errors
    /// [`TaskError::Input`] if there is no dynamic body of that name.
    pub fn bodies_in(&self, scene: &Scene, target: &str) -> Result<WorldBodies, TaskError> {
        let own = self.target().name.clone();
        self.bodies_called(scene, &|name| if name == own { target.to_owned() } else { name.to_owned() })
    }

    /// The bodies of a world built from `scene`; `called` maps the planner's body names to those of the world.
    ///
    /// # Errors
    /// [`TaskError::Input`] if the target, or another body that has to reach a place or to topple, is missing. Bodies
    /// that only have to keep still or avoid a place may be missing.
    pub fn bodies_called(
        &self,
        scene: &Scene,
        called: &dyn Fn(&str) -> String,
    ) -> Result<WorldBodies, TaskError> {
        let dynamic: Vec<Mover> = scene
            .bodies
            .iter()
            .enumerate()
            .filter(|(_, b)| b.kind == BodyKind::Dynamic)
            .map(|(id, b)| Mover::of(id, b))
            .collect();
        let missing = |name: &str| {
            let names: Vec<&str> = dynamic.iter().map(|m| m.name.as_str()).collect();
            InputError::new(
                format!("scene `{}` has no dynamic body `{name}`", scene.name),
                self.path(),
                format!("its dynamic bodies are: {}", names.join(", ")),
            )
        };
        let find = |name: &str| {
            let name = called(name);
            dynamic.iter().find(|m| m.name == name).map(|m| m.id).ok_or_else(|| missing(&name))
        };
        let target = find(&self.target().name)?;
        let mut term_bodies = Vec::new();
        if let Objective::Terms(terms) = &self.objective {
            for (term, bodies) in terms {
                for body in bodies {
                    match find(&body.name) {
                        Err(e) if is_indispensable(term) => return Err(e.into()),
                        found => term_bodies.push(found.ok()),
                    }
                }
            }
        }
        Ok(WorldBodies { target, term_bodies, dynamic, arena: arena_of(scene) })
    }

    /// Builds a world of a scene and saves it at rest, as [`ResolvedTask::rollout`] expects. The objects are at rest in
    /// the scan. Once they have settled and fallen asleep, the simulation spends no time on objects that the shot does
    /// not touch. If they do not settle quickly and in place, the world starts in the state of the scene.
    ///
    /// # Errors
    /// [`SimError::Body`] if a body cannot be simulated.
    pub fn prepare(
        &self,
        factory: &dyn WorldFactory,
        scene: &Scene,
        options: &WorldOptions,
        bodies: &WorldBodies,
    ) -> Result<Simulation, SimError> {
        let mut simulation = Simulation::new(factory, scene, options)?;
        if !bodies.settle(&mut simulation, options.dt) {
            simulation = Simulation::new(factory, scene, options)?;
        }
        simulation.save();
        Ok(simulation)
    }

    /// Carries out a strike ([`ResolvedTask::striker`]) in a simulation in its first state and measures the objective.
    ///
    /// A rollout ends at the horizon, or when the sweep is over and everything rests. Without recording, it also ends
    /// once the objective is final. The objective is final if the target ball could not come closer in the time left
    /// even with all kinetic energy, or if the ball rolls away from the goal outside all other bodies. Other balls that
    /// roll away no longer count. Other bodies must be still, since they might topple.
    ///
    /// # Errors
    /// [`SimError::Diverged`] if a state is not finite. [`SimError::Unphysical`] if bodies have more energy than the
    /// robot gave them, if they gain energy after the strike, if a ball is more than 5 mm inside of another body, or if
    /// another moving body is 10 mm deeper in others than at the start. Checked every 16 steps.
    pub fn rollout(
        &self,
        simulation: &mut Simulation,
        striker: impl Into<Striker>,
        bodies: &WorldBodies,
        recording: Option<MotionRecording>,
    ) -> Result<Rollout, SimError> {
        let settings = &self.common;
        let mut tracker = ObjectiveTracker::new(&self.objective, simulation, bodies);
        let start = simulation.states().to_vec();
        // The world has settled before, so the clock does not start at 0.
        let start_s = simulation.time_s();
        let striker = striker.into();
        let finger_speed = match &striker {
            Striker::Finger(motion) => motion.speed,
            Striker::Arm(_) => 0.0,
        };
        let striker = simulation.strike(striker, settings.striker.friction, settings.striker.restitution);
        let mut recorder = recording.map(|r| Recorder::new(r, bodies, striker));
        let steps = (settings.horizon_s / settings.dt).round().max(1.0) as usize;
        let mut time_s = 0.0;
        let rest = bodies.energy(simulation)[0];
        let mut checks = RolloutChecks { left: None, rest, start, striker, finger_speed };
        tracker.observe(time_s, simulation);
        if let Some(r) = &mut recorder {
            r.record(time_s, simulation);
        }
        for step in 1..=steps {
            simulation.advance(settings.dt)?;
            time_s = step as f64 * settings.dt;
            tracker.observe(time_s, simulation);
            if let Some(r) = &mut recorder {
                r.record_if_due(time_s, simulation);
            }
            let left_s = settings.horizon_s - time_s;
            // Checked only every 16 steps, because a check costs as much as a few contacts.
            if step % 16 != 0 {
                continue;
            }
            checks.check(time_s, simulation, bodies)?;
            if simulation.is_strike_over()
                && (bodies.all_rest(simulation)
                    || (recorder.is_none() && tracker.is_over(simulation, bodies, left_s)))
            {
                break;
            }
        }
        tracker.rest(time_s, simulation);
        Ok(Rollout {
            objective: tracker.objective(),
            closest_s: tracker.closest_s().unwrap_or(time_s),
            contacts: simulation
                .contacts()
                .iter()
                .map(|c| ContactEvent { time_s: c.time_s - start_s, ..*c })
                .collect(),
            end_s: time_s,
            trajectory: recorder.map(|r| r.finish(time_s, simulation)),
        })
    }
}

/// Tracks the objective during a motion.
enum ObjectiveTracker<'a> {
    ClosestApproach(ClosestApproach, BodyId),
    Terms(Vec<(TermTracker<'a>, BodyId)>),
}

impl<'a> ObjectiveTracker<'a> {
    fn new(objective: &'a Objective, simulation: &Simulation, bodies: &WorldBodies) -> Self {
        match objective {
            Objective::ClosestApproach(goal_w) => {
                Self::ClosestApproach(ClosestApproach::new(*goal_w), bodies.target)
            }
            Objective::Terms(terms) => {
                let of_terms = terms.iter().flat_map(|(term, bodies)| bodies.iter().map(move |_| term));
                let tracker = |(term, id): (&'a crate::Term, &Option<BodyId>)| {
                    id.map(|id| (TermTracker::new(term, simulation.state(id).x_wb), id))
                };
                Self::Terms(of_terms.zip(&bodies.term_bodies).filter_map(tracker).collect())
            }
        }
    }

    fn observe(&mut self, time_s: f64, simulation: &Simulation) {
        match self {
            Self::ClosestApproach(closest, id) => {
                closest.observe(time_s, horizontal(simulation.state(*id).x_wb.translation));
            }
            Self::Terms(trackers) => {
                trackers.iter_mut().for_each(|(t, id)| t.observe(time_s, &simulation.state(*id).x_wb));
            }
        }
    }

    /// Records that nothing moves any more.
    fn rest(&mut self, time_s: f64, simulation: &Simulation) {
        if let Self::Terms(trackers) = self {
            trackers.iter_mut().for_each(|(t, id)| t.rest(time_s, &simulation.state(*id).x_wb));
        }
    }

    fn objective(&self) -> f64 {
        match self {
            Self::ClosestApproach(closest, _) => closest.distance(),
            Self::Terms(trackers) => trackers.iter().map(|(t, _)| t.cost()).sum(),
        }
    }

    fn closest_s(&self) -> Option<f64> {
        match self {
            Self::ClosestApproach(closest, _) => Some(closest.time_s()),
            Self::Terms(_) => None,
        }
    }

    /// Whether the objective is final.
    fn is_over(&self, simulation: &Simulation, bodies: &WorldBodies, left_s: f64) -> bool {
        match self {
            Self::ClosestApproach(closest, _) => bodies.cannot_improve(simulation, closest, left_s),
            Self::Terms(trackers) => trackers.iter().all(|(t, _)| t.is_met()),
        }
    }
}

impl WorldBodies {
    /// Lets all bodies come to rest. Returns whether they did so without leaving their places.
    fn settle(&self, simulation: &mut Simulation, dt: f64) -> bool {
        let places: Vec<DVec2> = self.places(simulation).collect();
        let mut time_s = 0.0;
        while time_s < SETTLE_S && !self.all_rest(simulation) {
            if simulation.advance(dt).is_err() {
                return false;
            }
            time_s += dt;
        }
        let moved = places.iter().zip(self.places(simulation)).map(|(a, b)| a.distance(b));
        self.all_rest(simulation) && moved.fold(0.0, f64::max) < SETTLE_M
    }

    /// Lower and upper bound of the mechanical energy relative to rest, joules. Sleeping bodies have only potential
    /// energy.
    fn energy(&self, simulation: &Simulation) -> [f64; 2] {
        let gravity_w = simulation.gravity_w();
        let mut bounds = [0.0, 0.0];
        for m in &self.dynamic {
            let state = simulation.state(m.id);
            let (v2, w2) = (state.v_w.length_squared(), state.w_w.length_squared());
            let common = 0.5 * m.mass * v2 - m.mass * gravity_w.dot(state.x_wb.translation);
            bounds[0] += common + 0.5 * m.least_inertia * w2;
            bounds[1] += common + 0.5 * m.inertia * w2;
        }
        bounds
    }

    /// Name of the body with the most kinetic energy.
    fn fastest(&self, simulation: &Simulation) -> String {
        let energy = |m: &&Mover| {
            let state = simulation.state(m.id);
            m.mass * state.v_w.length_squared() + m.inertia * state.w_w.length_squared()
        };
        let fastest = self.dynamic.iter().max_by(|a, b| energy(a).total_cmp(&energy(b)));
        fastest.map(|m| m.name.clone()).unwrap_or_default()
    }

    fn places<'a>(&'a self, simulation: &'a Simulation) -> impl Iterator<Item = DVec2> + 'a {
        self.dynamic.iter().map(|m| horizontal(simulation.state(m.id).x_wb.translation))
    }

    fn all_rest(&self, simulation: &Simulation) -> bool {
        self.dynamic.iter().all(|m| simulation.is_asleep(m.id))
    }

    fn cannot_improve(&self, simulation: &Simulation, closest: &ClosestApproach, left_s: f64) -> bool {
        let mut energy = 0.0;
        let mut target_mass = f64::INFINITY;
        for m in &self.dynamic {
            if m.id == self.target {
                target_mass = m.mass;
            }
            if simulation.is_asleep(m.id) {
                continue;
            }
            let state = simulation.state(m.id);
            let (v, w) = (state.v_w.length(), state.w_w.length());
            let Some(radius) = m.radius else {
                if v > STILL.0 || w > STILL.1 {
                    return false;
                }
                continue;
            };
            if !self.rolls_away(&state, radius) {
                energy += 0.5 * (m.mass * v * v + m.inertia * w * w);
            } else if m.id == self.target {
                return closest.distance_of_ray(horizontal(state.v_w)) >= closest.distance();
            }
        }
        let fastest = (2.0 * energy / target_mass).sqrt();
        closest.current_distance() - fastest * left_s >= closest.distance()
    }

    /// Returns whether a ball is outside all other bodies and rolls outwards without slip, so that spin cannot reverse
    /// it.
    fn rolls_away(&self, state: &BodyState, radius: f64) -> bool {
        let (center, arena_radius) = self.arena;
        let outwards = horizontal(state.x_wb.translation) - center;
        let v = horizontal(state.v_w);
        // Velocity of a ball whose lowest point rests on the floor.
        let rolling = radius * horizontal(state.w_w.cross(DVec3::Z));
        outwards.length() > arena_radius + radius + ARENA_MARGIN_M
            && v.dot(outwards) > 0.0
            && v.distance(rolling) < 0.02 * v.length()
    }
}

/// The disc around the horizontal extents of all bodies except half spaces.
fn arena_of(scene: &Scene) -> (DVec2, f64) {
    let corners = scene.bodies.iter().flat_map(|b| {
        let local: Vec<DVec3> = match &b.shape {
            BodyShape::HalfSpace => Vec::new(),
            // The centre of the ball, extended by its radius in every direction.
            BodyShape::Sphere { radius } => {
                let r = *radius;
                [(r, r), (-r, r), (r, -r), (-r, -r)].map(|(x, y)| DVec3::new(x, y, 0.0)).to_vec()
            }
            shape => shape.meshes().into_iter().flat_map(|m| m.vertices).collect(),
        };
        local.into_iter().map(|p| b.x_wb.transform_point(p))
    });
    let points: Vec<DVec3> = corners.collect();
    let Some(around) = Aabb::of_points(points.iter().copied()) else { return (DVec2::ZERO, 0.0) };
    let center = horizontal(around.center());
    (center, points.iter().map(|p| horizontal(*p).distance(center)).fold(0.0, f64::max))
}

/// Checks for physically impossible motion.
struct RolloutChecks {
    /// Upper bound of the energy at the end of the strike, and of its kinetic part.
    left: Option<(f64, f64)>,
    /// Energy at the start.
    rest: f64,
    /// States of all bodies at the start.
    start: Vec<BodyState>,
    striker: BodyId,
    /// Speed of a finger at the contact, m/s; 0 for an arm.
    finger_speed: f64,
}

impl RolloutChecks {
    fn check(&mut self, time_s: f64, simulation: &Simulation, bodies: &WorldBodies) -> Result<(), SimError> {
        let unphysical =
            |why: PhysicsViolation| Err(SimError::Unphysical { engine: simulation.engine(), time_s, why });
        for m in bodies.dynamic.iter().filter(|m| !simulation.is_asleep(m.id)) {
            let Some((other, depth_m)) = simulation.deepest(m.id) else { continue };
            let is_too_deep = if m.radius.is_some() {
                depth_m > DEEPEST_M
            } else {
                // Computed only if it is decisive.
                depth_m > DEEPEST_BODY_M
                    && depth_m > DEEPEST_BODY_M + simulation.penetration_at(m.id, &self.start)
            };
            if is_too_deep {
                let (body, other) = (m.name.clone(), simulation.name(other).to_owned());
                return unphysical(PhysicsViolation::Inside { body, other, depth_m });
            }
        }
        let [low, high] = bodies.energy(simulation);
        if self.left.is_none() {
            let given = self.most_given(simulation, bodies);
            let has = low - self.rest;
            if has > (1.0 + ENERGY_GAIN.0) * given + ENERGY_GAIN.1 {
                let body = bodies.fastest(simulation);
                return unphysical(PhysicsViolation::MoreThanGiven { body, has_j: has, given_j: given });
            }
        }
        if !simulation.is_strike_over() {
            return Ok(());
        }
        match self.left {
            None => self.left = Some((high, high - self.rest)),
            Some((then, moving)) => {
                let gain = low - then;
                if gain > ENERGY_GAIN.0 * moving.max(0.0) + ENERGY_GAIN.1 {
                    return unphysical(PhysicsViolation::Gained {
                        body: bodies.fastest(simulation),
                        gain_j: gain,
                    });
                }
            }
        }
        Ok(())
    }

    /// Returns an upper bound of the energy from the robot, J: the work of the arm. For a kinematic finger, it is the
    /// kinetic energy of the touched bodies at a multiple of the finger's speed.
    fn most_given(&self, simulation: &Simulation, bodies: &WorldBodies) -> f64 {
        if let Some(work) = simulation.work_j(self.striker) {
            return work.max(0.0);
        }
        let with_finger = |id: BodyId| {
            simulation
                .contacts()
                .iter()
                .any(|c| [(c.body, c.other), (c.other, c.body)].contains(&(id, self.striker)))
        };
        let v2 = (FASTEST * self.finger_speed).powi(2);
        let touched = |m: &&Mover| with_finger(m.id);
        // Engines that do not report all contacts may miss some. For these, all bodies count as touched.
        let any = bodies.dynamic.iter().any(|m| with_finger(m.id));
        bodies.dynamic.iter().filter(|m| !any || touched(m)).map(|m| 0.5 * m.mass * v2).sum()
    }
}

struct Recorder<'a> {
    every_s: f64,
    bodies: &'a WorldBodies,
    striker: BodyId,
    times_s: Vec<f64>,
    /// One per dynamic body, then the striker.
    tracks: Vec<Vec<BodyState>>,
}

impl<'a> Recorder<'a> {
    fn new(recording: MotionRecording, bodies: &'a WorldBodies, striker: BodyId) -> Self {
        let tracks = vec![Vec::new(); bodies.dynamic.len() + 1];
        Self { every_s: recording.every_s, bodies, striker, times_s: Vec::new(), tracks }
    }

    fn record(&mut self, time_s: f64, simulation: &Simulation) {
        self.times_s.push(time_s);
        let ids = self.bodies.dynamic.iter().map(|m| m.id).chain([self.striker]);
        for (track, id) in self.tracks.iter_mut().zip(ids) {
            track.push(simulation.state(id));
        }
    }

    fn record_if_due(&mut self, time_s: f64, simulation: &Simulation) {
        // Half a microsecond of slack, so that rounded times do not skip a state.
        if self.times_s.len() as f64 * self.every_s <= time_s + 5e-7 {
            self.record(time_s, simulation);
        }
    }

    fn finish(mut self, end_s: f64, simulation: &Simulation) -> Trajectory {
        if self.times_s.last().is_some_and(|&t| t < end_s) {
            self.record(end_s, simulation);
        }
        let striker = self.tracks.pop().unwrap_or_default();
        let moved = |states: &[BodyState]| {
            states.first().is_some_and(|first| {
                states.iter().any(|s| {
                    first.x_wb.translation.distance(s.x_wb.translation) > MOVED.0
                        || first.x_wb.rotation.angle_between(s.x_wb.rotation) > MOVED.1
                })
            })
        };
        let bodies = self
            .bodies
            .dynamic
            .iter()
            .zip(self.tracks)
            .filter(|(m, states)| m.id == self.bodies.target || moved(states))
            .map(|(m, states)| BodyTrack { name: m.name.clone(), states })
            .chain([BodyTrack { name: STRIKER.to_owned(), states: striker }])
            .collect();
        Trajectory { times_s: self.times_s, bodies }
    }
}

#[cfg(test)]
mod tests;
