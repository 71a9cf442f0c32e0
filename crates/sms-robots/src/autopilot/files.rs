//! All files of a flight.

use super::{Geodetic, Home, mission, set_points, timed, write_csv, write_tlog};
use crate::{Flight, Quadrotor};
use glamx::DVec3;
use serde::{Deserialize, Serialize};
use sms_core::{CoreError, InputError, Ranges, atomic};
use std::path::Path;

/// Settings of the flight files.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FlightFiles {
    /// Time between set-points, seconds. PX4's offboard mode requires more than two per second.
    pub period_s: f64,
    /// Position at arming: world x and y, metres. By default below the start of the flight.
    pub home_w: Option<[f64; 2]>,
    /// Height of the ground at this position in the world, metres.
    pub ground_m: f64,
    /// Direction of east in the world: rotation about z from the world's x, radians.
    pub east_yaw: f64,
    /// The same place on Earth. Without it no mission is written.
    pub geodetic: Option<Geodetic>,
}

impl Default for FlightFiles {
    fn default() -> Self {
        Self { period_s: 0.05, home_w: None, ground_m: 0.0, east_yaw: 0.0, geodetic: None }
    }
}

impl FlightFiles {
    /// Checks the values.
    ///
    /// # Errors
    /// [`InputError`] that names the key and what is allowed.
    pub fn validate(&self) -> Result<(), InputError> {
        let r = Ranges::of("flight");
        r.within("period_s", self.period_s, 0.001, 0.5)?;
        r.within("ground_m", self.ground_m, -1e3, 1e3)?;
        r.within("east_yaw", self.east_yaw, -10.0, 10.0)?;
        for (key, value) in [("home_w[0]", 0), ("home_w[1]", 1)] {
            r.within(key, self.home_w.map_or(0.0, |h| h[value]), -1e3, 1e3)?;
        }
        if let Some(g) = &self.geodetic {
            // Longitude is undefined at the poles.
            r.within("geodetic.latitude_deg", g.latitude_deg, -89.0, 89.0)?;
            r.within("geodetic.longitude_deg", g.longitude_deg, -180.0, 180.0)?;
            r.within("geodetic.altitude_m", g.altitude_m, -500.0, 9000.0)?;
        }
        Ok(())
    }

    /// The home position of the vehicle for this flight.
    pub fn home(&self, flight: &Flight, vehicle: &Quadrotor) -> Home {
        let [x, y] = self.home_w.unwrap_or_else(|| flight.path().control_w()[0].truncate().to_array());
        let home_w = DVec3::new(x, y, self.ground_m + vehicle.standing_height());
        Home { home_w, east_yaw: self.east_yaw, geodetic: self.geodetic }
    }
}

/// Writes a flight into a folder and returns the names of the files: `flight.json`, `flight.parquet`, `setpoints.csv`,
/// `setpoints.tlog`, and with a known place on Earth `mission.plan` and `mission.waypoints`.
///
/// # Errors
/// [`CoreError::Input`] for settings out of range; [`CoreError::Write`].
pub fn write_flight(
    dir: &Path,
    flight: &Flight,
    vehicle: &Quadrotor,
    config: &FlightFiles,
) -> Result<Vec<&'static str>, CoreError> {
    config.validate()?;
    let home = config.home(flight, vehicle);
    let timed = timed(flight, config.period_s);
    atomic::write_json(&dir.join("flight.json"), &timed)?;
    timed.write_parquet(&dir.join("flight.parquet"))?;
    let points = set_points(&timed, &home);
    write_csv(&dir.join("setpoints.csv"), &points)?;
    write_tlog(&dir.join("setpoints.tlog"), &points)?;
    let mut written = vec!["flight.json", "flight.parquet", "setpoints.csv", "setpoints.tlog"];
    let first = timed.points[0];
    if let Some(mission) = mission(flight, &home, first.yaw, first.v_w.length()) {
        mission.write(dir)?;
        written.extend(["mission.plan", "mission.waypoints"]);
    }
    Ok(written)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::autopilot::timed::tests::flight;

    #[test]
    fn missions_are_written_only_where_home_is_known() {
        let dir = tempfile::tempdir().unwrap();
        let vehicle = Quadrotor::default();
        let mut config = FlightFiles::default();
        assert_eq!(write_flight(dir.path(), &flight(), &vehicle, &config).unwrap().len(), 4);
        assert!(!dir.path().join("mission.plan").exists());
        config.geodetic = Some(Geodetic { latitude_deg: 47.4, longitude_deg: 8.5, altitude_m: 488.0 });
        for name in write_flight(dir.path(), &flight(), &vehicle, &config).unwrap() {
            assert!(dir.path().join(name).metadata().unwrap().len() > 100, "{name}");
        }
        assert!(config.home(&flight(), &vehicle).home_w.distance(DVec3::new(-1.6, 1.2, 0.05)) < 1e-12);
        config.geodetic = Some(Geodetic { latitude_deg: 91.0, longitude_deg: 8.5, altitude_m: 488.0 });
        let error = write_flight(dir.path(), &flight(), &vehicle, &config).unwrap_err().to_string();
        assert!(error.contains("latitude_deg"), "{error}");
    }
}
