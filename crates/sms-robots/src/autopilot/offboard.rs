//! Set-points for the autopilot's offboard mode, as a table and as MAVLink messages.

use super::{FlightPhase, Home, TimedFlight};
use glamx::DVec3;
use mavlink::dialects::common::{
    MavFrame, MavMessage, PositionTargetTypemask as Ignored, SET_POSITION_TARGET_LOCAL_NED_DATA,
};
use mavlink::{MAVLinkV2MessageRaw, MavHeader, MavlinkReader, MavlinkVersion};
use sms_core::{CoreError, InputError, atomic};
use std::fmt::Write;
use std::path::Path;

/// Header of a frame of MAVLink 2, its first byte, and its checksum.
const HEADER: usize = 10;
const MAGIC: u8 = 0xfd;
const CHECKSUM: usize = 2;
/// Bytes of the time before each frame of a log.
const STAMP: usize = 8;
/// Who sends: a companion computer (system 1, component 191), to the autopilot of the same system.
const SENDER: [u8; 2] = [1, 191];
const RECEIVER: [u8; 2] = [1, 1];

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
    /// What the vehicle does from here on.
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

/// Writes a table with a row a set-point: seconds, metres, m/s, radians.
///
/// # Errors
/// [`CoreError::Write`].
pub fn write_csv(path: &Path, points: &[SetPoint]) -> Result<(), CoreError> {
    let mut text = String::from("time_s,north_m,east_m,down_m,vn_m_s,ve_m_s,vd_m_s,heading_rad,phase\n");
    for s in points {
        let (p, v) = (s.p_ned, s.v_ned);
        let _ = writeln!(
            text,
            "{:.4},{:.5},{:.5},{:.5},{:.5},{:.5},{:.5},{:.5},{}",
            s.time_s,
            p.x,
            p.y,
            p.z,
            v.x,
            v.y,
            v.z,
            s.heading,
            s.phase.as_str()
        );
    }
    atomic::write_bytes(path, text.as_bytes())
}

/// Writes a telemetry log: of each set-point the time in microseconds (eight bytes, the highest first), then a frame of MAVLink 2
/// (crate `mavlink`) with the message SET_POSITION_TARGET_LOCAL_NED. Phases are not in it.
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

/// Number, time (ms), position and velocity (NED), heading of each message of a log that [`write_tlog`] wrote, in single precision.
///
/// # Errors
/// [`CoreError::Input`] when a frame is cut, is another message, or its checksum is wrong.
pub fn read_tlog(path: &Path) -> Result<Vec<(u8, u32, [f32; 7])>, CoreError> {
    let bytes = std::fs::read(path).map_err(CoreError::read(path))?;
    let mut rest = &bytes[..];
    let mut messages = Vec::new();
    while !rest.is_empty() {
        let fault = |what: &str| {
            let what = format!("message {} of this log {what}", messages.len() + 1);
            CoreError::from(InputError::new(what, path, "write the file again with `sms plan`"))
        };
        let length = rest.get(STAMP + 1).map(|l| usize::from(*l)).ok_or_else(|| fault("is cut off"))?;
        let end = STAMP + HEADER + length + CHECKSUM;
        let frame = rest.get(STAMP..end).ok_or_else(|| fault("is cut off"))?;
        if frame[0] != MAGIC {
            return Err(fault("is no set-point"));
        }
        // One frame alone: the reader would look for the next one that is whole.
        let read = MavlinkReader::new(frame).read_message::<MavMessage>(MavlinkVersion::V2);
        let (header, message) = read.map_err(|_| fault("is damaged"))?;
        let MavMessage::SET_POSITION_TARGET_LOCAL_NED(m) = message else {
            return Err(fault("is no set-point"));
        };
        messages.push((header.sequence, m.time_boot_ms, [m.x, m.y, m.z, m.vx, m.vy, m.vz, m.yaw]));
        rest = &rest[end..];
    }
    Ok(messages)
}

/// A frame of MAVLink 2. Accelerations and the rate of yaw are not given.
fn frame(point: &SetPoint, sequence: u8) -> Vec<u8> {
    let ([x, y, z], [vx, vy, vz]) = (single(point.p_ned), single(point.v_ned));
    let message = MavMessage::SET_POSITION_TARGET_LOCAL_NED(SET_POSITION_TARGET_LOCAL_NED_DATA {
        time_boot_ms: (point.time_s * 1e3).round() as u32,
        x,
        y,
        z,
        vx,
        vy,
        vz,
        yaw: point.heading as f32,
        coordinate_frame: MavFrame::MAV_FRAME_LOCAL_NED,
        type_mask: Ignored::POSITION_TARGET_TYPEMASK_AX_IGNORE
            | Ignored::POSITION_TARGET_TYPEMASK_AY_IGNORE
            | Ignored::POSITION_TARGET_TYPEMASK_AZ_IGNORE
            | Ignored::POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE,
        target_system: RECEIVER[0],
        target_component: RECEIVER[1],
        ..Default::default()
    });
    let [system_id, component_id] = SENDER;
    let mut raw = MAVLinkV2MessageRaw::new();
    raw.serialize_message(MavHeader { system_id: system_id.into(), component_id, sequence }, &message);
    raw.raw_bytes().to_vec()
}

fn single(v: DVec3) -> [f32; 3] {
    v.to_array().map(|c| c as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::autopilot::timed;
    use crate::autopilot::timed::tests::flight;

    fn points() -> Vec<SetPoint> {
        let home = Home { home_w: DVec3::new(-1.6, 1.2, 0.05), east_yaw: 0.7, geodetic: None };
        set_points(&timed(&flight(), 0.05), &home)
    }

    /// Bytes of pymavlink 2.4 for the same message.
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
    fn logs_read_back_and_damage_is_found() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("setpoints.tlog");
        let points = points();
        write_tlog(&path, &points).unwrap();
        let read = read_tlog(&path).unwrap();
        assert_eq!(read.len(), points.len());
        for (k, (point, (sequence, time_ms, values))) in points.iter().zip(&read).enumerate() {
            assert_eq!((usize::from(*sequence), *time_ms), (k % 256, (point.time_s * 1e3).round() as u32));
            let (p, v) = (point.p_ned, point.v_ned);
            assert_eq!(*values, [p.x, p.y, p.z, v.x, v.y, v.z, point.heading].map(|x| x as f32));
        }
        let whole = std::fs::read(&path).unwrap();
        let mut flipped = whole.clone();
        flipped[STAMP + HEADER + 6] ^= 1;
        for (bytes, why) in
            [(&whole[..whole.len() - 1], "cut off"), (&flipped[..], "message 1 of this log is damaged")]
        {
            std::fs::write(&path, bytes).unwrap();
            let error = read_tlog(&path).unwrap_err().to_string();
            assert!(error.contains(why), "{error}");
        }
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
        // It descends to 1 cm above where it will stand, 0.8 m above the floor of which 0.05 m are its legs.
        assert!((down[0] + 0.76).abs() < 1e-5 && (down[1] - 0.3).abs() < 1e-9, "{down:?}");
        assert_eq!(last[8], "cut");
    }
}
