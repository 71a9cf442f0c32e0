//! The motion of a strike as a table that a robot's own program replays, in JSON and Parquet.

use crate::arm::control::osc::joint_friction;
use crate::arm::dynamics::workspace::Workspace;
use crate::arm::model::RobotModel;
use crate::arm::strike::approach::{Phase, StrikePlan};
use crate::arm::strike::check::StrikeCheck;
use crate::arm::strike::motion::{JointSample, motor_torques};
use glamx::{DPose3, DQuat};
use serde::{Deserialize, Serialize};
use sms_core::table::{Column, write_table};
use sms_core::{CoreError, InputError, atomic};
use std::path::Path;

/// What a program says of itself that no check has looked at.
const NOT_CHECKED: &str = "nothing was checked";

/// Version of the files.
pub const PROGRAM_VERSION: u32 = 1;

/// One row of a [`JointProgram`]; vectors have one entry for each joint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProgramPoint {
    /// Seconds from the start.
    pub time_s: f64,
    /// What this part of the motion is for.
    pub phase: Phase,
    /// Positions, rad (m).
    pub q: Vec<f64>,
    /// Speeds, rad/s (m/s).
    pub qd: Vec<f64>,
    /// Torques of the motors with gravity and friction, N·m (N).
    pub tau: Vec<f64>,
    /// The part that has to be sent to a robot whose joints control the torque behind the gear and compensate gravity
    /// and friction themselves: M q̈ + C q̇ without the rotors' inertia. libfranka's `Torques` are of this kind.
    pub tau_command: Vec<f64>,
    /// Position of the tool in the world, metres.
    pub tool_position_w: [f64; 3],
    /// Attitude of the tool in the world, as x, y, z, w.
    pub tool_quaternion_w: [f64; 4],
}

/// A motion of the robot's joints at a fixed rate, from rest to rest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointProgram {
    /// [`PROGRAM_VERSION`].
    pub version: u32,
    /// Name of the robot.
    pub robot: String,
    /// Names of the joints, in the order of all vectors.
    pub joints: Vec<String>,
    /// Link whose pose is given.
    pub tool: String,
    /// Pose of the robot's base in the world: position, metres.
    pub base_position_w: [f64; 3],
    /// Attitude of the base in the world, as x, y, z, w.
    pub base_quaternion_w: [f64; 4],
    /// Time between points, seconds.
    pub period_s: f64,
    /// When the tool is at the contact, seconds.
    pub contact_s: f64,
    /// Asked speed of the tool at the contact, m/s.
    pub contact_speed: f64,
    /// Whether every check of [`crate::check_strike`] passed. What says nothing of it is not executable.
    #[serde(default)]
    pub executable: bool,
    /// The checks that did not pass, in words.
    #[serde(default)]
    pub failed_checks: Vec<String>,
    /// The points.
    pub points: Vec<ProgramPoint>,
}

impl JointProgram {
    /// The program of a strike, one point every `period_s` seconds; not executable until it is [`Self::checked`].
    pub fn of_strike(model: &RobotModel, plan: &StrikePlan, period_s: f64, ws: &mut Workspace) -> Self {
        let n = model.dof();
        let total: f64 = plan.phases.iter().map(|(_, m)| m.duration_s()).sum();
        let count = (total / period_s).ceil() as usize;
        let points = (0..=count)
            .map(|k| {
                let time_s = k as f64 * period_s;
                let (phase, s) = plan.at(model, time_s, ws);
                let friction = |i: usize| {
                    let joint = &model.joints()[i];
                    joint_friction(joint.damping, joint.friction, s.qd[i])
                };
                let mut gravity = [0.0; crate::MAX_JOINTS];
                model.gravity_torques(&s.q, ws, &mut gravity);
                // Gravity's pass leaves the placement of all joints.
                let x_wt = model.frame_pose(model.tool(), ws);
                ProgramPoint {
                    time_s,
                    phase,
                    q: s.q[..n].to_vec(),
                    qd: s.qd[..n].to_vec(),
                    tau: s.tau[..n].to_vec(),
                    tau_command: (0..n)
                        .map(|i| s.tau[i] - gravity[i] - friction(i) - model.joints()[i].armature * s.qdd[i])
                        .collect(),
                    tool_position_w: x_wt.translation.to_array(),
                    tool_quaternion_w: x_wt.rotation.to_array(),
                }
            })
            .collect();
        Self {
            version: PROGRAM_VERSION,
            robot: model.name().to_owned(),
            joints: model.joints().iter().map(|j| j.name.clone()).collect(),
            tool: model.frames()[model.tool().0].name.clone(),
            base_position_w: model.x_wr().translation.to_array(),
            base_quaternion_w: model.x_wr().rotation.to_array(),
            period_s,
            contact_s: plan.contact_s(),
            contact_speed: plan.sweep.sweep.speed,
            executable: false,
            failed_checks: vec![NOT_CHECKED.to_owned()],
            points,
        }
    }

    /// The same program, marked with what its check found.
    pub fn checked(self, check: &StrikeCheck) -> Self {
        let failed_checks = check.failed().map(|i| i.detail.clone()).collect();
        Self { executable: check.executable(), failed_checks, ..self }
    }

    /// Pose of the base, `X_WR`.
    pub fn x_wr(&self) -> DPose3 {
        DPose3::from_parts(self.base_position_w.into(), DQuat::from_array(self.base_quaternion_w))
    }

    /// Writes JSON.
    ///
    /// # Errors
    /// [`CoreError::Write`].
    pub fn write_json(&self, path: &Path) -> Result<(), CoreError> {
        atomic::write_json(path, self)
    }

    /// Reads what [`Self::write_json`] wrote.
    ///
    /// # Errors
    /// [`CoreError`] when the file is missing, is no such program, or holds vectors of the wrong length.
    pub fn read_json(path: &Path) -> Result<Self, CoreError> {
        let program: Self = atomic::read_json(path)?;
        let n = program.joints.len();
        let whole = |p: &ProgramPoint| [&p.q, &p.qd, &p.tau, &p.tau_command].iter().all(|v| v.len() == n);
        if program.version != PROGRAM_VERSION || !program.points.iter().all(whole) {
            let what = "this is no joint program of this version, or a vector in it has the wrong length";
            return Err(InputError::new(what, path, "plan again").into());
        }
        Ok(program)
    }

    /// Writes one row for each point to a Parquet file: `time_s`, `phase`, `executable` (1, or 0 in every row), for each joint `q_NAME`, `qd_NAME`,
    /// `tau_NAME`, `tau_command_NAME`, and the tool's `x`, `y`, `z`, `qx`, `qy`, `qz`, `qw`; units as in
    /// [`ProgramPoint`].
    ///
    /// # Errors
    /// [`CoreError::Write`].
    pub fn write_parquet(&self, path: &Path) -> Result<(), CoreError> {
        let column =
            |value: &dyn Fn(&ProgramPoint) -> f64| Column::F64(self.points.iter().map(value).collect());
        let phases = self.points.iter().map(|p| p.phase.name().to_owned()).collect();
        let executable = vec![i32::from(self.executable); self.points.len()];
        let mut columns: Vec<(String, Column)> = vec![
            ("time_s".to_owned(), column(&|p| p.time_s)),
            ("phase".to_owned(), Column::Text(phases)),
            ("executable".to_owned(), Column::I32(executable)),
        ];
        for (i, joint) in self.joints.iter().enumerate() {
            columns.push((format!("q_{joint}"), column(&|p| p.q[i])));
            columns.push((format!("qd_{joint}"), column(&|p| p.qd[i])));
            columns.push((format!("tau_{joint}"), column(&|p| p.tau[i])));
            columns.push((format!("tau_command_{joint}"), column(&|p| p.tau_command[i])));
        }
        for (i, name) in ["x", "y", "z"].into_iter().enumerate() {
            columns.push((name.to_owned(), column(&|p| p.tool_position_w[i])));
        }
        for (i, name) in ["qx", "qy", "qz", "qw"].into_iter().enumerate() {
            columns.push((name.to_owned(), column(&|p| p.tool_quaternion_w[i])));
        }
        write_table(path, &columns)
    }
}

impl Phase {
    /// The name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Approach => "approach",
            Self::Descent => "descent",
            Self::Sweep => "sweep",
            Self::Lift => "lift",
        }
    }
}

impl StrikePlan {
    /// Duration of all phases, seconds.
    pub fn duration_s(&self) -> f64 {
        self.phases.iter().map(|(_, m)| m.duration_s()).sum()
    }

    /// Phase and joints at `time_s` seconds from the start of the approach, between samples by a cubic whose ends have
    /// their positions and speeds; torques are those of that motion.
    pub fn at(&self, model: &RobotModel, time_s: f64, ws: &mut Workspace) -> (Phase, JointSample) {
        let mut rest = time_s.max(0.0);
        let last = self.phases.len() - 1;
        for (k, (phase, motion)) in self.phases.iter().enumerate() {
            if rest > motion.duration_s() && k < last {
                rest -= motion.duration_s();
                continue;
            }
            let h = motion.period_s;
            let steps = motion.samples.len() - 1;
            let index = ((rest / h).floor() as usize).min(steps);
            let before = &motion.samples[index];
            let share = rest / h - index as f64;
            let mut s = *before;
            if share > 1e-9 && index < steps {
                let after = &motion.samples[index + 1];
                for i in 0..model.dof() {
                    let u = share;
                    // Cubic Hermite.
                    let by = after.q[i] - before.q[i];
                    let (a, b) = (h * before.qd[i] - by, by - h * after.qd[i]);
                    s.q[i] = before.q[i] + u * by + u * (1.0 - u) * ((1.0 - u) * a + u * b);
                    s.qd[i] = before.qd[i] + u * (after.qd[i] - before.qd[i]);
                    s.qdd[i] = before.qdd[i] + u * (after.qdd[i] - before.qdd[i]);
                }
                s.tau = motor_torques(model, &s.q, &s.qd, &s.qdd, ws);
            }
            return (*phase, s);
        }
        // Not reached: the last phase always returns.
        (Phase::Lift, self.phases[last].1.samples[0])
    }
}
