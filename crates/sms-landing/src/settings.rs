//! Settings of the landing planner.

use serde::{Deserialize, Serialize};
use sms_core::{InputError, Ranges};
use sms_wash::{SphSettings, StreamSettings};
use std::path::Path;

/// Perturbations of worlds and flights. All errors are uniform within ± the given half width.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LandingDisturbances {
    /// Whether masses and frictions are sampled within their materials' intervals.
    pub materials: bool,
    /// Horizontal position error of a body that stands on another, metres.
    pub object_m: f64,
    /// Relative error of the wash's strength, from the wash model and the vehicle's mass.
    pub wash_share: f64,
    /// Horizontal position error of the flight, metres.
    pub flight_m: f64,
    /// Relative error of the flight's speed.
    pub speed_share: f64,
}

impl Default for LandingDisturbances {
    fn default() -> Self {
        // Scans place the edges of large objects within a few millimetres. Models of wash differ by 10 to 20 % in
        // moments about edges (experiments/studies/wash.md). A vehicle with a camera holds its place within a few
        // centimetres.
        Self { materials: true, object_m: 0.004, wash_share: 0.2, flight_m: 0.02, speed_share: 0.1 }
    }
}

/// Settings of the landing planner (`[landing]`). Budgets count rollouts, never seconds, so a plan does not depend on
/// the machine.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LandingSettings {
    /// Number of points of the screening, each flown with `jet` in the scanned world.
    pub screening: usize,
    /// Number of perturbed worlds in which the structure stands; they are sorted by the smallest load that tips it.
    pub draws: usize,
    /// Number of these worlds that serve as margins: the hardest and those at 1/2, 1/4, … of the order. Candidates that
    /// succeed in the scanned world are flown with `jet` in the hardest margin, those that fail there in the next, and
    /// so on. 0 disables margins.
    pub margins: usize,
    /// Number of additional margins: one of the hardest worlds, with a lighter structure in each.
    pub lighter: usize,
    /// Share of the structure's mass that is left in the last of these.
    pub lightest: f64,
    /// Number of candidates with the best margins that are flown with `jet` in the hardest worlds.
    pub candidates: usize,
    /// Number of these hardest worlds.
    pub jet_worlds: usize,
    /// Number of the best candidates that are flown with `sph` in the scanned world.
    pub refine: usize,
    /// Number of local searches with `sph` from the best of these.
    pub polish_starts: usize,
    /// Number of points per local search.
    pub polish: usize,
    /// Number of candidates that are flown with `sph` in perturbed worlds.
    pub finalists: usize,
    /// Number of these worlds, chosen like the margins; 0 plans for the scanned world alone and disables `jet_worlds`,
    /// too.
    pub worlds: usize,
    /// Number of separate worlds for the prediction.
    pub forecast_worlds: usize,
    /// Cap of the objective: all toppled structures count the same.
    pub toppled: f64,
    /// Perturbations of worlds and flights.
    pub disturbances: LandingDisturbances,
    /// Settings of the wash model `jet`.
    pub jet: StreamSettings,
    /// Settings of the wash model `sph`. Its own threads are unused, because rollouts run in parallel.
    pub sph: SphSettings,
}

impl Default for LandingSettings {
    fn default() -> Self {
        Self {
            screening: 200,
            draws: 40,
            margins: 5,
            lighter: 3,
            lightest: 0.4,
            candidates: 8,
            jet_worlds: 6,
            refine: 4,
            polish_starts: 0,
            polish: 4,
            finalists: 2,
            worlds: 5,
            forecast_worlds: 5,
            toppled: 1.0,
            disturbances: LandingDisturbances::default(),
            // Half as many flow lines as the model's default: `jet` only preselects.
            jet: StreamSettings { rings: 6, spokes: 12, ..StreamSettings::default() },
            sph: SphSettings::default(),
        }
    }
}

impl LandingSettings {
    /// Returns the settings of a quick plan with about half of the rollouts.
    pub fn draft() -> Self {
        Self {
            screening: 96,
            draws: 24,
            candidates: 4,
            refine: 2,
            finalists: 1,
            worlds: 3,
            forecast_worlds: 3,
            ..Self::default()
        }
    }

    /// Returns settings with four times the rollouts, for a machine with more cores.
    pub fn fine() -> Self {
        Self {
            screening: 640,
            draws: 128,
            candidates: 48,
            jet_worlds: 12,
            refine: 20,
            polish_starts: 3,
            polish: 20,
            finalists: 8,
            worlds: 16,
            forecast_worlds: 32,
            ..Self::default()
        }
    }

    /// Checks the values; `path` names the settings file in errors.
    ///
    /// # Errors
    /// [`InputError`] that names the key.
    pub fn validate(&self, path: &Path) -> Result<(), InputError> {
        let r = Ranges::of("landing");
        let named = |e: InputError| e.at_path(path);
        for (key, value, low, high) in [
            ("screening", self.screening, 1, 1_000_000),
            ("draws", self.draws, 1, 1024),
            ("margins", self.margins, 0, 64),
            ("lighter", self.lighter, 0, 64),
            ("candidates", self.candidates, 1, 1_000_000),
            ("jet_worlds", self.jet_worlds, 0, 1024),
            ("refine", self.refine, 1, 1_000_000),
            ("polish_starts", self.polish_starts, 0, 1_000_000),
            ("polish", self.polish, 0, 1_000_000),
            ("finalists", self.finalists, 1, 1_000_000),
            ("worlds", self.worlds, 0, 1024),
            ("forecast_worlds", self.forecast_worlds, 0, 1024),
        ] {
            r.count(key, value, low, high).map_err(named)?;
        }
        let d = &self.disturbances;
        for (key, value, low, high) in [
            ("toppled", self.toppled, 0.1, 1e3),
            ("lightest", self.lightest, 0.05, 1.0),
            ("disturbances.object_m", d.object_m, 0.0, 0.1),
            ("disturbances.wash_share", d.wash_share, 0.0, 0.9),
            ("disturbances.flight_m", d.flight_m, 0.0, 1.0),
            ("disturbances.speed_share", d.speed_share, 0.0, 0.9),
        ] {
            r.within(key, value, low, high).map_err(named)?;
        }
        self.validate_wash().map_err(named)
    }

    /// Checks the settings of the wash models.
    fn validate_wash(&self) -> Result<(), InputError> {
        let r = Ranges::of("landing");
        let (jet, sph) = (&self.jet, &self.sph);
        for (key, value, low, high) in [
            ("jet.air_density", jet.air_density, 1e-3, 100.0),
            ("jet.reach", jet.reach, 0.01, 100.0),
            ("jet.merge_spans", jet.merge_spans, 0.01, 100.0),
            ("sph.air_density", sph.air_density, 1e-3, 100.0),
            ("sph.spacing", sph.spacing, 1e-3, 1.0),
            // Below one spacing a particle has no neighbours.
            ("sph.support_spacings", sph.support_spacings, 1.0, 10.0),
            ("sph.sound_speed", sph.sound_speed, 0.1, 1e3),
            ("sph.exponent", sph.exponent, 0.1, 20.0),
            ("sph.slack", sph.slack, 0.0, 1.0),
            ("sph.viscosity", sph.viscosity, 0.0, 10.0),
            ("sph.cfl", sph.cfl, 1e-3, 10.0),
            ("sph.reach", sph.reach, 0.01, 100.0),
            ("sph.margin", sph.margin, 0.0, 100.0),
            ("sph.lifetime_s", sph.lifetime_s, 1e-3, 100.0),
        ] {
            r.within(key, value, low, high)?;
        }
        for (key, value, low, high) in [
            ("jet.rings", jet.rings, 1, 1000),
            ("jet.spokes", jet.spokes, 1, 1000),
            ("jet.pieces", jet.pieces, 1, 1000),
            ("sph.max_particles", sph.max_particles, 1, 100_000_000),
        ] {
            r.count(key, value, low, high)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_valid_and_faults_are_named() {
        let path = Path::new("settings.toml");
        for preset in [LandingSettings::default(), LandingSettings::draft(), LandingSettings::fine()] {
            preset.validate(path).unwrap();
        }
        let text = |e: InputError| e.to_string();
        let none = LandingSettings { screening: 0, ..LandingSettings::default() };
        let message = text(none.validate(path).unwrap_err());
        assert!(message.contains("`landing.screening`") && message.contains("settings.toml"), "{message}");
        let nan = LandingSettings { toppled: f64::NAN, ..LandingSettings::default() };
        assert!(text(nan.validate(path).unwrap_err()).contains("toppled"));
        let mut flat = LandingSettings::default();
        flat.sph.spacing = 0.0;
        assert_eq!(flat.validate(path).unwrap_err().key(), Some("landing.sph.spacing"));
        assert!(toml::from_str::<LandingSettings>("[disturbances]\nwind = 1.0").is_err());
    }
}
