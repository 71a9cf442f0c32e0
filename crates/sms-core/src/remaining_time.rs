//! Estimate of the time left of a part of the work.

use std::num::NonZero;

/// Number of reports that an estimate needs: the standard error of the mean of 16 durations that scatter by as much as
/// their mean is a quarter of it.
const REPORTS: u64 = 16;
/// Share of the units after which fewer reports suffice, one in `SHARE`: short parts have few.
const SHARE: u64 = 4;

/// Estimates the seconds left from the pace since the first report of units done. What precedes it (worlds to build, an
/// earlier attempt) is not part of the pace.
#[derive(Debug, Clone)]
pub struct RemainingTime {
    /// Seconds and units done at the first report.
    first: Option<(f64, u64)>,
    /// Reports after the first one.
    reports: u64,
    /// Threads that do units at the same time.
    threads: u64,
}

impl Default for RemainingTime {
    fn default() -> Self {
        Self::with_threads(std::thread::available_parallelism().map_or(1, NonZero::get))
    }
}

impl RemainingTime {
    /// Creates an estimate for a part that begins, with units done by up to `threads` threads.
    pub fn with_threads(threads: usize) -> Self {
        Self { first: None, reports: 0, threads: threads as u64 }
    }

    /// Records that `done` of `units` units are done after `elapsed_s` seconds and returns the seconds left, once the
    /// pace is known well enough.
    pub fn report(&mut self, elapsed_s: f64, done: u64, units: u64) -> Option<f64> {
        if done == 0 {
            return None;
        }
        let Some((first_s, before)) = self.first else {
            self.first = Some((elapsed_s, done));
            return None;
        };
        self.reports += 1;
        let (counted, left) = (done.saturating_sub(before), units.saturating_sub(done));
        // Units that began together end together, so that the first of them say nothing about the pace.
        let is_enough = self.reports >= REPORTS.max(2 * self.threads)
            || counted >= units.saturating_sub(before).div_ceil(SHARE);
        (is_enough && counted > 0 && left > 0).then(|| (elapsed_s - first_s) / counted as f64 * left as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fifteen seconds pass before the first of 3216 rollouts of 10 ms.
    #[test]
    fn preparation_is_not_part_of_the_pace() {
        let mut time = RemainingTime::with_threads(2);
        let at = |done: u64| 15.0 + 0.01 * done as f64;
        let estimates: Vec<Option<f64>> = (1..=40).map(|done| time.report(at(done), done, 3216)).collect();
        assert!(estimates[..16].iter().all(Option::is_none), "{estimates:?}");
        for (done, left) in (1..).zip(&estimates).skip(16) {
            assert!((left.unwrap() - 0.01 * (3216 - done) as f64).abs() < 1e-6, "{done}: {left:?}");
        }
    }

    #[test]
    fn short_and_resumed_parts_have_an_estimate_after_a_quarter() {
        let mut time = RemainingTime::with_threads(2);
        let left: Vec<Option<f64>> = (0..=8).map(|done| time.report(2.0 * done as f64, done, 8)).collect();
        assert_eq!(left[..3], [None, None, None]);
        assert_eq!((left[3], left[7], left[8]), (Some(10.0), Some(2.0), None));
        // 600 of 1000 bytes are there from an earlier attempt.
        let mut time = RemainingTime::with_threads(2);
        assert_eq!(time.report(1.0, 600, 1000), None);
        assert_eq!(time.report(2.0, 700, 1000), Some(3.0));
        assert_eq!(time.report(3.0, 1200, 1000), None, "more than planned");
    }

    #[test]
    fn threads_that_began_together_are_waited_for() {
        let mut time = RemainingTime::with_threads(64);
        // The first wave of 64 rollouts ends after a second, within a millisecond.
        let wave = (1..=64).map(|done| (1.0 + 1e-5 * done as f64, done));
        assert!(wave.map(|(s, done)| time.report(s, done, 10_000)).all(|left| left.is_none()));
    }
}
