//! Plans, made of what the planner sees.

use super::seen::Seen;
use super::{BilliardsBench, Row, Shot};
use crate::BenchError;
use sms_core::{Cancel, NoProgress, Progress, Seed, Warnings};
use sms_plan::{Plan, PlanConfig, PlanError, plan, search_nominal};
use sms_robot::RobotConfig;
use sms_scene::Scene;
use sms_sim::RapierFactory;
use sms_task::ResolvedTask;
use std::collections::BTreeMap;
use std::time::Instant;

/// Plans of every row with the seconds that they took.
pub(super) type Plans = BTreeMap<Row, (Vec<Shot>, f64)>;

/// Plans with every row. Looks at nothing but its arguments.
pub(super) fn make(
    bench: &BilliardsBench,
    seen: &Seen,
    robot: &RobotConfig,
    seed: Seed,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<Plans, BenchError> {
    let free = seen.task.resolve(&seen.scene).map_err(PlanError::from)?;
    let task = free.clone().with_robot(robot, &seen.scene)?;
    let planner = Planner { bench, task: &task, scene: &seen.scene, seed, cancel };
    let mut plans = Plans::new();
    progress.begin("bench billiards: plans", (bench.starts + 3) as u64);
    for (i, row) in [Row::Grid, Row::Paper, Row::Robust, Row::Ours].into_iter().enumerate() {
        let began = Instant::now();
        let shots = match row {
            Row::Grid => vec![planner.grid(&free)?],
            Row::Paper => planner.paper()?,
            Row::Robust => vec![planner.whole(&bench.robust, seed.derive("robust"))?],
            Row::Ours => (0..bench.starts)
                .map(|k| {
                    progress.update((i + k) as u64, row.as_str());
                    planner.whole(&bench.ours, seed.derive_index("ours", k as u64))
                })
                .collect::<Result<_, _>>()?,
        };
        progress.update(i as u64 + 1, row.as_str());
        plans.insert(row, (shots, began.elapsed().as_secs_f64()));
    }
    progress.end("");
    Ok(plans)
}

struct Planner<'a> {
    bench: &'a BilliardsBench,
    task: &'a ResolvedTask,
    scene: &'a Scene,
    seed: Seed,
    cancel: &'a Cancel,
}

impl Planner<'_> {
    /// Distance of the target ball from the goal in the scanned world.
    fn idle_m(&self) -> f64 {
        let goal = self.task.goal_w().unwrap_or_default();
        self.task.target().center_w.truncate().distance(goal)
    }

    fn nothing(&self, evaluations: usize) -> Shot {
        Shot {
            action: None,
            predicted_m: self.idle_m(),
            predicted_mean_m: None,
            evaluations,
            iterations: 0,
            by_arm: true,
        }
    }

    /// The baseline knows no arm; a strike that the arm cannot make is made by a finger that gives no way.
    fn grid(&self, free: &ResolvedTask) -> Result<Shot, BenchError> {
        let found = self.bench.grid.plan(free, self.scene)?;
        let by_arm = self.task.striker(&self.task.strike(&found.action)).is_ok();
        Ok(Shot { action: Some(found.action), predicted_m: found.predicted_m, by_arm, ..self.nothing(0) })
    }

    fn paper(&self) -> Result<Vec<Shot>, BenchError> {
        let config = PlanConfig { starts: self.bench.starts, ..self.bench.paper.clone() };
        let seed = self.seed.derive("paper");
        let found =
            search_nominal(self.task, self.scene, &RapierFactory, &config, usize::MAX, seed, self.cancel)?;
        let shot = |s: sms_plan::StartSummary| {
            let counted = Shot { iterations: s.iterations, ..self.nothing(s.evaluations) };
            if s.objective.is_finite() {
                Shot { action: Some(s.action), predicted_m: s.objective, ..counted }
            } else {
                counted
            }
        };
        Ok(found.starts.into_iter().map(shot).collect())
    }

    fn whole(&self, config: &PlanConfig, seed: Seed) -> Result<Shot, BenchError> {
        let found = plan(
            self.task,
            self.scene,
            &RapierFactory,
            config,
            seed,
            &NoProgress,
            self.cancel,
            &Warnings::new(),
        );
        match found {
            Ok(outcome) => {
                let Plan { action, objective, predicted, evaluations, .. } = outcome.plan;
                Ok(Shot {
                    action: Some(action),
                    predicted_m: objective,
                    predicted_mean_m: predicted.map(|p| p.mean),
                    ..self.nothing(evaluations)
                })
            }
            Err(PlanError::OutOfReach(_)) => Ok(self.nothing(config.robust_evaluations)),
            Err(PlanError::Nothing { evaluations, .. }) => Ok(self.nothing(evaluations)),
            Err(other) => Err(other.into()),
        }
    }
}
