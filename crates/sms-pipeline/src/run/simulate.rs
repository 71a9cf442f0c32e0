//! Simulates the scene at rest.

use super::Run;
use crate::Error;
use crate::cache::record;
use crate::stages::drift_text;
use sms_core::metrics::Metrics;
use sms_core::{InputError, Warnings, atomic};
use sms_scene::load_scene;
use sms_sim::{RapierFactory, RestingDrift, resting_drift};

impl Run<'_> {
    /// Simulates the scene at rest for `seconds` and returns the drift of each body.
    ///
    /// # Errors
    /// [`Error::Input`] for a time out of range, [`Error::Sim`] if the scene cannot be simulated.
    pub fn simulate(&self, seconds: f64) -> Result<Vec<RestingDrift>, Error> {
        if !(seconds > 0.0 && seconds <= 600.0) {
            let what = format!("{seconds} seconds cannot be simulated");
            return Err(InputError::new(what, "--seconds", "use more than 0 and at most 600").into());
        }
        let run = self.open()?;
        let scene = load_scene(&run.stage_dir("scene", "materialize")?)?;
        let drifts = resting_drift(&RapierFactory, &scene, seconds)?;
        let worst = |f: fn(&RestingDrift) -> f64| drifts.iter().map(f).fold(0.0, f64::max);
        let mut metrics = Metrics::new();
        metrics.set("simulate.seconds_simulated", seconds);
        metrics.set("simulate.drift_m", worst(|d| d.moved_m));
        metrics.set("simulate.turn_rad", worst(|d| d.turned_rad));
        let warnings = Warnings::new();
        for drift in drifts.iter().filter(|d| d.moved_m > 0.002 || d.turned_rad > 1f64.to_radians()) {
            let cure = "check its underside and neighbours in the report's 3-D view";
            warnings.add("simulate", "does_not_rest", drift_text(drift), cure);
        }
        atomic::write_json(&run.root().join("simulate.json"), &drifts)?;
        record(self.context, &run, "simulate", &["simulate."], metrics, &warnings)?;
        Ok(drifts)
    }
}
