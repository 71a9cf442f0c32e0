//! Export of a planned approach ([`crate::Flight`]) for autopilots: see `docs/book/src/guides/flight.md`.
//!
//! | file | frame | for |
//! |---|---|---|
//! | `flight.json`, `flight.parquet` | world, z up | people and programs ([`TimedFlight`]) |
//! | `setpoints.csv`, `setpoints.tlog` | local NED of the autopilot | PX4's offboard mode ([`set_points`]) |
//! | `mission.plan`, `mission.waypoints` | WGS 84, heights above home | QGroundControl ([`Mission`]); requires the home position |
//!
//! ```
//! use glamx::DVec3;
//! use sms_robots::autopilot::{FlightPhase, Home, timed};
//! use sms_robots::{BezierPath, Flight, FlightSettings};
//! let path = BezierPath::approach(DVec3::new(2.0, 0.0, 1.1), DVec3::ZERO, 1.0, 0.5);
//! let flight = Flight::new(path, FlightSettings::default())?;
//! let points = timed(&flight, 0.05).points;
//! assert_eq!((points[0].phase, points.last().unwrap().phase), (FlightPhase::Approach, FlightPhase::Cut));
//! // The vehicle was armed on the floor below the start. North is along the world's y, east along its x.
//! let home = Home { home_w: DVec3::new(2.0, 0.0, 0.05), east_yaw: 0.0, geodetic: None };
//! assert!(home.to_ned(points[0].p_w).distance(DVec3::new(0.0, 0.0, -1.05)) < 1e-12);
//! # Ok::<(), sms_robots::VehicleError>(())
//! ```

mod files;
mod home;
mod mission;
mod offboard;
mod timed;

pub use files::{FlightFiles, write_flight};
pub use home::{Geodetic, Home};
pub use mission::{Mission, MissionItem, mission};
pub use offboard::{SetPoint, set_points, write_csv, write_tlog};
pub use timed::{FlightPhase, TimedFlight, TimedPoint, timed};
