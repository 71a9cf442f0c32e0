//! State that all stages of planning share.

use crate::counter::Counter;
use crate::space::Space;
use crate::strategy::strategy_of;
use crate::worlds::Worlds;
use crate::{LocalSearch, PlanConfig, PlanError};
use sms_core::Seed;
use sms_scene::Scene;
use sms_sim::WorldFactory;
use sms_task::{Action, ResolvedTask, Rollout};

/// One planning run: its input, the scanned world and the counter of rollouts.
pub(crate) struct Session<'a> {
    pub(crate) task: &'a ResolvedTask,
    /// The scanned scene.
    pub(crate) scene: &'a Scene,
    pub(crate) factory: &'a dyn WorldFactory,
    pub(crate) config: &'a PlanConfig,
    pub(crate) seed: Seed,
    pub(crate) space: Space,
    /// The scanned world.
    pub(crate) nominal: Worlds<'a>,
    pub(crate) counter: Counter<'a>,
}

impl Session<'_> {
    /// Whether the robot can carry out the strike of a unit point.
    pub(crate) fn is_feasible(&self, x: &[f64]) -> Result<bool, PlanError> {
        self.counter.draw(self.task, &self.space.action(x))
    }

    /// The next point of a local search with a strike that the robot can carry out; `None` at the end of the search.
    pub(crate) fn next_feasible(&self, search: &mut LocalSearch) -> Result<Option<Vec<f64>>, PlanError> {
        while let Some(x) = search.next_point().map(<[f64]>::to_vec) {
            if self.is_feasible(&x)? {
                return Ok(Some(x));
            }
            search.refuse();
        }
        Ok(None)
    }

    /// Whether the whole motion of an action, from home to the lift, passes every check of the robot.
    pub(crate) fn is_executable(&self, action: &Action) -> Result<bool, PlanError> {
        self.counter.executable(self.task, action)
    }

    /// The name of the strategy that a rollout follows.
    pub(crate) fn strategy_of(&self, rollout: &Rollout) -> String {
        strategy_of(rollout, self.scene, self.task)
    }
}
