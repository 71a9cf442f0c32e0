//! Which of the good actions to choose: the one that still works when the world is a little different.

use crate::disturb::quantile;
use crate::search::Scored;
use crate::space::is_near;

/// Objective up to which an action may be chosen for its robustness: `good`, or 1.5 times the best one found where
/// nothing as good was found.
pub(crate) fn acceptable(scored: &[Scored], good: f64) -> f64 {
    let best = scored.iter().map(|s| s.objective).fold(f64::INFINITY, f64::min);
    good.max(1.5 * best)
}

/// Up to `count` acceptable actions, best first, that differ from each other by more than the steps in some
/// coordinate.
pub(crate) fn candidates(scored: &[Scored], acceptable: f64, steps: &[f64], count: usize) -> Vec<Scored> {
    let mut order: Vec<&Scored> = scored.iter().filter(|s| s.objective <= acceptable).collect();
    // Stable: what was tried first comes first among equals.
    order.sort_by(|a, b| a.objective.total_cmp(&b.objective));
    let mut chosen: Vec<Scored> = Vec::new();
    for s in order {
        if chosen.len() == count {
            break;
        }
        if !chosen.iter().any(|c| is_near(&c.x, &s.x, steps)) {
            chosen.push(s.clone());
        }
    }
    chosen
}

/// Indices of the `count` rows with the smallest 90 % quantile, in order of it; ties keep the better nominal one,
/// which comes first.
pub(crate) fn most_robust(outcomes: &[Vec<f64>], count: usize) -> Vec<usize> {
    let q90: Vec<f64> = outcomes.iter().map(|row| quantile(row, 0.9)).collect();
    let mut order: Vec<usize> = (0..outcomes.len()).collect();
    order.sort_by(|&a, &b| q90[a].total_cmp(&q90[b]));
    order.truncate(count);
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scored(x: f64, objective: f64) -> Scored {
        Scored { x: vec![x], objective }
    }

    #[test]
    fn a_slightly_worse_but_robust_action_wins_and_a_bad_one_is_not_asked() {
        let all = [scored(0.1, 0.001), scored(0.5, 0.009), scored(0.9, 0.04), scored(0.11, 0.002)];
        let limit = acceptable(&all, 0.01);
        assert_eq!(limit, 0.01);
        let chosen = candidates(&all, limit, &[0.05], 8);
        assert_eq!(chosen.iter().map(|c| c.x[0]).collect::<Vec<_>>(), [0.1, 0.5]);
        let outcomes = [vec![0.0, 0.0, 0.3, 0.4], vec![0.01, 0.02, 0.02, 0.03]];
        assert_eq!(most_robust(&outcomes, 1), [1]);
    }

    #[test]
    fn without_a_good_action_those_near_the_best_are_asked() {
        let all = [scored(0.1, 0.2), scored(0.5, 0.25), scored(0.9, 0.5)];
        let chosen = candidates(&all, acceptable(&all, 0.01), &[0.05], 8);
        assert_eq!(chosen.len(), 2);
    }
}
