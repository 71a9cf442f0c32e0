//! Smoothed-particle hydrodynamics: the air of the propellers as particles that interact with each other and with the
//! bodies (Monaghan 2005; the paper cites Koschier et al. 2020).
//!
//! The gas is weakly compressible. Pressure follows from density by an equation of state, clamped below at zero, and
//! Monaghan's artificial viscosity damps shocks. As in the paper, only the air of the propellers is simulated: it flies
//! freely to the structure, spreads along it and leaves. Particles that cannot meet the structure any more are retired.
//!
//! Pair forces are equal and opposite, and a body receives the momentum that particles lose at its surface. Therefore
//! emitted = in flight + retired + on bodies at any time, up to rounding ([`SphWash::ledger`]).

mod cells;
mod contact;
mod emitter;
mod forces;
mod kernel;
mod lanes;
mod particles;

pub use emitter::EmissionPattern;
pub use kernel::SmoothingKernel;

use crate::wash::Stream;
use crate::{BodyState, BodySurface, Emission, VehicleState, Wash, WashError, Wrench};
use cells::CellGrid;
use contact::{Moved, Near, Obstacles};
use emitter::Emitter;
use forces::Gas;
use glamx::{DPose3, DVec3};
use particles::Particles;
use serde::{Deserialize, Serialize};
use sms_core::Aabb;

/// Number of particles per task of the motion.
const CHUNK: usize = 128;
/// Largest coordinate (metres) and speed (m/s) of a valid particle.
const FARTHEST: f32 = 1e4;
/// Distance that particles keep from surfaces, in spacings.
const OFFSET: f64 = 0.25;

/// Settings of the particle model.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SphSettings {
    /// Density of the air, kg/m³.
    pub air_density: f64,
    /// Momentum of a propeller's stream.
    pub emission: Emission,
    /// Spacing of particles in air at rest, metres (experiments/studies/wash.md).
    pub spacing: f64,
    /// Radius of the kernel's support, in spacings.
    pub support_spacings: f64,
    /// The smoothing kernel.
    pub kernel: SmoothingKernel,
    /// Arrangement of emitted particles.
    pub pattern: EmissionPattern,
    /// Sound speed of the gas, m/s. The physical value would need steps of 0.1 ms. Forces on bodies are momentum fluxes
    /// and hardly depend on the sound speed.
    pub sound_speed: f64,
    /// Exponent of the equation of state: 1 linear, 7 Tait's for liquids.
    pub exponent: f64,
    /// Relative excess of density below which the pressure is zero. Density sums over irregular particles scatter by
    /// about as much, and this scatter must not widen a free jet.
    pub slack: f64,
    /// Artificial viscosity, Monaghan's α.
    pub viscosity: f64,
    /// Step divided by (support / (sound speed + speed of the stream)).
    pub cfl: f64,
    /// An emitter is active only while the structure is in its way within this distance, metres.
    pub reach: f64,
    /// Particles are kept only if they are within this distance of the structure's bounding box, or will enter it,
    /// metres.
    pub margin: f64,
    /// Age at which particles are retired, seconds.
    pub lifetime_s: f64,
    /// Largest number of particles; emitters pause when it is reached.
    pub max_particles: usize,
    /// Whether to use the threads of the current rayon pool. Disable this if rollouts run in parallel: this is faster,
    /// and no thread starts another rollout within a step. The results are the same.
    pub parallel: bool,
}

impl Default for SphSettings {
    fn default() -> Self {
        Self {
            air_density: crate::disk::AIR_DENSITY,
            emission: Emission::Momentum,
            spacing: 0.025,
            support_spacings: 2.0,
            kernel: SmoothingKernel::WendlandC2,
            pattern: EmissionPattern::Sunflower,
            sound_speed: 20.0,
            exponent: 1.0,
            slack: 0.1,
            viscosity: 0.2,
            cfl: 1.0,
            reach: 1.2,
            margin: 0.1,
            lifetime_s: 0.5,
            max_particles: 30_000,
            parallel: true,
        }
    }
}

impl SphSettings {
    /// Returns settings of an independent model of the same air, to evaluate plans made with `self`: particles of half
    /// the size, with another kernel, sound speed and emission pattern.
    pub fn independent(&self) -> Self {
        Self {
            spacing: 0.5 * self.spacing,
            kernel: SmoothingKernel::CubicSpline,
            pattern: EmissionPattern::Square,
            sound_speed: 1.6 * self.sound_speed,
            max_particles: 8 * self.max_particles,
            ..*self
        }
    }

    /// Mass of a particle, kg.
    fn particle_mass(&self) -> f64 {
        self.air_density * self.spacing.powi(3)
    }

    fn check(&self) -> Result<(), WashError> {
        for (name, value) in [
            ("air_density", self.air_density),
            ("spacing", self.spacing),
            ("sound_speed", self.sound_speed),
            ("cfl", self.cfl),
            ("reach", self.reach),
            ("lifetime_s", self.lifetime_s),
            ("max_particles", self.max_particles as f64),
        ] {
            WashError::positive(name, value)?;
        }
        let range = |name: &str, value: f64, low: f64, high: f64, must| {
            if (low..=high).contains(&value) {
                return Ok(());
            }
            Err(WashError::Setting { name: name.to_owned(), value, must })
        };
        range("support_spacings", self.support_spacings, 1.2, 4.0, "from 1.2 to 4")?;
        range("exponent", self.exponent, 1.0, 7.0, "from 1 to 7")?;
        range("slack", self.slack, 0.0, 1.0, "from 0 to 1")?;
        range("viscosity", self.viscosity, 0.0, 2.0, "from 0 to 2")?;
        range("margin", self.margin, 0.0, 10.0, "from 0 to 10")
    }
}

/// Momentum balance, N·s in the world, over all steps since the start or the last restore.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Ledger {
    /// Momentum of all emitted particles at emission.
    pub emitted_w: DVec3,
    /// Momentum transferred to bodies.
    pub on_bodies_w: DVec3,
    /// Momentum of retired particles at retirement.
    pub retired_w: DVec3,
    /// Momentum of the current particles.
    pub in_flight_w: DVec3,
    /// Number of emitted particles.
    pub emitted: usize,
    /// Number of particles that were not emitted for lack of capacity.
    pub dropped: usize,
}

#[derive(Debug, Clone, Default)]
struct State {
    particles: Particles,
    emitters: Vec<Emitter>,
    ledger: Ledger,
}

/// Wash by smoothed-particle hydrodynamics. The results do not depend on the number of threads.
pub struct SphWash {
    settings: SphSettings,
    surfaces: Vec<BodySurface>,
    state: State,
    saved: State,
    // Buffers.
    sorted: Particles,
    cells: CellGrid,
    moved: Vec<Moved>,
    offsets: Vec<(f64, f64)>,
    poses_bw: Vec<DPose3>,
    near: Vec<Near>,
    streams: Vec<Stream>,
}

impl SphWash {
    /// Creates a model with still air, for bodies with the given surfaces.
    ///
    /// # Errors
    /// [`WashError::Setting`] when a setting is out of range.
    pub fn new(surfaces: Vec<BodySurface>, settings: SphSettings) -> Result<Self, WashError> {
        settings.check()?;
        let room = settings.max_particles.min(20_000);
        Ok(Self {
            settings,
            surfaces,
            state: State { particles: Particles::with_capacity(room), ..State::default() },
            saved: State::default(),
            sorted: Particles::with_capacity(room),
            cells: CellGrid::default(),
            moved: Vec::with_capacity(room),
            offsets: Vec::new(),
            poses_bw: Vec::new(),
            near: Vec::new(),
            streams: Vec::new(),
        })
    }

    /// Positions (metres) and velocities (m/s) of all particles in the world, in an order that changes with every step.
    pub fn particles(&self) -> impl Iterator<Item = ([f32; 3], [f32; 3])> + '_ {
        let p = &self.state.particles;
        (0..p.len()).map(move |i| (p.position(i), p.velocity(i)))
    }

    /// The momentum balance.
    pub fn ledger(&self) -> Ledger {
        let in_flight_w =
            self.settings.particle_mass() * DVec3::from_array(self.state.particles.velocity_sum());
        Ledger { in_flight_w, ..self.state.ledger }
    }

    /// Longest stable step for streams of this speed, seconds.
    pub fn longest_step(&self, speed: f64) -> f64 {
        let s = &self.settings;
        s.cfl * s.support_spacings * s.spacing / (s.sound_speed + speed)
    }

    /// The bounding box of all bodies, widened by the margin.
    fn structure(&self) -> Option<Aabb> {
        let bodies = self.surfaces.iter().zip(&self.near).filter(|(s, _)| s.extent().is_some());
        let around = Aabb::of_points(bodies.flat_map(|(_, n)| [n.around.min, n.around.max]))?;
        let margin = self.settings.margin;
        Some(Aabb { min: around.min - margin, max: around.max + margin })
    }

    fn emit(&mut self, structure: Option<&Aabb>, dt: f64) {
        let State { particles, emitters, ledger } = &mut self.state;
        for (rotor, emitter) in emitters.iter_mut().enumerate() {
            let blows = self.streams.iter().find(|s| s.rotor == rotor).filter(|stream| {
                structure.is_some_and(|around| {
                    let wider = Aabb {
                        min: around.min - stream.emitted.radius,
                        max: around.max + stream.emitted.radius,
                    };
                    meets(&wider, stream.p_w, stream.axis_w, self.settings.reach)
                })
            });
            let Some(stream) = blows else {
                emitter.rest();
                continue;
            };
            let (emitted, dropped) = emitter.emit(stream, &self.settings, dt, &mut self.offsets, particles);
            ledger.emitted += emitted;
            ledger.dropped += dropped;
            let v_w = (stream.emitted.speed * stream.axis_w).as_vec3().as_dvec3();
            ledger.emitted_w += emitted as f64 * self.settings.particle_mass() * v_w;
        }
    }

    /// One step of the particles.
    fn substep(&mut self, dt: f64, structure: Option<&Aabb>, bodies: &[BodyState], wrenches: &mut [Wrench]) {
        self.emit(structure, dt);
        let s = &self.settings;
        let mass = s.particle_mass();
        let State { particles, ledger, .. } = &mut self.state;
        if particles.len() == 0 {
            return;
        }
        let support = (s.support_spacings * s.spacing) as f32;
        particles.scatter(self.cells.sort(&particles.x, particles.len(), support), &mut self.sorted);
        let sorted = &mut self.sorted;
        let gas = Gas {
            support,
            mass: mass as f32,
            rest_density: (s.air_density * (1.0 + s.slack)) as f32,
            sound_speed: s.sound_speed as f32,
            exponent: s.exponent as f32,
            viscosity: s.viscosity as f32,
        };
        match s.kernel {
            SmoothingKernel::WendlandC2 => {
                forces::accelerations::<kernel::WendlandC2>(&gas, sorted, &self.cells, s.parallel)
            }
            SmoothingKernel::CubicSpline => {
                forces::accelerations::<kernel::CubicSpline>(&gas, sorted, &self.cells, s.parallel)
            }
        }
        let obstacles = Obstacles {
            surfaces: &self.surfaces,
            motions: bodies,
            poses_bw: &self.poses_bw,
            near: &self.near,
            offset: OFFSET * s.spacing,
            mass,
        };
        self.moved.resize(sorted.len(), Moved::default());
        let still = &*sorted;
        forces::each_chunk(&mut self.moved, CHUNK, s.parallel, |first, out| {
            for (j, moved) in out.iter_mut().enumerate() {
                let i = first + j;
                let (v, a) = (still.velocity(i), still.acceleration[i]);
                let v = std::array::from_fn(|c| v[c] + dt as f32 * a[c]);
                *moved = obstacles.advance(still.position(i), v, dt);
            }
        });
        // In order, so that sums do not depend on threads.
        let lifetime = s.lifetime_s as f32;
        let mut kept = 0;
        for (i, moved) in self.moved.iter().enumerate() {
            for hit in &moved.hits[..moved.hit_count as usize] {
                let body = hit.body as usize;
                wrenches[body].push(hit.impulse_w, hit.p_w, bodies[body].x_wb.translation);
                ledger.on_bodies_w += hit.impulse_w;
            }
            if !moved.x.iter().chain(&moved.v).all(|c| c.abs() < FARTHEST) {
                // The particle diverged because the step was too long. Its effect on bodies is in their wrenches.
                continue;
            }
            let age = sorted.age[i] + dt as f32;
            if age < lifetime && structure.is_some_and(|around| will_meet(around, moved)) {
                particles.set(kept, moved.x, moved.v, age);
                kept += 1;
            } else {
                ledger.retired_w += mass * DVec3::from_array(moved.v.map(f64::from));
            }
        }
        particles.resize(kept);
    }
}

/// Returns whether a particle is inside the box or flies towards it.
fn will_meet(around: &Aabb, moved: &Moved) -> bool {
    let x = DVec3::from_array(moved.x.map(f64::from));
    let inside = x.cmpge(around.min).all() && x.cmple(around.max).all();
    inside || meets(around, x, DVec3::from_array(moved.v.map(f64::from)), f64::INFINITY)
}

/// Returns whether a ray is inside a box at some parameter from 0 to `reach`; false for a zero direction.
fn meets(around: &Aabb, origin: DVec3, direction: DVec3, reach: f64) -> bool {
    let (mut enter, mut leave) = (0.0, reach);
    for axis in 0..3 {
        let (o, d) = (origin[axis], direction[axis]);
        if d.abs() < 1e-6 {
            if o < around.min[axis] || o > around.max[axis] {
                return false;
            }
            continue;
        }
        let (a, b) = ((around.min[axis] - o) / d, (around.max[axis] - o) / d);
        enter = f64::max(enter, a.min(b));
        leave = f64::min(leave, a.max(b));
    }
    enter <= leave
}

impl Wash for SphWash {
    fn name(&self) -> &'static str {
        "sph"
    }

    fn step(&mut self, dt: f64, vehicle: &VehicleState<'_>, bodies: &[BodyState], wrenches: &mut [Wrench]) {
        assert_eq!(bodies.len(), self.surfaces.len(), "a motion for each surface");
        assert_eq!(wrenches.len(), self.surfaces.len(), "a wrench for each surface");
        assert_eq!(vehicle.rotors.len(), vehicle.thrusts.len(), "a thrust for each propeller");
        wrenches.fill(Wrench::default());
        if dt <= 0.0 {
            return;
        }
        self.streams.clear();
        self.streams.extend(vehicle.streams(self.settings.air_density, self.settings.emission));
        self.state.emitters.resize(vehicle.rotors.len(), Emitter::default());
        self.poses_bw.clear();
        self.poses_bw.extend(bodies.iter().map(|b| b.x_wb.inverse()));
        self.near.clear();
        self.near.extend(self.surfaces.iter().zip(bodies).map(|(s, b)| Near::of(s, b)));
        let structure = self.structure();
        let speed = self.streams.iter().map(|s| s.emitted.speed).fold(0.0, f64::max);
        let substeps = (dt / self.longest_step(speed)).ceil().max(1.0);
        for _ in 0..substeps as usize {
            self.substep(dt / substeps, structure.as_ref(), bodies, wrenches);
        }
        for wrench in wrenches.iter_mut() {
            // Converts impulses to forces.
            wrench.force_w /= dt;
            wrench.torque_w /= dt;
        }
    }

    fn is_active(&self) -> bool {
        self.state.particles.len() > 0
    }

    fn save(&mut self) {
        self.saved.particles.copy_from(&self.state.particles);
        self.saved.emitters.clone_from(&self.state.emitters);
        self.saved.ledger = self.state.ledger;
    }

    fn restore(&mut self) {
        self.state.particles.copy_from(&self.saved.particles);
        self.state.emitters.clone_from(&self.saved.emitters);
        self.state.ledger = self.saved.ledger;
    }

    fn particles_w(&self) -> Vec<[f32; 3]> {
        self.particles().map(|(x, _)| x).collect()
    }
}
