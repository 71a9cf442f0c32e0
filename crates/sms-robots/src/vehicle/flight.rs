//! The approach of the paper's landing task: a quadratic Bézier curve above the platform, then straight down.

use super::VehicleError;
use glamx::{DPose3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// Number of pieces for the arc length of a curve.
const PIECES: usize = 256;

/// A quadratic Bézier curve, flown at constant speed.
#[derive(Debug, Clone, PartialEq)]
pub struct BezierPath {
    control_w: [DVec3; 3],
    /// Arc length from the start to each of [`PIECES`] equal steps of the parameter, metres.
    lengths: Vec<f64>,
}

impl BezierPath {
    /// The curve with these control points, metres.
    pub fn new(control_w: [DVec3; 3]) -> Self {
        let mut path = Self { control_w, lengths: vec![0.0] };
        let (mut length, mut last) = (0.0, control_w[0]);
        for k in 1..=PIECES {
            let p_w = path.at(k as f64 / PIECES as f64);
            length += p_w.distance(last);
            path.lengths.push(length);
            last = p_w;
        }
        path
    }

    /// The paper's approach: control points at the start, at `radius` (metres) and `angle` (radians, about z from x)
    /// from the landing point, and at the landing point, all at the height of `start_w`.
    pub fn approach(start_w: DVec3, landing_w: DVec3, radius: f64, angle: f64) -> Self {
        let landing_w = landing_w.with_z(start_w.z);
        let via_w = landing_w + radius * DVec3::new(angle.cos(), angle.sin(), 0.0);
        Self::new([start_w, via_w, landing_w])
    }

    /// The control points.
    pub fn control_w(&self) -> [DVec3; 3] {
        self.control_w
    }

    /// Length of the curve, metres.
    pub fn length(&self) -> f64 {
        self.lengths[PIECES]
    }

    fn at(&self, u: f64) -> DVec3 {
        let [a, b, c] = self.control_w;
        (1.0 - u) * (1.0 - u) * a + 2.0 * u * (1.0 - u) * b + u * u * c
    }

    fn tangent(&self, u: f64) -> DVec3 {
        let [a, b, c] = self.control_w;
        (2.0 * (1.0 - u) * (b - a) + 2.0 * u * (c - b)).try_normalize().unwrap_or(DVec3::ZERO)
    }

    /// The point (metres) at an arc length, and the direction of the curve there.
    pub fn point(&self, length: f64) -> (DVec3, DVec3) {
        let length = length.clamp(0.0, self.length());
        let k = self.lengths.partition_point(|l| *l < length).clamp(1, PIECES);
        let (a, b) = (self.lengths[k - 1], self.lengths[k]);
        let part = if b > a { (length - a) / (b - a) } else { 0.0 };
        let u = ((k - 1) as f64 + part) / PIECES as f64;
        (self.at(u), self.tangent(u))
    }
}

/// Settings of a flight.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FlightSettings {
    /// Speed along the curve, m/s.
    pub speed: f64,
    /// Speed of the descent, m/s.
    pub descent_speed: f64,
    /// Height of the vehicle's lowest point above the landing place during the approach, metres.
    pub height: f64,
    /// Height of the motor cut, metres.
    pub cut_height: f64,
}

impl Default for FlightSettings {
    fn default() -> Self {
        // Slow enough to avoid hard braking above the platform.
        Self { speed: 0.5, descent_speed: 0.3, height: 0.35, cut_height: 0.01 }
    }
}

/// A flight from start to motor cut. The vehicle stays level: at these speeds it tilts by less than 2° and accelerates
/// for a tenth of a second.
#[derive(Debug, Clone, PartialEq)]
pub struct Flight {
    path: BezierPath,
    settings: FlightSettings,
}

/// State of a vehicle in flight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlightState {
    /// Pose of the vehicle in the world.
    pub x_wv: DPose3,
    /// Velocity of its origin, m/s.
    pub v_w: DVec3,
    /// Whether the motors are running.
    pub motors: bool,
}

impl Flight {
    /// Plans a flight along the curve, [`FlightSettings::height`] above the origin of the landed vehicle.
    ///
    /// # Errors
    /// [`VehicleError::Setting`] when a speed is not positive, or the motor cut is above the approach.
    pub fn new(path: BezierPath, settings: FlightSettings) -> Result<Self, VehicleError> {
        VehicleError::positive("speed", settings.speed)?;
        VehicleError::positive("descent_speed", settings.descent_speed)?;
        VehicleError::positive("height", settings.height)?;
        if !(0.0..=settings.height).contains(&settings.cut_height) {
            let (name, value) = ("cut_height", settings.cut_height);
            return Err(VehicleError::Setting { name, value, must: "from 0 to the flight's height" });
        }
        Ok(Self { path, settings })
    }

    /// The curve.
    pub fn path(&self) -> &BezierPath {
        &self.path
    }

    /// Start of the descent, seconds.
    pub fn arrival_s(&self) -> f64 {
        self.path.length() / self.settings.speed
    }

    /// Time of the motor cut, seconds.
    pub fn duration_s(&self) -> f64 {
        self.arrival_s() + (self.settings.height - self.settings.cut_height) / self.settings.descent_speed
    }

    /// State of the vehicle after `t` seconds; after the motor cut the state at that moment.
    pub fn state(&self, t: f64) -> FlightState {
        let motors = t < self.duration_s();
        let t = t.clamp(0.0, self.duration_s());
        let (p_w, direction_w) = self.path.point(t * self.settings.speed);
        let descent = (t - self.arrival_s()).max(0.0) * self.settings.descent_speed;
        let v_w = if t < self.arrival_s() {
            self.settings.speed * direction_w
        } else {
            self.settings.descent_speed * DVec3::NEG_Z
        };
        let x_wv = DPose3::from_parts(p_w - descent * DVec3::Z, DQuat::IDENTITY);
        FlightState { x_wv, v_w, motors }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flight() -> Flight {
        let path = BezierPath::approach(DVec3::new(2.0, 0.0, 1.0), DVec3::new(0.1, -0.1, 0.0), 1.2, 2.0);
        Flight::new(path, FlightSettings::default()).unwrap()
    }

    #[test]
    fn a_straight_curve_has_the_length_of_the_line() {
        let path = BezierPath::new([DVec3::ZERO, DVec3::new(0.3, 0.0, 0.0), DVec3::new(2.0, 0.0, 0.0)]);
        assert!((path.length() - 2.0).abs() < 1e-12);
        // The speed is constant although the parameter is not.
        assert!((path.point(0.5).0.x - 0.5).abs() < 1e-4);
        assert_eq!(path.point(0.5).1, DVec3::X);
    }

    /// The closed form of a symmetric parabola's length.
    #[test]
    fn a_parabola_has_its_closed_form_length() {
        let path = BezierPath::new([DVec3::new(-1.0, 0.0, 0.0), DVec3::new(0.0, 2.0, 0.0), DVec3::X]);
        // y = 1 − x² from −1 to 1.
        let expected = 5f64.sqrt() + 0.5 * 2f64.asinh();
        assert!((path.length() / expected - 1.0).abs() < 1e-5);
    }

    #[test]
    fn it_starts_at_the_start_and_cuts_motors_over_the_landing_point() {
        let flight = flight();
        assert_eq!(flight.state(0.0).x_wv.translation, DVec3::new(2.0, 0.0, 1.0));
        let end = flight.state(flight.duration_s());
        assert!(end.x_wv.translation.distance(DVec3::new(0.1, -0.1, 1.0 - 0.34)) < 1e-9);
        assert!(!end.motors && flight.state(flight.duration_s() - 1e-6).motors);
        // The curve arrives from the approach point.
        let direction_w = flight.state(flight.arrival_s() - 1e-9).v_w.normalize();
        assert!(direction_w.distance(-DVec3::new(2f64.cos(), 2f64.sin(), 0.0)) < 1e-2);
    }

    #[test]
    fn velocities_are_derivatives_of_positions() {
        let flight = flight();
        for k in 1..60 {
            let t = flight.duration_s() * f64::from(k) / 60.0;
            if (t - flight.arrival_s()).abs() < 1e-3 {
                continue;
            }
            let e = 1e-4;
            let change = flight.state(t + e).x_wv.translation - flight.state(t - e).x_wv.translation;
            assert!((change / (2.0 * e)).distance(flight.state(t).v_w) < 5e-3);
        }
    }

    #[test]
    fn bad_settings_are_refused() {
        let path = flight().path().clone();
        let bad = FlightSettings { cut_height: 0.5, ..FlightSettings::default() };
        assert!(Flight::new(path.clone(), bad).is_err());
        assert!(Flight::new(path, FlightSettings { speed: 0.0, ..FlightSettings::default() }).is_err());
    }
}
