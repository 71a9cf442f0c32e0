//! Estimate of the remaining time of a scan: measured seconds per step, times the largest number of remaining steps,
//! times the share of this number that frames have needed so far.

/// Number of steps over which seconds per step are averaged: they grow with the number of Gaussians.
const HORIZON: f64 = 100.0;

/// Measurements so far.
#[derive(Debug, Clone)]
pub(crate) struct Pace {
    /// Most steps of each slot.
    limits: Vec<usize>,
    /// A slot and its number of steps, if it ends before its limit.
    end: Option<(usize, usize)>,
    /// Steps taken by finished slots, and their limits.
    used: usize,
    allowed: usize,
    seconds_per_step: Option<f64>,
    /// Measurements of it. The first one includes buffers that are allocated and shaders that are compiled once.
    measured: usize,
    /// Seconds spent outside steps (seeding, pruning, rendering) in finished frames, and the number of these frames.
    beside: (f64, usize),
    /// Seconds per rendering, and the number of renderings at the end.
    render: (f64, usize),
}

impl Pace {
    /// Creates an estimate for slots with these limits; `measured` views are rendered at the end.
    pub(crate) fn new(limits: Vec<usize>, measured: usize) -> Self {
        Self {
            limits,
            end: None,
            used: 0,
            allowed: 0,
            seconds_per_step: None,
            measured: 0,
            beside: (0.0, 0),
            render: (0.0, measured),
        }
    }

    /// Total units: the limit of steps.
    pub(crate) fn units(&self) -> u64 {
        self.limits.iter().sum::<usize>() as u64
    }

    /// Units done at `step` of `slot`: the unused steps of a slot count as done.
    pub(crate) fn done(&self, slot: usize, step: usize) -> u64 {
        let before: usize = self.limits.iter().take(slot).sum();
        let limit = self.limit(slot);
        (before + (step * limit / self.steps(slot).max(1)).min(limit)) as u64
    }

    /// Records the number of steps of a slot, once it is known.
    pub(crate) fn ends(&mut self, slot: usize, steps: usize) {
        self.end = Some((slot, steps));
    }

    /// Number of steps of a slot, as far as it is known.
    pub(crate) fn steps(&self, slot: usize) -> usize {
        self.end.filter(|end| end.0 == slot).map_or(self.limit(slot), |end| end.1)
    }

    /// Most steps of a slot.
    pub(crate) fn limit(&self, slot: usize) -> usize {
        self.limits.get(slot).copied().unwrap_or(0)
    }

    /// Seconds a step; `None` before any was taken.
    pub(crate) fn seconds_per_step(&self) -> Option<f64> {
        self.seconds_per_step
    }

    /// Records the seconds of some steps.
    pub(crate) fn stepped(&mut self, steps: usize, seconds: f64) {
        if steps == 0 {
            return;
        }
        let latest = seconds / steps as f64;
        let weight = (steps as f64 / HORIZON).min(1.0);
        let mean = self.seconds_per_step.filter(|_| self.measured > 1);
        self.seconds_per_step = Some(mean.map_or(latest, |s| s + weight * (latest - s)));
        self.measured += 1;
    }

    /// Records a slot finished after `steps` steps; `beside` are the seconds of everything else in it, if measured.
    pub(crate) fn finished(&mut self, slot: usize, steps: usize, beside: Option<f64>) {
        self.used += steps.min(self.limit(slot));
        self.allowed += self.limit(slot);
        if let Some(seconds) = beside {
            self.beside = (self.beside.0 + seconds, self.beside.1 + 1);
        }
    }

    /// Records the seconds of one rendering.
    pub(crate) fn rendered(&mut self, seconds: f64) {
        self.render.0 = seconds;
    }

    /// Returns the seconds left at `step` of `slot`; `None` before the second measurement.
    pub(crate) fn seconds_left(&self, slot: usize, step: usize) -> Option<f64> {
        let per_step = self.seconds_per_step.filter(|_| self.measured > 1)?;
        let share = if self.allowed > 0 { self.used as f64 / self.allowed as f64 } else { 1.0 };
        let later = self.limits.iter().skip(slot + 1).sum::<usize>();
        let steps = (self.steps(slot).saturating_sub(step) + later) as f64 * share;
        let slots = self.limits.len().saturating_sub(slot + 1) as f64;
        let beside = if self.beside.1 > 0 { self.beside.0 / self.beside.1 as f64 } else { 0.0 };
        Some(steps * per_step + slots * beside + self.render.0 * self.render.1 as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn before_any_frame_is_done_all_steps_are_expected() {
        let mut pace = Pace::new(vec![100, 20, 20, 60], 4);
        assert_eq!((pace.units(), pace.seconds_left(0, 0)), (200, None));
        // The first batch is slow, because it prepares the others.
        pace.stepped(10, 60.0);
        assert_eq!((pace.seconds_per_step(), pace.seconds_left(0, 10)), (Some(6.0), None));
        pace.stepped(10, 0.5);
        assert_eq!(pace.done(0, 20), 20);
        assert!((pace.seconds_left(0, 20).unwrap() - 180.0 * 0.05).abs() < 1e-12);
    }

    #[test]
    fn frames_that_stop_early_shorten_the_forecast() {
        let mut pace = Pace::new(vec![100, 20, 20, 60], 4);
        pace.stepped(30, 0.3);
        pace.stepped(30, 0.3);
        pace.finished(0, 60, Some(2.0));
        pace.rendered(0.5);
        assert_eq!(pace.done(1, 0), 100, "what was not needed counts as done");
        // At most 100 steps are left, of which 60 % are expected; two more slots have 2 s besides their steps.
        let expected = 100.0 * 0.6 * 0.01 + 2.0 * 2.0 + 4.0 * 0.5;
        assert!((pace.seconds_left(1, 0).unwrap() - expected).abs() < 1e-12);
        // Only rendering is left.
        pace.finished(1, 20, Some(2.0));
        pace.finished(2, 20, None);
        assert!((pace.seconds_left(3, 60).unwrap() - 2.0).abs() < 1e-12);
    }

    #[test]
    fn a_known_end_shortens_the_forecast() {
        let mut pace = Pace::new(vec![2000], 0);
        pace.stepped(100, 1.0);
        pace.stepped(100, 1.0);
        assert!((pace.seconds_left(0, 500).unwrap() - 15.0).abs() < 1e-9);
        pace.ends(0, 750);
        assert!((pace.seconds_left(0, 500).unwrap() - 2.5).abs() < 1e-9);
        assert_eq!((pace.done(0, 375), pace.done(0, 750), pace.steps(0)), (1000, 2000, 750));
    }

    #[test]
    fn a_changing_pace_is_followed() {
        let mut pace = Pace::new(vec![1000], 0);
        pace.stepped(10, 0.1);
        (0..60).for_each(|_| pace.stepped(10, 0.4));
        let left = pace.seconds_left(0, 500).unwrap();
        assert!((left - 500.0 * 0.04).abs() < 0.1, "{left}");
        pace.stepped(0, 1.0);
        assert_eq!(pace.seconds_left(0, 500), Some(left));
    }
}
