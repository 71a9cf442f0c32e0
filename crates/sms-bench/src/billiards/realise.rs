//! What becomes of plans in the target worlds. The truth is looked at here.

use super::seen::Seen;
use super::{Row, Shot};
use crate::BenchError;
use rayon::prelude::*;
use sms_core::{Cancel, Progress};
use sms_robot::RobotConfig;
use sms_sim::SimError;
use sms_synth::TruthScene;
use sms_target::{Target, TargetError, TargetOptions, execute_on};
use sms_task::{Action, TaskError};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};

/// A shot by what decides its outcome: the values' bits, and whether the arm makes it.
type Key = (Vec<u64>, bool);

fn key(shot: &Shot) -> Option<Key> {
    shot.action.as_ref().map(|a| (a.0.iter().map(|v| v.to_bits()).collect(), shot.by_arm))
}

/// Carries every distinct shot out once. `None` where the engine cannot finish it; what does nothing leaves the ball where
/// it is.
pub(super) fn realise(
    target: &dyn Target,
    seen: &Seen,
    truth: &TruthScene,
    robot: &RobotConfig,
    plans: &BTreeMap<Row, Vec<Shot>>,
    idle_m: f64,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<BTreeMap<Row, Vec<Option<f64>>>, BenchError> {
    let mut distinct: BTreeMap<Key, &Action> = BTreeMap::new();
    for shot in plans.values().flatten() {
        if let (Some(key), Some(action)) = (key(shot), &shot.action) {
            distinct.insert(key, action);
        }
    }
    let distinct: Vec<(Key, &Action)> = distinct.into_iter().collect();
    progress.begin(&format!("bench billiards: {}", target.label()), distinct.len() as u64);
    let done = AtomicU64::new(0);
    let outcomes: BTreeMap<Key, Option<f64>> = distinct
        .into_par_iter()
        .map(|(key, action)| {
            cancel.check()?;
            let robot = if key.1 { robot.clone() } else { RobotConfig::default() };
            let options = TargetOptions { chaos_runs: 0, robot, ..TargetOptions::default() };
            let outcome = match execute_on(target, &seen.task, action, &seen.scene, truth, &options) {
                Ok(execution) => Some(execution.objective),
                Err(e) if is_failed_shot(&e) => None,
                Err(e) => return Err(BenchError::from(e)),
            };
            progress.update(done.fetch_add(1, Ordering::SeqCst) + 1, "shots");
            Ok((key, outcome))
        })
        .collect::<Result<_, _>>()?;
    progress.end("");
    let of = |shot: &Shot| key(shot).map_or(Some(idle_m), |k| outcomes[&k]);
    Ok(plans.iter().map(|(row, shots)| (*row, shots.iter().map(of).collect())).collect())
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
