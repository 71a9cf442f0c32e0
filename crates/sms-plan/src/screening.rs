//! Screening: a coarse scan of the actions before local searches.

use crate::space::is_near;
use crate::{Halton, PlanError, Space};
use rayon::prelude::*;
use sms_core::Seed;

/// Largest number of draws per point returned.
const MOST_DRAWS: usize = 8;

/// Whether the robot can carry out the strike of a unit point; called from many threads.
pub type Feasible<'a> = &'a (dyn Fn(&[f64]) -> Result<bool, PlanError> + Sync);

/// A screened point with its value, once known.
#[derive(Debug, Clone)]
pub struct Screened {
    /// The unit point.
    pub x: Vec<f64>,
    /// Whether a search from this point should use the smaller steps of the promising ranges.
    pub promising: bool,
    /// Objective; infinite until it is evaluated.
    pub objective: f64,
}

/// Returns `budget` feasible points: the suggestions of the task, then Halton points. Every other Halton point lies in
/// the promising ranges, if there are any. Stops after eight draws per point, so the result may have fewer points. The
/// result does not depend on the number of threads.
///
/// # Errors
/// The first error of `feasible`.
pub fn points(
    space: &Space,
    suggestions: bool,
    seed: Seed,
    budget: usize,
    feasible: Feasible<'_>,
) -> Result<Vec<Screened>, PlanError> {
    let n = space.dimensions();
    let (everywhere, direct) = (Halton::new(n, seed.derive("box")), Halton::new(n, seed.derive("promising")));
    let unknown = |x: Vec<f64>, promising| Screened { x, promising, objective: f64::INFINITY };
    let mut draws = space
        .suggestions
        .iter()
        .filter(|_| suggestions)
        .map(|x| unknown(x.clone(), true))
        .chain((0..).map(|i: u64| {
            // Each sequence has its own index: every other point covers only half of the first parameter's range.
            if !space.has_promising() {
                unknown(everywhere.point(i), false)
            } else if i.is_multiple_of(2) {
                unknown(space.in_promising(&direct.point(i / 2)), true)
            } else {
                unknown(everywhere.point(i / 2), false)
            }
        }))
        .take(budget.saturating_mul(MOST_DRAWS));
    let mut found: Vec<Screened> = Vec::new();
    while found.len() < budget {
        let block: Vec<Screened> = draws.by_ref().take(budget - found.len()).collect();
        if block.is_empty() {
            break;
        }
        let can: Vec<bool> = block.par_iter().map(|s| feasible(&s.x)).collect::<Result<_, _>>()?;
        found.extend(block.into_iter().zip(can).filter_map(|(s, can)| can.then_some(s)));
    }
    Ok(found)
}

/// Returns up to `count` points, best first, that differ by more than half of their first steps in some coordinate,
/// each with these steps.
pub fn distinct(
    space: &Space,
    screened: &[Screened],
    initial_step: f64,
    count: usize,
) -> Vec<(Screened, Vec<f64>)> {
    let mut order: Vec<&Screened> = screened.iter().collect();
    // Stable: equal points keep the order of their evaluation.
    order.sort_by(|a, b| a.objective.total_cmp(&b.objective));
    let mut chosen: Vec<(Screened, Vec<f64>)> = Vec::new();
    for s in order {
        if chosen.len() == count {
            break;
        }
        let steps = space.steps(initial_step, s.promising);
        let half: Vec<f64> = steps.iter().map(|s| 0.5 * s).collect();
        if !chosen.iter().any(|(c, _)| is_near(&c.x, &s.x, &half)) {
            chosen.push((s.clone(), steps));
        }
    }
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_task::Parameter;
    use std::sync::atomic::{AtomicUsize, Ordering};

    fn space() -> Space {
        let parameter = |name: &str| Parameter { name: name.into(), unit: "1".into(), low: 0.0, high: 1.0 };
        Space::of(["speed", "angle"].map(parameter).to_vec(), vec![[0.0, 1.0]; 2])
    }

    /// Feasible points of the scan and the number of draws.
    fn drawn(share: f64, budget: usize, threads: usize) -> (Vec<Vec<f64>>, usize) {
        let draws = AtomicUsize::new(0);
        let feasible = |x: &[f64]| {
            draws.fetch_add(1, Ordering::SeqCst);
            Ok(x[0] < share)
        };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let found = pool.install(|| points(&space(), false, Seed(4), budget, &feasible)).unwrap();
        (found.into_iter().map(|s| s.x).collect(), draws.into_inner())
    }

    #[test]
    fn points_are_drawn_until_enough_are_feasible() {
        let (all, draws) = drawn(1.0, 90, 1);
        assert_eq!((all.len(), draws), (90, 90));
        let (third, draws) = drawn(1.0 / 3.0, 90, 1);
        assert!(third.len() == 90 && third.iter().all(|x| x[0] < 1.0 / 3.0));
        assert!((250..290).contains(&draws), "{draws}");
        // The feasible points, in the order of drawing.
        let many = drawn(1.0, draws, 1).0;
        assert_eq!(third, many.into_iter().filter(|x| x[0] < 1.0 / 3.0).collect::<Vec<_>>());
        assert_eq!(drawn(1.0 / 3.0, 90, 4), (third, draws));
    }

    #[test]
    fn drawing_ends_where_few_points_are_feasible() {
        let (none, draws) = drawn(0.0, 30, 2);
        assert_eq!((none.len(), draws), (0, 240));
        let (few, draws) = drawn(0.05, 30, 2);
        assert!((6..=18).contains(&few.len()) && draws == 240, "{} of {draws}", few.len());
    }

    #[test]
    fn the_first_error_ends_the_drawing() {
        let result = points(&space(), false, Seed(4), 30, &|_| Err(sms_core::CoreError::Interrupted.into()));
        assert!(matches!(result, Err(PlanError::Core(sms_core::CoreError::Interrupted))));
    }
}
