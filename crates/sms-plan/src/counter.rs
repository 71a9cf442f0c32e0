//! Counts and progress of rollouts.

use crate::prediction::RolloutOutcome;
use crate::{InvalidRollout, PlanError, Refusal};
use sms_core::{Cancel, Progress, shown_units};
use sms_sim::SimError;
use sms_task::{Action, ResolvedTask};
use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Counts rollouts, reports progress and checks for cancellation.
pub(crate) struct Counter<'a> {
    progress: &'a dyn Progress,
    cancel: &'a Cancel,
    done: AtomicUsize,
    /// Rollouts before the current part of the work.
    before: AtomicUsize,
    /// Planned rollouts of the current part; 0 if unknown.
    planned: AtomicUsize,
    /// Whether a part has begun and not ended.
    is_in_part: AtomicBool,
    invalid: AtomicUsize,
    /// Invalid rollouts by reason: their number and the alphabetically first example.
    invalid_rollouts: Mutex<BTreeMap<String, (usize, String)>>,
    /// Strikes refused in place of a rollout, by reason.
    refused: Mutex<Reasons>,
    /// Refused points of scans and searches, by reason. Other points were tried in their place.
    passed_over: Mutex<Reasons>,
}

/// Reasons of refused strikes, with the number of strikes.
pub(crate) type Reasons = BTreeMap<String, usize>;

fn note(reasons: &Mutex<Reasons>, reason: String) {
    if let Ok(mut reasons) = reasons.lock() {
        *reasons.entry(reason).or_default() += 1;
    }
}

impl<'a> Counter<'a> {
    pub(crate) fn new(progress: &'a dyn Progress, cancel: &'a Cancel) -> Self {
        Self {
            progress,
            cancel,
            done: AtomicUsize::new(0),
            before: AtomicUsize::new(0),
            planned: AtomicUsize::new(0),
            is_in_part: AtomicBool::new(false),
            invalid: AtomicUsize::new(0),
            invalid_rollouts: Mutex::default(),
            refused: Mutex::default(),
            passed_over: Mutex::default(),
        }
    }

    /// Starts a part of the work with about this many rollouts, 0 if unknown.
    pub(crate) fn begin(&self, part: &str, rollouts: usize) {
        self.before.store(self.done(), Ordering::SeqCst);
        self.planned.store(rollouts, Ordering::SeqCst);
        self.is_in_part.store(true, Ordering::SeqCst);
        self.progress.begin(part, rollouts as u64);
    }

    /// Ends the part. Rollouts outside of parts are not reported.
    pub(crate) fn end(&self, message: &str) {
        if self.is_in_part.swap(false, Ordering::SeqCst) {
            self.progress.end(message);
        }
    }

    pub(crate) fn done(&self) -> usize {
        self.done.load(Ordering::SeqCst)
    }

    pub(crate) fn invalid(&self) -> usize {
        self.invalid.load(Ordering::SeqCst)
    }

    /// Whether the robot can carry out the strike of a proposed point. Counts refusals; simulates nothing.
    pub(crate) fn draw(&self, task: &ResolvedTask, action: &Action) -> Result<bool, PlanError> {
        self.cancel.check()?;
        match task.striker(&task.strike(action)) {
            Err(SimError::Refused(e)) => {
                note(&self.passed_over, e.reason());
                Ok(false)
            }
            other => Ok(other.map(|_| true)?),
        }
    }

    /// Whether the motion of an action from home to the lift passes every check of the robot. Counts refusals.
    pub(crate) fn executable(&self, task: &ResolvedTask, action: &Action) -> Result<bool, PlanError> {
        self.cancel.check()?;
        let Some(reason) = task.not_executable(&task.strike(action)) else { return Ok(true) };
        note(&self.passed_over, reason);
        Ok(false)
    }

    fn note_invalid(&self, e: &SimError) {
        let (Ok(mut all), Some(reason)) = (self.invalid_rollouts.lock(), e.failure_reason()) else { return };
        let example = e.to_string();
        // The alphabetically first example, because threads finish in any order.
        let (count, least) = all.entry(reason).or_insert_with(|| (0, example.clone()));
        *count += 1;
        if example < *least {
            *least = example;
        }
    }

    /// Invalid rollouts so far by reason, the most frequent first.
    pub(crate) fn invalid_rollouts(&self) -> Vec<InvalidRollout> {
        let all = self.invalid_rollouts.lock().map(|all| all.clone()).unwrap_or_default();
        let mut all: Vec<InvalidRollout> = all
            .into_iter()
            .map(|(reason, (count, example))| InvalidRollout { reason, count, example })
            .collect();
        all.sort_by(|a, b| b.count.cmp(&a.count).then_with(|| a.reason.cmp(&b.reason)));
        all
    }

    /// Returns the strikes refused so far in place of a rollout.
    pub(crate) fn refused(&self) -> Reasons {
        self.refused.lock().map(|r| r.clone()).unwrap_or_default()
    }

    /// Refused points of scans and searches so far, together with `refused`, the most frequent reason first.
    pub(crate) fn refusals(&self, refused: &Reasons) -> Vec<Refusal> {
        let mut counted = self.passed_over.lock().map(|r| r.clone()).unwrap_or_default();
        for (reason, count) in refused {
            *counted.entry(reason.clone()).or_default() += count;
        }
        let mut all: Vec<Refusal> =
            counted.into_iter().map(|(reason, count)| Refusal { reason, count }).collect();
        all.sort_by(|a, b| b.count.cmp(&a.count).then_with(|| a.reason.cmp(&b.reason)));
        all
    }

    /// The objective of a rollout; infinite if it is invalid or refused.
    pub(crate) fn count(&self, rollout: impl FnOnce() -> Result<f64, SimError>) -> Result<f64, PlanError> {
        Ok(self.shot(rollout)?.objective())
    }

    /// The outcome of a rollout; as [`Counter::count`].
    pub(crate) fn shot(
        &self,
        rollout: impl FnOnce() -> Result<f64, SimError>,
    ) -> Result<RolloutOutcome, PlanError> {
        self.cancel.check()?;
        let shot = match rollout() {
            Err(SimError::Refused(e)) => {
                note(&self.refused, e.reason());
                RolloutOutcome::Refused
            }
            Err(e @ (SimError::Diverged { .. } | SimError::Unphysical { .. })) => {
                self.invalid.fetch_add(1, Ordering::SeqCst);
                self.note_invalid(&e);
                RolloutOutcome::Invalid
            }
            other => RolloutOutcome::Done(other?),
        };
        let done = self.done.fetch_add(1, Ordering::SeqCst) + 1;
        if self.is_in_part.load(Ordering::SeqCst) {
            let in_part = done.saturating_sub(self.before.load(Ordering::SeqCst)) as u64;
            let planned = self.planned.load(Ordering::SeqCst) as u64;
            self.progress.update(shown_units(in_part, planned), "shots simulated");
        }
        Ok(shot)
    }
}
