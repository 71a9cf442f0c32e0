//! The last worlds of the choice: who cannot become the best of its strategy any more is not tried in the rest of them.

use crate::prediction::compare;
use crate::robust::{Candidate, STRATEGIES};
use crate::{PlanConfig, PlanError};
use std::ops::Range;

/// Worlds that candidates are tried in between two looks at whether they are beaten.
const BLOCK: usize = 4;

/// Tries candidates in worlds; outcomes are appended.
pub(crate) type TryIn<'a> =
    &'a mut dyn FnMut(&mut [Candidate], &[usize], Range<usize>) -> Result<(), PlanError>;

/// Tries the ranked candidates, which have been in the worlds before `range`, in those of `range`: the best of each strategy
/// in all of them, the others, some worlds at a time, as long as they may still become better than that one. Returns those
/// that were tried in all, in their order. The best of each strategy over all worlds is among them.
pub(crate) fn until_beaten(
    all: &mut [Candidate],
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
    let mut seen = range.start;
    while seen < range.end && !others.is_empty() {
        others.retain(|&i| {
            // The best rank that it can still come to: no objective is less than 0, and what cannot be believed ranks last.
            let least = all[i].rank(config, range.end.saturating_sub(all[i].outcomes.len()));
            let beats = |&l: &usize| {
                all[l].strategy == all[i].strategy && compare(all[l].rank(config, 0), least).is_lt()
            };
            !leaders.iter().any(beats)
        });
        let next = (seen + BLOCK).min(range.end);
        try_in(all, &others, seen..next)?;
        seen = next;
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

    /// The best of each strategy in order, as the choice takes them.
    fn best(all: &[Candidate], who: &[usize], config: &PlanConfig) -> Vec<usize> {
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
        /// Whatever the outcomes, the best of each strategy are those of trying all in all worlds.
        #[test]
        fn the_choice_is_that_of_trying_everything(
            outcomes in prop::collection::vec((0..6usize, prop::collection::vec(0.0..1.0f64, TOTAL)), 1..14),
            kind in 0..4usize,
            nominal_worlds in 0..5usize,
        ) {
            let objective =
                [RobustObjective::Mean, RobustObjective::Q50, RobustObjective::Q75, RobustObjective::Q90][kind];
            let config = PlanConfig { objective, nominal_worlds, ..PlanConfig::default() };
            // Bad candidates and unbelievable rollouts among good ones.
            let truth: Vec<(usize, Vec<f64>)> = outcomes
                .into_iter()
                .enumerate()
                .map(|(i, (s, row))| {
                    let scale = 0.05 * (1.0 + i as f64);
                    (s, row.iter().map(|&v| if v > 0.97 { f64::INFINITY } else { scale * v }).collect())
                })
                .collect();
            let candidate = |(s, row): &(usize, Vec<f64>), seen: usize| Candidate {
                x: Vec::new(),
                action: Action(Vec::new()),
                objective: row[0],
                strategy: s.to_string(),
                outcomes: row[..seen].to_vec(),
            };
            let full: Vec<Candidate> = truth.iter().map(|t| candidate(t, TOTAL)).collect();
            let everyone: Vec<usize> = (0..full.len()).collect();
            let mut all: Vec<Candidate> = truth.iter().map(|t| candidate(t, FROM)).collect();
            let left = until_beaten(&mut all, &everyone, FROM..TOTAL, &config, &mut |all, who, range| {
                who.iter().for_each(|&i| all[i].outcomes.extend(&truth[i].1[range.clone()]));
                Ok(())
            }).unwrap();
            prop_assert!(left.iter().all(|&i| all[i].outcomes == full[i].outcomes));
            prop_assert_eq!(best(&all, &left, &config), best(&full, &everyone, &config));
        }
    }

    #[test]
    fn who_is_beaten_is_tried_no_more() {
        let rows = [[0.01; TOTAL], [0.5; TOTAL], [0.9; TOTAL]];
        let mut all: Vec<Candidate> = rows
            .iter()
            .zip(["direct", "direct", "off a"])
            .map(|(row, strategy)| Candidate {
                x: Vec::new(),
                action: Action(Vec::new()),
                objective: 0.0,
                strategy: strategy.into(),
                outcomes: row[..FROM].to_vec(),
            })
            .collect();
        let mut tried = 0;
        let left = until_beaten(
            &mut all,
            &[0, 1, 2],
            FROM..TOTAL,
            &PlanConfig::default(),
            &mut |all, who, range| {
                tried += who.len() * range.len();
                who.iter().for_each(|&i| all[i].outcomes.extend(&rows[i][range.clone()]));
                Ok(())
            },
        )
        .unwrap();
        assert_eq!((left, tried), (vec![0, 2], 2 * (TOTAL - FROM)));
    }
}
