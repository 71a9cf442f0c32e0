//! Interface of optimisers that spend a whole budget and evaluate their points in parallel.

use crate::{Minimum, PlanError, TrialPhase};
use rayon::prelude::*;

/// A point of the unit box to evaluate.
#[derive(Debug, Clone, PartialEq)]
pub struct Proposal {
    /// The point.
    pub x: Vec<f64>,
    /// Purpose of the evaluation.
    pub phase: TrialPhase,
    /// Index of the start of this search; −1 during screening.
    pub start: i32,
}

/// One local search of a method.
#[derive(Debug, Clone, PartialEq)]
pub struct StartRecord {
    /// The initial point.
    pub initial: Vec<f64>,
    /// Objective at this point.
    pub initial_objective: f64,
    /// The result so far; its iterations are generations for a population.
    pub found: Minimum,
    /// Number of infeasible points that the search proposed.
    pub refused: usize,
}

/// A population search of the unit box in ask-and-tell form.
///
/// The proposals depend only on the settings, the seed and the values of earlier proposals, so that the result does
/// not depend on the number of threads. Values may be infinite (an invalid rollout), never NaN. Infeasible points
/// have no value and cost no budget; the search proposes others instead.
pub trait BatchOptimiser {
    /// The next points, at most `room` (the remaining budget, at least 1). Empty when the search has ended.
    fn ask(&mut self, room: usize) -> Vec<Proposal>;

    /// Receives the values of the last proposals, in their order; `None` for infeasible points.
    fn tell(&mut self, values: &[Option<f64>]);

    /// The local searches so far, in order of their indices.
    fn starts(&self) -> Vec<StartRecord>;
}

/// [`drive`] stops after this many infeasible points per evaluation of the budget.
const MOST_REFUSED: usize = 8;

/// Runs an optimiser until it ends or has used `budget` evaluations. Returns all evaluated points in the order in which
/// they were proposed.
///
/// Points for which the objective is `None` are infeasible. They do not count as evaluations, but the run stops after
/// eight infeasible points per evaluation of the budget. Uses rayon's current pool.
///
/// # Errors
/// The first error of the objective.
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
        debug_assert!(asked.len() <= room, "the optimiser asks for more than is left");
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
