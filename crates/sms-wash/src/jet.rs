//! The turbulent round jet: mean velocities of a stream that mixes with still air.
//!
//! Far from its origin every round jet is self-similar. It widens in proportion to the distance z: its half-radius
//! (where the mean speed is half of that on the axis) is S·z with S = 0.094. The speed on the axis decays like 1/z, and
//! the profile is 1/(1 + aη²)², η = r/z, a = (√2 − 1)/S² (Hussein, Capp and George 1994; Pope, *Turbulent Flows*,
//! section 5.1). The speed on the axis follows from S and the conserved momentum: u = B·u_exit·d/z with B = 5.93
//! (measurements: 5.8 to 6.1).
//!
//! Bauersfeld et al. (arXiv 2403.13321) measured that the air below a quadrotor is such a jet, with the momentum of the
//! thrust, from about 2.5 times the distance of its motors on. The constants here are the classic ones, not their fit.

use std::f64::consts::PI;

/// Growth of the half-radius with distance (Hussein et al. 1994, laser-Doppler).
pub const SPREADING_RATE: f64 = 0.094;

/// The profile's constant a = (√2 − 1)/S².
const PROFILE: f64 = (std::f64::consts::SQRT_2 - 1.0) / (SPREADING_RATE * SPREADING_RATE);

/// A jet from a nozzle of uniform speed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RoundJet {
    /// Momentum per second, N.
    pub momentum_flux: f64,
    /// Radius at the nozzle, metres.
    pub exit_radius: f64,
    /// Density of the jet and of the surrounding air, kg/m³.
    pub air_density: f64,
}

impl RoundJet {
    /// Radius (metres) of the circle with the share `inner` (0 to 1) of the momentum at distance `z`, and the mean
    /// speed (m/s) at that radius. At the nozzle the shares fill a disk evenly. The radii at the nozzle and those of
    /// the far law are blended with the fourth power, which nearly preserves the core's speed over four diameters.
    pub fn stream(&self, inner: f64, z: f64) -> (f64, f64) {
        let inner = inner.clamp(0.0, 1.0 - 1e-9);
        let nozzle = self.exit_radius.powi(2);
        let rest = (1.0 - inner).powf(-1.0 / 3.0);
        // Squared radii and their derivatives, both divided by the share so that the axis needs no special case.
        let share = if inner > 1e-9 { (rest - 1.0) / (PROFILE * inner) } else { 1.0 / (3.0 * PROFILE) };
        let far = z * z * share;
        let far_slope = z * z * rest.powi(4) / (3.0 * PROFILE);
        let both = (nozzle * nozzle + far * far).sqrt();
        let slope = (nozzle * nozzle + far * far_slope) / both;
        let speed = (self.momentum_flux / (self.air_density * PI * slope)).sqrt();
        ((both * inner).sqrt(), speed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    impl RoundJet {
        /// Mean speed on the axis at distance `z`, m/s.
        fn centerline_speed(&self, z: f64) -> f64 {
            self.stream(0.0, z).1
        }
    }

    fn jet() -> RoundJet {
        RoundJet { momentum_flux: 2.898_855, exit_radius: 0.0685 / 2f64.sqrt(), air_density: 1.225 }
    }

    #[test]
    fn far_away_it_is_the_published_jet() {
        let jet = jet();
        let d = 2.0 * jet.exit_radius;
        let exit = jet.centerline_speed(0.0);
        assert!((exit - 17.9182).abs() < 1e-3, "the nozzle's speed is the exit speed: {exit}");
        for z_over_d in [30.0, 50.0, 90.0] {
            let z = z_over_d * d;
            let decay = jet.centerline_speed(z) / exit * z_over_d;
            // Published: 5.8 (hot wires and laser), 5.9, 6.06 (Wygnanski, Panchapakesan).
            assert!((5.75..6.1).contains(&decay), "B = {decay}");
            let half = 0.5 * jet.centerline_speed(z);
            let (mut low, mut high) = (0.0, 1.0);
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                if jet.stream(middle, z).1 > half { low = middle } else { high = middle }
            }
            let half_radius = jet.stream(low, z).0;
            assert!((half_radius / z / SPREADING_RATE - 1.0).abs() < 2e-3, "S at {z_over_d} d");
        }
        // The profile against Pope's formula.
        let z = 60.0 * d;
        for inner in [0.1, 0.4, 0.7, 0.95] {
            let (r, u) = jet.stream(inner, z);
            let eta = r / z;
            let expected = (1.0 + PROFILE * eta * eta).powi(-2);
            assert!((u / jet.centerline_speed(z) - expected).abs() < 2e-3);
        }
    }

    #[test]
    fn momentum_is_the_same_at_every_distance() {
        let jet = jet();
        for z in [0.0, 0.1, 0.3, 0.6, 1.0, 4.0] {
            let mut flux = 0.0;
            let (mut r0, mut u0) = jet.stream(0.0, z);
            // Integrates over radii; the shares of momentum are the tested quantity.
            for k in 1..20_000 {
                let (r, u) = jet.stream(f64::from(k) / 20_000.0, z);
                flux += jet.air_density * 0.5 * (u * u + u0 * u0) * PI * (r * r - r0 * r0);
                (r0, u0) = (r, u);
            }
            assert!((flux / jet.momentum_flux - 1.0).abs() < 2e-3, "{z}: {flux}");
        }
    }

    #[test]
    fn the_core_keeps_its_speed_over_four_diameters() {
        let jet = jet();
        let d = 2.0 * jet.exit_radius;
        assert!(jet.centerline_speed(4.0 * d) > 0.94 * jet.centerline_speed(0.0));
        let speeds: Vec<f64> = (0..100).map(|k| jet.centerline_speed(f64::from(k) * d)).collect();
        assert!(speeds.windows(2).all(|w| w[1] < w[0]));
    }
}
