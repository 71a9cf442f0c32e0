//! A mission of waypoints for QGroundControl.

use super::{Geodetic, Home};
use crate::Flight;
use serde_json::{Value, json};
use sms_core::{CoreError, atomic};
use std::fmt::Write;
use std::path::Path;

/// Commands (enum `MAV_CMD`).
const WAYPOINT: u16 = 16;
const LAND: u16 = 21;
const TAKEOFF: u16 = 22;
const CHANGE_SPEED: u16 = 178;
/// Frames (enum `MAV_FRAME`): heights above sea level, above home, and none for commands without a place.
const GLOBAL: u8 = 0;
const ABOVE_HOME: u8 = 3;
const NO_PLACE: u8 = 2;
/// Largest deviation of the straight pieces between waypoints from the curve, metres.
const CHORD_M: f64 = 0.01;
/// Acceptance radius of a waypoint, metres.
const ACCEPTANCE_M: f64 = 0.15;

/// One item of a mission.
#[derive(Debug, Clone, PartialEq)]
pub struct MissionItem {
    /// `MAV_CMD`.
    pub command: u16,
    /// `MAV_FRAME`.
    pub frame: u8,
    /// Parameters 1 to 7. For a place, 5 to 7 are latitude and longitude in degrees and the height in metres.
    pub params: [f64; 7],
}

/// A mission: take off, the approach, land.
#[derive(Debug, Clone, PartialEq)]
pub struct Mission {
    /// The start.
    pub home: Geodetic,
    /// Speed on the way, m/s.
    pub speed: f64,
    /// The items.
    pub items: Vec<MissionItem>,
}

/// The mission of a flight; `None` if the home position is unknown. The way between waypoints deviates from the curve
/// by less than a centimetre. The autopilot determines the timing: the speed along the curve is `speed` (m/s), and the
/// descent speed is a parameter of the vehicle.
pub fn mission(flight: &Flight, home: &Home, yaw: f64, speed: f64) -> Option<Mission> {
    let geodetic = home.geodetic?;
    let path = flight.path();
    let heading = home.heading(yaw).to_degrees().rem_euclid(360.0);
    let place = |command: u16, acceptance: f64, p_w| {
        let (latitude, longitude, above) = home.to_geodetic(p_w)?;
        let params = [0.0, acceptance, 0.0, heading, latitude, longitude, above];
        Some(MissionItem { command, frame: ABOVE_HOME, params })
    };
    let pieces = pieces(flight);
    let speed_item = MissionItem {
        command: CHANGE_SPEED,
        frame: NO_PLACE,
        // Ground speed; throttle unchanged.
        params: [1.0, speed, -1.0, 0.0, 0.0, 0.0, 0.0],
    };
    let mut items = vec![place(TAKEOFF, 0.0, path.point(0.0).0)?, speed_item];
    for k in 1..=pieces {
        items.push(place(WAYPOINT, ACCEPTANCE_M, path.point(path.length() * k as f64 / pieces as f64).0)?);
    }
    items.push(place(LAND, 0.0, flight.state(flight.duration_s()).x_wv.translation)?);
    Some(Mission { home: geodetic, speed, items })
}

/// Returns the number of equal pieces of the curve with chords close enough to it.
fn pieces(flight: &Flight) -> usize {
    let path = flight.path();
    let point = |s: f64| path.point(path.length() * s).0;
    let off = |n: usize, k: usize| {
        let (a, b) = (point(k as f64 / n as f64), point((k + 1) as f64 / n as f64));
        let middle = point((k as f64 + 0.5) / n as f64);
        let along = (b - a).normalize_or_zero();
        (middle - a - along * (middle - a).dot(along)).length()
    };
    (1..64).find(|&n| (0..n).all(|k| off(n, k) < CHORD_M)).unwrap_or(64)
}

impl Mission {
    /// The mission as a plan of QGroundControl (JSON, version 1).
    pub fn plan(&self) -> Value {
        let home = self.home;
        let items: Vec<Value> = self
            .items
            .iter()
            .enumerate()
            .map(|(i, item)| {
                let mut value = json!({
                    "autoContinue": true,
                    "command": item.command,
                    "doJumpId": i + 1,
                    "frame": item.frame,
                    "params": item.params,
                    "type": "SimpleItem",
                });
                if item.frame == ABOVE_HOME {
                    value["AMSLAltAboveTerrain"] = Value::Null;
                    value["Altitude"] = json!(item.params[6]);
                    value["AltitudeMode"] = json!(1);
                }
                value
            })
            .collect();
        json!({
            "fileType": "Plan",
            "groundStation": "QGroundControl",
            "version": 1,
            "geoFence": {"circles": [], "polygons": [], "version": 2},
            "rallyPoints": {"points": [], "version": 2},
            "mission": {
                "version": 2,
                // PX4, multirotor.
                "firmwareType": 12,
                "vehicleType": 2,
                "cruiseSpeed": self.speed,
                "hoverSpeed": self.speed,
                "globalPlanAltitudeMode": 1,
                "plannedHomePosition": [home.latitude_deg, home.longitude_deg, home.altitude_m],
                "items": items,
            },
        })
    }

    /// The mission as text, "QGC WPL 110", with home in the first row.
    pub fn waypoints(&self) -> String {
        let home = self.home;
        let mut text = String::from("QGC WPL 110\n");
        let mut row = |index: usize, current: u8, frame: u8, command: u16, params: &[f64; 7]| {
            let _ = write!(text, "{index}\t{current}\t{frame}\t{command}");
            for (k, p) in params.iter().enumerate() {
                // A latitude of 1e-9° is a tenth of a millimetre.
                let digits = if (4..6).contains(&k) { 9 } else { 4 };
                let _ = write!(text, "\t{:.digits$}", p);
            }
            text.push_str("\t1\n");
        };
        let at_home = [0.0, 0.0, 0.0, 0.0, home.latitude_deg, home.longitude_deg, home.altitude_m];
        row(0, 1, GLOBAL, WAYPOINT, &at_home);
        for (i, item) in self.items.iter().enumerate() {
            row(i + 1, 0, item.frame, item.command, &item.params);
        }
        text
    }

    /// Writes both forms into a folder: `mission.plan`, `mission.waypoints`.
    ///
    /// # Errors
    /// [`CoreError::Write`].
    pub fn write(&self, dir: &Path) -> Result<(), CoreError> {
        atomic::write_json(&dir.join("mission.plan"), &self.plan())?;
        atomic::write_bytes(&dir.join("mission.waypoints"), self.waypoints().as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::autopilot::timed::tests::flight;
    use glamx::DVec3;

    fn home() -> Home {
        let geodetic = Geodetic { latitude_deg: -33.86, longitude_deg: 151.21, altitude_m: 12.5 };
        Home { home_w: DVec3::new(-1.6, 1.2, 0.05), east_yaw: 0.7, geodetic: Some(geodetic) }
    }

    #[test]
    fn waypoints_lie_on_the_curve_and_the_last_item_lands() {
        let (flight, home) = (flight(), home());
        let mission = mission(&flight, &home, 0.0, 0.7).unwrap();
        let commands: Vec<u16> = mission.items.iter().map(|i| i.command).collect();
        assert_eq!((commands[0], commands[1], *commands.last().unwrap()), (TAKEOFF, CHANGE_SPEED, LAND));
        let p_w = |i: &MissionItem| home.world_of_geodetic(i.params[4], i.params[5], i.params[6]).unwrap();
        assert!(p_w(&mission.items[0]).distance(DVec3::new(-1.6, 1.2, 1.15)) < 1e-6);
        let ways: Vec<DVec3> = mission.items.iter().filter(|i| i.command == WAYPOINT).map(p_w).collect();
        assert!(ways.len() >= 4, "{}", ways.len());
        // Every point of the curve is within 1.1 cm of the polygon of waypoints.
        let corners: Vec<DVec3> = std::iter::once(flight.path().point(0.0).0).chain(ways).collect();
        for k in 0..=200 {
            let p = flight.path().point(flight.path().length() * f64::from(k) / 200.0).0;
            let off = corners.windows(2).map(|w| {
                let t = ((p - w[0]).dot(w[1] - w[0]) / (w[1] - w[0]).length_squared()).clamp(0.0, 1.0);
                p.distance(w[0] + t * (w[1] - w[0]))
            });
            assert!(off.fold(f64::INFINITY, f64::min) < 0.011);
        }
        let land = mission.items.last().unwrap();
        assert!(p_w(land).distance(DVec3::new(0.2, -0.1, 0.81)) < 1e-6, "{}", p_w(land));
        // Along the world's x with east 0.7 rad from it: 90° + 40.1° from north.
        assert!((land.params[3] - 130.107).abs() < 0.001, "{}", land.params[3]);
        let nowhere = Home { geodetic: None, ..home };
        assert_eq!(super::mission(&flight, &nowhere, 0.0, 0.7), None);
    }

    #[test]
    fn files_read_back_to_a_millimetre() {
        let dir = tempfile::tempdir().unwrap();
        let (flight, home) = (flight(), home());
        let mission = mission(&flight, &home, 0.3, 0.7).unwrap();
        mission.write(dir.path()).unwrap();
        let text = std::fs::read_to_string(dir.path().join("mission.waypoints")).unwrap();
        let (header, rows) = text.split_once('\n').unwrap();
        assert_eq!(header, "QGC WPL 110");
        let rows: Vec<Vec<f64>> =
            rows.lines().map(|row| row.split('\t').map(|field| field.parse().unwrap()).collect()).collect();
        assert_eq!(rows[0][8..11], [mission.home.latitude_deg, mission.home.longitude_deg, 12.5]);
        assert_eq!(rows.len(), 1 + mission.items.len());
        let plan: Value = atomic::read_json(&dir.path().join("mission.plan")).unwrap();
        assert_eq!((&plan["fileType"], &plan["version"]), (&json!("Plan"), &json!(1)));
        for (i, (a, row)) in mission.items.iter().zip(&rows[1..]).enumerate() {
            assert_eq!((f64::from(a.frame), f64::from(a.command)), (row[2], row[3]));
            let item = &plan["mission"]["items"][i];
            assert_eq!((&item["command"], &item["doJumpId"]), (&json!(a.command), &json!(i + 1)));
            let written: Vec<f64> =
                item["params"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
            assert_eq!(written, a.params);
            if a.frame == ABOVE_HOME {
                let p_w = |p: &[f64; 7]| home.world_of_geodetic(p[4], p[5], p[6]).unwrap();
                assert!(p_w(&a.params).distance(p_w(row[4..11].try_into().unwrap())) < 2e-4);
            }
        }
    }
}
