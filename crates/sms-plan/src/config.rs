//! Settings of the planner.

use crate::robust::FIRST_WORLDS;
use crate::{Disturbances, NelderMead, RobustObjective};
use serde::{Deserialize, Serialize};
use sms_core::{InputError, Ranges};
use std::path::Path;

/// Most disturbed worlds: each is a simulation of the whole scene that is kept, twice as many as are set.
const MOST_WORLDS: usize = 1024;

/// A nominal search whose best is within this share of what counts as success does not begin anew: 1 cm of 5.
pub const SOLVED: f64 = 0.2;

/// How starts are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// The paper: a local search from each of a number of random simplexes.
    MultiStart,
    /// A part of the budget on Halton points, then local searches from the best ones: few evaluations for all, more for
    /// the better half of them, and so on.
    Halving,
}

impl Method {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::MultiStart, Self::Halving];

    /// The word in settings files and tables.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::MultiStart => "multi_start",
            Self::Halving => "halving",
        }
    }
}

/// Settings of the planner. Budgets count rollouts, never seconds, so that a plan does not depend on the machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlanConfig {
    /// How starts are found.
    pub method: Method,
    /// Number of starts (paper: 30).
    pub starts: usize,
    /// Rollouts in the nominal world. With [`Method::MultiStart`] the optimiser's own limit counts instead.
    pub evaluations: usize,
    /// Share of them spent on screening: points whose strikes the robot can make. Others that are drawn (at most eight for
    /// each) cost nothing.
    pub screening_share: f64,
    /// Whether the task may suggest points to try first (for billiards: aim at the ghost ball).
    pub suggestions: bool,
    /// The local search. Its steps begin at `initial_step` of the range that a start was drawn from.
    pub nelder_mead: NelderMead,
    /// First step of the local search, as a share of the range that its start was drawn from.
    pub initial_step: f64,
    /// Searches that [`Method::Halving`] does not halve any more.
    pub survivors: usize,
    /// Rollouts in the nominal world where disturbed worlds follow, in the place of `evaluations`.
    pub robust_evaluations: usize,
    /// How many times the nominal search begins anew, from other points and with as many rollouts, as long as its best comes to
    /// more than [`SOLVED`] of what counts as success. Not with [`Method::MultiStart`].
    pub anew: usize,
    /// Points of a scan of the disturbed worlds, each tried in one of them; only such as the robot can make.
    pub scan: usize,
    /// Distinct actions from the nominal search that are tried in the first few disturbed worlds; half as many more come
    /// from the scan.
    pub candidates: usize,
    /// Simplex searches over the first few disturbed worlds, from the best candidates.
    pub descents: usize,
    /// Points that each of them may try, each in all of these worlds, before the worse half of the searches ends.
    pub descent: usize,
    /// Least number of them that are tried in all worlds, and how many of the best are tried in as many worlds again.
    pub finalists: usize,
    /// What is minimised over the disturbed worlds.
    pub objective: RobustObjective,
    /// How many of them the world as scanned, the likeliest of all, counts for when candidates are ranked. It steadies a choice over few
    /// worlds. Simplex searches over disturbed worlds (`descents`, `polish_starts`) go on without it; what they find is carried out there
    /// before it is ranked.
    pub nominal_worlds: usize,
    /// How many simplex searches go on over all worlds, from the best candidates.
    pub polish_starts: usize,
    /// Points that each of them may try, each in all worlds.
    pub polish: usize,
    /// Worlds that play no part in the choice, for the prediction.
    pub forecast_worlds: usize,
    /// Rollouts that find out which unknown matters most, at most, and as many again that find out why the action was
    /// chosen; 0 leaves both out. Up to 64 more tell apart the properties of the two materials that matter most.
    pub sensitivity_rollouts: usize,
    /// The disturbed worlds.
    pub disturbances: Disturbances,
}

impl Default for PlanConfig {
    fn default() -> Self {
        Self {
            method: Method::Halving,
            starts: 30,
            evaluations: 1500,
            screening_share: 0.3,
            suggestions: true,
            nelder_mead: NelderMead::default(),
            initial_step: 0.08,
            survivors: 4,
            robust_evaluations: 400,
            anew: 2,
            scan: 800,
            candidates: 72,
            descents: 16,
            descent: 8,
            finalists: 12,
            objective: RobustObjective::Mean,
            nominal_worlds: 0,
            polish_starts: 3,
            polish: 12,
            forecast_worlds: 32,
            sensitivity_rollouts: 160,
            disturbances: Disturbances::default(),
        }
    }
}

impl PlanConfig {
    /// Checks the values; `path` is the settings file, or what stands for it.
    ///
    /// # Errors
    /// [`InputError`] that names the key.
    pub fn validate(&self, path: &Path) -> Result<(), InputError> {
        let d = &self.disturbances;
        let r = Ranges::of("plan");
        let named = |e: InputError| InputError { path: path.display().to_string(), ..e };
        for (key, value, low, high) in [
            ("starts", self.starts, 1, 1_000_000),
            ("evaluations", self.evaluations, 1, 1_000_000),
            ("survivors", self.survivors, 1, 1_000_000),
            ("robust_evaluations", self.robust_evaluations, 1, 1_000_000),
            ("anew", self.anew, 0, 1000),
            ("scan", self.scan, 0, 1_000_000),
            ("candidates", self.candidates, 1, 1_000_000),
            ("descents", self.descents, 0, 1_000_000),
            ("descent", self.descent, 1, 1_000_000),
            ("finalists", self.finalists, 1, 1_000_000),
            ("nominal_worlds", self.nominal_worlds, 0, 1000),
            ("polish_starts", self.polish_starts, 0, 1_000_000),
            ("polish", self.polish, 0, 1_000_000),
            ("forecast_worlds", self.forecast_worlds, 1, 1_000_000),
            ("sensitivity_rollouts", self.sensitivity_rollouts, 0, 1_000_000),
            ("nelder_mead.max_iterations", self.nelder_mead.max_iterations, 0, 1_000_000),
            ("nelder_mead.restarts", self.nelder_mead.restarts, 0, 1_000_000),
        ] {
            r.count(key, value, low, high).map_err(named)?;
        }
        // The command line sets it, too.
        r.count("disturbances.worlds", d.worlds, 0, MOST_WORLDS)
            .map_err(|e| named(InputError { what: format!("{} (`--robust` sets it)", e.what), ..e }))?;
        for (key, value, low, high) in [
            ("screening_share", self.screening_share, 0.0, 1.0),
            ("initial_step", self.initial_step, 1e-6, 1.0),
            ("disturbances.position_m", d.position_m, 0.0, 0.1),
            ("disturbances.radius_m", d.radius_m, 0.0, 0.1),
            ("disturbances.object_m", d.object_m, 0.0, 0.1),
            ("disturbances.object_rad", d.object_rad, 0.0, 1.0),
            ("disturbances.contact_m", d.contact_m, 0.0, 0.1),
            ("disturbances.angle_rad", d.angle_rad, 0.0, 1.0),
            ("disturbances.speed_share", d.speed_share, 0.0, 0.9),
            ("nelder_mead.reflection", self.nelder_mead.reflection, 0.0, 100.0),
            ("nelder_mead.expansion", self.nelder_mead.expansion, 0.0, 100.0),
            ("nelder_mead.contraction", self.nelder_mead.contraction, 0.0, 1.0),
            ("nelder_mead.shrink", self.nelder_mead.shrink, 0.0, 1.0),
            ("nelder_mead.x_tolerance", self.nelder_mead.x_tolerance, 0.0, 1.0),
            ("nelder_mead.f_tolerance", self.nelder_mead.f_tolerance, 0.0, 10.0),
        ] {
            r.within(key, value, low, high).map_err(named)?;
        }
        Ok(())
    }

    /// Rollouts in the nominal world.
    pub(crate) fn nominal_evaluations(&self) -> usize {
        if self.disturbances.worlds == 0 { self.evaluations } else { self.robust_evaluations }
    }

    /// Most rollouts of a nominal search.
    pub(crate) fn budget(&self) -> usize {
        if self.method == Method::MultiStart { usize::MAX } else { self.nominal_evaluations() }
    }

    /// Most nominal searches, one after the other.
    pub(crate) fn searches(&self) -> usize {
        if self.method == Method::MultiStart { 1 } else { 1 + self.anew }
    }

    /// About how many rollouts the choice and the forecast take.
    pub(crate) fn disturbed_rollouts(&self) -> usize {
        let half = self.disturbances.worlds;
        if half == 0 {
            return 0;
        }
        let few = FIRST_WORLDS.min(half);
        let mut count = self.scan + (self.candidates + self.candidates.div_ceil(2)) * few;
        let mut searches = self.descents;
        while searches > 0 {
            count += searches * self.descent * few;
            searches = if searches > 4 { searches.div_ceil(2).max(4) } else { 0 };
        }
        let (mut alive, mut seen) = (self.candidates.div_ceil(2).max(self.finalists), few);
        while seen < half {
            let next = (2 * seen).min(half);
            count += alive * (next - seen);
            alive = alive.div_ceil(2).max(self.finalists);
            seen = next;
        }
        count + half * (self.polish_starts * self.polish + self.finalists) + self.forecast_worlds
    }

    /// A quick plan: about a third of the rollouts.
    pub fn draft() -> Self {
        Self {
            starts: 12,
            evaluations: 480,
            robust_evaluations: 240,
            scan: 240,
            candidates: 24,
            descents: 8,
            descent: 8,
            finalists: 6,
            polish_starts: 2,
            polish: 8,
            forecast_worlds: 16,
            sensitivity_rollouts: 64,
            disturbances: Disturbances { worlds: 8, ..Disturbances::default() },
            ..Self::default()
        }
    }

    /// Four times the rollouts, for a machine with more cores.
    pub fn fine() -> Self {
        Self {
            evaluations: 6000,
            robust_evaluations: 2400,
            scan: 4000,
            candidates: 256,
            descents: 64,
            descent: 12,
            finalists: 24,
            polish_starts: 6,
            polish: 24,
            forecast_worlds: 64,
            disturbances: Disturbances { worlds: 32, ..Disturbances::default() },
            ..Self::default()
        }
    }

    /// The paper's method: 30 searches of 30 iterations each, the nominally best action wins.
    pub fn paper() -> Self {
        Self {
            method: Method::MultiStart,
            nelder_mead: NelderMead::paper(),
            disturbances: Disturbances { worlds: 0, ..Disturbances::default() },
            ..Self::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_valid_and_faults_are_named() {
        let path = Path::new("plan.toml");
        for preset in [PlanConfig::default(), PlanConfig::draft(), PlanConfig::fine(), PlanConfig::paper()] {
            preset.validate(path).unwrap();
        }
        let none = PlanConfig { starts: 0, ..PlanConfig::default() };
        let message = none.validate(path).unwrap_err().to_string();
        assert!(message.contains("`plan.starts`") && message.contains("plan.toml"), "{message}");
        let nan = PlanConfig { initial_step: f64::NAN, ..PlanConfig::default() };
        assert!(nan.validate(path).is_err());
        let worlds = |worlds| PlanConfig {
            disturbances: Disturbances { worlds, ..Disturbances::default() },
            ..PlanConfig::default()
        };
        worlds(1024).validate(path).unwrap();
        let message = worlds(1_000_000).validate(path).unwrap_err().to_string();
        for part in ["`plan.disturbances.worlds`", "--robust", "1000000", "1024"] {
            assert!(message.contains(part), "{message}");
        }
    }
}
