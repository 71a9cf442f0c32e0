//! Plans, made from the planner's view alone.

use super::{BilliardsBench, Row, Shot};
use crate::BenchError;
use crate::cpu_time::cpu_seconds;
use sms_core::{Cancel, Progress, Seed, StageContext, Warnings};
use sms_plan::{Plan, PlanConfig, PlanError, optimiser, plan, search_nominal};
use sms_robots::RobotConfig;
use sms_scene::Scene;
use sms_sim::RapierFactory;
use sms_task::{ResolvedTask, Task, Trajectory};
use std::time::Instant;

/// A scene with the task that is to be done in it.
#[derive(Clone, Copy)]
pub(super) struct View<'a> {
    pub(super) task: &'a Task,
    pub(super) scene: &'a Scene,
}

/// The plans of a row.
pub(super) struct Planned {
    pub(super) shots: Vec<Shot>,
    /// Seconds on the wall.
    pub(super) seconds: f64,
    /// CPU seconds, where the system tells.
    pub(super) cpu_s: Option<f64>,
    /// Predicted motion of a row with one plan.
    pub(super) motion: Option<Trajectory>,
}

/// Plans the rows of one scene with one robot.
#[derive(Clone, Copy)]
pub(super) struct RowPlanner<'a> {
    pub(super) bench: &'a BilliardsBench,
    pub(super) robot: &'a RobotConfig,
    pub(super) seed: Seed,
    pub(super) progress: &'a dyn Progress,
    pub(super) cancel: &'a Cancel,
}

impl RowPlanner<'_> {
    /// Plans with a row, with `starts` starts if it has any. The result depends on the arguments and the planner's fields only.
    pub(super) fn plan(&self, view: View<'_>, row: Row, starts: usize) -> Result<Planned, BenchError> {
        let &Self { bench, robot, seed, progress, cancel } = self;
        let free = view.task.resolve(view.scene).map_err(PlanError::from)?;
        let task = free.clone().with_robot(robot, view.scene)?;
        let planner = TaskPlanner { bench, task: &task, scene: view.scene, seed, cancel };
        let count = if row == Row::Ours { starts } else { 1 };
        progress.begin(&format!("bench billiards: plans, {}", row.as_str()), count as u64);
        let (began, cpu) = (Instant::now(), cpu_seconds());
        let mut motion = None;
        let shots = match row {
            Row::Grid => vec![planner.grid(&free)?],
            Row::Paper => planner.paper(starts)?,
            Row::Robust => {
                let (shot, predicted) = planner.whole(&bench.robust, seed.derive("robust"))?;
                motion = predicted;
                vec![shot]
            }
            Row::Ours => (0..starts)
                .map(|k| {
                    let seed = seed.derive_index("ours", k as u64);
                    let (shot, _) = planner.whole(&bench.ours, seed)?;
                    progress.update(k as u64 + 1, "starts");
                    Ok(shot)
                })
                .collect::<Result<_, BenchError>>()?,
        };
        progress.end("");
        Ok(Planned {
            shots,
            seconds: began.elapsed().as_secs_f64(),
            cpu_s: cpu_seconds().zip(cpu).map(|(now, then)| now - then),
            motion,
        })
    }
}

struct TaskPlanner<'a> {
    bench: &'a BilliardsBench,
    task: &'a ResolvedTask,
    scene: &'a Scene,
    seed: Seed,
    cancel: &'a Cancel,
}

impl TaskPlanner<'_> {
    /// Distance of the target ball from the goal in the scanned world.
    fn idle_m(&self) -> f64 {
        let goal = self.task.goal_w().unwrap_or_default();
        self.task.target().center_w.truncate().distance(goal)
    }

    fn nothing(&self, evaluations: usize) -> Shot {
        Shot { evaluations, ..Shot::nothing(self.idle_m()) }
    }

    /// The baseline has no arm; a strike that the arm cannot make is made by a kinematic finger.
    fn grid(&self, free: &ResolvedTask) -> Result<Shot, BenchError> {
        let found = self.bench.grid.plan(free, self.scene)?;
        let by_arm = self.task.striker(&self.task.strike(&found.action)).is_ok();
        Ok(Shot { action: Some(found.action), predicted_m: found.predicted_m, by_arm, ..self.nothing(0) })
    }

    fn paper(&self, starts: usize) -> Result<Vec<Shot>, BenchError> {
        let config = PlanConfig { starts, ..self.bench.paper.clone() };
        let seed = self.seed.derive("paper").derive("search");
        let found = search_nominal(
            self.task,
            self.scene,
            &RapierFactory,
            &|space, feasible| optimiser(space, &config, seed, feasible),
            usize::MAX,
            self.cancel,
        )?;
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

    /// A plan of ours with its predicted motion.
    fn whole(&self, config: &PlanConfig, seed: Seed) -> Result<(Shot, Option<Trajectory>), BenchError> {
        let found = plan(
            self.task,
            self.scene,
            &RapierFactory,
            config,
            StageContext::quiet(self.cancel, &Warnings::new()).with_seed(seed),
        );
        match found {
            Ok(outcome) => {
                let Plan { action, objective, predicted, evaluations, starts, trajectory, .. } = outcome.plan;
                let shot = Shot {
                    action: Some(action),
                    predicted_m: objective,
                    predicted_mean_m: predicted.map(|p| p.mean),
                    iterations: starts.iter().map(|s| s.iterations).sum(),
                    ..self.nothing(evaluations)
                };
                Ok((shot, Some(trajectory)))
            }
            Err(PlanError::OutOfReach(_)) => Ok((self.nothing(config.robust_evaluations), None)),
            Err(PlanError::Nothing { evaluations, .. }) => Ok((self.nothing(evaluations), None)),
            Err(other) => Err(other.into()),
        }
    }
}
