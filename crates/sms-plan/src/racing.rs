//! Racing over the last worlds of the choice: a candidate drops out once it can no longer become the best of its
//! strategy.

use crate::candidate::{RobustCandidate, STRATEGIES};
use crate::prediction::compare;
use crate::{PlanConfig, PlanError};
use std::ops::Range;

/// Worlds in which candidates are tried between two eliminations.
const BLOCK: usize = 4;

/// Tries candidates in worlds and appends the outcomes.
pub(crate) type TryIn<'a> =
    &'a mut dyn FnMut(&mut [RobustCandidate], &[usize], Range<usize>) -> Result<(), PlanError>;

/// Tries ranked candidates in the worlds of `range`. Their outcomes must cover the earlier worlds.
///
/// The best candidate of each strategy is tried in all worlds. The others are tried block by block while they may still
/// become better than this one. Returns the candidates that were tried in all worlds, in rank order. The result always
/// contains the best of each strategy over all worlds.
pub(crate) fn race(
    all: &mut [RobustCandidate],
    ranked: &[usize],
    range: Range<usize>,
    config: &PlanConfig,
    try_in: TryIn<'_>,
) -> Result<Vec<usize>, PlanError> {
    let mut leaders: Vec<usize> = Vec::new();
    for &i in ranked {
        let is_new = !leaders.iter().any(|&l| all[l].strategy == all[i].strategy);
        if leaders.len() < STRATEGIES && is_new {
            leaders.push(i);
        }
    }
    let mut others: Vec<usize> = ranked.iter().copied().filter(|i| !leaders.contains(i)).collect();
    try_in(all, &leaders, range.clone())?;
    let mut tried = range.start;
    while tried < range.end && !others.is_empty() {
        others.retain(|&i| {
            // A lower bound of the final rank: no objective is below 0, and invalid rollouts only worsen a rank.
            let least = all[i].rank(config, range.end.saturating_sub(all[i].outcomes.len()));
            let beats = |&l: &usize| {
                all[l].strategy == all[i].strategy && compare(all[l].rank(config, 0), least).is_lt()
            };
            !leaders.iter().any(beats)
        });
        let next = (tried + BLOCK).min(range.end);
        try_in(all, &others, tried..next)?;
        tried = next;
    }
    Ok(ranked.iter().copied().filter(|i| leaders.contains(i) || others.contains(i)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::RobustObjective;
    use proptest::prelude::*;
    use sms_task::Action;

    const FROM: usize = 6;
    const TOTAL: usize = 16;

    /// Returns the best of each strategy in rank order, as the choice selects them.
    fn best(all: &[RobustCandidate], who: &[usize], config: &PlanConfig) -> Vec<usize> {
        let mut order = who.to_vec();
        order.sort_by(|&a, &b| {
            compare(all[a].rank(config, 0), all[b].rank(config, 0))
                .then(all[a].objective.total_cmp(&all[b].objective))
        });
        let mut best: Vec<usize> = Vec::new();
        for i in order {
            if best.len() < STRATEGIES && !best.iter().any(|&b| all[b].strategy == all[i].strategy) {
                best.push(i);
            }
        }
        best
    }

    proptest! {
        /// For any outcomes, racing and complete evaluation agree on the best of each strategy.
        #[test]
        fn racing_and_trying_everything_choose_the_same(
            outcomes in prop::collection::vec((0..6usize, prop::collection::vec(0.0..1.0f64, TOTAL)), 1..14),
            kind in 0..4usize,
            nominal_worlds in 0..5usize,
        ) {
            let objective =
                [RobustObjective::Mean, RobustObjective::Q50, RobustObjective::Q75, RobustObjective::Q90][kind];
            let config = PlanConfig { objective, nominal_worlds, ..PlanConfig::default() };
            // Bad candidates and invalid rollouts among good ones.
            let truth: Vec<(usize, Vec<f64>)> = outcomes
                .into_iter()
                .enumerate()
                .map(|(i, (s, row))| {
                    let scale = 0.05 * (1.0 + i as f64);
                    (s, row.iter().map(|&v| if v > 0.97 { f64::INFINITY } else { scale * v }).collect())
                })
                .collect();
            let candidate = |(s, row): &(usize, Vec<f64>), seen: usize| RobustCandidate {
                x: Vec::new(),
                action: Action(Vec::new()),
                objective: row[0],
                strategy: s.to_string(),
                outcomes: row[..seen].to_vec(),
            };
            let full: Vec<RobustCandidate> = truth.iter().map(|t| candidate(t, TOTAL)).collect();
            let everyone: Vec<usize> = (0..full.len()).collect();
            let mut all: Vec<RobustCandidate> = truth.iter().map(|t| candidate(t, FROM)).collect();
            let left = race(&mut all, &everyone, FROM..TOTAL, &config, &mut |all, who, range| {
                who.iter().for_each(|&i| all[i].outcomes.extend(&truth[i].1[range.clone()]));
                Ok(())
            }).unwrap();
            prop_assert!(left.iter().all(|&i| all[i].outcomes == full[i].outcomes));
            prop_assert_eq!(best(&all, &left, &config), best(&full, &everyone, &config));
        }
    }

    #[test]
    fn dropped_candidates_are_not_tried_again() {
        let rows = [[0.01; TOTAL], [0.5; TOTAL], [0.9; TOTAL]];
        let mut all: Vec<RobustCandidate> = rows
            .iter()
            .zip(["direct", "direct", "off a"])
            .map(|(row, strategy)| RobustCandidate {
                x: Vec::new(),
                action: Action(Vec::new()),
                objective: 0.0,
                strategy: strategy.into(),
                outcomes: row[..FROM].to_vec(),
            })
            .collect();
        let mut tried = 0;
        let left = race(&mut all, &[0, 1, 2], FROM..TOTAL, &PlanConfig::default(), &mut |all, who, range| {
            tried += who.len() * range.len();
            who.iter().for_each(|&i| all[i].outcomes.extend(&rows[i][range.clone()]));
            Ok(())
        })
        .unwrap();
        assert_eq!((left, tried), (vec![0, 2], 2 * (TOTAL - FROM)));
    }
}
