//! Simulates the scene at rest.

use super::Run;
use crate::Error;
use crate::cache::record;
use crate::stages::drift_text;
use sms_core::metrics::Metrics;
use sms_core::{BACKGROUND, InputError, Warnings, atomic};
use sms_scene::{BodyKind, load_scene};
use sms_sim::{RapierFactory, RestingDrift, resting_drift};

/// Returns whether a drift is that of a body at rest ([`sms_core::is_at_rest`]).
pub fn is_at_rest(drift: &RestingDrift) -> bool {
    sms_core::is_at_rest(drift.moved_m, drift.turned_rad)
}

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
        self.warn_stale(&run, "scene");
        let drifts = resting_drift(&RapierFactory, &scene, seconds)?;
        let worst = |f: fn(&RestingDrift) -> f64| drifts.iter().map(f).fold(0.0, f64::max);
        // The floor and the environment are no objects.
        let fixed = scene.bodies.iter().filter(|b| b.kind == BodyKind::Static && b.label != BACKGROUND);
        let mut metrics = Metrics::new();
        metrics.set("simulate.seconds_simulated", seconds);
        metrics.set("simulate.moving_bodies", drifts.len());
        metrics.set("simulate.fixed_bodies", fixed.count());
        metrics.set("simulate.drift_m", worst(|d| d.moved_m));
        metrics.set("simulate.turn_rad", worst(|d| d.turned_rad));
        let warnings = Warnings::new();
        for drift in drifts.iter().filter(|d| !is_at_rest(d)) {
            let cure = "check its underside and neighbours in the report's 3-D view";
            warnings.add("simulate", "does_not_rest", drift_text(drift), cure);
        }
        atomic::write_json(&run.root().join("simulate.json"), &drifts)?;
        record(self.context, &run, "simulate", &["simulate."], metrics, &warnings)?;
        Ok(drifts)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_sim::RestLimits;

    #[test]
    fn the_limits_are_twice_those_of_materialize() {
        let limits = RestLimits::default();
        let drift = |moved: f64, turned: f64| RestingDrift {
            body: "mug".into(),
            moved_m: moved * limits.moved_m,
            turned_rad: turned * limits.turned_rad,
        };
        assert!(is_at_rest(&drift(1.99, 1.99)));
        assert!(!is_at_rest(&drift(2.01, 0.0)) && !is_at_rest(&drift(0.0, 2.01)));
        assert!(!is_at_rest(&drift(f64::NAN, 0.0)));
    }
}
