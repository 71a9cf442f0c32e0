//! Result of carrying out a plan in a target world.

use crate::{Trajectory, json};
use serde::{Deserialize, Serialize};
use sms_core::{CoreError, atomic};
use std::path::Path;

/// Position of a realised objective in its predicted distribution.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AgainstPrediction {
    /// Predicted objective in the scanned world.
    pub nominal: f64,
    /// Mean of the predicted distribution.
    pub mean: f64,
    /// 90 % quantile of the predicted distribution.
    pub q90: f64,
    /// Share of the predicted worlds with a smaller objective than the realised one; equal ones count half. 0 is better
    /// than all worlds, 1 worse than all, 0.5 as expected.
    pub rank: f64,
    /// Number of predicted worlds with a valid rollout.
    pub worlds: usize,
}

impl AgainstPrediction {
    /// The rank as text: "worse than 78 % of 32 predicted worlds".
    pub fn rank_text(&self) -> String {
        let percent = (100.0 * self.rank).round();
        match self.rank {
            r if r <= 0.0 => format!("better than in all {} predicted worlds", self.worlds),
            r if r >= 1.0 => format!("worse than in all {} predicted worlds", self.worlds),
            _ => format!("worse than in {percent:.0} % of {} predicted worlds", self.worlds),
        }
    }
}

/// A plan carried out in a target world, with the observed trajectory.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Execution {
    /// Engine of the target, with its label ("rapier3d f32, quarter step (same engine)").
    pub engine: String,
    /// Realised objective, in the task's unit.
    pub objective: f64,
    /// Unit of the objective.
    pub objective_unit: String,
    /// Whether the task's success condition was met.
    pub success: bool,
    /// Largest |Δobjective| over runs with start positions perturbed by 1 µm: a lower bound of any planner's error.
    pub chaos_floor: f64,
    /// Position of the objective in the predicted distribution; `None` for plans without one.
    #[serde(default)]
    pub predicted: Option<AgainstPrediction>,
    /// The recorded motion, under the target's body names.
    pub trajectory: Trajectory,
    /// Planner's body name → target's body name, for the matched bodies.
    pub matches: Vec<(String, String)>,
}

impl Execution {
    /// Writes `execution.json` and `trajectory.parquet` into a folder.
    ///
    /// # Errors
    /// [`CoreError::Write`].
    pub fn save(&self, dir: &Path) -> Result<(), CoreError> {
        json::write(&dir.join("execution.json"), self)?;
        self.trajectory.write_parquet(&dir.join("trajectory.parquet"))
    }

    /// Reads `execution.json` of a folder.
    ///
    /// # Errors
    /// [`CoreError::Read`] or [`CoreError::Input`] that names the file.
    pub fn load(dir: &Path) -> Result<Self, CoreError> {
        atomic::read_json(&dir.join("execution.json"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::BodyTrack;
    use glamx::{DPose3, DVec3};
    use sms_sim::BodyState;

    #[test]
    fn an_execution_reads_back_exactly() {
        let x_wb = DPose3::from_translation(DVec3::new(0.1 + 0.2, 1.0 / 3.0, -1e-17));
        let state = BodyState { x_wb, v_w: DVec3::X, w_w: DVec3::Y };
        let mut execution = Execution {
            engine: "rapier3d f32, quarter step (same engine)".to_owned(),
            objective: 0.012_345_678_901_234_5,
            objective_unit: "m".to_owned(),
            success: true,
            chaos_floor: 1e-5,
            predicted: None,
            trajectory: Trajectory {
                times_s: vec![0.0, 0.01],
                bodies: vec![BodyTrack { name: "target".to_owned(), states: vec![state, state] }],
            },
            matches: vec![("ball_1".to_owned(), "target".to_owned())],
        };
        let dir = tempfile::tempdir().unwrap();
        execution.save(dir.path()).unwrap();
        assert_eq!(Execution::load(dir.path()).unwrap(), execution);
        assert!(dir.path().join("trajectory.parquet").exists());
        let text = std::fs::read_to_string(dir.path().join("execution.json")).unwrap();
        assert!(text.lines().count() < 20, "one line per key, not per number:\n{text}");
        let p = AgainstPrediction { nominal: 0.004, mean: 0.01, q90: 0.03, rank: 0.625, worlds: 32 };
        execution.predicted = Some(p);
        execution.save(dir.path()).unwrap();
        assert_eq!(Execution::load(dir.path()).unwrap(), execution);
    }
}
