//! Set-points for the autopilot's offboard mode, as a table and as MAVLink messages.

use super::{FlightPhase, Home, TimedFlight};
use glamx::DVec3;
use sms_core::{CoreError, atomic};
use std::fmt::Write;
use std::path::Path;

/// Sender: a companion computer (system 1, component 191) of the autopilot's system.
const SENDER: [u8; 2] = [1, 191];
const RECEIVER: [u8; 2] = [1, 1];

/// First byte of a MAVLink 2 frame.
const MAGIC: u8 = 0xFD;
/// SET_POSITION_TARGET_LOCAL_NED of the common dialect: number, length, and the seed of its checksum, which stands for
/// the fields' names and types.
const MESSAGE_ID: u16 = 84;
const PAYLOAD_BYTES: u8 = 53;
const FORMAT_SEED: u8 = 143;
/// MAV_FRAME_LOCAL_NED.
const FRAME_LOCAL_NED: u8 = 1;
/// POSITION_TARGET_TYPEMASK: accelerations (bits 6 to 8) and yaw rate (bit 11).
const IGNORED: u16 = 0b1001_1100_0000;

/// A set-point in the autopilot's local frame: north, east, down from home.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SetPoint {
    /// Seconds from the start.
    pub time_s: f64,
    /// Position, metres.
    pub p_ned: DVec3,
    /// Velocity, m/s.
    pub v_ned: DVec3,
    /// Clockwise from north, radians.
    pub heading: f64,
    /// Phase of the flight.
    pub phase: FlightPhase,
}

/// A flight in the autopilot's frame.
pub fn set_points(flight: &TimedFlight, home: &Home) -> Vec<SetPoint> {
    let point = |p: &super::TimedPoint| SetPoint {
        time_s: p.time_s,
        p_ned: home.to_ned(p.p_w),
        v_ned: home.vector_to_ned(p.v_w),
        heading: home.heading(p.yaw),
        phase: p.phase,
    };
    flight.points.iter().map(point).collect()
}

/// Writes a table with one row per set-point: seconds, metres, m/s, radians.
///
/// # Errors
/// [`CoreError::Write`].
pub fn write_csv(path: &Path, points: &[SetPoint]) -> Result<(), CoreError> {
    let mut text = String::from("time_s,north_m,east_m,down_m,vn_m_s,ve_m_s,vd_m_s,heading_rad,phase\n");
    for s in points {
        let (p, v) = (s.p_ned, s.v_ned);
        let _ = write!(text, "{:.4}", s.time_s);
        for value in [p.x, p.y, p.z, v.x, v.y, v.z, s.heading] {
            let _ = write!(text, ",{value:.5}");
        }
        let _ = writeln!(text, ",{}", s.phase.as_str());
    }
    atomic::write_bytes(path, text.as_bytes())
}

/// Writes a telemetry log: for each set-point the time in microseconds (eight bytes, big endian), then a MAVLink 2
/// frame with the message SET_POSITION_TARGET_LOCAL_NED. Phases are not included.
///
/// # Errors
/// [`CoreError::Write`].
pub fn write_tlog(path: &Path, points: &[SetPoint]) -> Result<(), CoreError> {
    let mut bytes = Vec::new();
    for (k, point) in points.iter().enumerate() {
        bytes.extend(((point.time_s * 1e6).round() as u64).to_be_bytes());
        bytes.extend(frame(point, k as u8));
    }
    atomic::write_bytes(path, &bytes)
}

/// Returns the MAVLink 2 frame of a SET_POSITION_TARGET_LOCAL_NED message without accelerations and yaw rate, unsigned
/// (<https://mavlink.io/en/guide/serialization.html>). It is the only message written, so a library of the whole
/// dialect, which takes longer to compile than this crate, only checks it in tests.
fn frame(point: &SetPoint, sequence: u8) -> Vec<u8> {
    let mut payload = Vec::with_capacity(usize::from(PAYLOAD_BYTES));
    payload.extend(((point.time_s * 1e3).round() as u32).to_le_bytes());
    let acceleration = DVec3::ZERO;
    for vector in [point.p_ned, point.v_ned, acceleration] {
        payload.extend(vector.as_vec3().to_array().into_iter().flat_map(f32::to_le_bytes));
    }
    let yaw_rate = 0.0f32;
    payload.extend([point.heading as f32, yaw_rate].into_iter().flat_map(f32::to_le_bytes));
    payload.extend(IGNORED.to_le_bytes());
    payload.extend(RECEIVER);
    payload.push(FRAME_LOCAL_NED);

    let [id, id_high] = MESSAGE_ID.to_le_bytes();
    let (no_signature, compatible) = (0, 0);
    let mut frame = vec![MAGIC, PAYLOAD_BYTES, no_signature, compatible, sequence, SENDER[0], SENDER[1]];
    frame.extend([id, id_high, 0]);
    frame.extend(payload);
    let sum = frame[1..].iter().chain(&[FORMAT_SEED]).fold(u16::MAX, |sum, byte| mcrf4xx(sum, *byte));
    frame.extend(sum.to_le_bytes());
    frame
}

/// Adds a byte to a CRC-16/MCRF4XX checksum: the polynomial x¹⁶ + x¹² + x⁵ + 1, reflected.
fn mcrf4xx(sum: u16, byte: u8) -> u16 {
    (0..8).fold(sum ^ u16::from(byte), |sum, _| (sum >> 1) ^ if sum & 1 == 1 { 0x8408 } else { 0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::autopilot::timed;
    use crate::autopilot::timed::tests::flight;
    use mavlink::dialects::common::MavMessage;
    use mavlink::{MavlinkReader, MavlinkVersion};

    /// Lengths of the time stamp before each frame of a log, and of header and checksum of a MAVLink 2 frame.
    const STAMP: usize = 8;
    const HEADER: usize = 10;
    const CHECKSUM: usize = 2;

    fn points() -> Vec<SetPoint> {
        let home = Home { home_w: DVec3::new(-1.6, 1.2, 0.05), east_yaw: 0.7, geodetic: None };
        set_points(&timed(&flight(), 0.05), &home)
    }

    /// Compares with the bytes of pymavlink 2.4 for the same message.
    #[test]
    fn frames_are_those_of_another_implementation() {
        let point = SetPoint {
            time_s: 1.234,
            p_ned: DVec3::new(1.5, -2.25, -0.875),
            v_ned: DVec3::new(0.5, -0.25, 0.125),
            heading: 0.75,
            phase: FlightPhase::Approach,
        };
        let expected = "fd3500000701bf540000d20400000000c03f000010c0000060bf0000003f000080be0000003e0000000000000000000000000000403f00000000c009010101febc";
        let hex: String = frame(&point, 7).iter().map(|b| format!("{b:02x}")).collect();
        assert_eq!(hex, expected);
    }

    #[test]
    fn logs_read_back() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("setpoints.tlog");
        let points = points();
        write_tlog(&path, &points).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let mut rest = &bytes[..];
        for (k, point) in points.iter().enumerate() {
            let end = STAMP + HEADER + usize::from(rest[STAMP + 1]) + CHECKSUM;
            let read = MavlinkReader::new(&rest[STAMP..end]).read_message::<MavMessage>(MavlinkVersion::V2);
            let (header, MavMessage::SET_POSITION_TARGET_LOCAL_NED(m)) = read.unwrap() else {
                panic!("message {k}")
            };
            let time_ms = (point.time_s * 1e3).round() as u32;
            assert_eq!((usize::from(header.sequence), m.time_boot_ms), (k % 256, time_ms));
            let (p, v) = (point.p_ned, point.v_ned);
            let expected = [p.x, p.y, p.z, v.x, v.y, v.z, point.heading].map(|x| x as f32);
            assert_eq!([m.x, m.y, m.z, m.vx, m.vy, m.vz, m.yaw], expected);
            rest = &rest[end..];
        }
        assert!(rest.is_empty());
    }

    #[test]
    fn the_table_has_a_row_a_point_and_down_is_down() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("setpoints.csv");
        let points = points();
        write_csv(&path, &points).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let rows: Vec<Vec<&str>> = text.lines().map(|l| l.split(',').collect()).collect();
        assert!(rows.len() == points.len() + 1 && rows.iter().all(|r| r.len() == 9));
        assert_eq!(&rows[1][..4], ["0.0000", "0.00000", "0.00000", "-1.10000"], "above home");
        let last = &rows[points.len()];
        let down: [f64; 2] = [last[3], last[6]].map(|t| t.parse().unwrap());
        // The vehicle descends to 1 cm above its resting height: the pad is at 0.8 m, and the legs are 0.05 m long.
        assert!((down[0] + 0.76).abs() < 1e-5 && (down[1] - 0.3).abs() < 1e-9, "{down:?}");
        assert_eq!(last[8], "cut");
    }
}
