//! Recorded motion.

use serde::{Deserialize, Serialize};
use sms_core::CoreError;
use sms_core::table::{Column, write_table};
use sms_sim::BodyState;
use std::path::Path;

/// The motion of one body.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BodyTrack {
    /// The body's name (the striker's is `striker`).
    pub name: String,
    /// One state per entry of [`Trajectory::times_s`].
    pub states: Vec<BodyState>,
}

/// Recorded motion of all bodies that moved, and of the striker.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Trajectory {
    /// Seconds from the start.
    pub times_s: Vec<f64>,
    /// The bodies.
    pub bodies: Vec<BodyTrack>,
}

impl Trajectory {
    /// The track of a body.
    pub fn body(&self, name: &str) -> Option<&BodyTrack> {
        self.bodies.iter().find(|b| b.name == name)
    }

    /// Writes one row per body and time to a Parquet file: `time_s`, `body`, position `x`, `y`, `z` (m), attitude
    /// `qx`, `qy`, `qz`, `qw`, velocity `vx`, `vy`, `vz` (m/s), angular velocity `wx`, `wy`, `wz` (rad/s), all in the
    /// world.
    ///
    /// # Errors
    /// [`CoreError::Write`].
    pub fn write_parquet(&self, path: &Path) -> Result<(), CoreError> {
        let rows: Vec<(f64, &str, &BodyState)> = self
            .bodies
            .iter()
            .flat_map(|b| self.times_s.iter().zip(&b.states).map(move |(&t, s)| (t, b.name.as_str(), s)))
            .collect();
        let column =
            |value: fn(&BodyState) -> f64| Column::F64(rows.iter().map(|(_, _, s)| value(s)).collect());
        write_table(
            path,
            &[
                ("time_s", Column::F64(rows.iter().map(|r| r.0).collect())),
                ("body", Column::Text(rows.iter().map(|r| r.1.to_owned()).collect())),
                ("x", column(|s| s.x_wb.translation.x)),
                ("y", column(|s| s.x_wb.translation.y)),
                ("z", column(|s| s.x_wb.translation.z)),
                ("qx", column(|s| s.x_wb.rotation.x)),
                ("qy", column(|s| s.x_wb.rotation.y)),
                ("qz", column(|s| s.x_wb.rotation.z)),
                ("qw", column(|s| s.x_wb.rotation.w)),
                ("vx", column(|s| s.v_w.x)),
                ("vy", column(|s| s.v_w.y)),
                ("vz", column(|s| s.v_w.z)),
                ("wx", column(|s| s.w_w.x)),
                ("wy", column(|s| s.w_w.y)),
                ("wz", column(|s| s.w_w.z)),
            ],
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::{DPose3, DQuat, DVec3};
    use sms_core::table::read_table;

    #[test]
    fn the_parquet_file_has_a_row_per_body_and_time() {
        let state = |x: f64| BodyState {
            x_wb: DPose3::from_parts(DVec3::new(x, 2.0, 3.0), DQuat::from_rotation_z(x)),
            v_w: DVec3::new(4.0, 5.0, 6.0),
            w_w: DVec3::new(7.0, 8.0, 9.0),
        };
        let track = |name: &str, x: f64| BodyTrack {
            name: name.to_owned(),
            states: vec![state(x), state(x + 0.5), state(x + 1.0)],
        };
        let trajectory =
            Trajectory { times_s: vec![0.0, 0.1, 0.2], bodies: vec![track("cue", 0.0), track("cup", 10.0)] };
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("trajectory.parquet");
        trajectory.write_parquet(&path).unwrap();
        let table = read_table(&path).unwrap();
        assert_eq!(table.len(), 15);
        let column = |name: &str| table.iter().find(|(n, _)| n == name).map(|(_, c)| c.clone()).unwrap();
        assert_eq!(column("time_s"), Column::F64(vec![0.0, 0.1, 0.2, 0.0, 0.1, 0.2]));
        assert_eq!(column("x"), Column::F64(vec![0.0, 0.5, 1.0, 10.0, 10.5, 11.0]));
        assert_eq!(column("body").len(), 6);
        assert_eq!(column("wz"), Column::F64(vec![9.0; 6]));
        let Column::F64(qw) = column("qw") else { panic!("qw is numbers") };
        assert!((qw[1] - 0.25f64.cos()).abs() < 1e-15);
    }
}
