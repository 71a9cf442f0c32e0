//! The robot arm that carries out the strikes of a task.

use crate::ResolvedTask;
use glamx::{DMat4, DPose3};
use sms_core::InputError;
use sms_robots::{
    ArmStrike, Obstacle, RobotConfig, RobotModel, StrikeConfig, StrikeError, ToolPath, Workspace,
    check_strike, obstacles, plan_startable_sweep, plan_strike,
};
use sms_scene::Scene;
use sms_sim::{SimError, Striker, StrikerMotion};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

/// A robot in the planner's scene with a cache of planned sweeps. A sweep depends only on the action, so it is planned
/// once for all worlds.
pub struct RobotArm {
    settings: RobotConfig,
    model: Arc<RobotModel>,
    config: StrikeConfig,
    obstacles: Vec<Obstacle>,
    planned: Mutex<BTreeMap<[u64; 6], Result<Arc<ArmStrike>, StrikeError>>>,
}

impl RobotArm {
    /// Creates the robot of the settings, with the bodies of a scene as obstacles. The struck body is not an obstacle.
    /// `None` if the settings have no pose of the robot.
    ///
    /// # Errors
    /// [`InputError`] of the robot's URDF.
    pub fn new(config: &RobotConfig, scene: &Scene, struck: usize) -> Result<Option<Self>, InputError> {
        let Some(x_wr) = config.x_wr(&scene.x_world_recording) else { return Ok(None) };
        let settings =
            RobotConfig { x_world_robot: Some(rows(&x_wr)), x_recording_robot: None, ..config.clone() };
        Ok(Some(Self {
            model: Arc::new(config.model()?.with_base(x_wr)),
            config: config.strike_config(),
            obstacles: obstacles(scene, struck),
            settings,
            planned: Mutex::default(),
        }))
    }

    /// The settings, with the pose of the robot in the world of the scene.
    pub fn settings(&self) -> &RobotConfig {
        &self.settings
    }

    /// The robot model with its base in the world.
    pub fn model(&self) -> &RobotModel {
        &self.model
    }

    /// Plans the sweep of a strike, in a posture that the arm can reach from home.
    ///
    /// # Errors
    /// [`StrikeError`]: out of reach, beyond a joint limit, or blocked by an obstacle.
    pub fn strike(&self, motion: &StrikerMotion) -> Result<Arc<ArmStrike>, StrikeError> {
        let c = motion.contact_w;
        let key = [c.x, c.y, c.z, motion.angle, motion.speed, motion.ball_radius].map(f64::to_bits);
        if let Some(known) = self.planned.lock().ok().and_then(|p| p.get(&key).cloned()) {
            return known;
        }
        let half = self.config.half_m;
        let sweep = motion.sweep(half.x);
        let ws = &mut Workspace::default();
        let found = plan_startable_sweep(&self.model, &sweep, &self.obstacles, &self.config, ws)
            .map(|plan| Arc::new(ArmStrike::of_plan(self.model.clone(), &plan, self.config.osc, half)));
        if let Ok(mut planned) = self.planned.lock() {
            planned.insert(key, found.clone());
        }
        found
    }

    /// Checks the whole motion of a strike, from home to the lift after it, as `sms robot` does. Returns the name of
    /// the first failed check, without values, or `None`. Takes about ten times as long as [`Self::strike`].
    pub fn not_executable(&self, motion: &StrikerMotion) -> Option<String> {
        let ws = &mut Workspace::default();
        let sweep = motion.sweep(self.config.half_m.x);
        let strike = match plan_strike(&self.model, &sweep, &self.obstacles, &self.config, ws) {
            Ok(strike) => strike,
            Err(e) => return Some(e.reason()),
        };
        let check = check_strike(&self.model, &strike, &self.obstacles, &self.config, ws);
        let failed = check.failed().next()?;
        Some(format!("the motion from home fails the check of {}", failed.kind.name()))
    }

    /// Plans the sweep of a strike with execution errors: the posture and tool orientation of the commanded strike,
    /// moved to the start of the actual one. Limits and obstacles are checked for the commanded strike.
    ///
    /// # Errors
    /// [`StrikeError`] of the commanded strike, or if the posture cannot follow.
    pub fn strike_near(
        &self,
        commanded: &StrikerMotion,
        carried_out: &StrikerMotion,
    ) -> Result<Arc<ArmStrike>, StrikeError> {
        let commanded = self.strike(commanded)?;
        let moved = commanded.moved_to(|front_m| carried_out.sweep(front_m));
        let start = moved.path().at(0.0).x_wt;
        let ws = &mut Workspace::default();
        let q_start = self.model.refine(&start, &commanded.q_start, &self.config.ik, ws)?;
        Ok(Arc::new(ArmStrike { q_start, ..moved }))
    }
}

impl std::fmt::Debug for RobotArm {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RobotArm").field("settings", &self.settings).finish_non_exhaustive()
    }
}

/// Row-major 4 × 4 matrix of a pose.
fn rows(x: &DPose3) -> [[f64; 4]; 4] {
    DMat4::from_rotation_translation(x.rotation, x.translation).transpose().to_cols_array_2d()
}

impl ResolvedTask {
    /// Returns the same task for the robot of the settings, or for a kinematic finger if they have no pose of the
    /// robot. `scene` is the scene in which the task was resolved.
    ///
    /// # Errors
    /// [`InputError`] of the robot's URDF.
    pub fn with_robot(mut self, config: &RobotConfig, scene: &Scene) -> Result<Self, InputError> {
        self.arm = RobotArm::new(config, scene, self.cue().index)?.map(Arc::new);
        Ok(self)
    }

    /// The robot that carries out strikes; `None` for the finger.
    pub fn arm(&self) -> Option<&RobotArm> {
        self.arm.as_deref()
    }

    /// The name of the check that the whole motion of a strike fails. `None` if every check passes, or without a
    /// robot.
    pub fn not_executable(&self, motion: &StrikerMotion) -> Option<String> {
        self.arm.as_ref()?.not_executable(motion)
    }

    /// The name of the striker.
    pub fn striker_name(&self) -> String {
        match &self.arm {
            Some(arm) => format!("{} under torque control", arm.model().name()),
            None => "a kinematic finger (no robot pose is known)".to_owned(),
        }
    }

    /// The striker for a strike.
    ///
    /// # Errors
    /// [`SimError::Refused`] if the arm cannot carry it out.
    pub fn striker(&self, motion: &StrikerMotion) -> Result<Striker, SimError> {
        Ok(match &self.arm {
            Some(arm) => Striker::Arm(arm.strike(motion)?),
            None => motion.into(),
        })
    }

    /// The striker for a strike with execution errors. `commanded` is the strike without them.
    ///
    /// # Errors
    /// [`SimError::Refused`] if the arm cannot carry out the commanded strike.
    pub fn striker_near(
        &self,
        commanded: &StrikerMotion,
        carried_out: &StrikerMotion,
    ) -> Result<Striker, SimError> {
        Ok(match &self.arm {
            Some(arm) => Striker::Arm(arm.strike_near(commanded, carried_out)?),
            None => carried_out.into(),
        })
    }
}
