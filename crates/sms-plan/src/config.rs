//! Settings of the planner.

use crate::{NelderMead, Perturbation, RobustObjective};
use serde::{Deserialize, Serialize};
use sms_core::{InputError, Ranges};
use std::path::Path;

/// Largest number of perturbed worlds. Each is a simulation of the whole scene that stays in memory, and there are
/// twice as many as this setting.
const MOST_WORLDS: usize = 1024;

/// Number of worlds in which all candidates are tried.
pub(crate) const FIRST_WORLDS: usize = 4;

/// A nominal search is not repeated when its best objective is within this share of the success limit (1 cm of 5 cm).
pub const SOLVED: f64 = 0.2;

/// Methods of the nominal search.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// The paper: a local search from each of a number of random simplexes.
    MultiStart,
    /// Successive halving: a part of the budget is spent on Halton points, then local searches start from the best
    /// ones, with few evaluations for all, more for the better half, and so on.
    Halving,
}

impl Method {
    /// All methods.
    pub const ALL: [Self; 2] = [Self::MultiStart, Self::Halving];

    /// The value in settings files and tables.
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
    /// Method of the nominal search.
    pub method: Method,
    /// Number of starts (paper: 30).
    pub starts: usize,
    /// Rollouts in the nominal world. With the method `multi_start` the optimiser's own limit applies instead.
    pub evaluations: usize,
    /// Share of these rollouts for screening. Screening evaluates only strikes that the robot can carry out; infeasible
    /// draws (at most eight per point) cost nothing.
    pub screening_share: f64,
    /// Whether the task may suggest points to try first (for billiards: aim at the ghost ball).
    pub suggestions: bool,
    /// The local search. Its first steps are `initial_step` times the range of its start.
    pub nelder_mead: NelderMead,
    /// First step of the local search, as a share of the range of its start.
    pub initial_step: f64,
    /// Number of searches at which the method `halving` stops halving.
    pub survivors: usize,
    /// Rollouts in the nominal world if perturbed worlds follow; replaces `evaluations`.
    pub robust_evaluations: usize,
    /// Number of times that the nominal search is repeated from other points, with the same budget, while its best
    /// objective exceeds a fifth of the success limit. Not used by the method `multi_start`.
    #[serde(rename = "anew")]
    pub restarts: usize,
    /// Number of points in the scan of the perturbed worlds. Each is feasible for the robot and tried in one of the
    /// worlds.
    pub scan: usize,
    /// Distinct actions of the nominal search that are tried in the first few perturbed worlds. The scan adds half
    /// this number.
    pub candidates: usize,
    /// Number of simplex searches over the first few perturbed worlds, from the best candidates.
    pub descents: usize,
    /// Number of points per search and round, each tried in all of these worlds. The worse half of the searches ends
    /// after each round.
    pub descent: usize,
    /// Smallest number of candidates that are tried in the first half of the worlds, and number of best candidates in
    /// the second half.
    pub finalists: usize,
    /// Statistic that is minimised over the perturbed worlds.
    pub objective: RobustObjective,
    /// Weight of the scanned world, the most likely one, in the ranking, as a number of perturbed worlds. It stabilizes
    /// a choice over few worlds. Simplex searches over perturbed worlds (`descents`, `polish_starts`) do not use it;
    /// their points are tried in the scanned world before they are ranked.
    pub nominal_worlds: usize,
    /// Number of simplex searches over the first half of the worlds, from the best candidates.
    pub polish_starts: usize,
    /// Number of points per search, each tried in all of these worlds.
    pub polish: usize,
    /// Number of worlds for the forecast. They are not used for the choice.
    pub forecast_worlds: usize,
    /// Largest number of rollouts of the sensitivity analysis, and of the counterfactuals that explain the choice; 0
    /// skips both. The analysis spends up to 64 additional rollouts to separate the properties of the two most
    /// important materials.
    pub sensitivity_rollouts: usize,
    /// Errors in perturbed worlds and strikes.
    #[serde(rename = "disturbances")]
    pub perturbation: Perturbation,
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
            restarts: 2,
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
            perturbation: Perturbation::default(),
        }
    }
}

impl PlanConfig {
    /// Checks the values. `path` names the settings file in errors.
    ///
    /// # Errors
    /// [`InputError`] that names the key.
    pub fn validate(&self, path: &Path) -> Result<(), InputError> {
        let d = &self.perturbation;
        let r = Ranges::of("plan");
        let named = |e: InputError| e.at_path(path);
        for (key, value, low, high) in [
            ("starts", self.starts, 1, 1_000_000),
            ("evaluations", self.evaluations, 1, 1_000_000),
            ("survivors", self.survivors, 1, 1_000_000),
            ("robust_evaluations", self.robust_evaluations, 1, 1_000_000),
            ("anew", self.restarts, 0, 1000),
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
        // The error names the option of the command line for this setting.
        r.count("disturbances.worlds", d.worlds, 0, MOST_WORLDS).map_err(|mut e| {
            e.what += " (`--robust` sets it)";
            named(e)
        })?;
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
        if self.perturbation.worlds == 0 { self.evaluations } else { self.robust_evaluations }
    }

    /// Largest number of rollouts of a nominal search.
    pub(crate) fn budget(&self) -> usize {
        if self.method == Method::MultiStart { usize::MAX } else { self.nominal_evaluations() }
    }

    /// Number of rollouts of a nominal search for progress; 0 if only the optimiser limits them.
    pub(crate) fn planned_evaluations(&self) -> usize {
        if self.method == Method::MultiStart { 0 } else { self.budget() }
    }

    /// Largest number of nominal searches.
    pub(crate) fn searches(&self) -> usize {
        if self.method == Method::MultiStart { 1 } else { 1 + self.restarts }
    }

    /// Approximate number of rollouts of the choice.
    pub(crate) fn perturbed_rollouts(&self) -> usize {
        let half = self.perturbation.worlds;
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
        count + half * (self.polish_starts * self.polish + self.finalists)
    }

    /// A quick plan with about a third of the rollouts.
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
            perturbation: Perturbation { worlds: 8, ..Perturbation::default() },
            ..Self::default()
        }
    }

    /// Four times the rollouts, for machines with more cores.
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
            perturbation: Perturbation { worlds: 32, ..Perturbation::default() },
            ..Self::default()
        }
    }

    /// The paper's method: 30 searches of 30 iterations each; the nominally best action wins.
    pub fn paper() -> Self {
        Self {
            method: Method::MultiStart,
            nelder_mead: NelderMead::paper(),
            perturbation: Perturbation { worlds: 0, ..Perturbation::default() },
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
            perturbation: Perturbation { worlds, ..Perturbation::default() },
            ..PlanConfig::default()
        };
        worlds(1024).validate(path).unwrap();
        let message = worlds(1_000_000).validate(path).unwrap_err().to_string();
        for part in ["`plan.disturbances.worlds`", "--robust", "1000000", "1024"] {
            assert!(message.contains(part), "{message}");
        }
    }
}
