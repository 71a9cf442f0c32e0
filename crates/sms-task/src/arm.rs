//! The arm that carries a task's strikes out.

use crate::ResolvedTask;
use glamx::{DMat4, DPose3};
use sms_core::{Hash, Hasher, InputError};
use sms_robots::{
    ArmStrike, IkTarget, Obstacle, RobotConfig, RobotModel, StrikeConfig, StrikeError, ToolPath, Workspace,
    check_strike, obstacles, plan_startable_sweep, plan_strike,
};
use sms_scene::{BodyShape, Scene};
use sms_sim::{SimError, Striker, StrikerMotion};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

/// A robot in the planner's scene, with the sweeps that were planned for it. A sweep depends on the action alone; it is
/// planned once, however many worlds it is tried in.
pub struct RobotArm {
    settings: RobotConfig,
    model: Arc<RobotModel>,
    config: StrikeConfig,
    around: Vec<Obstacle>,
    /// Of the scene's bodies and of the one that is struck: two arms are the same only among the same things.
    among: Hash,
    planned: Mutex<BTreeMap<[u64; 6], Result<Arc<ArmStrike>, StrikeError>>>,
}

impl RobotArm {
    /// The robot of the settings, among the bodies of a scene; the one that is struck is no obstacle. `None` where the
    /// settings do not say where it stands.
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
            around: obstacles(scene, struck),
            among: hash_of(scene, struck),
            settings,
            planned: Mutex::default(),
        }))
    }

    /// The settings of the robot, with its place in the world of the scene.
    pub fn settings(&self) -> &RobotConfig {
        &self.settings
    }

    /// The robot, standing in the world.
    pub fn model(&self) -> &RobotModel {
        &self.model
    }

    /// The arm's sweep for a strike, in a posture that it can come to from home.
    ///
    /// # Errors
    /// [`StrikeError`]: out of reach, beyond a limit, or something in the way.
    pub fn strike(&self, motion: &StrikerMotion) -> Result<Arc<ArmStrike>, StrikeError> {
        let c = motion.contact_w;
        let key = [c.x, c.y, c.z, motion.angle, motion.speed, motion.ball_radius].map(f64::to_bits);
        if let Some(known) = self.planned.lock().ok().and_then(|p| p.get(&key).cloned()) {
            return known;
        }
        let half = self.config.half_m;
        let sweep = motion.sweep(half.x);
        let found =
            plan_startable_sweep(&self.model, &sweep, &self.around, &self.config, &mut Workspace::default());
        let found =
            found.map(|plan| Arc::new(ArmStrike::of_plan(self.model.clone(), &plan, self.config.osc, half)));
        if let Ok(mut planned) = self.planned.lock() {
            planned.insert(key, found.clone());
        }
        found
    }

    /// Checks the whole motion of a strike, from home to the lift after it, as `sms robot` does: `None` where every check
    /// passes, else what does not, without figures. Takes some ten times as long as [`Self::strike`].
    pub fn not_executable(&self, motion: &StrikerMotion) -> Option<String> {
        let ws = &mut Workspace::default();
        let sweep = motion.sweep(self.config.half_m.x);
        let strike = match plan_strike(&self.model, &sweep, &self.around, &self.config, ws) {
            Ok(strike) => strike,
            Err(e) => return Some(e.reason()),
        };
        let check = check_strike(&self.model, &strike, &self.around, &self.config, ws);
        let failed = check.failed().next()?;
        Some(format!("the motion from home does not pass the check of {}", failed.kind.name()))
    }

    /// The arm's sweep for a strike that is carried out a little off: the posture of the asked one, with the tool held as
    /// there, moved to the start of the other. Limits and obstacles are those of the asked one.
    ///
    /// # Errors
    /// [`StrikeError`] of the asked strike, or where the posture cannot follow.
    pub fn strike_near(
        &self,
        asked: &StrikerMotion,
        carried_out: &StrikerMotion,
    ) -> Result<Arc<ArmStrike>, StrikeError> {
        let asked = self.strike(asked)?;
        let moved = asked.moved_to(|front_m| carried_out.sweep(front_m));
        let start = IkTarget::Pose(moved.path().at(0.0).x_wt);
        let ws = &mut Workspace::default();
        let q_start = self.model.refine(&start, &asked.q_start, &self.config.ik, ws)?;
        Ok(Arc::new(ArmStrike { q_start, ..moved }))
    }
}

impl std::fmt::Debug for RobotArm {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RobotArm").field("settings", &self.settings).finish_non_exhaustive()
    }
}

impl PartialEq for RobotArm {
    fn eq(&self, other: &Self) -> bool {
        (&self.settings, &self.config, &self.among) == (&other.settings, &other.config, &other.among)
    }
}

/// What the obstacles are made from: names, poses and shapes of all bodies, and which is none.
fn hash_of(scene: &Scene, struck: usize) -> Hash {
    let mut hasher = Hasher::new();
    hasher.bytes(&struck.to_le_bytes());
    let mut numbers = |values: &[f64]| {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        hasher.bytes(&bytes);
    };
    for body in &scene.bodies {
        let (p, q) = (body.x_wb.translation, body.x_wb.rotation);
        numbers(&[p.x, p.y, p.z, q.x, q.y, q.z, q.w]);
        match &body.shape {
            BodyShape::Sphere { radius } => numbers(&[*radius]),
            BodyShape::HalfSpace => numbers(&[]),
            shape => {
                for mesh in shape.meshes() {
                    let corners: Vec<f64> = mesh.vertices.iter().flat_map(|v| v.to_array()).collect();
                    numbers(&corners);
                }
            }
        }
    }
    for body in &scene.bodies {
        hasher.text(&body.name);
    }
    hasher.finish()
}

/// Row-major 4 × 4 matrix of a pose.
fn rows(x: &DPose3) -> [[f64; 4]; 4] {
    DMat4::from_rotation_translation(x.rotation, x.translation).transpose().to_cols_array_2d()
}

impl ResolvedTask {
    /// The same task, carried out by the robot of the settings where they say where it stands; by a finger that gives
    /// no way where they do not. `scene` is the one that the task was resolved in.
    ///
    /// # Errors
    /// [`InputError`] of the robot's URDF.
    pub fn with_robot(mut self, config: &RobotConfig, scene: &Scene) -> Result<Self, InputError> {
        self.arm = RobotArm::new(config, scene, self.cue().index)?.map(Arc::new);
        Ok(self)
    }

    /// The robot that carries strikes out; `None` for the finger.
    pub fn arm(&self) -> Option<&RobotArm> {
        self.arm.as_deref()
    }

    /// Why a strike cannot be carried out from home to its end; `None` where every check of its whole motion passes, or
    /// where there is no robot to check.
    pub fn not_executable(&self, motion: &StrikerMotion) -> Option<String> {
        self.arm.as_ref()?.not_executable(motion)
    }

    /// What carries strikes out, in words.
    pub fn striker_name(&self) -> String {
        match &self.arm {
            Some(arm) => format!("{} under torque control", arm.model().name()),
            None => "a finger that gives no way (the robot's place is not known)".to_owned(),
        }
    }

    /// What carries a strike out.
    ///
    /// # Errors
    /// [`SimError::Refused`] when the arm cannot make it.
    pub fn striker(&self, motion: &StrikerMotion) -> Result<Striker, SimError> {
        Ok(match &self.arm {
            Some(arm) => Striker::Arm(arm.strike(motion)?),
            None => motion.into(),
        })
    }

    /// What carries a strike out that goes a little off: `asked` is what the arm was told.
    ///
    /// # Errors
    /// [`SimError::Refused`] when the arm cannot make the asked strike.
    pub fn striker_near(
        &self,
        asked: &StrikerMotion,
        carried_out: &StrikerMotion,
    ) -> Result<Striker, SimError> {
        Ok(match &self.arm {
            Some(arm) => Striker::Arm(arm.strike_near(asked, carried_out)?),
            None => carried_out.into(),
        })
    }
}
