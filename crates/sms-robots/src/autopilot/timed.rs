//! The approach over time.

use crate::Flight;
use glamx::DVec3;
use serde::{Deserialize, Serialize};
use sms_core::CoreError;
use sms_core::table::{Column, write_table};
use std::path::Path;

/// Phase of an approach.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FlightPhase {
    /// It flies along the curve.
    Approach,
    /// It descends straight down.
    Descent,
    /// Its motors are cut, and it falls.
    Cut,
}

impl FlightPhase {
    /// Name in files.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Approach => "approach",
            Self::Descent => "descent",
            Self::Cut => "cut",
        }
    }
}

/// The vehicle at one time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TimedPoint {
    /// Seconds from the start.
    pub time_s: f64,
    /// Centre of mass, metres.
    pub p_w: DVec3,
    /// Velocity, m/s.
    pub v_w: DVec3,
    /// Rotation about z from the world's x to the vehicle's, radians.
    pub yaw: f64,
    /// Phase from this time on.
    pub phase: FlightPhase,
}

/// An approach over time, in the world: metres, z up.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TimedFlight {
    /// Frame and units of the numbers, for readers of the file.
    pub frame: String,
    /// Control points of the Bézier curve, metres.
    pub control_w: [DVec3; 3],
    /// Start of the descent, seconds.
    pub arrival_s: f64,
    /// Time of the motor cut, seconds.
    pub cut_s: f64,
    /// The states in order of time.
    pub points: Vec<TimedPoint>,
}

/// Samples a flight every `period_s` seconds, and at the arrival over the landing point and at the motor cut.
pub fn timed(flight: &Flight, period_s: f64) -> TimedFlight {
    let (arrival_s, cut_s) = (flight.arrival_s(), flight.duration_s());
    let steps = (cut_s / period_s).ceil() as usize;
    let mut times: Vec<f64> = (0..steps).map(|k| k as f64 * period_s).chain([arrival_s, cut_s]).collect();
    times.retain(|t| *t <= cut_s);
    times.sort_by(f64::total_cmp);
    times.dedup_by(|a, b| *a - *b < 1e-9);
    let point = |time_s: f64| {
        let state = flight.state(time_s);
        let forward_w = state.x_wv.rotation * DVec3::X;
        let phase = match time_s {
            t if t >= cut_s => FlightPhase::Cut,
            t if t >= arrival_s => FlightPhase::Descent,
            _ => FlightPhase::Approach,
        };
        TimedPoint {
            time_s,
            p_w: state.x_wv.translation,
            v_w: state.v_w,
            yaw: forward_w.y.atan2(forward_w.x),
            phase,
        }
    };
    TimedFlight {
        frame: "world of the run: metres, z up; the vehicle's centre of mass; yaw in radians about z from x"
            .to_owned(),
        control_w: flight.path().control_w(),
        arrival_s,
        cut_s,
        points: times.into_iter().map(point).collect(),
    }
}

impl TimedFlight {
    /// Writes one row per point to a Parquet file: `time_s`, `x`, `y`, `z` (m), `vx`, `vy`, `vz` (m/s), `yaw` (rad),
    /// `phase`.
    ///
    /// # Errors
    /// [`CoreError::Write`].
    pub fn write_parquet(&self, path: &Path) -> Result<(), CoreError> {
        let column = |value: fn(&TimedPoint) -> f64| Column::F64(self.points.iter().map(value).collect());
        let phases = self.points.iter().map(|p| p.phase.as_str().to_owned()).collect();
        write_table(
            path,
            &[
                ("time_s", column(|p| p.time_s)),
                ("x", column(|p| p.p_w.x)),
                ("y", column(|p| p.p_w.y)),
                ("z", column(|p| p.p_w.z)),
                ("vx", column(|p| p.v_w.x)),
                ("vy", column(|p| p.v_w.y)),
                ("vz", column(|p| p.v_w.z)),
                ("yaw", column(|p| p.yaw)),
                ("phase", Column::Text(phases)),
            ],
        )
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::{BezierPath, FlightSettings};
    use sms_core::atomic;
    use sms_core::table::read_table;

    /// m/s.
    const SPEED: f64 = 0.7;

    pub(crate) fn flight() -> Flight {
        let path = BezierPath::approach(DVec3::new(-1.6, 1.2, 1.15), DVec3::new(0.2, -0.1, 0.8), 1.4, 1.2);
        Flight::new(path, FlightSettings { speed: SPEED, ..FlightSettings::default() }).unwrap()
    }

    #[test]
    fn points_follow_the_flight_and_arrival_and_cut_are_among_them() {
        let (flight, timed) = (flight(), timed(&flight(), 0.05));
        assert_eq!(timed.points[0].p_w, DVec3::new(-1.6, 1.2, 1.15));
        for pair in timed.points.windows(2) {
            let dt = pair[1].time_s - pair[0].time_s;
            assert!(dt > 0.0 && dt < 0.05 + 1e-9);
            if pair[0].phase == FlightPhase::Approach {
                assert!((pair[0].v_w.length() - SPEED).abs() < 1e-9);
                // The distance per step matches the speed up to the curvature.
                assert!((pair[1].p_w.distance(pair[0].p_w) - SPEED * dt).abs() < 1e-4);
            }
        }
        let at = |phase| timed.points.iter().find(|p| p.phase == phase).unwrap();
        assert_eq!(
            (at(FlightPhase::Descent).time_s, at(FlightPhase::Cut).time_s),
            (flight.arrival_s(), flight.duration_s())
        );
        let end = timed.points.last().unwrap();
        assert!(
            end.phase == FlightPhase::Cut && end.p_w.distance(DVec3::new(0.2, -0.1, 0.81)) < 1e-9,
            "{}",
            end.p_w
        );
    }

    #[test]
    fn files_read_back_as_they_were() {
        let dir = tempfile::tempdir().unwrap();
        let timed = timed(&flight(), 0.1);
        let json = dir.path().join("flight.json");
        atomic::write_json(&json, &timed).unwrap();
        assert_eq!(atomic::read_json::<TimedFlight>(&json).unwrap(), timed);
        let parquet = dir.path().join("flight.parquet");
        timed.write_parquet(&parquet).unwrap();
        let table = read_table(&parquet).unwrap();
        let column = |name: &str| table.iter().find(|(n, _)| n == name).unwrap().1.clone();
        assert_eq!(column("z"), Column::F64(timed.points.iter().map(|p| p.p_w.z).collect()));
        assert_eq!(column("vy"), Column::F64(timed.points.iter().map(|p| p.v_w.y).collect()));
        assert_eq!(column("phase").len(), timed.points.len());
    }
}
