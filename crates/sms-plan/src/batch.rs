//! The seam to optimisers that spend a whole budget and have their points evaluated side by side.

use crate::{Phase, PlanError};
use rayon::prelude::*;

/// A point of the unit box whose objective is wanted.
#[derive(Debug, Clone, PartialEq)]
pub struct Proposal {
    /// The point.
    pub x: Vec<f64>,
    /// What it is for.
    pub phase: Phase,
    /// Index of the start it belongs to; −1 in the screening.
    pub start: i32,
}

/// One local search of a method.
#[derive(Debug, Clone, PartialEq)]
pub struct StartRecord {
    /// Where it began.
    pub initial: Vec<f64>,
    /// Objective there.
    pub initial_objective: f64,
    /// The best point.
    pub x: Vec<f64>,
    /// Objective there.
    pub objective: f64,
    /// Rollouts used.
    pub evaluations: usize,
    /// Iterations (generations) used.
    pub iterations: usize,
    /// Points that it asked for and that cannot be tried at all.
    pub refused: usize,
}

/// A search of the unit box by populations: it says which points it wants evaluated next, and is told their values.
///
/// What it asks for depends on its settings, its seed and the values it was told alone, so that the result is the same
/// however many threads evaluate a population. Values may be infinite (a rollout that is no rollout), never NaN. Points that
/// cannot be tried at all have none; they cost nothing, and it asks for others in their place.
pub trait BatchOptimiser {
    /// Name for tables ("halving").
    fn name(&self) -> &'static str;

    /// The next points, at most `room` of them (the budget that is left, at least 1). None when it has nothing more
    /// to ask.
    fn ask(&mut self, room: usize) -> Vec<Proposal>;

    /// The values of the points last asked for, in their order; `None` for those that cannot be tried.
    fn tell(&mut self, values: &[Option<f64>]);

    /// The local searches so far, in order of their index.
    fn starts(&self) -> Vec<StartRecord>;
}

/// Points that cannot be tried, for each evaluation of the budget, after which [`drive`] stops.
const MOST_REFUSED: usize = 8;

/// Runs an optimiser until it asks no more or has used `budget` evaluations. Everything that was evaluated, in the
/// order of asking. Uses rayon's current pool. Points for which the objective is `None` cannot be tried: they are no
/// evaluations, up to eight times as many as the budget has.
///
/// # Errors
/// The objective's first error.
pub fn drive(
    optimiser: &mut dyn BatchOptimiser,
    budget: usize,
    objective: &(dyn Fn(&[f64]) -> Result<Option<f64>, PlanError> + Sync),
) -> Result<Vec<(Proposal, f64)>, PlanError> {
    let mut log: Vec<(Proposal, f64)> = Vec::new();
    let mut refused = 0;
    while log.len() < budget && refused < budget.saturating_mul(MOST_REFUSED) {
        let room = budget - log.len();
        let mut asked = optimiser.ask(room);
        debug_assert!(asked.len() <= room, "{} asks for more than is left", optimiser.name());
        asked.truncate(room);
        if asked.is_empty() {
            break;
        }
        let values: Vec<Option<f64>> = asked.par_iter().map(|p| objective(&p.x)).collect::<Result<_, _>>()?;
        optimiser.tell(&values);
        refused += values.iter().filter(|v| v.is_none()).count();
        log.extend(asked.into_iter().zip(values).filter_map(|(p, v)| Some((p, v?))));
    }
    Ok(log)
}
