//! The coarse scan that methods begin with.

use crate::Halton;
use crate::space::{Space, is_near};
use sms_core::Seed;

/// A point of the scan and, later, its value.
#[derive(Debug, Clone)]
pub(crate) struct Screened {
    pub(crate) x: Vec<f64>,
    /// Whether a search from here should take the smaller steps of the promising ranges.
    pub(crate) promising: bool,
    pub(crate) objective: f64,
}

/// What the task suggests, then Halton points: every other one in the promising ranges, where there are any.
pub(crate) fn points(space: &Space, suggestions: bool, seed: Seed, budget: usize) -> Vec<Screened> {
    let n = space.dimensions();
    let (everywhere, direct) = (Halton::new(n, seed.derive("box")), Halton::new(n, seed.derive("promising")));
    let unknown = |x: Vec<f64>, promising| Screened { x, promising, objective: f64::INFINITY };
    space
        .suggestions
        .iter()
        .filter(|_| suggestions)
        .map(|x| unknown(x.clone(), true))
        .chain((0..).map(|i: u64| {
            if space.has_promising() && i.is_multiple_of(2) {
                unknown(space.in_promising(&direct.point(i / 2)), true)
            } else {
                unknown(everywhere.point(i), false)
            }
        }))
        .take(budget)
        .collect()
}

/// Up to `count` points, best first, that differ from each other by more than half of their first steps in some
/// coordinate; each with these steps.
pub(crate) fn distinct(
    space: &Space,
    screened: &[Screened],
    initial_step: f64,
    count: usize,
) -> Vec<(Screened, Vec<f64>)> {
    let mut order: Vec<&Screened> = screened.iter().collect();
    // Stable: what was tried first comes first among equals.
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
