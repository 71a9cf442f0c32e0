//! A strike as a joint trajectory for a robot's own program, in JSON and Parquet.

use crate::arm::strike::motion::{JointSample, motor_torques};
use crate::{Phase, RobotModel, StrikeCheck, StrikePlan, Workspace, joint_friction};
use serde::{Deserialize, Serialize};
use sms_core::CoreError;
use sms_core::table::{Column, write_table};
use std::path::Path;

/// The failed check of an unchecked program.
const NOT_CHECKED: &str = "nothing was checked";

/// Version of the format.
pub(super) const PROGRAM_VERSION: u32 = 1;

/// One row of a [`JointProgram`]; vectors have one entry per joint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProgramPoint {
    /// Seconds from the start.
    pub time_s: f64,
    /// Phase of the motion.
    pub phase: Phase,
    /// Positions, rad (m).
    pub q: Vec<f64>,
    /// Speeds, rad/s (m/s).
    pub qd: Vec<f64>,
    /// Torques of the motors with gravity and friction, N·m (N).
    pub tau: Vec<f64>,
    /// Command for a robot with joint torque control behind the gear that compensates gravity and friction itself: M q̈
    /// + C q̇ without rotor inertia, as libfranka's `Torques`.
    pub tau_command: Vec<f64>,
    /// Position of the tool in the world, metres.
    pub tool_position_w: [f64; 3],
    /// Attitude of the tool in the world, as x, y, z, w.
    pub tool_quaternion_w: [f64; 4],
}

/// A joint motion at a fixed rate, from rest to rest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointProgram {
    /// Version of the format.
    pub version: u32,
    /// Name of the robot.
    pub robot: String,
    /// Names of the joints, in the order of all vectors.
    pub joints: Vec<String>,
    /// Link of the tool's pose.
    pub tool: String,
    /// Pose of the robot's base in the world: position, metres.
    pub base_position_w: [f64; 3],
    /// Attitude of the base in the world, as x, y, z, w.
    pub base_quaternion_w: [f64; 4],
    /// Time between points, seconds.
    pub period_s: f64,
    /// Time of the contact, seconds.
    pub contact_s: f64,
    /// Requested speed of the tool at the contact, m/s.
    pub contact_speed: f64,
    /// Whether every check of [`crate::check_strike`] passed; false if absent.
    #[serde(default)]
    pub executable: bool,
    /// Descriptions of the failed checks.
    #[serde(default)]
    pub failed_checks: Vec<String>,
    /// The points.
    pub points: Vec<ProgramPoint>,
}

impl JointProgram {
    /// Samples a strike every `period_s` seconds. The program is not executable until [`Self::checked`].
    pub fn of_strike(model: &RobotModel, plan: &StrikePlan, period_s: f64, ws: &mut Workspace) -> Self {
        let n = model.dof();
        let count = (plan.duration_s() / period_s).ceil() as usize;
        let points = (0..=count)
            .map(|k| {
                let time_s = k as f64 * period_s;
                let (phase, s) = plan.at(model, time_s, ws);
                let mut gravity = [0.0; crate::MAX_JOINTS];
                model.gravity_torques(&s.q, ws, &mut gravity);
                let command = |i: usize| {
                    let joint = &model.joints()[i];
                    let friction = joint_friction(joint.damping, joint.friction, s.qd[i]);
                    s.tau[i] - gravity[i] - friction - joint.armature * s.qdd[i]
                };
                // `gravity_torques` has computed the forward kinematics.
                let x_wt = model.frame_pose(model.tool(), ws);
                ProgramPoint {
                    time_s,
                    phase,
                    q: s.q[..n].to_vec(),
                    qd: s.qd[..n].to_vec(),
                    tau: s.tau[..n].to_vec(),
                    tau_command: (0..n).map(command).collect(),
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

    /// Returns the program with the result of its checks.
    pub fn checked(self, check: &StrikeCheck) -> Self {
        let failed_checks = check.failed().map(|i| i.detail.clone()).collect();
        Self { executable: check.executable(), failed_checks, ..self }
    }

    /// Writes one row per point to a Parquet file: `time_s`, `phase`, `executable` (1, or 0 in every row), for each
    /// joint `q_NAME`, `qd_NAME`, `tau_NAME`, `tau_command_NAME`, and the tool's `x`, `y`, `z`, `qx`, `qy`, `qz`, `qw`;
    /// units as in JSON.
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
    /// The phase's name in files.
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

    /// Returns the phase and the joint state at `time_s` seconds from the start of the approach. Between samples,
    /// positions are cubic Hermite interpolants, and torques are those of the interpolated motion.
    pub fn at(&self, model: &RobotModel, time_s: f64, ws: &mut Workspace) -> (Phase, JointSample) {
        let (mut rest, mut k) = (time_s.max(0.0), 0);
        while k + 1 < self.phases.len() && rest > self.phases[k].1.duration_s() {
            rest -= self.phases[k].1.duration_s();
            k += 1;
        }
        let (phase, motion) = &self.phases[k];
        let h = motion.period_s;
        let steps = motion.samples.len() - 1;
        let index = ((rest / h).floor() as usize).min(steps);
        let before = &motion.samples[index];
        let u = rest / h - index as f64;
        let mut s = *before;
        if u > 1e-9 && index < steps {
            let after = &motion.samples[index + 1];
            for i in 0..model.dof() {
                let by = after.q[i] - before.q[i];
                let (a, b) = (h * before.qd[i] - by, by - h * after.qd[i]);
                s.q[i] = before.q[i] + u * by + u * (1.0 - u) * ((1.0 - u) * a + u * b);
                s.qd[i] = before.qd[i] + u * (after.qd[i] - before.qd[i]);
                s.qdd[i] = before.qdd[i] + u * (after.qdd[i] - before.qdd[i]);
            }
            s.tau = motor_torques(model, &s.q, &s.qd, &s.qdd, ws);
        }
        (*phase, s)
    }
}
