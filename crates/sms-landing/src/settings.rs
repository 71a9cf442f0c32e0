//! Settings of the planner of landings.

use serde::{Deserialize, Serialize};
use sms_core::{InputError, Ranges};
use sms_wash::{SphSettings, StreamSettings};
use std::path::Path;

/// How worlds and flights are disturbed. All errors are uniform within ± the given half width.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LandingDisturbances {
    /// Whether masses and frictions are sampled within their materials' intervals.
    pub materials: bool,
    /// Horizontal error of where a body stands on another, metres.
    pub object_m: f64,
    /// Relative error of the wash's strength: what the model and the vehicle's mass leave open.
    pub wash_share: f64,
    /// Horizontal error of the flight, metres.
    pub flight_m: f64,
    /// Relative error of its speed.
    pub speed_share: f64,
}

impl Default for LandingDisturbances {
    fn default() -> Self {
        // Scans place the edges of large objects within a few millimetres. Models of wash differ by 10 to 20 % in
        // moments about edges (experiments/studies/wash.md). A vehicle with a camera holds its place within a few centimetres.
        Self { materials: true, object_m: 0.004, wash_share: 0.2, flight_m: 0.02, speed_share: 0.1 }
    }
}

/// Settings of the planner of landings (`[landing]`). Budgets count rollouts, never seconds, so that a plan does not depend on the
/// machine.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LandingSettings {
    /// Points of the screening, each flown with `jet` in the scanned world.
    pub screening: usize,
    /// Disturbed worlds in which the structure stands, among which those are sought in which the least load tips it.
    pub draws: usize,
    /// So many of them, the hardest and those at the half, the quarter and so on of the order, are margins: what succeeds in the
    /// scanned world is flown with `jet` in the hardest, what fails in the next, and so on. 0 leaves margins out.
    pub margins: usize,
    /// Margins beyond them: the hardest but few, with a structure that is lighter and lighter.
    pub lighter: usize,
    /// Share of its mass that is left in the last of these.
    pub lightest: f64,
    /// Those with the best margins that are flown with `jet` in the hardest of the worlds.
    pub candidates: usize,
    /// Number of the hardest worlds.
    pub jet_worlds: usize,
    /// The best of those that are flown with `sph` in the scanned world.
    pub refine: usize,
    /// Local searches with `sph` from the best of these.
    pub polish_starts: usize,
    /// Points that each of them may try.
    pub polish: usize,
    /// How many go on to disturbed worlds with `sph`.
    pub finalists: usize,
    /// Number of these worlds, chosen as the margins are; 0 plans for the scanned world alone, with `jet_worlds` left out, too.
    pub worlds: usize,
    /// Worlds that play no part in the choice, for the prediction.
    pub forecast_worlds: usize,
    /// Largest objective that is told apart from a larger one: what has toppled has toppled.
    pub toppled: f64,
    /// The disturbed worlds.
    pub disturbances: LandingDisturbances,
    /// The model `jet`.
    pub jet: StreamSettings,
    /// The model `sph`. Rollouts run side by side, so that its own threads are left unused.
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
            // Half as many flow lines as the model's default: this one only sorts out.
            jet: StreamSettings { rings: 6, spokes: 12, ..StreamSettings::default() },
            sph: SphSettings::default(),
        }
    }
}

impl LandingSettings {
    /// A quick plan, of about half of the rollouts.
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

    /// Four times the rollouts, for a machine with more cores.
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

    /// Checks the values; `path` is the settings file, or what stands for it.
    ///
    /// # Errors
    /// [`InputError`] that names the key.
    pub fn validate(&self, path: &Path) -> Result<(), InputError> {
        let r = Ranges::of("landing");
        let named = |e: InputError| InputError { path: path.display().to_string(), ..e };
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
        assert!(toml::from_str::<LandingSettings>("[disturbances]\nwind = 1.0").is_err());
    }
}
