//! A landing task resolved in a scene: the surface, the structure, and the flight of an action.

use crate::surface::body_index;
use crate::{LandingAction, LandingError, LandingSurface, LandingTask};
use glamx::{DVec2, DVec3};
use sms_core::{Aabb, InputError};
use sms_robots::{BezierPath, Flight, FlightSettings, Quadrotor};
use sms_scene::{BodyKind, Scene};
use sms_sim::{RestLimits, RestingDrift, SimError, WorldFactory, WorldOptions, resting_drift, wash_surfaces};
use sms_task::Parameter;

/// Largest gap between the boxes of touching bodies, metres: reconstructions leave gaps.
const TOUCH_M: f64 = 0.01;
/// Largest drift of a structure that stands: a reconstruction settles by a few millimetres.
pub(crate) const STANDS: RestLimits = RestLimits { seconds: 2.0, moved_m: 0.01, turned_rad: 0.035 };

/// Execution errors of a flight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CarriedOut {
    /// Shift of the whole flight, the landing point included, metres.
    pub shift_w: DVec2,
    /// Factor on the planned speeds.
    pub speed: f64,
    /// Factor on the hover thrust that drives the wash.
    pub wash: f64,
}

impl Default for CarriedOut {
    /// Returns an exact execution.
    fn default() -> Self {
        Self { shift_w: DVec2::ZERO, speed: 1.0, wash: 1.0 }
    }
}

/// A landing task with the surface and the structure found in a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct ResolvedLanding {
    task: LandingTask,
    vehicle: Quadrotor,
    surface: LandingSurface,
    structure: Vec<String>,
}

impl LandingTask {
    /// Finds the surface and the structure in a scene (scanned or ground truth).
    ///
    /// # Errors
    /// [`LandingError`] for an invalid vehicle file, an unknown body, no surface, or none that is wide enough.
    pub fn resolve(&self, scene: &Scene) -> Result<ResolvedLanding, LandingError> {
        self.validate()?;
        let vehicle = self.quadrotor()?;
        let surface = LandingSurface::find(self, &vehicle, scene)?;
        let structure = if self.chooses_structure() {
            connected(scene, &surface.body)?
        } else {
            for name in &self.structure {
                body_index(self, scene, "structure", name)?;
            }
            self.structure.clone()
        };
        Ok(ResolvedLanding { task: self.clone(), vehicle, surface, structure })
    }
}

/// Returns the dynamic bodies that touch a body, directly or through each other, and the body itself if it is dynamic;
/// in the scene's order.
fn connected(scene: &Scene, platform: &str) -> Result<Vec<String>, LandingError> {
    let surfaces = wash_surfaces(scene)?;
    let boxes: Vec<Option<Aabb>> =
        scene.bodies.iter().zip(&surfaces).map(|(b, s)| s.extent_w(&b.x_wb)).collect();
    let mut is_in: Vec<bool> = scene.bodies.iter().map(|b| b.name == platform).collect();
    loop {
        let joins = |i: usize| {
            let Some(own) =
                boxes[i].as_ref().filter(|_| !is_in[i] && scene.bodies[i].kind == BodyKind::Dynamic)
            else {
                return false;
            };
            (0..is_in.len()).any(|k| {
                let touches = |b: &Aabb| (own.min - b.max).max(b.min - own.max).max_element() <= TOUCH_M;
                is_in[k] && boxes[k].as_ref().is_some_and(touches)
            })
        };
        match (0..is_in.len()).find(|&i| joins(i)) {
            Some(i) => is_in[i] = true,
            None => break,
        }
    }
    let dynamic = scene.bodies.iter().zip(is_in).filter(|(b, is)| *is && b.kind == BodyKind::Dynamic);
    Ok(dynamic.map(|(b, _)| b.name.clone()).collect())
}

impl ResolvedLanding {
    pub(crate) fn of(
        task: LandingTask,
        vehicle: Quadrotor,
        surface: LandingSurface,
        structure: Vec<String>,
    ) -> Self {
        Self { task, vehicle, surface, structure }
    }

    /// Returns the task.
    pub fn task(&self) -> &LandingTask {
        &self.task
    }

    /// Returns the vehicle.
    pub fn vehicle(&self) -> &Quadrotor {
        &self.vehicle
    }

    /// Returns the surface to land on.
    pub fn surface(&self) -> &LandingSurface {
        &self.surface
    }

    /// Returns the names of the bodies that must stay in place.
    pub fn structure(&self) -> &[String] {
        &self.structure
    }

    /// Returns the position of the vehicle's centre at the start of the flight, metres in the world.
    pub fn start_w(&self) -> DVec3 {
        let [x, y] = self.task.start_w;
        DVec3::new(x, y, self.flight_height_w())
    }

    /// Returns the height of the vehicle's centre along the curve, metres in the world.
    pub fn flight_height_w(&self) -> f64 {
        self.standing_w(DVec2::ZERO).z + self.task.flight.height
    }

    /// Returns the position of the vehicle's centre when it stands with its axis at this point, metres in the world.
    pub fn standing_w(&self, landing_w: DVec2) -> DVec3 {
        landing_w.extend(self.surface.top_w + self.vehicle.standing_height())
    }

    /// Returns the parameters of an action and their ranges, in the order of [`LandingAction::values`]. The ranges of
    /// the landing point are the bounding box of [`LandingSurface::point`].
    pub fn parameters(&self) -> Vec<Parameter> {
        let s = &self.surface;
        let along = DVec2::from(s.along_w).abs();
        let reach = along * s.half[0] + DVec2::new(along.y, along.x) * s.half[1];
        let b = &self.task.bounds;
        let parameter = |name: &str, unit: &str, low: f64, high: f64| Parameter {
            name: name.to_owned(),
            unit: unit.to_owned(),
            low,
            high,
        };
        vec![
            parameter("landing_x", "m", s.center_w[0] - reach.x, s.center_w[0] + reach.x),
            parameter("landing_y", "m", s.center_w[1] - reach.y, s.center_w[1] + reach.y),
            parameter("approach_radius", "m", b.approach_radius[0], b.approach_radius[1]),
            parameter("approach_angle", "rad", b.approach_angle[0], b.approach_angle[1]),
        ]
    }

    /// Returns the action of a point in [0, 1]⁴: along and across the surface's rectangle, approach radius and angle.
    ///
    /// # Panics
    /// If there are fewer than four values.
    pub fn action_at(&self, u: &[f64]) -> LandingAction {
        let b = &self.task.bounds;
        let mix = |[low, high]: [f64; 2], t: f64| low + t.clamp(0.0, 1.0) * (high - low);
        LandingAction {
            landing_w: self.surface.point([u[0].clamp(0.0, 1.0), u[1].clamp(0.0, 1.0)]).to_array(),
            approach_radius: mix(b.approach_radius, u[2]),
            approach_angle: mix(b.approach_angle, u[3]),
        }
    }

    /// Inverts [`ResolvedLanding::action_at`], clamped to the bounds; angles are reduced modulo 2π first.
    pub fn unit(&self, action: &LandingAction) -> Vec<f64> {
        let b = &self.task.bounds;
        let part = |[low, high]: [f64; 2], v: f64| {
            if high > low { ((v - low) / (high - low)).clamp(0.0, 1.0) } else { 0.5 }
        };
        let tau = std::f64::consts::TAU;
        let low = b.approach_angle[0];
        let angle = low + (action.approach_angle - low).rem_euclid(tau);
        let [u, v] = self.surface.unit(action.landing());
        vec![u, v, part(b.approach_radius, action.approach_radius), part(b.approach_angle, angle)]
    }

    /// Returns whether the vehicle fits at the landing point.
    pub fn is_possible(&self, action: &LandingAction) -> bool {
        self.surface.fits(action.landing())
    }

    /// Returns the straight approach to a landing point: the approach point is half way from the start.
    pub fn straight(&self, landing_w: DVec2) -> LandingAction {
        let back = DVec2::from(self.task.start_w) - landing_w;
        LandingAction {
            landing_w: landing_w.to_array(),
            approach_radius: 0.5 * back.length(),
            approach_angle: back.to_angle().rem_euclid(std::f64::consts::TAU),
        }
    }

    /// Returns the flight of an action: the Bézier curve of the paper in the flight plane, then straight down.
    ///
    /// # Errors
    /// [`LandingError::Vehicle`] for speeds that are not positive.
    pub fn flight(&self, action: &LandingAction, carried_out: &CarriedOut) -> Result<Flight, LandingError> {
        let shift = carried_out.shift_w.extend(0.0);
        let landing_w = self.standing_w(action.landing()) + shift;
        let path = BezierPath::approach(
            self.start_w() + shift,
            landing_w,
            action.approach_radius,
            action.approach_angle,
        );
        let f = self.task.flight;
        let settings = FlightSettings {
            speed: f.speed * carried_out.speed,
            descent_speed: f.descent_speed * carried_out.speed,
            ..f
        };
        Ok(Flight::new(path, settings)?)
    }

    /// Returns the options for worlds of this task.
    pub fn world_options(&self) -> WorldOptions {
        // Contact timing is for the impacts of balls, which this task does not have.
        WorldOptions { dt: self.task.dt, contact_timing: false, ..WorldOptions::default() }
    }

    /// Simulates the scene at rest for 2 s and returns the drift of each body of the structure.
    ///
    /// # Errors
    /// [`LandingError::AlreadyFalling`] if one of them drifts by more than a centimetre or 2°; [`LandingError::Sim`] if
    /// the scene cannot be simulated.
    pub fn check_rest(
        &self,
        factory: &dyn WorldFactory,
        scene: &Scene,
    ) -> Result<Vec<RestingDrift>, LandingError> {
        let drifts = match resting_drift(factory, &scene.without_pictures(), STANDS.seconds) {
            Ok(drifts) => drifts,
            Err(SimError::Diverged { body, .. }) => {
                let drift = RestingDrift { body, moved_m: f64::INFINITY, turned_rad: std::f64::consts::PI };
                return Err(self.falling(&drift, scene, ""));
            }
            Err(e) => return Err(e.into()),
        };
        let own: Vec<RestingDrift> =
            drifts.into_iter().filter(|d| self.structure.contains(&d.body)).collect();
        let excess = |d: &RestingDrift| STANDS.excess(d);
        match own.iter().max_by(|a, b| excess(a).total_cmp(&excess(b))).filter(|d| excess(d) > 1.0) {
            None => Ok(own),
            Some(d) => Err(self.falling(d, scene, "")),
        }
    }

    /// Returns the error for a structure of which one body drifts this far; `or` is an additional cure.
    pub(crate) fn falling(&self, drift: &RestingDrift, scene: &Scene, or: &str) -> LandingError {
        let how = match drift.moved_m.is_finite() {
            true => {
                let (cm, degrees) = (1e2 * drift.moved_m, drift.turned_rad.to_degrees());
                format!("moves by {cm:.1} cm and turns by {degrees:.0}°")
            }
            false => "diverges".to_owned(),
        };
        LandingError::AlreadyFalling(
            InputError::new(
                format!(
                    "the structure does not stand by itself: within {} s `{}` {how}",
                    STANDS.seconds, drift.body
                ),
                self.task.path(),
                format!(
                    "check the reconstruction with `sms report`: a contact face may be hidden from the camera, or a mass \
                     wrong (`sms materials`){or}"
                ),
            )
            .because(format!("scene `{}`", scene.name)),
        )
    }
}
