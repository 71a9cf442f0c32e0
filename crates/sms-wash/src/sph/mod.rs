//! Smoothed-particle hydrodynamics: the air of the propellers as particles that press on each other and on the bodies
//! (Monaghan 2005; Koschier et al. 2020 are what the paper cites).
//!
//! The gas is weakly compressible: pressure follows from density by an equation of state that only pushes (clamped below),
//! shocks are damped by Monaghan's artificial viscosity. Only the air that the propellers move is there, as in the paper: it flies
//! freely to the structure, spreads along it and leaves. Particles that cannot meet the structure any more are retired.
//!
//! Momentum: pair forces are equal and opposite, what a particle loses at a surface its body gets. So at any time
//! emitted = in flight + retired + on bodies, to rounding ([`SphWash::ledger`]).

mod cells;
mod contact;
mod emitter;
mod forces;
mod kernel;
mod lanes;
mod particles;

pub use emitter::Pattern;
pub use kernel::Kernel;

use crate::wash::Stream;
use crate::{BodyMotion, BodySurface, Emission, VehicleState, Wash, WashError, Wrench};
use cells::Cells;
use contact::{Moved, Near, Obstacles};
use emitter::Emitter;
use forces::Gas;
use glamx::{DPose3, DVec3};
use particles::Particles;
use serde::{Deserialize, Serialize};
use sms_core::Aabb;

/// Particles of one task when they are moved.
const CHUNK: usize = 128;
/// Coordinates (metres) and speeds (m/s) beyond this are no particle's.
const FARTHEST: f32 = 1e4;
/// Distance that particles keep from surfaces, in spacings.
const OFFSET: f64 = 0.25;

/// How the air is made of particles.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SphSettings {
    /// Density of the air, kg/m³.
    pub air_density: f64,
    /// How much momentum leaves a propeller.
    pub emission: Emission,
    /// Distance of particles in air at rest, metres (experiments/studies/wash.md).
    pub spacing: f64,
    /// Radius of the kernel's support, in spacings.
    pub support_spacings: f64,
    /// The kernel.
    pub kernel: Kernel,
    /// How emitters lay out particles.
    pub pattern: Pattern,
    /// Sound speed of the gas, m/s. The real one would need steps of 0.1 ms; forces on bodies are those of momentum, whatever it is.
    pub sound_speed: f64,
    /// Exponent of the equation of state: 1 linear, 7 Tait's for liquids.
    pub exponent: f64,
    /// By how much density must exceed that of the air before there is pressure, as a part of it: sums over particles that are
    /// no lattice scatter by about as much, and a jet that flies freely is not to be widened by that.
    pub slack: f64,
    /// Artificial viscosity, Monaghan's α.
    pub viscosity: f64,
    /// Step over (support / (sound speed + speed of the stream)).
    pub cfl: f64,
    /// Emitters blow only when the structure lies in their way within this distance, metres.
    pub reach: f64,
    /// Particles are followed while they are, or will come, within this distance of the box around the structure, metres.
    pub margin: f64,
    /// Age at which particles are retired wherever they are, seconds.
    pub lifetime_s: f64,
    /// No more particles than this; emitters pause.
    pub max_particles: usize,
    /// Whether steps use the threads of the current rayon pool. Switch it off where rollouts themselves run in parallel: that is
    /// faster, and no thread then begins another rollout within a step. The numbers are the same.
    pub parallel: bool,
}

impl Default for SphSettings {
    fn default() -> Self {
        Self {
            air_density: crate::AIR_DENSITY,
            emission: Emission::Momentum,
            spacing: 0.025,
            support_spacings: 2.0,
            kernel: Kernel::WendlandC2,
            pattern: Pattern::Sunflower,
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
    /// The same air with another model of it: particles of half the size, another kernel, sound speed and emission pattern. What is
    /// planned with `self` is to be judged by this.
    pub fn independent(&self) -> Self {
        Self {
            spacing: 0.5 * self.spacing,
            kernel: Kernel::CubicSpline,
            pattern: Pattern::Square,
            sound_speed: 1.6 * self.sound_speed,
            max_particles: 8 * self.max_particles,
            ..*self
        }
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

/// Where momentum is, N·s in the world. It is gathered over all steps since the start or the last restore.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Ledger {
    /// Of all particles emitted, as they were emitted.
    pub emitted_w: DVec3,
    /// Handed over to bodies.
    pub on_bodies_w: DVec3,
    /// Of retired particles, as they were retired.
    pub retired_w: DVec3,
    /// Of the particles that there are.
    pub in_flight_w: DVec3,
    /// Particles emitted.
    pub emitted: usize,
    /// Particles that found no room and were not emitted.
    pub dropped: usize,
}

#[derive(Debug, Clone, Default)]
struct State {
    particles: Particles,
    emitters: Vec<Emitter>,
    ledger: Ledger,
}

/// Wash by smoothed-particle hydrodynamics. Steps give the same numbers whatever the number of threads.
pub struct SphWash {
    settings: SphSettings,
    surfaces: Vec<BodySurface>,
    state: State,
    saved: State,
    // Kept for their memory.
    sorted: Particles,
    cells: Cells,
    moved: Vec<Moved>,
    offsets: Vec<(f64, f64)>,
    poses_bw: Vec<DPose3>,
    near: Vec<Near>,
    streams: Vec<Stream>,
}

impl SphWash {
    /// Still air around bodies of these surfaces.
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
            cells: Cells::default(),
            moved: Vec::with_capacity(room),
            offsets: Vec::new(),
            poses_bw: Vec::new(),
            near: Vec::new(),
            streams: Vec::new(),
        })
    }

    /// The settings.
    pub fn settings(&self) -> &SphSettings {
        &self.settings
    }

    /// Number of particles that there are.
    pub fn particle_count(&self) -> usize {
        self.state.particles.len()
    }

    /// Mass of a particle, kg.
    pub fn particle_mass(&self) -> f64 {
        self.settings.air_density * self.settings.spacing.powi(3)
    }

    /// Positions (metres) and velocities (m/s) of all particles in the world, in an order that changes with every step.
    pub fn particles(&self) -> impl Iterator<Item = ([f32; 3], [f32; 3])> + '_ {
        let p = &self.state.particles;
        (0..p.len()).map(move |i| (p.position(i), p.velocity(i)))
    }

    /// Where momentum went.
    pub fn ledger(&self) -> Ledger {
        let in_flight_w = self.particle_mass() * DVec3::from_array(self.state.particles.velocity_sum());
        Ledger { in_flight_w, ..self.state.ledger }
    }

    /// Longest stable step for streams of this speed, seconds.
    pub fn longest_step(&self, speed: f64) -> f64 {
        let s = &self.settings;
        s.cfl * s.support_spacings * s.spacing / (s.sound_speed + speed)
    }

    /// The box around all bodies, widened by the margin.
    fn structure(&self) -> Option<Aabb> {
        let bodies = self.surfaces.iter().zip(&self.near).filter(|(s, _)| s.extent().is_some());
        let around = Aabb::of_points(bodies.flat_map(|(_, n)| [n.around.min, n.around.max]))?;
        let margin = self.settings.margin;
        Some(Aabb { min: around.min - margin, max: around.max + margin })
    }

    fn emit(&mut self, structure: Option<&Aabb>, dt: f64) {
        let mass = self.particle_mass();
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
            let (emitted, dropped) = emitter.emit(
                stream,
                self.settings.pattern,
                self.settings.spacing,
                mass,
                dt,
                self.settings.max_particles,
                &mut self.offsets,
                particles,
            );
            ledger.emitted += emitted;
            ledger.dropped += dropped;
            let v_w = (stream.emitted.speed * stream.axis_w).as_vec3().as_dvec3();
            ledger.emitted_w += emitted as f64 * mass * v_w;
        }
    }

    /// One step of the particles.
    fn substep(&mut self, dt: f64, structure: Option<&Aabb>, bodies: &[BodyMotion], wrenches: &mut [Wrench]) {
        self.emit(structure, dt);
        let mass = self.particle_mass();
        let s = &self.settings;
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
            Kernel::WendlandC2 => {
                forces::accelerations::<kernel::WendlandC2>(&gas, sorted, &self.cells, s.parallel)
            }
            Kernel::CubicSpline => {
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
        // In order: sums do not depend on threads.
        let lifetime = s.lifetime_s as f32;
        let mut kept = 0;
        for (i, moved) in self.moved.iter().enumerate() {
            for hit in &moved.hits[..moved.hit_count as usize] {
                let body = hit.body as usize;
                wrenches[body].push(hit.impulse_w, hit.p_w, bodies[body].x_wb.translation);
                ledger.on_bodies_w += hit.impulse_w;
            }
            if !moved.x.iter().chain(&moved.v).all(|c| c.abs() < FARTHEST) {
                // It blew up (a user's step was too long); what it did to bodies shows in their wrenches.
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

/// Whether a particle is in the box or flies towards it.
fn will_meet(around: &Aabb, moved: &Moved) -> bool {
    let x = DVec3::from_array(moved.x.map(f64::from));
    let inside = x.cmpge(around.min).all() && x.cmple(around.max).all();
    inside || meets(around, x, DVec3::from_array(moved.v.map(f64::from)), f64::INFINITY)
}

/// Whether a ray is in a box at some parameter from 0 to `reach`. A direction without length never gets there.
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

    fn step(&mut self, dt: f64, vehicle: &VehicleState<'_>, bodies: &[BodyMotion], wrenches: &mut [Wrench]) {
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
            // Impulses over the step's time.
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
