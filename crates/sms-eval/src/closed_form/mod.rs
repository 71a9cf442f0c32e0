//! Closed-form experiments for every engine: physics that a world must reproduce for valid plans. [`probes`] lists
//! them. Tests check each engine against [`Probe::limit`], and `sms-experiments physics` prints the errors.
//!
//! ```
//! use sms_eval::closed_form;
//! use sms_sim::RapierFactory;
//! let probe = closed_form::probes().iter().find(|p| p.name == "head_on_restitution").unwrap();
//! let measured = probe.measure(&RapierFactory)?;
//! assert!(measured.worst <= probe.limit);
//! # Ok::<(), sms_sim::SimError>(())
//! ```

mod arm;
mod impacts;
mod motion;
mod scenes;

use sms_sim::{SimError, WorldFactory};

/// Statistic of the errors that the limit applies to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Statistic {
    /// The largest absolute error.
    Worst,
    /// The root mean square.
    Rms,
}

/// One experiment with a closed-form answer, run with several values.
#[derive(Debug, Clone, Copy)]
pub struct Probe {
    /// Name, as in `bench.physics.{engine}.{name}`; ends with the unit unless it is a pure number.
    pub name: &'static str,
    /// Description of the measured quantity.
    pub what: &'static str,
    /// Largest acceptable error, in the probe's unit.
    pub limit: f64,
    /// The statistic that `limit` bounds.
    pub statistic: Statistic,
    run: fn(&dyn WorldFactory) -> Result<Vec<f64>, SimError>,
}

/// The errors of one probe in one engine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ErrorSummary {
    /// Largest absolute error.
    pub worst: f64,
    /// Root mean square of the errors.
    pub rms: f64,
    /// Number of errors.
    pub count: usize,
}

impl Probe {
    /// Runs the experiment.
    ///
    /// # Errors
    /// [`SimError`] when a world cannot be built or diverges.
    pub fn measure(&self, factory: &dyn WorldFactory) -> Result<ErrorSummary, SimError> {
        let errors = (self.run)(factory)?;
        // NaN must count as a failure.
        let worst =
            errors.iter().map(|e| if e.is_nan() { f64::INFINITY } else { e.abs() }).fold(0.0, f64::max);
        let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len().max(1) as f64).sqrt();
        Ok(ErrorSummary { worst, rms, count: errors.len() })
    }

    /// Returns the statistic that the limit applies to.
    pub fn figure(&self, measured: &ErrorSummary) -> f64 {
        match self.statistic {
            Statistic::Worst => measured.worst,
            Statistic::Rms if measured.rms.is_nan() => f64::INFINITY,
            Statistic::Rms => measured.rms,
        }
    }
}

/// Every probe. All run at the nominal step of 2.5 ms.
pub fn probes() -> &'static [Probe] {
    use Statistic::{Rms, Worst};
    const fn probe(
        name: &'static str,
        what: &'static str,
        limit: f64,
        statistic: Statistic,
        run: fn(&dyn WorldFactory) -> Result<Vec<f64>, SimError>,
    ) -> Probe {
        Probe { name, what, limit, statistic, run }
    }
    const PROBES: &[Probe] = &[
        probe(
            "oblique_deg",
            "direction of a ball struck at 4 cuts and 4 speeds, no friction, degrees",
            0.01,
            Rms,
            impacts::oblique_without_friction,
        ),
        probe(
            "oblique_friction_deg",
            "the same with friction between the balls (cut-induced throw), degrees",
            0.1,
            Worst,
            impacts::oblique_with_friction,
        ),
        probe("oblique_speed", "speed of the struck ball, relative", 0.002, Worst, impacts::oblique_speed),
        probe(
            "spin_throw_deg",
            "direction of a ball struck head on by one with side spin, degrees",
            0.1,
            Worst,
            impacts::spin_throw,
        ),
        probe(
            "topspin_throw_deg",
            "direction of a ball struck at a cut by one that rolls or is drawn, in free space, degrees",
            0.1,
            Worst,
            impacts::topspin_throw,
        ),
        probe(
            "head_on_restitution",
            "restitution of two balls head on, absolute",
            0.002,
            Worst,
            impacts::head_on,
        ),
        probe(
            "head_on_momentum",
            "momentum of two balls head on, relative",
            1e-5,
            Worst,
            impacts::head_on_momentum,
        ),
        probe(
            "wall_45_restitution",
            "velocity after a wall at 45°, as a share of the speed (hull and mesh)",
            0.002,
            Worst,
            impacts::wall,
        ),
        probe(
            "drop_restitution",
            "restitution of a dropped ball by the height that it comes back to, absolute",
            0.01,
            Worst,
            impacts::drop,
        ),
        probe(
            "follow_through_deg",
            "direction of the object ball that a rolling one strikes on a table, degrees",
            0.1,
            Worst,
            impacts::follow_through,
        ),
        probe(
            "follow_through_speed",
            "speed of that ball when it rolls, over 5/7 of its first − 1",
            0.01,
            Worst,
            impacts::follow_through_speed,
        ),
        probe(
            "follow_through_cue_deg",
            "direction of the cue ball, which its spin carries forward, degrees",
            1.0,
            Worst,
            impacts::follow_through_cue,
        ),
        probe(
            "arm_strike_speed",
            "speed of a ball of 30 g to 2 kg that the arm strikes, over (1 + e)·v/(1 + m/M) − 1",
            0.005,
            Worst,
            arm::speed,
        ),
        probe(
            "arm_strike_momentum",
            "momentum of that ball and of the arm, relative",
            1e-4,
            Worst,
            arm::momentum,
        ),
        probe(
            "arm_strike_energy",
            "energy of ball and arm after an elastic blow, relative",
            0.01,
            Worst,
            arm::energy,
        ),
        probe(
            "slide_to_roll",
            "speed of a sliding ball when it rolls, over 5/7 − 1",
            0.002,
            Worst,
            motion::slide_to_roll,
        ),
        probe(
            "curved_path",
            "place of a sliding ball with draw and side spin when it begins to roll, over its way",
            0.01,
            Worst,
            motion::curved_path,
        ),
        probe(
            "rolling_stop",
            "way of a rolling ball until it stops, relative",
            0.005,
            Worst,
            motion::rolling_stop,
        ),
        probe(
            "sliding_block",
            "way of a sliding block until it stops, relative",
            0.02,
            Worst,
            motion::sliding_block,
        ),
        probe(
            "tipping_force",
            "force at which an overhanging platform tips, relative",
            0.02,
            Worst,
            motion::tipping_force,
        ),
        // A quarter of the permitted drift of a body of an exported scene in a second.
        probe(
            "stack_drift_mm",
            "how far boxes of a stack of four come in 4 s, mm",
            1.0,
            Worst,
            motion::stack,
        ),
    ];
    PROBES
}
