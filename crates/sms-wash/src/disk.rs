//! The actuator disk of momentum theory (the paper's appendix "Quadrotor Propeller Model"), and the stream of its
//! emitter.

use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Density of air at sea level and 15 °C, kg/m³ (the paper's value).
pub(crate) const AIR_DENSITY: f64 = 1.225;

/// Interpretation of the calibration in the paper's appendix. Both have the mass flow through the disk.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Emission {
    /// As in the appendix: emitted over the disk at the disk's speed. This stream carries half of the thrust; the other
    /// half is the pressure behind the disk, which particles lack.
    Paper,
    /// The far wake of the disk, contracted to half the area, at the exit speed: it carries the whole thrust.
    #[default]
    Momentum,
}

/// A hovering propeller as an ideal disk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ActuatorDisk {
    /// Thrust, N.
    pub thrust: f64,
    /// Radius of the disk, metres.
    pub radius: f64,
    /// Density of the air, kg/m³.
    pub air_density: f64,
}

/// The stream of an emitter: a cylinder of uniform speed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Emitted {
    /// Mass per second, kg/s.
    pub mass_flow: f64,
    /// Speed, m/s.
    pub speed: f64,
    /// Radius of the cylinder, metres.
    pub radius: f64,
}

impl Emitted {
    /// Momentum per second, N.
    pub fn momentum_flux(&self) -> f64 {
        self.mass_flow * self.speed
    }
}

impl ActuatorDisk {
    /// Area of the disk, m².
    pub fn area(&self) -> f64 {
        PI * self.radius * self.radius
    }

    /// Speed far behind the disk, m/s: √(F / (ρA/2)).
    pub fn exit_speed(&self) -> f64 {
        (self.thrust.max(0.0) / (0.5 * self.air_density * self.area())).sqrt()
    }

    /// Speed through the disk, m/s: half of the exit speed.
    pub fn disk_speed(&self) -> f64 {
        0.5 * self.exit_speed()
    }

    /// Mass flow through the disk, kg/s.
    pub fn mass_flow(&self) -> f64 {
        self.air_density * self.area() * self.disk_speed()
    }

    /// The stream of an emitter in place of the disk.
    pub fn emitted(&self, emission: Emission) -> Emitted {
        let (speed, radius) = match emission {
            Emission::Paper => (self.disk_speed(), self.radius),
            Emission::Momentum => (self.exit_speed(), self.radius * std::f64::consts::FRAC_1_SQRT_2),
        };
        Emitted { mass_flow: self.mass_flow(), speed, radius }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn published() -> ActuatorDisk {
        ActuatorDisk { thrust: 1.182 * 9.81 / 4.0, radius: 0.0685, air_density: AIR_DENSITY }
    }

    /// Computed by hand from the appendix.
    #[test]
    fn the_published_vehicle_has_the_published_calibration() {
        let disk = published();
        assert!((disk.thrust - 2.898_855).abs() < 1e-6);
        assert!((disk.area() - 0.014_741_1).abs() < 1e-7);
        assert!((disk.exit_speed() - 17.9182).abs() < 1e-4);
        assert!((disk.disk_speed() - 8.9591).abs() < 1e-4);
        assert!((disk.mass_flow() - 0.161_783).abs() < 1e-6);
    }

    #[test]
    fn one_reading_carries_the_thrust_and_the_other_half_of_it() {
        let disk = published();
        let (momentum, paper) = (disk.emitted(Emission::Momentum), disk.emitted(Emission::Paper));
        assert!((momentum.momentum_flux() / disk.thrust - 1.0).abs() < 1e-12);
        assert!((paper.momentum_flux() / disk.thrust - 0.5).abs() < 1e-12);
        assert_eq!(momentum.mass_flow, paper.mass_flow);
        for stream in [momentum, paper] {
            // Both are air of ambient density.
            let volume_flow = PI * stream.radius * stream.radius * stream.speed;
            assert!((stream.mass_flow / volume_flow / AIR_DENSITY - 1.0).abs() < 1e-12);
        }
        // Bernoulli: power of the wake = thrust × speed through the disk.
        let power = 0.5 * momentum.mass_flow * momentum.speed.powi(2);
        assert!((power / (disk.thrust * disk.disk_speed()) - 1.0).abs() < 1e-12);
        assert!((4.0 * power - 103.885).abs() < 1e-3);
    }

    #[test]
    fn a_disk_without_thrust_is_still() {
        let off = ActuatorDisk { thrust: 0.0, ..published() };
        assert_eq!(off.emitted(Emission::Momentum).momentum_flux(), 0.0);
    }
}
