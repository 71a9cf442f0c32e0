//! The TUM RGB-D benchmark's format (Sturm et al., IROS 2012).
//!
//! `rgb.txt`, `depth.txt`: `time file`; `groundtruth.txt`, if there is one: `time tx ty tz qx qy qz qw`, the pose of the
//! colour camera (OpenCV axes) in the world. Colour and depth are associated one to one by time; the pose is interpolated at the
//! time of the depth image, because depth determines the surfaces. Depth is in 1/5000 m.

use super::to_opencv;
use crate::depth_file::depth_size;
use crate::formats::nerfstudio::{checked_intrinsics, not_registered};
use crate::recording::{Notice, RecordedFrame, Recording, RecordingFormat};
use crate::{Axes, Distortion, FramesError, Lens, PoseDirection, ReadOptions};
use glamx::{DPose3, DQuat, DVec3};
use rayon::prelude::*;
use sms_core::{InputError, read_color_size};
use std::path::{Path, PathBuf};

/// Resolution of the times, seconds: they have six decimals, and a difference of two is rounded.
const TIME_RESOLUTION_S: f64 = 1e-6;

struct Calibration {
    /// fx, fy, cx, cy of a 640 × 480 image unless read from a file.
    intrinsics: [f64; 4],
    distortion: [f64; 5],
}

/// Reads a text file's rows of words without comments, with their line numbers.
fn rows(path: &Path) -> Result<Vec<(usize, Vec<String>)>, FramesError> {
    let text = std::fs::read_to_string(path).map_err(|e| {
        InputError::new(
            "this file of a TUM RGB-D recording cannot be read",
            path,
            "a recording holds rgb.txt, depth.txt and, with poses, groundtruth.txt",
        )
        .because(e)
    })?;
    Ok(text
        .lines()
        .enumerate()
        .map(|(i, l)| (i + 1, l.split('#').next().unwrap_or_default()))
        .filter(|(_, l)| !l.trim().is_empty())
        .map(|(i, l)| {
            let words = l.split(|c: char| c.is_whitespace() || c == ',').filter(|w| !w.is_empty());
            (i, words.map(str::to_owned).collect())
        })
        .collect())
}

fn number(word: &str, path: &Path, line: usize) -> Result<f64, InputError> {
    word.parse::<f64>().ok().filter(|v| v.is_finite()).ok_or_else(|| {
        InputError::new(
            format!("line {line} holds \"{word}\" where a finite number should be"),
            path,
            "correct or remove this line",
        )
    })
}

fn read_list(path: &Path) -> Result<Vec<(f64, String)>, FramesError> {
    let mut list = Vec::new();
    for (line, words) in rows(path)? {
        let [time, file, ..] = words.as_slice() else {
            let cure = "correct or remove this line";
            return Err(InputError::new(format!("line {line} is not `time file`"), path, cure).into());
        };
        list.push((number(time, path, line)?, file.clone()));
    }
    list.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(list)
}

fn read_trajectory(path: &Path) -> Result<Vec<(f64, DPose3)>, FramesError> {
    let mut poses = Vec::new();
    for (line, words) in rows(path)? {
        let values = words.iter().map(|w| number(w, path, line)).collect::<Result<Vec<_>, _>>()?;
        let &[time, tx, ty, tz, qx, qy, qz, qw] = values.as_slice() else {
            let what = format!("line {line} has {} numbers instead of 8", values.len());
            return Err(InputError::new(what, path, "each line must be `time tx ty tz qx qy qz qw`").into());
        };
        let rotation = DQuat::from_xyzw(qx, qy, qz, qw);
        if (rotation.length() - 1.0).abs() > 5e-3 {
            let what = format!(
                "the pose in line {line} is not rigid: its quaternion has length {:.4}",
                rotation.length()
            );
            let cure = "export the trajectory again with unit quaternions in the order qx qy qz qw, or remove the \
                        line";
            return Err(InputError::new(what, path, cure).into());
        }
        poses.push((time, DPose3::from_parts(DVec3::new(tx, ty, tz), rotation.normalize())));
    }
    poses.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(poses)
}

/// Pairs indices, closest in time first, each used once, at most `max_gap` seconds apart; ordered by `a`.
fn associate(a: &[(f64, String)], b: &[(f64, String)], max_gap: f64) -> Vec<(usize, usize)> {
    let mut candidates: Vec<(f64, usize, usize)> = Vec::new();
    let max_gap = max_gap + TIME_RESOLUTION_S;
    for (i, (t, _)) in a.iter().enumerate() {
        let from = b.partition_point(|(s, _)| *s < t - max_gap);
        for (j, (s, _)) in b.iter().enumerate().skip(from).take_while(|(_, (s, _))| *s <= t + max_gap) {
            candidates.push(((s - t).abs(), i, j));
        }
    }
    candidates.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)).then(x.2.cmp(&y.2)));
    let (mut used_a, mut used_b) = (vec![false; a.len()], vec![false; b.len()]);
    let mut pairs = Vec::new();
    for (_, i, j) in candidates {
        if !used_a[i] && !used_b[j] {
            (used_a[i], used_b[j]) = (true, true);
            pairs.push((i, j));
        }
    }
    pairs.sort_unstable();
    pairs
}

/// Interpolates the pose at `time`, linear in position and spherical-linear in rotation; `None` outside the trajectory or in a gap
/// longer than `max_gap` seconds.
fn interpolate(trajectory: &[(f64, DPose3)], time: f64, max_gap: f64) -> Option<DPose3> {
    let after = trajectory.partition_point(|(t, _)| *t < time);
    let (t1, b) = trajectory.get(after)?;
    if *t1 == time {
        return Some(*b);
    }
    let (t0, a) = &trajectory[after.checked_sub(1)?];
    if t1 - t0 > max_gap + TIME_RESOLUTION_S {
        return None;
    }
    let s = (time - t0) / (t1 - t0);
    Some(DPose3::from_parts(a.translation.lerp(b.translation, s), a.rotation.slerp(b.rotation, s)))
}

/// Cameras with their published fx, fy, cx, cy and k1, k2, p1, p2, k3.
const PUBLISHED: [(&str, [f64; 4], [f64; 5]); 3] = [
    ("freiburg1", [517.3, 516.5, 318.6, 255.3], [0.2624, -0.9531, -0.0054, 0.0026, 1.1633]),
    ("freiburg2", [520.9, 521.0, 325.1, 249.7], [0.2312, -0.7849, -0.0033, -0.0001, 0.9172]),
    ("freiburg3", [535.4, 539.2, 320.1, 247.6], [0.0; 5]),
];
const DEFAULT: (&str, [f64; 4], [f64; 5]) = ("ROS default", [525.0, 525.0, 319.5, 239.5], [0.0; 5]);

/// Returns the published calibration of the camera that the folder's name mentions, else ROS's default.
fn published_calibration(dir: &Path) -> (Calibration, &'static str) {
    let full = std::fs::canonicalize(dir).unwrap_or_else(|_| dir.to_owned());
    let name = full.file_name().map(|n| n.to_string_lossy().to_lowercase()).unwrap_or_default();
    let (camera, intrinsics, distortion) =
        PUBLISHED.into_iter().find(|p| name.contains(p.0)).unwrap_or(DEFAULT);
    (Calibration { intrinsics, distortion }, camera)
}

/// Reads `fx fy cx cy [k1 k2 p1 p2 [k3]]` in one row, or a 3 × 3 matrix in three.
fn read_calibration(path: &Path) -> Result<Calibration, FramesError> {
    let mut table = Vec::new();
    for (line, words) in rows(path)? {
        table.push(words.iter().map(|w| number(w, path, line)).collect::<Result<Vec<_>, _>>()?);
    }
    if table.len() == 3 && table.iter().all(|r| r.len() == 3) {
        let intrinsics = [table[0][0], table[1][1], table[0][2], table[1][2]];
        return Ok(Calibration { intrinsics, distortion: [0.0; 5] });
    }
    match table.first().map(Vec::as_slice) {
        Some(&[fx, fy, cx, cy, ref rest @ ..]) if [0, 4, 5].contains(&rest.len()) => {
            let mut distortion = [0.0; 5];
            distortion[..rest.len()].copy_from_slice(rest);
            Ok(Calibration { intrinsics: [fx, fy, cx, cy], distortion })
        }
        _ => Err(InputError::new(
            "this calibration has an unknown layout",
            path,
            "write one line `fx fy cx cy k1 k2 p1 p2 k3` (distortion optional) or a 3 × 3 matrix in three lines",
        )
        .into()),
    }
}

pub(crate) fn open(dir: &Path, options: &ReadOptions) -> Result<Recording, FramesError> {
    let colors = read_list(&dir.join("rgb.txt"))?;
    let depths = read_list(&dir.join("depth.txt"))?;
    let trajectory_path = dir.join("groundtruth.txt");
    let has_poses = !options.ignore_poses && trajectory_path.is_file();
    let trajectory = if has_poses { read_trajectory(&trajectory_path)? } else { Vec::new() };
    let mut notices = Vec::new();

    let pairs = associate(&colors, &depths, options.max_pair_gap_s);
    let mut posed: Vec<(f64, PathBuf, PathBuf, DPose3)> = Vec::new();
    for &(i, j) in &pairs {
        let recorded = || interpolate(&trajectory, depths[j].0, options.max_pose_gap_s);
        if let Some(pose) = if has_poses { recorded() } else { Some(DPose3::identity()) } {
            posed.push((depths[j].0, dir.join(&colors[i].1), dir.join(&depths[j].1), pose));
        }
    }
    let Some(start) = posed.first().map(|p| p.0) else {
        let what = format!(
            "no frame has colour, depth and pose at the same time ({} colour, {} depth images, {} pairs, {} poses)",
            colors.len(),
            depths.len(),
            pairs.len(),
            trajectory.len()
        );
        let cure = "check that the three files use the same clock, or raise `read.max_pair_gap_s` and \
                    `read.max_pose_gap_s` (--set)";
        return Err(InputError::new(what, &trajectory_path, cure).into());
    };
    let images = colors.len();
    for (dropped, lack, key, limit_s) in [
        (images - pairs.len(), "no depth image", "max_pair_gap_s", options.max_pair_gap_s),
        (
            pairs.len() - posed.len(),
            "no pose: the poses around them are not",
            "max_pose_gap_s",
            options.max_pose_gap_s,
        ),
    ] {
        if dropped > 0 {
            notices.push(Notice {
                code: "frames_without_partner",
                message: format!("{dropped} of {images} colour images have {lack} within {limit_s} s"),
                cure: format!("to use more of them, raise the limit: `--set read.{key}={}`", 2.0 * limit_s),
            });
        }
    }

    let axes = options.axes.unwrap_or(Axes::Opencv);
    let poses = options.poses.unwrap_or(PoseDirection::CameraToWorld);
    let pixel_center = options.pixel_center.unwrap_or(0.0);
    let (calibration, source) = calibration(dir, options, &mut notices)?;
    let read: Vec<Result<RecordedFrame, FramesError>> = posed
        .into_par_iter()
        .map(|(time, color_path, depth_path, pose)| {
            let size = read_color_size(&color_path)?;
            let depth = depth_size(&depth_path)?;
            if depth != size && !options.depth_same_field_of_view {
                let cure = "register depth to colour, or use `--set read.depth_same_field_of_view=true` if both \
                            show the same field of view";
                return Err(not_registered(depth, size, &depth_path, cure).into());
            }
            if source.is_none() && size != (640, 480) {
                let what = format!("the image is {} × {}, for which no calibration is known", size.0, size.1);
                let cure = "write `fx fy cx cy k1 k2 p1 p2 k3` to intrinsics.txt in the recording's folder";
                return Err(InputError::new(what, &color_path, cure).into());
            }
            let file = source.as_deref().unwrap_or(dir);
            let intrinsics = checked_intrinsics(size, calibration.intrinsics, 0.5 - pixel_center, file)?;
            let color_lens = Lens { intrinsics, distortion: Distortion::from_opencv(calibration.distortion) };
            let depth_lens = Lens { intrinsics: intrinsics.scaled_to(depth.0, depth.1), ..color_lens };
            Ok(RecordedFrame {
                color_path,
                depth_path,
                mask_path: None,
                color_lens,
                depth_lens,
                x_rc: to_opencv(pose, axes, poses),
                pose_rounding: 0.0,
                time_s: Some(time - start),
            })
        })
        .collect();
    Ok(Recording {
        root: dir.to_owned(),
        format: RecordingFormat::TumRgbd,
        frames: read.into_iter().collect::<Result<Vec<_>, _>>()?,
        depth_unit_m: options.depth_unit_m.unwrap_or(1.0 / 5000.0),
        axes,
        poses,
        has_poses,
        pixel_center,
        world_up_r: None,
        world_is_aligned: false,
        notices,
        options: options.clone(),
    })
}

/// Returns the calibration and its file (`None` for published defaults, which hold at 640 × 480 only).
fn calibration(
    dir: &Path,
    options: &ReadOptions,
    notices: &mut Vec<Notice>,
) -> Result<(Calibration, Option<PathBuf>), FramesError> {
    let distortion = options.distortion;
    if let Some(intrinsics) = options.intrinsics {
        let calibration = Calibration { intrinsics, distortion: distortion.unwrap_or([0.0; 5]) };
        return Ok((calibration, Some(PathBuf::from("the read options"))));
    }
    for name in ["intrinsics.txt", "calibration.txt"] {
        let path = dir.join(name);
        if path.is_file() {
            let mut calibration = read_calibration(&path)?;
            calibration.distortion = distortion.unwrap_or(calibration.distortion);
            return Ok((calibration, Some(path)));
        }
    }
    let (mut calibration, name) = published_calibration(dir);
    calibration.distortion = distortion.unwrap_or(calibration.distortion);
    notices.push(Notice {
        code: "assumed_intrinsics",
        message: format!(
            "the recording has no calibration; the benchmark's published one is assumed ({name})"
        ),
        cure: "write `fx fy cx cy k1 k2 p1 p2 k3` to intrinsics.txt in the recording's folder".to_owned(),
    });
    Ok((calibration, None))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn association_takes_the_closest_pairs_once_each() {
        let list = |times: &[f64]| times.iter().map(|&t| (t, String::new())).collect::<Vec<_>>();
        // 0.108 is nearest to 0.105, so 0.1 is paired with 0.12; nothing is within reach of 0.3.
        assert_eq!(associate(&list(&[0.1, 0.108, 0.3]), &list(&[0.105, 0.12]), 0.02), [(0, 1), (1, 0)]);
        assert_eq!(associate(&list(&[0.1, 0.2]), &list(&[0.2001, 0.0999]), 0.0), []);
        // The limit is included, although the difference of these times is more than 0.02 by rounding.
        let pair = (list(&[1_305_031_102.008]), list(&[1_305_031_102.028]));
        assert_eq!(associate(&pair.0, &pair.1, 0.02), [(0, 0)]);
    }

    #[test]
    fn poses_are_interpolated_by_time_and_gaps_are_left_open() {
        let at = |x: f64, angle: f64| DPose3::from_parts(DVec3::X * x, DQuat::from_rotation_z(angle));
        let trajectory = [(0.0, at(0.0, 0.0)), (0.1, at(1.0, 0.8)), (5.0, at(2.0, 0.0))];
        let pose = interpolate(&trajectory, 0.025, 0.2).unwrap();
        assert!((pose.translation.x - 0.25).abs() < 1e-12);
        assert!(pose.rotation.angle_between(DQuat::from_rotation_z(0.2)) < 1e-9);
        assert!(interpolate(&trajectory, 1.0, 0.2).is_none(), "in a gap");
        assert!(
            interpolate(&trajectory, -0.1, 0.2).is_none() && interpolate(&trajectory, 6.0, 0.2).is_none()
        );
        assert!(interpolate(&trajectory, 5.0, 0.2).is_some(), "exactly at a pose");
        // Poses at 10 Hz: neighbours differ by 0.1 s and the rounding of the clock's time.
        let start = 1_305_031_102.175;
        let slow: Vec<_> = (0..100).map(|i| (start + 0.1 * f64::from(i), at(0.0, 0.0))).collect();
        let middles = slow.iter().map(|(t, _)| t + 0.05).take(99);
        assert!(middles.into_iter().all(|t| interpolate(&slow, t, 0.1).is_some()));
    }
}
