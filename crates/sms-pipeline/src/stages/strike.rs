//! Scene and task → the plan of a strike.

use crate::{Error, RobotPlace};
use sms_core::StageContext;
use sms_plan::{PlanConfig, PlanError, PlanOutcome};
use sms_scene::Scene;
use sms_sim::RapierFactory;
use sms_task::{ResolvedTask, Task};

/// A task resolved in a scene, for the robot and for a kinematic finger.
#[derive(Debug, Clone)]
pub struct StrikeProblem {
    /// The task without a robot.
    pub task: ResolvedTask,
    with_robot: ResolvedTask,
    is_default_robot: bool,
}

impl StrikeProblem {
    /// Resolves a task in a scene.
    ///
    /// # Errors
    /// [`Error::Task`] if the scene does not have the bodies, [`Error::Input`] if the robot cannot be used.
    pub fn new(task: &Task, scene: &Scene, robot: &RobotPlace) -> Result<Self, Error> {
        let task = task.resolve(scene)?;
        let with_robot = task.clone().with_robot(&robot.config, scene)?;
        Ok(Self { task, with_robot, is_default_robot: robot.is_from_recording })
    }

    /// Searches for the best strike. If the default robot of a generated recording reaches none, plans with a kinematic
    /// finger of infinite mass instead and adds a warning.
    ///
    /// # Errors
    /// As [`sms_plan::plan`].
    pub fn plan(
        &self,
        scene: &Scene,
        config: &PlanConfig,
        context: StageContext<'_>,
    ) -> Result<PlanOutcome, Error> {
        let search = |task| sms_plan::plan(task, scene, &RapierFactory, config, context);
        match search(&self.with_robot) {
            Err(PlanError::OutOfReach(e)) if self.is_default_robot => {
                context.warnings.add(
                    "plan",
                    "no_strike_in_reach",
                    e.what,
                    "this plan is for a kinematic finger; set the robot's pose in [robot] of the settings",
                );
                Ok(search(&self.task)?)
            }
            other => Ok(other?),
        }
    }
}
