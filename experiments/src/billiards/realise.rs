//! Execution of plans in the target worlds. This module reads the truth.

use super::rows::View;
use super::{Row, Shot, Unfinished};
use crate::BenchError;
use rayon::prelude::*;
use sms_core::{Cancel, Progress};
use sms_robots::RobotConfig;
use sms_sim::SimError;
use sms_synth::TruthScene;
use sms_target::{Target, TargetError, TargetOptions, execute};
use sms_task::{Action, TaskError, Trajectory};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};

/// A shot by the inputs of its outcome: the values' bits, whether the arm makes it, and whether it was planned in the paper's
/// scene.
type Key = (Vec<u64>, bool, bool);

fn key(row: Row, shot: &Shot) -> Option<Key> {
    let bits = |a: &Action| a.0.iter().map(|v| v.to_bits()).collect();
    shot.action.as_ref().map(|a| (bits(a), shot.by_arm, row == Row::Paper))
}

/// Outcomes of plans in one target.
pub(super) struct Realised {
    /// Objectives, metres; `None` if the engine could not finish the shot.
    pub(super) rows: BTreeMap<Row, Vec<Option<f64>>>,
    /// Reasons, for rows with unfinished shots.
    pub(super) unfinished: BTreeMap<Row, Unfinished>,
    /// Motion of the robust plan.
    pub(super) motion: Option<Trajectory>,
}

/// Executes shots in a target world.
pub(super) struct Realiser<'a> {
    pub(super) target: &'a dyn Target,
    pub(super) truth: &'a TruthScene,
    pub(super) robot: &'a RobotConfig,
    /// Objective without an action, metres.
    pub(super) idle_m: f64,
}

impl Realiser<'_> {
    /// One shot: its objective and its motion, or why the engine cannot finish it, or why it is of another ball.
    fn shoot(
        &self,
        view: View<'_>,
        action: &Action,
        by_arm: bool,
    ) -> Result<Result<(f64, Trajectory), String>, BenchError> {
        let robot = if by_arm { self.robot.clone() } else { RobotConfig::default() };
        let options = TargetOptions { chaos_runs: 0, robot, ..TargetOptions::default() };
        match execute(self.target, view.task, action, view.scene, self.truth, &options) {
            Ok(execution) => {
                let resolved = view.task.resolve(view.scene).map_err(TargetError::from)?;
                let planned = resolved.target().name.as_str();
                let truly = execution.matches.iter().find(|m| m.0 == planned).map(|m| m.1.as_str());
                if let Some(other) = truly.filter(|name| *name != self.truth.target) {
                    return Ok(Err(format!("the plan takes `{other}` for the ball that is to be moved")));
                }
                Ok(Ok((execution.objective, execution.trajectory)))
            }
            Err(e) if is_failed_shot(&e) => Ok(Err(e.to_string())),
            Err(e) => Err(BenchError::from(e)),
        }
    }

    /// Largest change of a shot's objective when every true body moves by up to `nudge_m`, metres.
    pub(super) fn sensitivity_m(
        &self,
        view: View<'_>,
        shot: &Shot,
        nudge_m: f64,
    ) -> Result<Option<f64>, BenchError> {
        let Some(action) = &shot.action else { return Ok(None) };
        let robot = if shot.by_arm { self.robot.clone() } else { RobotConfig::default() };
        let options = TargetOptions { chaos_runs: 6, chaos_m: nudge_m, robot, ..TargetOptions::default() };
        match execute(self.target, view.task, action, view.scene, self.truth, &options) {
            Ok(execution) => Ok(Some(execution.chaos_floor)),
            Err(e) if is_failed_shot(&e) => Ok(None),
            Err(e) => Err(BenchError::from(e)),
        }
    }

    /// Executes every distinct shot once. A shot that does nothing leaves the ball in place.
    pub(super) fn realise<'v>(
        &self,
        view_of: &(dyn Fn(Row) -> View<'v> + Sync),
        plans: &BTreeMap<Row, Vec<Shot>>,
        progress: &dyn Progress,
        cancel: &Cancel,
    ) -> Result<Realised, BenchError> {
        let mut distinct: BTreeMap<Key, (Row, &Action)> = BTreeMap::new();
        for (&row, shot) in plans.iter().flat_map(|(row, shots)| shots.iter().map(move |s| (row, s))) {
            if let (Some(key), Some(action)) = (key(row, shot), &shot.action) {
                distinct.insert(key, (row, action));
            }
        }
        let distinct: Vec<(Key, (Row, &Action))> = distinct.into_iter().collect();
        progress.begin(&format!("bench billiards: {}", self.target.label()), distinct.len() as u64);
        let done = AtomicU64::new(0);
        let outcomes: BTreeMap<Key, Result<(f64, Trajectory), String>> = distinct
            .into_par_iter()
            .map(|(key, (row, action))| {
                cancel.check()?;
                let outcome = self.shoot(view_of(row), action, key.1)?;
                progress.update(done.fetch_add(1, Ordering::SeqCst) + 1, "shots");
                Ok((key, outcome))
            })
            .collect::<Result<_, BenchError>>()?;
        progress.end("");
        let of = |row: Row, shot: &Shot| match key(row, shot) {
            Some(key) => outcomes[&key].as_ref().ok().map(|o| o.0),
            None => Some(self.idle_m),
        };
        let why = |row: Row, shots: &[Shot]| -> Unfinished {
            let why = |shot| outcomes[&key(row, shot)?].as_ref().err().cloned();
            shots.iter().enumerate().filter_map(|(i, shot)| Some((i, why(shot)?))).collect()
        };
        let robust = plans.get(&Row::Robust).and_then(|v| key(Row::Robust, v.first()?));
        Ok(Realised {
            rows: plans.iter().map(|(&row, v)| (row, v.iter().map(|s| of(row, s)).collect())).collect(),
            unfinished: plans
                .iter()
                .map(|(&row, v)| (row, why(row, v)))
                .filter(|(_, why)| !why.is_empty())
                .collect(),
            motion: robust.and_then(|key| outcomes[&key].as_ref().ok().map(|o| o.1.clone())),
        })
    }
}

/// Whether the shot is to blame, and not the scene.
fn is_failed_shot(error: &TargetError) -> bool {
    match error {
        TargetError::Sim(e) | TargetError::Task(TaskError::Sim(e)) => {
            e.is_invalid_rollout() || matches!(e, SimError::Refused(_))
        }
        _ => false,
    }
}
